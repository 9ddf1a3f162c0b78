"""The see-through track: one observation in, planes out, in which a code behind bubbles is to be read."""

from __future__ import annotations

import time

import numpy as np
from scipy.spatial import cKDTree

from sabench.api import Code, Reconstruction, SeeThroughSolver
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.geometry.grid import Grid
from sabench.metrics.averages import mean_of_each
from sabench.metrics.code_reading import (
    compare_with_single_views,
    read_right,
    read_volume,
    single_views,
)
from sabench.plotting import pictures
from sabench.tasks.reconstruction import check_array, check_case
from sabench.tasks.solver_call import attempt
from sabench.utils import memory
from sabench.utils.arrays import F32, F64, I64
from sabench.utils.progress import track
from sabench.worlds.readable_codes import code_of

_ENLARGED_PX, _DRAWN_PX = 400, 200  # longer side of a picture, and of the code itself
_MARGIN = 3.0  # voxels around the code that are shown


def run(algorithm: SeeThroughSolver, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
    """Look through every frame; returns the seconds that each took.

    Raises
    ------
    InputError
        A frame that shows nothing, or a solver that declines, raises, or returns a wrong shape or
        values that are not finite.
    """
    seconds = []
    for frame in range(data.rig.frames):
        case = data.observation(frame)
        check_case(case, f"{data.root}: frame {frame}")
        start = time.perf_counter()
        guess: Reconstruction = attempt(algorithm, name, case, Reconstruction, f" on frame {frame}")
        seconds.append(time.perf_counter() - start)
        check_array(name, frame, "volume", guess.volume, np.dtype(np.float32), case.grid.shape)
        writer.add(frame, guess)
        memory.trim()
    return seconds


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write every frame of a foreign result anew; reading checks it."""
    for frame in range(data.rig.frames):
        writer.add(frame, result.reconstruction(frame))
        memory.trim()


def score_result(data: Dataset, result: Result | str) -> dict[str, float | None]:
    """All scores: means over the frames; what single cameras show is there to compare with."""
    return mean_of_each(
        [_score_frame(data, result, frame) for frame in track(range(data.rig.frames), "score")]
    )


def _score_frame(data: Dataset, result: Result | str, frame: int) -> dict[str, float]:
    code = code_of(data.scene, data.manifest.seed, frame)
    single = single_views(data.observation(frame).images, data.true_cameras, code.points_mm)
    return compare_with_single_views(_cells(data, result, frame, code), single, code.dark)


def _cells(data: Dataset, result: Result | str, frame: int, code: Code) -> F64:
    """Mean brightness (cell,) of each cell: in a result's planes, or what the word `truth` or `empty` stands for."""
    if not isinstance(result, Result):
        return np.where(code.dark, 0.0, 1.0) if result == "truth" else np.zeros(len(code.dark))
    return read_volume(data.rig.grid, result.reconstruction(frame).volume, code.points_mm)


def images(data: Dataset) -> bytes:
    """What the cameras saw, as a PNG."""
    seen = data.observation(0)
    return pictures.backlit(seen.images, seen.black_dn, seen.white_dn)


def picture(data: Dataset, result: Result | str) -> bytes:
    """The code's plane in an estimate, or the code itself, as a PNG."""
    code = code_of(data.scene, data.manifest.seed, 0)
    if not isinstance(result, Result):
        return pictures.grey_picture(drawn(code), _ENLARGED_PX)
    return pictures.grey_picture(
        code_plane(data.rig.grid, result.reconstruction(0).volume, code), _ENLARGED_PX
    )


def error_picture(data: Dataset, result: Result) -> bytes:
    """Which cells of the code are read wrong, as a PNG."""
    code = code_of(data.scene, data.manifest.seed, 0)
    right, where = read_right(_cells(data, result, 0, code), code.dark), _nearest(code)
    return pictures.read_picture(code.dark[where], right[where])


def code_plane(grid: Grid, volume: F32, code: Code) -> F64:
    """The plane (y, x) of a volume that is nearest to the code's middle, as far as the code reaches."""
    places, size = grid.to_voxels(code.points_mm.reshape(-1, 3)), np.asarray(volume.shape[::-1])
    low, high = (
        np.clip(np.rint(end), 0, size - 1).astype(int)
        for end in (places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN)
    )
    middle = int(np.clip(np.rint(places[:, 2].mean()), 0, size[2] - 1))
    return np.asarray(volume[middle, low[1] : high[1] + 1, low[0] : high[0] + 1], dtype=np.float64)


def drawn(code: Code) -> F64:
    """The code as it is, seen along Z."""
    return np.where(code.dark[_nearest(code)], 0.0, 1.0)


def _nearest(code: Code) -> I64:
    """The cell (rows, columns) that is nearest to each pixel of a picture along Z."""
    middles = code.points_mm.mean(axis=1)[:, :2]
    low, high = (end(code.points_mm.reshape(-1, 3)[:, :2], axis=0) for end in (np.min, np.max))
    columns, rows = np.maximum(1, np.rint((high - low) / (high - low).max() * _DRAWN_PX)).astype(
        int
    )
    x, y = np.meshgrid(np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows))
    return np.asarray(cKDTree(middles).query(np.column_stack([x.ravel(), y.ravel()]))[1]).reshape(
        rows, columns
    )
