"""Run a solver on the observation side of a data set, and weigh what it cost."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from sabench import memory, plugins
from sabench.api import Observation, Reconstruction, Solver
from sabench.dataset.read import Dataset, open_dataset
from sabench.dataset.result import Result, open_result, result_writer
from sabench.errors import InputError
from sabench.scene import validate


def solve(
    solver: str, dataset: Dataset | str | Path, out: str | Path, *, parameters: dict[str, Any] | None = None, overwrite: bool = False
) -> Result:
    """Run a solver on every frame of a data set and write its result file.

    Parameters
    ----------
    solver : its name.
    out : the result file to make.
    parameters : of the solver; the others keep their defaults.
    overwrite : replace an existing result.

    Raises
    ------
    InputError
        An unknown solver or parameter, a broken data set, or a solver that declines, raises, or returns a wrong shape or values that are not finite.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    algorithm = make_solver(solver, parameters or {})
    seconds = []
    memory.forget_peak()
    resolved = algorithm.parameters.model_dump(mode="json")
    with result_writer(Path(out), data, solver, resolved, overwrite=overwrite) as writer:
        for frame in range(data.rig.frames):
            case = data.observation(frame)
            start = time.perf_counter()
            guess = _attempt(algorithm, solver, case, frame)
            seconds.append(time.perf_counter() - start)
            writer.add(frame, guess)
            del case, guess
            memory.trim()
        writer.set_cost(float(np.mean(seconds)), memory.peak_mb())
    return open_result(out, data)


def make_solver(name: str, parameters: dict[str, Any]) -> Solver:
    """A solver with checked parameters."""
    plugin = plugins.load("solvers", name)
    made: Solver = plugin(validate(plugin.Parameters, parameters, f"solver {name}"))
    return made


def _attempt(algorithm: Solver, name: str, case: Observation, frame: int) -> Reconstruction:
    """One call of a solver, which may do anything; what it returns is checked here."""
    try:
        reason = algorithm.skip(case)
        guess = None if reason else algorithm.solve(case)
    except Exception as error:
        raise InputError(f"solver {name} failed on frame {frame}: {type(error).__name__}: {error}") from error
    if reason:
        raise InputError(f"solver {name} declines this case: {reason}")
    if not isinstance(guess, Reconstruction):
        raise InputError(f"solver {name}: expected a Reconstruction, got {type(guess).__name__}")
    _check_array(name, frame, "volume", guess.volume, np.dtype(np.float32), case.grid.shape)
    if guess.particles_mm is not None:
        _check_array(name, frame, "particles_mm", guess.particles_mm, np.dtype(np.float64), (len(guess.particles_mm), 3))
    return guess


def _check_array(solver: str, frame: int, what: str, array: Any, kind: np.dtype[Any], shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != kind:
        got = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise InputError(f"solver {solver}: {what}: expected {kind} of shape {shape}, got {got}")
    if not np.isfinite(array).all():
        raise InputError(f"solver {solver}: {what}: expected finite values, got NaN or infinite ones in frame {frame}")
