"""Pictures of a page, compressed: images of cameras and stacks of planes."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.bubbles.backlit_images import transmission
from sabench.algorithms.refocus import find_edge_on, refocus_on_surface, refocus_sum
from sabench.api import Observation
from sabench.apps.viewer.surroundings import rounded
from sabench.dataset.reader import Dataset
from sabench.dataset.schema import image_name
from sabench.geometry.grid import Grid
from sabench.plotting.pictures import join_blocks
from sabench.utils.arrays import F32, F64, U8, triple
from sabench.utils.progress import progress_bar

_PLANES = 40
_SLICE_PX, _LONGEST_PX = 480, 1024
_QUALITY, _LOWEST_QUALITY = 80, 20
_GAMMA = 0.5
_DARKEST, _BRIGHTEST = 20.0, 99.9  # percentiles shown as black and white
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True)
class Planes:
    """Position of a stack of parallel planes.

    Attributes
    ----------
    corner_mm : (3,) outer corner of the first plane's first pixel.
    across_mm, down_mm : (3,) edges of a plane, along its columns and its rows.
    step_mm : (3,) from a plane to the next one.
    """

    corner_mm: F64
    across_mm: F64
    down_mm: F64
    step_mm: F64


@dataclass(frozen=True)
class Stack:
    """Planes of the volume as pictures (plane, row, column) of grey values."""

    name: str
    place: Planes
    pictures: U8

    def describe(self) -> dict[str, Any]:
        """Describe the stack as the page's JSON holds it."""
        return {
            "name": self.name,
            "corner": rounded(self.place.corner_mm),
            "across": rounded(self.place.across_mm),
            "down": rounded(self.place.down_mm),
            "step": rounded(self.place.step_mm, 6),
            "planes": [compress(one, _QUALITY) for one in self.pictures],
        }


def compress(grey: U8, quality: int) -> str:
    """Compress a grey picture (row, column) to a URL that holds it."""
    import cv2

    _, data = cv2.imencode(".webp", grey, [cv2.IMWRITE_WEBP_QUALITY, quality])
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()


def camera_pictures(
    data: Dataset, frames: Sequence[int], most_bytes: int
) -> tuple[dict[int, list[str]], bool]:
    """Compress every camera's image of as many frames as fit, by frame.

    The quality of the first frame falls until its images fit. Says also whether all frames did.
    """
    pictures: dict[int, list[str]] = {}
    for frame in progress_bar(frames, "images"):
        grey = [*_grey_images(data, frame)]
        quality, own = _QUALITY, [compress(one, _QUALITY) for one in grey]
        while not pictures and sum(map(len, own)) > most_bytes and quality > _LOWEST_QUALITY:
            quality -= 20
            own = [compress(one, quality) for one in grey]
        most_bytes -= sum(map(len, own))
        if most_bytes < 0:
            return pictures, False
        pictures[frame] = own
    return pictures, True


def has_images(data: Dataset) -> bool:
    """Return whether a data set has images; that of a target may have none."""
    first = image_name(data.setup.cameras[0].name, 0, "tif")
    return first in data.contents.files or data.references is not None


def is_bright(data: Dataset) -> bool:
    """Return whether images are bright, with dark objects, as before a backlight."""
    levels = data.setup.sensor
    middle = (levels.black_dn + levels.white_dn) / 2.0
    return has_images(data) and float(np.median(data.raw_image(0, 0))) > middle


def _grey_images(data: Dataset, frame: int) -> Iterator[U8]:
    """Scale a frame's images to 8 bits; dim particles are raised."""
    images = np.stack([data.raw_image(n, frame) for n in range(len(data.setup.cameras))])
    light = images.astype(np.float32) - np.float32(data.setup.sensor.black_dn)
    top = np.percentile(light, _BRIGHTEST)
    block = -(-max(images.shape[1:]) // _LONGEST_PX)
    grey = _grey(light, 0.0, float(max(top, 1.0)), 1.0 if is_bright(data) else _GAMMA)
    yield from join_blocks(grey, block)


def _grey(values: F32, low: float, high: float, gamma: float) -> U8:
    share = np.clip((values - np.float32(low)) / np.float32(max(high - low, 1e-12)), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * share**gamma), dtype=np.uint8)


def refocused_stack(data: Dataset, frame: int) -> Stack:
    """Refocus a frame on planes through the volume, at right angles to the view."""
    case, backlit = data.observation(frame), is_bright(data)
    images = transmission(case) if backlit else case.normalised_images()
    axis, sign = _viewing_axis(case)
    if axis == 2 and find_edge_on(case.cameras, case.grid) is None:
        planes, place = _by_slabs(case, images)
    else:
        planes, place = _plane_by_plane(case, images, axis, sign)
    low, high = np.percentile(planes, [1.0 if backlit else _DARKEST, _BRIGHTEST])
    grey = _grey(planes, float(low), float(high), 1.0 if backlit else _GAMMA)
    return Stack("refocused images", place, grey)


def volume_stack(volume: F32, grid: Grid) -> Stack:
    """Join the planes of a reconstruction (z, y, x) to as many as a page holds."""
    thick = -(-volume.shape[0] // _PLANES)
    block = -(-max(volume.shape[1:]) // _SLICE_PX)
    padded = np.pad(volume, ((0, -len(volume) % thick), (0, 0), (0, 0)))
    joined = join_blocks(padded.reshape(-1, thick, *volume.shape[1:]).max(axis=1), block)
    (low, high), step = grid.box_mm, thick * grid.voxel_mm[2]
    corner = low + step / 2.0 * _Z
    place = Planes(corner, (high - low) * _X, (high - low) * _Y, step * _Z)
    # find the value shown as white; few voxels may be bright at all
    bright = joined[joined > 0.0]
    white = float(np.percentile(bright, _BRIGHTEST)) if bright.size else 1.0
    return Stack("reconstruction", place, _grey(joined, 0.0, white, _GAMMA))


def _viewing_axis(case: Observation) -> tuple[int, int]:
    """Find the axis of the world that the cameras look along, and the sign."""
    middles = [np.array([[one.columns / 2.0, one.rows / 2.0]]) for one in case.cameras]
    rays = [one.back_project(at) for one, at in zip(case.cameras, middles, strict=True)]
    mean = np.nanmean([one.directions[0] for one in rays], axis=0)
    axis = int(np.argmax(np.abs(mean)))
    return axis, -1 if mean[axis] < 0.0 else 1


def _by_slabs(case: Observation, images: F32) -> tuple[F32, Planes]:
    """Refocus planes of constant Z, at the data set's voxels where they are small."""
    low, high = case.grid.box_mm
    size, voxel = high - low, min(case.grid.voxel_mm[:2])
    pixel = max(float(size[:2].max()) / _SLICE_PX, voxel)
    finer = max(1, int(pixel / voxel))
    columns, rows = (max(1, round(float(edge / pixel * finer))) for edge in size[:2])
    shape = min(_PLANES, case.grid.shape[0]), rows, columns
    edges = size / shape[::-1]
    grid = Grid(triple(low + edges / 2.0), triple(edges), shape)
    planes = join_blocks(refocus_sum(images, case.cameras, grid), finer)
    place = Planes(low + edges[2] / 2.0 * _Z, size * _X, size * _Y, edges[2] * _Z)
    return planes, place


def _plane_by_plane(case: Observation, images: F32, axis: int, sign: int) -> tuple[F32, Planes]:
    """Refocus planes of any orientation, coarser: each point is projected on its own."""
    low, high = case.grid.box_mm
    place = _place_planes(low, high, axis, sign)
    edges = place.down_mm, place.across_mm
    pixel = 2.0 * max(np.linalg.norm(one) for one in edges) / _SLICE_PX
    rows, columns = (
        (np.arange(count) + 0.5) / count
        for count in (max(2, round(float(np.linalg.norm(one) / pixel))) for one in edges)
    )
    first = place.corner_mm + rows[:, None, None] * edges[0] + columns[:, None] * edges[1]
    made = [
        refocus_on_surface(images, case.cameras, first + n * place.step_mm, "additive").values
        for n in progress_bar(range(_PLANES), "planes")
    ]
    return np.nan_to_num(np.stack(made)), place


def _place_planes(low_mm: F64, high_mm: F64, axis: int, sign: int) -> Planes:
    """Place planes across an axis of a box; their front faces the cameras."""
    size, ahead = high_mm - low_mm, sign * np.eye(3)[axis]
    down = _Z if axis == 1 else _Y
    across = np.cross(down, ahead)
    edges = abs(size @ across) * across, abs(size @ down) * down
    step = ahead * size[axis] / _PLANES
    middle = (low_mm + high_mm) / 2.0 - (_PLANES - 1) / 2.0 * step
    return Planes(middle - (edges[0] + edges[1]) / 2.0, *edges, step)
