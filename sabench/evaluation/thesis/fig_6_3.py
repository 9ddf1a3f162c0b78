"""Figure 6-3: calibration grid in one image and refocused, with its sharpness.

Nine cameras look at a checkerboard in air through a thin acrylic wall. They are calibrated from the
board at random positions and at one reference position, which is then rendered and refocused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.wall_frame import fit_similarity
from sabench.algorithms.refocus import refocus_sum
from sabench.evaluation.thesis.chapter_4 import (
    Board,
    by_camera,
    draw,
    photograph,
    reprojection,
    solve_case,
)
from sabench.evaluation.thesis.common import AGREES, Item, claim, coarsen, make_row
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.projective_camera import Projective
from sabench.geometry.triangulation import triangulate
from sabench.metrics.edge_sharpness import EdgeSharpness, measure_sharpness
from sabench.plotting.charts import Curve, Figure, Panel, Picture
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.utils.arrays import F32, F64
from sabench.utils.progress import progress_bar

SEEDS = 5
_FRAMES = 8  # boards at random positions
_SIGMA_MM = 0.01  # of the reference board's position
_FINE = 4  # voxels per pixel
_SOLVERS = {"linear": "linear_autocal", "refractive": "refractive_autocal"}
_MIDDLE = 4  # camera
_SHIFTS_PX = (0.25, 0.5, 1.0)  # by which exact cameras are moved, to see what sharpness shows
_ACCURATE_PX = 0.4  # error of the mapping from which refocusing suffers, as chapter 4 says
_RAW, _EXACT = "single images", "exact cameras"
_WORST = "exact cameras moved by 1 px"


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure widths and MTF50 of edges in single images and refocused planes."""
    found: dict[str, list[EdgeSharpness]] = {}
    off: dict[str, list[float]] = {}
    for seed in progress_bar(seeds, "checkerboards"):
        given = _join(draw(_scene(pixels), seed), draw(_reference(pixels), seed))
        images = _render(pixels, seed)
        cameras = _calibrate(given, off) | _exact(given, pixels, seed)
        planes = {name: _refocus(given, images, own) for name, own in cameras.items()}
        raw = [_single(given, images, number) for number in range(len(images))]
        width, mtf50 = np.mean([[one.width_mm, one.mtf50] for one in raw], axis=0)
        found.setdefault(_RAW, []).append(EdgeSharpness(float(width), float(mtf50)))
        for name, plane in planes.items():
            found.setdefault(name, []).append(_refocused(given, plane))
        if seed == seeds[0]:
            shown = images[_MIDDLE], planes
    for name, every in found.items():
        yield from _sharpness_rows(name, every, found)
    for name, errors in off.items():
        yield claim(
            f"{name}: true mean reprojection error of the worst camera, px",
            "accurately calibrates the cameras",
            max(errors),
            max(errors) < _ACCURATE_PX,
            f"mean over seeds {np.mean(errors):.3g}; holds below {_ACCURATE_PX}",
        )
    yield from _claims(found)
    yield _figure(*shown, found)


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


def _render(pixels: int | None, seed: int) -> F32:
    """Render the reference board as every camera records it."""
    scene = _reference(pixels)
    numbers = progress_bar(range(9), f"render the reference board, seed {seed}")
    return np.stack([photograph(scene, 0, number, seed) for number in numbers]).astype(np.float32)


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
    seen = triangulate(cameras, given.case.pixels[:, -1])
    similarity = np.linalg.inv(fit_similarity(seen, given.points_mm[-1]))
    return tuple(
        replace(camera, matrix=tuple(tuple(row) for row in (camera.matrix @ similarity).tolist()))
        if isinstance(camera, Projective)
        else camera
        for camera in cameras
    )


def _exact(given: Board, pixels: int | None, seed: int) -> dict[str, tuple[CameraModel, ...]]:
    """Collect the exact cameras, and the same moved in random directions."""
    moved = {
        f"exact cameras moved by {shift:g} px": nominal_cameras(
            _reference(pixels, calibration={"shift_px": shift}), given.cameras, seed
        )
        for shift in _SHIFTS_PX
    }
    return {_EXACT: given.cameras, **moved}


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


def _refocused(given: Board, plane: F64) -> EdgeSharpness:
    corners = _grid(given).to_voxels(given.points_mm[-1])[:, :2]
    return _measure(given, plane, corners)


def _single(given: Board, images: F32, number: int) -> EdgeSharpness:
    return _measure(given, images[number].astype(np.float64), given.exact[number, -1])


def _measure(given: Board, values: F64, corners: F64) -> EdgeSharpness:
    target = given.case.target
    lattice = corners.reshape(target.rows, target.columns, 2)
    return measure_sharpness(values, lattice, target.pitch_mm)


def _sharpness_rows(
    name: str, every: Sequence[EdgeSharpness], found: dict[str, list[EdgeSharpness]]
) -> Iterator[Item]:
    """Measure width and MTF50, beside those of single images."""
    raw = np.mean([one.width_mm for one in found[_RAW]])
    widths = [one.width_mm for one in every]
    note = f"{np.mean(widths) / raw:.3g} of single images"
    yield make_row(f"{name}: width of an edge, 10 to 90 %, mm", None, widths, note)
    yield make_row(f"{name}: MTF50, cycles / mm", None, [one.mtf50 for one in every])


def _claims(found: dict[str, list[EdgeSharpness]]) -> Iterator[Item]:
    """Decide what section 6.2 says of the figure."""
    width = {name: float(np.mean([one.width_mm for one in own])) for name, own in found.items()}
    for name in _SOLVERS:
        yield claim(
            f"{name}: width by calibrated over width by exact cameras",
            "sharpness demonstrates the accuracy",
            width[name] / width[_EXACT],
            width[name] <= (1.0 + AGREES) * width[_EXACT],
        )


def _figure(image: F32, planes: dict[str, F64], found: dict[str, list[EdgeSharpness]]) -> Figure:
    """Draw image, refocused plane, and widths against the error of the cameras."""
    rows, columns = image.shape
    panels = [
        Panel(
            "(a) one image",
            "px",
            "px",
            (Picture(image.astype(np.float64), (0.0, 0.0), (columns - 1.0, rows - 1.0)),),
        )
    ]
    for title, name in (("(b) refocused, linear calibration", "linear"), ("1 px off", _WORST)):
        half = [size // 4 for size in planes[name].shape]
        part = planes[name][half[0] : 2 * half[0], half[1] : 2 * half[1]]
        ends = (part.shape[1] - 1.0) / _FINE, (part.shape[0] - 1.0) / _FINE
        panels.append(Panel(title, "px of an image", "", (Picture(part, (0.0, 0.0), ends),)))
    shifts = [0.0, *_SHIFTS_PX]
    names = [_EXACT, *(f"exact cameras moved by {shift:g} px" for shift in _SHIFTS_PX)]
    width = {name: float(np.mean([one.width_mm for one in own])) for name, own in found.items()}
    level = (Curve(name, (0.0, shifts[-1]), (width[name],) * 2) for name in (_RAW, *_SOLVERS))
    curve = Curve("exact cameras moved", shifts, [width[name] for name in names])
    panels.append(Panel("", "error of the cameras, px", "width of an edge, mm", (curve, *level)))
    return Figure("fig-6-3", "Figure 6-3: calibration grid", tuple(panels), across=2)
