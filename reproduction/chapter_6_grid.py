"""Figure 6-3: calibration grid in one image and refocused, with its sharpness.

Nine cameras look at a checkerboard in air through a thin acrylic wall. They are calibrated from the
board at random positions and at one reference position, which is then rendered and refocused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.parameters import fit_similarity
from sabench.algorithms.refocus import refocus_sum
from sabench.evaluation.reproduction import Item
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.projective_camera import Projective
from sabench.geometry.triangulation import triangulate
from sabench.plotting.drawing import Curve, Figure, Panel, Picture
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.utils.arrays import F32, F64
from sabench.utils.progress import progress_bar

from .chapter_4 import Board, by_camera, draw, photograph, reprojection, solve_case
from .common import AGREES, claim, coarsen, image_panel, make_row

_FRAMES = 8  # boards at random positions
_SIGMA_MM = 0.01  # of the reference board's position
_FINE = 4  # voxels per pixel
_SOLVERS = {"linear": "linear_autocal", "refractive": "refractive_autocal"}
_MIDDLE = 4  # camera
_SHIFTS_PX = (0.25, 0.5, 1.0)  # by which exact cameras are moved, to see what sharpness shows
_ACCURATE_PX = 0.4  # error of the mapping from which refocusing suffers, as chapter 4 says
_RAW, _EXACT = "single images", "exact cameras"
_WORST = "exact cameras moved by 1 px"


def fig_6_3(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure widths and MTF50 of edges in single images and refocused planes."""
    edges: dict[str, list[EdgeSharpness]] = {}
    off: dict[str, list[float]] = {}
    for seed in progress_bar(seeds, "checkerboards"):
        given = _join(draw(_scene(pixels), seed), draw(_reference(pixels), seed))
        # render the reference board as every camera records it
        scene = _reference(pixels)
        numbers = progress_bar(range(9), f"render the reference board, seed {seed}")
        images = np.stack([photograph(scene, 0, number, seed) for number in numbers]).astype(
            np.float32
        )
        # collect the exact cameras, and the same moved in random directions
        moved = {
            f"exact cameras moved by {shift:g} px": nominal_cameras(
                _reference(pixels, calibration={"shift_px": shift}), given.cameras, seed
            )
            for shift in _SHIFTS_PX
        }
        cameras = _calibrate(given, off) | {_EXACT: given.cameras, **moved}
        planes = {name: _refocus(given, images, rig) for name, rig in cameras.items()}
        raw = [
            _measure(given, images[number].astype(np.float64), given.exact[number, -1])
            for number in range(len(images))
        ]
        width, mtf50 = np.mean([[edge.width_mm, edge.mtf50] for edge in raw], axis=0)
        edges.setdefault(_RAW, []).append(EdgeSharpness(float(width), float(mtf50)))
        for name, plane in planes.items():
            corners = _grid(given).to_voxels(given.points_mm[-1])[:, :2]
            edges.setdefault(name, []).append(_measure(given, plane, corners))
        if seed == seeds[0]:
            shown = images[_MIDDLE], planes
    for name, every in edges.items():
        yield from _sharpness_rows(name, every, edges)
    for name, errors in off.items():
        yield claim(
            f"{name}: true mean reprojection error of the worst camera, px",
            "accurately calibrates the cameras",
            max(errors),
            max(errors) < _ACCURATE_PX,
            f"mean over seeds {np.mean(errors):.3g}; holds below {_ACCURATE_PX}",
        )
    yield from _claims(edges)
    yield _figure(*shown, edges)


def _scene(pixels: int | None, **changes: Any) -> Scene:
    """Make the jet's array, before a board in air behind 3 mm of acrylic."""
    jet = coarsen(load_scene("jet-in-crossflow"), pixels).to_dict()
    values = {name: jet[name] for name in ("volume", "grid", "cameras", "sensor")}
    board = {
        "generator": "boards",
        "pattern": "checkerboard",
        "columns": 11,
        "rows": 9,
        "pitch_mm": 4.0,
        "tilt_deg": 20.0,
    }
    wall = {
        "point_mm": [0.0, 0.0, -60.0],
        "fluid_index": 1.0,
        "layers": [{"name": "acrylic", "index": 1.49, "thickness_mm": 3.0}],
    }
    values |= {
        "title": "checkerboard before the jet's nine cameras",
        "frames": _FRAMES,
        "wall": wall,
        "targets": board | changes.pop("targets", {}),
        "lighting": {"lamps": [{"center_mm": [side, -30.0, -400.0]} for side in (-270.0, 330.0)]},
        "render": {"samples_per_pixel": 64},
        "detection": {"noise_px": 0.1},
        "calibration": {"center_mm": 5.0, "turn_deg": 0.5, "focal_percent": 2.0, "points": 0.02},
    }
    return parse_scene(values | changes, values["title"])


def _reference(pixels: int | None, **changes: Any) -> Scene:
    """Make the same with the level board at the reference position alone.

    It is rolled, since edges along the pixels are sampled in few places.
    """
    level = {"tilt_deg": 0.0, "wander": 0.0, "roll_deg": 30.0}
    return _scene(pixels, frames=1, targets=level, **changes)


def _join(boards: Board, reference: Board) -> Board:
    """Append the known reference position to the unknown random ones."""
    unknown = np.full_like(boards.points_mm, np.nan)
    case = replace(
        boards.case,
        pixels=np.concatenate([boards.case.pixels, reference.case.pixels], axis=1),
        initial_mm=np.concatenate([boards.case.initial_mm, reference.points_mm]),
        known_mm=np.concatenate([unknown, reference.points_mm]),
        known_sigma_mm=np.concatenate([unknown, np.full_like(reference.points_mm, _SIGMA_MM)]),
    )
    return Board(
        case,
        boards.cameras,
        np.concatenate([boards.points_mm, reference.points_mm]),
        np.concatenate([boards.exact, reference.exact], axis=1),
    )


def _calibrate(given: Board, off: dict[str, list[float]]) -> dict[str, tuple[CameraModel, ...]]:
    """Calibrate by every solver; adds the worst camera's true error to `off`."""
    cameras: dict[str, tuple[CameraModel, ...]] = {}
    for name, solver in _SOLVERS.items():
        answer = solve_case(solver, given)
        off.setdefault(name, []).append(
            float(by_camera(reprojection(answer, given, given.exact)).max())
        )
        cameras[name] = _to_reference(answer.cameras, given)
    return cameras


def _to_reference(cameras: tuple[CameraModel, ...], given: Board) -> tuple[CameraModel, ...]:
    """Bring linear cameras to the reference plane by a similarity (4.4.3)."""
    points = triangulate(cameras, given.case.pixels[:, -1])
    similarity = np.linalg.inv(fit_similarity(points, given.points_mm[-1]))
    return tuple(
        replace(camera, matrix=tuple(tuple(row) for row in (camera.matrix @ similarity).tolist()))
        if isinstance(camera, Projective)
        else camera
        for camera in cameras
    )


def _grid(given: Board) -> Grid:
    """Make one plane of fine voxels at the reference position."""
    points = given.points_mm[-1]
    corners = given.exact[_MIDDLE, -1]
    pixel_mm = float(
        np.linalg.norm(points[1] - points[0]) / np.linalg.norm(corners[1] - corners[0])
    )
    voxel = pixel_mm / _FINE
    pitch = float(np.linalg.norm(points[1] - points[0]))
    low, high = points.min(axis=0) - pitch, points.max(axis=0) + pitch
    columns, rows = np.ceil((high - low)[:2] / voxel).astype(int).tolist()
    return Grid((low[0], low[1], float(points[:, 2].mean())), (voxel,) * 3, (1, rows, columns))


def _refocus(given: Board, images: F32, cameras: tuple[CameraModel, ...]) -> F64:
    """Average the images on the reference plane."""
    total = refocus_sum(images, cameras, _grid(given))[0]
    return np.asarray(total, dtype=np.float64) / len(images)


def _measure(given: Board, values: F64, corners: F64) -> EdgeSharpness:
    target = given.case.target
    lattice = corners.reshape(target.rows, target.columns, 2)
    return measure_sharpness(values, lattice, target.pitch_mm)


def _sharpness_rows(
    name: str, every: Sequence[EdgeSharpness], edges: dict[str, list[EdgeSharpness]]
) -> Iterator[Item]:
    """Measure width and MTF50, relative to single images."""
    raw = np.mean([edge.width_mm for edge in edges[_RAW]])
    widths = [edge.width_mm for edge in every]
    note = f"{np.mean(widths) / raw:.3g} of single images"
    yield make_row(f"{name}: width of an edge, 10 to 90 %, mm", None, widths, note)
    yield make_row(f"{name}: MTF50, cycles / mm", None, [edge.mtf50 for edge in every])


def _claims(edges: dict[str, list[EdgeSharpness]]) -> Iterator[Item]:
    """Decide what section 6.2 says of the figure."""
    width = {name: float(np.mean([edge.width_mm for edge in runs])) for name, runs in edges.items()}
    for name in _SOLVERS:
        yield claim(
            f"{name}: width by calibrated over width by exact cameras",
            "sharpness demonstrates the accuracy",
            width[name] / width[_EXACT],
            width[name] <= (1.0 + AGREES) * width[_EXACT],
        )


def _figure(image: F32, planes: dict[str, F64], edges: dict[str, list[EdgeSharpness]]) -> Figure:
    """Draw image, refocused plane, and widths against the error of the cameras."""
    panels = [image_panel("(a) one image", image)]
    for title, name in (("(b) refocused, linear calibration", "linear"), ("1 px off", _WORST)):
        half = [size // 4 for size in planes[name].shape]
        part = planes[name][half[0] : 2 * half[0], half[1] : 2 * half[1]]
        ends = (part.shape[1] - 1.0) / _FINE, (part.shape[0] - 1.0) / _FINE
        panels.append(Panel(title, "px of an image", "", (Picture(part, (0.0, 0.0), ends),)))
    shifts = [0.0, *_SHIFTS_PX]
    names = [_EXACT, *(f"exact cameras moved by {shift:g} px" for shift in _SHIFTS_PX)]
    width = {name: float(np.mean([edge.width_mm for edge in runs])) for name, runs in edges.items()}
    level = (Curve(name, (0.0, shifts[-1]), (width[name],) * 2) for name in (_RAW, *_SOLVERS))
    curve = Curve("exact cameras moved", shifts, [width[name] for name in names])
    panels.append(Panel("", "error of the cameras, px", "width of an edge, mm", (curve, *level)))
    return Figure("fig-6-3", "Figure 6-3: calibration grid", tuple(panels), across=2)


_ALONG = 0.3  # of the pitch: half the part of an edge that is looked at, far from the corners
_ACROSS = 0.35  # of the pitch: half the width of the strip across an edge
_FLAT = 0.25  # of the pitch: from here on the strip is as dark or bright as its side
_BINS_PER_PIXEL = 4  # bins of the edge spread per pixel, as in ISO 12233


@dataclass(frozen=True)
class EdgeSharpness:
    """Sharpness of an image in units of the board.

    Attributes
    ----------
    width_mm : distance over which an edge rises from 10 to 90 % of its contrast.
    mtf50 : spatial frequency (cycles / mm) that keeps half of its contrast.
    """

    width_mm: float
    mtf50: float


def measure_sharpness(values: F64, corners: F64, pitch_mm: float) -> EdgeSharpness:
    """Measure the mean edge of a checkerboard's image.

    Every edge between two neighbouring corners is brought to its own contrast and position first,
    so that uneven light and displacements of whole edges do not count as blur.

    Parameters
    ----------
    values : (rows, columns) image, linear in the light.
    corners : (m, n, 2) pixels (column, row) of the inner corners, neighbours along the first two
        axes; NaN where unknown.
    pitch_mm : distance of neighbouring corners.

    Source: ISO 12233 (slanted edge), with all edges of the board in one edge spread.

    Raises ValueError: no edge lies in the image.
    """
    flipped = corners.transpose(1, 0, 2)
    samples = [*_strips(values, corners, pitch_mm), *_strips(values, flipped, pitch_mm)]
    if not samples:
        raise ValueError("expected edges of a checkerboard in the image, got none")
    distance, level = np.concatenate(samples, axis=1)
    pixel_mm = pitch_mm / float(np.nanmean(np.linalg.norm(np.diff(corners, axis=1), axis=-1)))
    # average levels in bins of the distance; empty bins are interpolated
    step = pixel_mm / _BINS_PER_PIXEL
    reach = _ACROSS * pitch_mm
    half = int(reach / step)
    edges = step * (np.arange(-half, half + 1) - 0.5)
    count, total = (np.histogram(distance, edges, weights=weights)[0] for weights in (None, level))
    middle = (edges[1:] + edges[:-1]) / 2.0
    return _sharpness(
        *(middle, np.interp(middle, middle[count > 0], total[count > 0] / count[count > 0]))
    )


def _strips(values: F64, corners: F64, pitch_mm: float) -> list[F64]:
    """Collect distances (mm) and levels (2, k) of edges along the second axis."""
    rows, columns = len(corners), corners.shape[1] - 1
    strips = []
    for row in range(rows):
        aside, sign = (row + 1, 1.0) if row + 1 < rows else (row - 1, -1.0)
        for column in range(columns):
            origin = corners[row, column]
            axes = np.column_stack(
                [corners[row, column + 1] - origin, sign * (corners[aside, column] - origin)]
            )
            strip = _strip(values, origin, axes)
            if strip is not None:
                strips.append(strip * np.array([[pitch_mm], [1.0]]))
    return strips


def _strip(values: F64, origin: F64, axes: F64) -> F64 | None:
    """Read the strip across one edge from its start along `axes` (2, 2).

    Returns distances in pitches, and levels: 0 on the dark side, 1 on the bright side. None where
    the strip leaves the image or its corners are unknown.
    """
    ends = (
        origin
        + np.array(
            [[0.5 + side * _ALONG, across * _ACROSS] for side in (-1, 1) for across in (-1, 1)]
        )
        @ axes.T
    )
    (left, top), (right, bottom) = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    if (
        not np.isfinite(ends).all()
        or left < 0
        or top < 0
        or right >= values.shape[1]
        or bottom >= values.shape[0]
    ):
        return None
    x, y = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
    along, across = np.linalg.solve(axes, np.stack([x.ravel(), y.ravel()]) - origin[:, None])
    inside = (np.abs(along - 0.5) < _ALONG) & (np.abs(across) < _ACROSS)
    across = across[inside]
    level = values[int(top) : int(bottom) + 1, int(left) : int(right) + 1].ravel()[inside]
    low, high = level[across < -_FLAT].mean(), level[across > _FLAT].mean()
    if low > high:
        low, high, across = high, low, -across
    level = (level - low) / (high - low)
    shift = _ACROSS * (1.0 - 2.0 * level.mean())  # an ideal step there has this mean level
    return np.stack([across - shift, level])


def _sharpness(distance: F64, spread: F64) -> EdgeSharpness:
    """Compute width and MTF50 from an edge spread that rises with the distance."""
    from scipy.signal.windows import tukey  # takes long to load

    step = distance[1] - distance[0]
    line = np.diff(spread)
    size = 16 * len(line)
    contrast = np.abs(np.fft.rfft(line * tukey(len(line)), size))
    frequency = np.fft.rfftfreq(size, step)
    contrast /= contrast[0] * np.sinc(frequency * step) ** 2  # of the bin and of the difference
    first = int(np.argmax(contrast < 0.5))
    before, after = contrast[first - 1 : first + 1]
    part = (before - 0.5) / (before - after)
    mtf50 = frequency[first - 1] + part * (frequency[first] - frequency[first - 1])
    return EdgeSharpness(
        _cross(distance, spread, 0.9) - _cross(distance, spread, 0.1), float(mtf50)
    )


def _cross(distance: F64, spread: F64, level: float) -> float:
    """Find where the spread crosses a level, nearest to the edge."""
    above = spread >= level
    crossings = np.flatnonzero(~above[:-1] & above[1:])
    nearest = crossings[np.abs(distance[crossings]).argmin()]
    low, high = spread[nearest], spread[nearest + 1]
    step = distance[nearest + 1] - distance[nearest]
    return float(distance[nearest] + step * (level - low) / (high - low))
