"""The reconstruction track: one observation in, one volume out, frame by frame."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np

from sabench.api import Observation, Reconstruction, Solver
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.geometry.visibility import any_in_view
from sabench.metrics.averages import mean_of_each
from sabench.metrics.reconstruction_error import score_frame
from sabench.plotting import pictures
from sabench.tasks.reconstruction_scores import estimate
from sabench.tasks.solver_call import attempt
from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.progress import track

# float32 volumes that fit beside the images or the solver is not started: its own, and as much
# again for its work and the checks
_VOLUMES = 2.0
_TRIED = 33  # voxels along each axis that are looked for in the images


def run(algorithm: Solver, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
    """Reconstruct every frame; returns the seconds that each took.

    Raises
    ------
    InputError
        A frame that `check_case` refuses, or a solver that declines, raises, or returns a wrong
        shape or values that are not finite.
    """
    seconds = []
    for frame in range(data.rig.frames):
        guess, took = reconstruct(algorithm, name, data, frame)
        seconds.append(took)
        writer.add(frame, guess)
        del guess
        memory.trim()
    return seconds


def reconstruct(
    algorithm: Solver, name: str, data: Dataset, frame: int
) -> tuple[Reconstruction, float]:
    """One frame, and the seconds that it took; raises as `run` does."""
    case = data.observation(frame)
    check_case(case, f"{data.root}: frame {frame}")
    start = time.perf_counter()
    guess = _attempt(algorithm, name, case, frame)
    return guess, time.perf_counter() - start


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write every frame of a foreign result anew; reading checks it."""
    for frame in range(data.rig.frames):
        writer.add(frame, result.reconstruction(frame))
        memory.trim()


def score_result(data: Dataset, result: Result | str) -> dict[str, float | None]:
    """All scores: the means over the frames that have the figure."""
    frames = [
        score_frame(
            data.rig.grid, data.particles(frame), data.views(frame), estimate(data, result, frame)
        )
        for frame in track(range(data.rig.frames), "score")
    ]
    return mean_of_each(frames)


def images(data: Dataset) -> bytes:
    """What the cameras saw, as a PNG."""
    seen = data.observation(0)
    return pictures.montage(seen.images, seen.black_dn, seen.white_dn)


def picture(data: Dataset, result: Result | str) -> bytes:
    """A slice of an estimate, or of the truth, as a PNG."""
    return pictures.slice_picture(estimate(data, result, 0).volume, data.rig.grid.scored)


def error_picture(data: Dataset, result: Result) -> bytes:
    """The same slice of an estimate minus the truth, as a PNG."""
    return pictures.error_slice(
        estimate(data, result, 0).volume, estimate(data, "truth", 0).volume, data.rig.grid.scored
    )


def check_case(case: Observation, source: str) -> None:
    """Refuse what no algorithm can make anything of; `source` is named in errors. A black image passes: a camera may be covered.

    Raises
    ------
    InputError
        An image that is saturated all over, a grid that does not fit into memory, or one that no
        camera sees.
    """
    for camera, image in zip(case.cameras, case.images, strict=True):
        if image.min() >= case.white_dn:
            raise InputError(
                f"{source}: {camera.name}: expected an image that shows something, but every pixel is saturated ({case.white_dn:g} or more)"
            )
    _check_memory(case, source)
    axes = [
        axis[np.unique(np.linspace(0, len(axis) - 1, _TRIED).astype(int))]
        for axis in case.grid.axes_mm
    ]
    if not any_in_view(case.cameras, np.array(list(itertools.product(*axes)))):
        raise InputError(
            f"{source}: grid: expected it in view of at least one camera, but no camera of {len(case.cameras)} sees any of it"
        )


def _check_memory(case: Observation, source: str) -> None:
    """What a solver needs at least: `_VOLUMES` and the images as float32."""
    there, images = memory.available_mb(), case.images.size * 4 / 1e6
    (planes, rows, columns), voxel = case.grid.shape, _VOLUMES * 4 / 1e6
    need = images + planes * rows * columns * voxel
    if there is None or need <= there:
        return
    voxels = max(0, int((there - images) / voxel))
    largest = (
        f"{voxels // (rows * columns)} of its planes"
        if voxels >= rows * columns
        else f"{voxels} of its voxels"
    )
    raise InputError(
        f"{source}: grid: expected it to fit into memory, but its {planes} x {rows} x {columns} voxels (z, y, x) need {need:.0f} MB "
        f"where {there:.0f} MB are there: at most {largest} fit"
    )


def _attempt(algorithm: Solver, name: str, case: Observation, frame: int) -> Reconstruction:
    """One call of a solver, which may do anything; what it returns is checked here."""
    guess: Reconstruction = attempt(algorithm, name, case, Reconstruction, f" on frame {frame}")
    check_array(name, frame, "volume", guess.volume, np.dtype(np.float32), case.grid.shape)
    if guess.particles_mm is not None:
        check_array(
            name,
            frame,
            "particles_mm",
            guess.particles_mm,
            np.dtype(np.float64),
            (len(guess.particles_mm), 3),
        )
    return guess


def check_array(
    solver: str, frame: int, what: str, array: Any, kind: np.dtype[Any], shape: tuple[int, ...]
) -> None:
    """Refuse an array of another kind or shape, or one with values that are not finite."""
    if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != kind:
        got = (
            f"{array.dtype} of shape {array.shape}"
            if isinstance(array, np.ndarray)
            else type(array).__name__
        )
        raise InputError(f"solver {solver}: {what}: expected {kind} of shape {shape}, got {got}")
    if not np.isfinite(array).all():
        raise InputError(
            f"solver {solver}: {what}: expected finite values, got NaN or infinite ones in frame {frame}"
        )
