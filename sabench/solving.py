"""Run a solver on the observation side of a data set, and weigh what it cost."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any

import numpy as np

from sabench import plugins
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
    _forget_peak()
    resolved = algorithm.parameters.model_dump(mode="json")
    with result_writer(Path(out), data, solver, resolved, overwrite=overwrite) as writer:
        for frame in range(data.rig.frames):
            case = data.observation(frame)
            start = time.perf_counter()
            guess = _attempt(algorithm, solver, case, frame)
            seconds.append(time.perf_counter() - start)
            writer.add(frame, guess)
        writer.set_cost(float(np.mean(seconds)), _peak_mb())
    return open_result(out, data)


def make_solver(name: str, parameters: dict[str, Any]) -> Solver:
    """A solver with checked parameters."""
    plugin = plugins.load("solvers", name)
    made: Solver = plugin(validate(plugin.Parameters, parameters, f"solver {name}"))
    return made


def _attempt(algorithm: Solver, name: str, case: Observation, frame: int) -> Reconstruction:
    """One call of a solver, which may do anything; what it returns is checked here."""
    reason = algorithm.skip(case)
    if reason:
        raise InputError(f"solver {name} declines this case: {reason}")
    try:
        guess = algorithm.solve(case)
    except Exception as error:
        raise InputError(f"solver {name} failed on frame {frame}: {type(error).__name__}: {error}") from error
    if not isinstance(guess, Reconstruction) or not isinstance(guess.volume, np.ndarray):
        raise InputError(f"solver {name}: expected a Reconstruction with an array, got {type(guess).__name__}")
    if guess.volume.shape != case.grid.shape or guess.volume.dtype != np.float32:
        raise InputError(
            f"solver {name}: expected a float32 volume of shape {case.grid.shape}, got {guess.volume.dtype} of shape {guess.volume.shape}"
        )
    if not np.isfinite(guess.volume).all():
        raise InputError(f"solver {name}: expected finite intensities, got NaN or infinite ones in frame {frame}")
    return guess


def _forget_peak() -> None:
    """Start the process's memory high-water mark anew, where the system can (Linux)."""
    marks = Path("/proc/self/clear_refs")
    if marks.exists():
        try:
            marks.write_text("5")
        except OSError:
            return  # not permitted in some containers: the peak then covers the whole process, which is an upper bound


def _peak_mb() -> float:
    """Peak resident memory of this process in MB (10^6 bytes)."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # macOS counts bytes
