"""Task `see_through`: solvers turn one observation into a stack of planes.

A code behind bubbles is to be read in the planes.
"""

import numpy as np
from scipy.spatial import cKDTree

from sabench.api import Code, Reconstruction
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.geometry.grid import Grid
from sabench.metrics.code_reading import (
    compare_with_single_views,
    read_right,
    read_volume,
    single_views,
)
from sabench.plotting import pictures
from sabench.tasks.reconstruction import VolumeTask
from sabench.tasks.task import ANY, PERCENT, Captions, Figures, Gate, Score, Source
from sabench.utils.arrays import F32, F64, I64
from sabench.worlds.bubbles_and_bodies import code_of


class SeeThroughTask(VolumeTask):
    """Reading of a code through the bubbles in front of it."""

    name = "see_through"
    shown = "code"
    # fmt: off
    scores = (
        Score("read_percent", "larger", 1, "share of correctly read cells of a code behind "
              "bubbles, in its plane; guessing gives 50", counted=True, range=PERCENT),
        Score("separation", "larger", 2, "difference of the mean bright and dark cells over their "
              "scatter", heading="d'", range=ANY),
        Score("contrast", "larger", 3, "difference of these means over their sum", range=ANY),
        Score("single_percent", "steady", 1, "read % of single images, mean over the cameras",
              heading="single views, read %", range=PERCENT),
        Score("best_single_percent", "steady", 1,
              "read % of the best single image", heading="best view, read %", range=PERCENT),
        Score("single_separation", "steady", 2,
              "d' of single images, mean over the cameras", heading="single views, d'", range=ANY),
    )
    # fmt: on
    sufficient = 90.0
    gate = Gate("read_percent", 60.0)
    picture_has_truth = True
    captions = Captions(
        heading="The code's plane",
        estimates="The plane of the stack that contains the code behind the bubbles, each with its "
        "own brightness scale.",
        cameras="First frame of every camera.",
        errors="The code in black and white; orange cells are dark and read as bright, blue ones "
        "bright and read as dark.",
    )

    def truth(self, data: Dataset, frame: int) -> Reconstruction:
        """Make planes that are bright where the code is."""
        code, volume = _code(data, frame), np.zeros(data.setup.grid.shape, dtype=np.float32)
        return Reconstruction(_brighten(data.setup.grid, volume, code, 1.0))

    def wrong(self, data: Dataset, frame: int) -> Reconstruction:
        """Make noise that is darker where the code is dark."""
        rng = np.random.default_rng(frame)
        volume = rng.random(data.setup.grid.shape, dtype=np.float32)
        return Reconstruction(_brighten(data.setup.grid, volume, _code(data, frame), 0.5))

    def _score_frame(self, data: Dataset, source: Source, frame: int) -> Figures:
        code = _code(data, frame)
        images = data.observation(frame).images
        single = single_views(images, data.true_cameras, code.points_mm)
        return {**compare_with_single_views(self._cells(data, source, frame), single, code.dark)}

    def _cells(self, data: Dataset, source: Source, frame: int) -> F64:
        """Average the brightness (cell,) of each cell in the planes; the truth is exact."""
        code = _code(data, frame)
        if source == "truth":
            return np.where(code.dark, 0.0, 1.0)
        if source == "empty":
            return np.zeros(len(code.dark))
        return read_volume(data.setup.grid, self.read(data, source, frame).volume, code.points_mm)

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw the code's plane in an estimate, or the code itself, as a PNG."""
        code = _code(data, 0)
        if not isinstance(source, Result):
            return pictures.grey_picture(np.where(code.dark[_nearest(code)], 0.0, 1.0))
        plane = code_plane(data.setup.grid, self.read(data, source, 0).volume, code)
        return pictures.grey_picture(plane)

    def error_picture(self, data: Dataset, result: Result) -> bytes:
        """Draw the cells of the code that are read wrong, as a PNG."""
        code = _code(data, 0)
        right, where = read_right(self._cells(data, result, 0), code.dark), _nearest(code)
        return pictures.read_picture(code.dark[where], right[where])


def _code(data: Dataset, frame: int) -> Code:
    return code_of(data.scene, data.manifest.seed, frame)


def _brighten(grid: Grid, volume: F32, code: Code, light: float) -> F32:
    """Add light to a volume's voxels (z, y, x) where the code is bright; return it."""
    points = code.points_mm[~code.dark].reshape(-1, 3)
    voxels = np.rint(grid.to_voxels(points)).astype(np.int64)
    x, y, z = voxels[((voxels >= 0) & (voxels < grid.shape[::-1])).all(axis=1)].T
    volume[z, y, x] += np.float32(light)
    return volume


def code_plane(grid: Grid, volume: F32, code: Code) -> F64:
    """Cut a volume's plane (y, x) nearest to the code's middle, limited to the code."""
    voxels, size = grid.to_voxels(code.points_mm.reshape(-1, 3)), np.asarray(volume.shape[::-1])
    low, high = (
        np.clip(np.rint(end), 0, size - 1).astype(int)
        for end in (voxels.min(axis=0), voxels.max(axis=0))
    )
    middle = int(np.clip(np.rint(voxels[:, 2].mean()), 0, size[2] - 1))
    return np.asarray(volume[middle, low[1] : high[1] + 1, low[0] : high[0] + 1], dtype=np.float64)


def _nearest(code: Code) -> I64:
    """Find the cell (rows, columns) nearest to each pixel of a picture along Z."""
    middles = code.points_mm.mean(axis=1)[:, :2]
    low, high = (end(code.points_mm.reshape(-1, 3)[:, :2], axis=0) for end in (np.min, np.max))
    sides = np.rint((high - low) / (high - low).max() * pictures.ENLARGED_PX)
    columns, rows = np.maximum(1, sides).astype(int)
    x, y = np.meshgrid(np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows))
    nearest = cKDTree(middles).query(np.column_stack([x.ravel(), y.ravel()]))[1]
    return np.asarray(nearest).reshape(rows, columns)


TASK = SeeThroughTask()
