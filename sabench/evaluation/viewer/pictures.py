"""Pictures of a page, compressed: images of cameras and stacks of planes."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.bubbles import transmission
from sabench.algorithms.refocus import find_edge_on, refocus_on_surface, refocus_sum
from sabench.api import Observation
from sabench.dataset.reader import Dataset
from sabench.dataset.schema import image_name
from sabench.evaluation.viewer.surroundings import rounded
from sabench.geometry.grid import Grid
from sabench.plotting.pictures import join_blocks
from sabench.utils.arrays import F32, F64, U8
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_PLANES = 40
_SLICE_PX, _LONGEST_PX = 480, 1024
_QUALITY, _LOWEST_QUALITY = 80, 20
_GAMMA = 0.5
_BRIGHTEST = 99.9  # percentile shown as white


@dataclass(frozen=True)
class Stack:
    """Planes of the volume as pictures.

    Attributes
    ----------
    name : what they show.
    corner_mm : (3,) of the first plane's first pixel, at its outer corner.
    across_mm, down_mm : (3,) edges of a plane.
    step_mm : (3,) from a plane to the next one.
    planes : (plane, row, column) grey values.
    """

    name: str
    corner_mm: F64
    across_mm: F64
    down_mm: F64
    step_mm: F64
    planes: U8

    def describe(self) -> dict[str, Any]:
        """Describe the stack as the page's JSON holds it."""
        return {
            "name": self.name,
            "corner": rounded(self.corner_mm),
            "across": rounded(self.across_mm),
            "down": rounded(self.down_mm),
            "step": rounded(self.step_mm, 6),
            "planes": [compress(one, _QUALITY) for one in self.planes],
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
    """Return whether a data set has images; those of targets may have pixels of points alone."""
    first = image_name(data.setup.cameras[0].name, 0, "tif")
    return first in data.contents.files or data.references is not None


def is_bright(data: Dataset) -> bool:
    """Return whether the images are bright, with dark objects or marks."""
    return "bubbles" in data.shows or data.shows_target


def _grey_images(data: Dataset, frame: int) -> Iterator[U8]:
    """Scale a frame's images to 8 bits: backlit ones as they are, dim particles raised."""
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
    """Refocus a frame on planes through the volume, at right angles to the view.

    Raises
    ------
    InputError
        No image shows anything.
    """
    case, backlit = data.observation(frame), "bubbles" in data.shows
    images = transmission(case) if backlit else case.normalised_images()
    axis, sign = _viewing_axis(case)
    if axis == 2 and find_edge_on(case.cameras, case.grid) is None:
        stack = _by_slabs(case, images)
    else:
        stack = _plane_by_plane(case, images, axis, sign)
    return _as_stack("refocused images", *stack, backlit=backlit)


def volume_stack(volume: F32, grid: Grid) -> Stack:
    """Join the planes of a reconstruction (z, y, x) to as many as a page holds."""
    thick = -(-volume.shape[0] // _PLANES)
    block = -(-max(volume.shape[1:]) // _SLICE_PX)
    padded = np.pad(volume, ((0, -len(volume) % thick), (0, 0), (0, 0)))
    joined = padded.reshape(-1, thick, *volume.shape[1:]).max(axis=1)
    low = np.asarray(grid.low_mm) - np.asarray(grid.voxel_mm) / 2.0
    low[2] += thick * grid.voxel_mm[2] / 2.0
    size = np.asarray(grid.voxel_mm) * grid.shape[::-1]
    edges = [size[0] * np.eye(3)[0], size[1] * np.eye(3)[1], thick * grid.voxel_mm[2] * np.eye(3)[2]]
    return _as_stack("reconstruction", join_blocks(joined, block), low, *edges, backlit=False)


def _as_stack(
    name: str, planes: F32, corner: F64, across: F64, down: F64, step: F64, *, backlit: bool
) -> Stack:
    low, high = np.percentile(planes, [1.0 if backlit else 20.0, _BRIGHTEST])
    grey = _grey(planes, float(low), float(high), 1.0 if backlit else _GAMMA)
    return Stack(name, corner, across, down, step, grey)


def _viewing_axis(case: Observation) -> tuple[int, int]:
    """Find the axis of the world that the cameras look along, and the sign."""
    middles = np.array([[[one.columns / 2.0, one.rows / 2.0]] for one in case.cameras])
    rays = [one.back_project(at) for one, at in zip(case.cameras, middles, strict=True)]
    mean = np.nanmean([one.directions[0] for one in rays], axis=0)
    axis = int(np.argmax(np.abs(mean)))
    return axis, -1 if mean[axis] < 0.0 else 1


_Planes = tuple[F32, F64, F64, F64, F64]


def _by_slabs(case: Observation, images: F32) -> _Planes:
    """Refocus planes of constant Z; they are joined from planes of the data set's voxels."""
    low, high = case.grid.box_mm
    size = high - low
    pixel = max(float(size[:2].max()) / _SLICE_PX, min(case.grid.voxel_mm[:2]))
    finer = max(1, int(pixel / min(case.grid.voxel_mm[:2])))
    counts = np.maximum(np.rint(size[:2] / pixel * finer), 1.0)
    planes = min(_PLANES, case.grid.shape[0])
    voxel = np.array([*(size[:2] / counts), size[2] / planes])
    grid = Grid(tuple(low + voxel / 2.0), tuple(voxel), (planes, int(counts[1]), int(counts[0])))
    stack = join_blocks(refocus_sum(images, case.cameras, grid), finer)
    corner = low + [0.0, 0.0, voxel[2] / 2.0]
    return stack, corner, *(length * one for length, one in zip((size[0], size[1], voxel[2]), np.eye(3), strict=True))


def _plane_by_plane(case: Observation, images: F32, axis: int, sign: int) -> _Planes:
    """Refocus planes of any orientation, coarser: each point is projected on its own."""
    low, high = case.grid.box_mm
    size = high - low
    across, down = _plane_axes(axis, sign)
    shape = [int(np.clip(abs(size @ one) / size.max() * _SLICE_PX / 2, 2, None)) for one in (down, across)]
    step = sign * np.eye(3)[axis] * size[axis] / _PLANES
    corner = (low + high) / 2.0 - (abs(size @ across) * across + abs(size @ down) * down) / 2.0
    corner = corner - (_PLANES - 1) / 2.0 * step
    edges = abs(size @ across) * across, abs(size @ down) * down
    rows, columns = ((np.arange(count) + 0.5) / count for count in shape)
    plane = corner + rows[:, None, None] * edges[1] + columns[:, None] * edges[0]
    made = [
        refocus_on_surface(images, case.cameras, plane + n * step, "additive").values
        for n in progress_bar(range(_PLANES), "planes")
    ]
    return np.nan_to_num(np.stack(made)), corner, *edges, step


def _plane_axes(axis: int, sign: int) -> tuple[F64, F64]:
    """Choose unit vectors (3,) to the right and down in a plane, as the cameras see it."""
    down = np.eye(3)[2 if axis == 1 else 1]
    return np.cross(down, sign * np.eye(3)[axis]), down
