"""Small cases on which `ablation.py` judges rules of calibrations.

Targets and particle images are simulated, most of them by projection alone. A case's `f1` is the
share of true points that the answer puts where they are, within a limit of its own; `rms_px` is the
true reprojection error. A fault of the input has an `f1` of 1 where it is refused by name.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.calibration_reality import TANKS, Errors, guess, make_tank
from reproduction.chapter_4 import Board, draw, photograph, places_of, reprojection
from sabench.algorithms.calibration.target_detection import detect_target
from sabench.algorithms.calibration.unknown_selection import select_unknowns
from sabench.api.make import make_algorithm
from sabench.geometry.rigid_motion import fit_lateral_motion, fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.scenes import build_rig, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.worlds.calibration_targets import exact_pixels, pose_target

_LEAST_PX = 1e-3  # errors below are none
_FAR_PX = 99.0  # RMS error without an answer

Figures = dict[str, float]
Case = tuple[Callable[[int], Any], Callable[[Any], Figures]]


def board(count: int = 4, **changes: Any) -> Callable[[int], Board]:
    """Make a case of the bundled scene with so many cameras, boards of 6 x 6 points, changes."""

    def make(seed: int) -> Board:
        values = load_scene("calibration").to_dict()
        values["targets"] |= {"columns": 6, "rows": 6, "pitch_mm": 8.0}
        places = [(-150, -150), (150, -150), (-150, 150), (150, 150), (0, 0), (0, -150), (0, 150)]
        values["cameras"]["layout"] = {
            "kind": "list",
            "places": [{"center_mm": [x, y, -490.0]} for x, y in places[:count]],
        }
        values["calibration"]["known"] = [{"frame": 2, "point": 14}]
        for key, change in changes.items():
            if change is None:
                values.pop(key, None)
            else:
                merge = isinstance(change, dict) and not {"generator", "shape"} & change.keys()
                values[key] = values.get(key, {}) | change if merge else change
        return draw(parse_scene(values, "boards"), seed)

    return make


def tank(errors: Errors, *unknown: Any, frames: int = 10) -> Callable[[int], Board]:
    """Make a case of a tank with a guess as of a ruler, and some of its frames."""

    def make(seed: int) -> Board:
        made = make_tank(errors, seed)
        given, points = guess(made.case, seed), made.points_mm[:frames]
        exact = np.stack([camera.project(points.reshape(-1, 3))[0] for camera in made.cameras])
        exact = exact.reshape(len(made.cameras), *points.shape[:2], 2)
        parts = {
            key: getattr(given, key)[:frames]
            for key in ("initial_mm", "known_mm", "known_sigma_mm")
        }
        given = replace(given, pixels=given.pixels[:, :frames], unknown=unknown, **parts)
        return Board(given, made.cameras, points, exact)

    return make


def changed(
    make: Callable[[int], Board], change: Callable[[F64, np.random.Generator], F64]
) -> Callable[[int], Board]:
    """Change the pixels (camera, frame, point, 2) of a case."""

    def made(seed: int) -> Board:
        given = make(seed)
        pixels = change(given.case.pixels.copy(), np.random.default_rng(seed))
        return replace(given, case=replace(given.case, pixels=pixels))

    return made


def solved_by(
    name: str, within_mm: float, fit: Callable[..., Any] = fit_lateral_motion, **parameters: Any
) -> Callable[[Board], Figures]:
    """Score a solver: places within a limit after a motion, and the true reprojection error."""

    def score(given: Board) -> Figures:
        solver: Any = make_algorithm(name, parameters)
        try:
            answer = solver.solve(given.case)
        except InputError:
            return {"f1": 0.0, "rms_px": _FAR_PX}
        points, truths = places_of(answer, given).reshape(-1, 3), given.points_mm.reshape(-1, 3)
        there = np.isfinite(points).all(axis=1)
        found = fit(points[there], truths[there])(points[there])
        right = np.linalg.norm(found - truths[there], axis=1) < within_mm
        rms = float(np.sqrt(np.nanmean(reprojection(answer, given, given.exact) ** 2)))
        return {
            "f1": float(right.sum() / len(truths)),
            "rms_px": max(rms, _LEAST_PX),
            "true": float(len(truths)),
        }

    return score


def refuses(*words: str) -> Callable[[Board], Figures]:
    """Score 1 where `refractive_autocal` refuses a case in a sentence with some words."""

    def score(given: Board) -> Figures:
        solver: Any = make_algorithm("refractive_autocal", {})
        try:
            solver.solve(given.case)
        except InputError as error:
            return {"f1": float(all(word in str(error) for word in words))}
        return {"f1": 0.0}

    return score


def chooses(given: Board) -> Figures:
    """Score the unknowns that are chosen by the places and images that follow from them."""
    names, _ = select_unknowns(given.case)
    chosen = replace(given, case=replace(given.case, unknown=names))
    return solved_by("refractive_autocal", 0.2)(chosen)


def swap_cameras(pixels: F64, rng: np.random.Generator) -> F64:
    """Give two cameras each other's images."""
    return pixels[[1, 0, *range(2, len(pixels))]]


def turn_view(pixels: F64, rng: np.random.Generator) -> F64:
    """Count one view of a board from the opposite corner."""
    pixels[2, 1] = pixels[2, 1, ::-1]
    return pixels


def turn_frame(pixels: F64, rng: np.random.Generator) -> F64:
    """Count a frame from the opposite corner, in all cameras."""
    pixels[:, 1] = pixels[:, 1, ::-1]
    return pixels


def mirror(pixels: F64, rng: np.random.Generator) -> F64:
    """Count rows of all images from below."""
    pixels[..., 1] = 1199.0 - pixels[..., 1]
    return pixels


def shuffle(pixels: F64, rng: np.random.Generator) -> F64:
    """Count the points in no order."""
    for view in pixels.reshape(-1, *pixels.shape[2:]):
        view[:] = view[rng.permutation(len(view))]
    return pixels


def spoil_view(pixels: F64, rng: np.random.Generator) -> F64:
    """Spoil one view of a board: its points are 50 px off."""
    pixels[3, 2] += rng.normal(0.0, 50.0, pixels[3, 2].shape)
    return pixels


def hide(pixels: F64, rng: np.random.Generator) -> F64:
    """Leave out four points of ten."""
    pixels[rng.random(pixels.shape[:-1]) < 0.4] = np.nan
    return pixels


def particles(per_pixel: float, cameras: int, **errors: float) -> Callable[[int], Shot]:
    """Make images of particles by cameras that are a few pixels off, behind glass."""

    def make(seed: int) -> Shot:
        return simulate(_particle_scene(per_pixel, cameras, **errors), seed=seed)

    return make


def _particle_scene(per_pixel: float, cameras: int, **errors: float) -> Any:
    values = load_scene("array-9").to_dict()
    values["cameras"] |= {"rows": 160, "columns": 160, "particle_sigma_px": 0.8}
    places = [(-150, -100), (150, -100), (-150, 100), (150, 100), (0, -100), (0, 100)]
    values["cameras"]["layout"] = {
        "kind": "list",
        "places": [{"center_mm": [x, y, -510.0]} for x, y in places[:cameras]],
    }
    values["volume"] |= {"size_mm": [8.0, 8.0, 4.0]}
    values["grid"]["crop_mm"] = [1.0, 1.0, 0.0]
    values["particles"] = {"generator": "uniform", "per_pixel": per_pixel, "diameter_mm": 0.02}
    values["calibration"] = errors
    layers = [{"index": 1.5, "thickness_mm": 5.0}]
    values["wall"] = {"fluid_index": 1.333, "point_mm": [0.0, 0.0, -30.0], "layers": layers}
    return parse_scene(values, "particles")


def self_calibrated(cameras: int, **parameters: float) -> Callable[[Shot], Figures]:
    """Score the particles' images in corrected cameras, without a motion of all cameras."""

    def score(shot: Shot) -> Figures:
        solver: Any = make_algorithm("volume_self_calibration", parameters)
        try:
            answer = solver.solve(shot.observation)
        except InputError:
            return {"f1": 0.0, "rms_px": _FAR_PX}
        truths = shot.particles.position_mm
        true = build_rig(_particle_scene(0.01, cameras)).cameras
        exact = np.stack([camera.project(truths)[0] for camera in true])
        moved = fit_rigid_motion(truths, triangulate(answer.cameras, exact))(truths)
        again = np.stack([camera.project(moved)[0] for camera in answer.cameras])
        miss = np.linalg.norm(again - exact, axis=-1)
        rms = float(np.sqrt(np.mean(miss**2)))
        return {"f1": float((miss < 0.2).mean()), "rms_px": rms, "true": float(len(truths))}

    return score


def pictures(pattern: str) -> Callable[[int], Any]:
    """Render two pictures of a target, in 600 x 600 pixels."""

    def make(seed: int) -> Any:
        values = load_scene("calibration-boards").to_dict()
        values["cameras"] |= {"rows": 600, "columns": 600, "pixel_mm": 0.02}
        values["cameras"]["layout"] = {
            "kind": "list",
            "places": [{"center_mm": [x, 60.0, -490.0]} for x in (-150.0, 150.0)],
        }
        if pattern in ("wand", "glowing wand"):
            values["targets"] = {"generator": "wand", "balls": 5, "pitch_mm": 8.0, "ball_mm": 1.0}
            values["lighting"]["even"] = float(pattern == "glowing wand")
            values["calibration"]["known"] = [{"frame": 2, "point": 2}]
        else:
            values["targets"] |= {"pattern": pattern, "columns": 7, "rows": 6, "pitch_mm": 5.0}
            values["calibration"]["known"] = [{"frame": 2, "point": 20}]
        scene = parse_scene(values, pattern)
        placed = pose_target(scene, seed)
        cameras = build_rig(scene).cameras
        exact = [exact_pixels(camera, placed.points_mm)[0] for camera in cameras]
        return [photograph(scene, 0, camera, seed) for camera in range(2)], placed.target, exact

    return make


def detected(given: Any) -> Figures:
    """Score points that are found within half a pixel of where they are."""
    images, target, exact = given
    miss = np.stack(
        [
            np.linalg.norm(detect_target(image, target, own) - own, axis=-1)
            for image, own in zip(images, exact, strict=True)
        ]
    )
    right = miss < 0.5
    rms = float(np.sqrt(np.mean(miss[right] ** 2))) if right.any() else _FAR_PX
    return {"f1": float(right.sum() / np.isfinite(exact).all(axis=-1).sum()), "rms_px": rms}


def _start(part: float, **more: Any) -> dict[str, Any]:
    return {
        "points": part,
        "center_mm": 200.0 * part,
        "turn_deg": 20.0 * part,
        "focal_percent": 30.0 * part,
    } | more


_AUTOCAL = "refractive_autocal"
_TRAVERSED: dict[str, Any] = {
    "frames": 5,
    "targets": {"tilt_deg": 0.0, "roll_deg": 0.0, "wander": 0.2},
    "calibration": _start(0.0002),
}
_WAND: dict[str, Any] = {
    "frames": 12,
    "targets": {"generator": "wand", "balls": 5, "pitch_mm": 8.0, "ball_mm": 1.0},
    "calibration": _start(0.1, known=[{"frame": 2, "point": 2}]),
}
_CYLINDER = {
    "shape": "cylinder",
    "axis_point_mm": [0.0, 0.0, 35.0],
    "axis": [0.0, 1.0, 0.0],
    "outer_radius_mm": 70.0,
    "layers": [{"name": "glass", "index": 1.5, "thickness_mm": 5.0}],
    "fluid_index": 1.333,
}
_OFF = TANKS["known places, wall off by 50 mm"]
_NEAR = TANKS["all of these, near the wall, depth unknown"]
_BENT = Errors(k3=400.0, tilt_deg=0.7, bend_mm=-0.6, near_mm=40.0)
_OUTLIERS = {"noise_px": 0.1, "outliers": 0.2}
CALIBRATION: dict[str, Case] = {
    "boards, exact": (board(detection={"noise_px": 0.0}), solved_by(_AUTOCAL, 0.01)),
    "boards, wall": (board(7), solved_by(_AUTOCAL, 0.2)),
    "boards, air": (board(wall=None), solved_by(_AUTOCAL, 0.5, fit_rigid_motion)),
    "boards, noisy": (board(3, detection={"noise_px": 2.0}), solved_by(_AUTOCAL, 4.0)),
    "boards, outliers": (board(detection=_OUTLIERS), solved_by(_AUTOCAL, 0.5)),
    "few views": (board(3, frames=3), solved_by(_AUTOCAL, 1.0)),
    "hidden points": (changed(board(), hide), solved_by(_AUTOCAL, 0.5)),
    "spoilt view": (changed(board(), spoil_view), solved_by(_AUTOCAL, 0.5)),
    "wrong guess": (board(calibration=_start(0.3)), solved_by(_AUTOCAL, 0.5)),
    "no guess": (board(calibration=_start(0.3, points=0.0, blank=True)), solved_by(_AUTOCAL, 0.5)),
    "unknown lenses": (
        board(
            cameras={"distortion": {"k1": -0.5}},
            calibration=_start(0.1, shift_px=10.0, unknown=["principal_point", "k1"]),
        ),
        solved_by(_AUTOCAL, 1.0),
    ),
    "wand": (board(**_WAND), solved_by(_AUTOCAL, 1.0)),
    "ruler": (tank(TANKS["ideal"], frames=5), solved_by(_AUTOCAL, 1.0)),
    "wall off": (
        tank(_OFF, "wall", "thickness", "fluid_index", "k1", frames=6),
        solved_by(_AUTOCAL, 0.1),
    ),
    "near the wall": (tank(_NEAR, frames=6), solved_by(_AUTOCAL, 10.0)),
    "near the wall, noisy": (
        board(
            3,
            frames=4,
            detection={"noise_px": 0.5},
            volume={"center_mm": [0.0, 0.0, 17.0], "size_mm": [50.0, 50.0, 20.0]},
            targets={"tilt_deg": 5.0},
            calibration=_start(0.1, known=[]),
        ),
        solved_by(_AUTOCAL, 30.0),
    ),
    "bent into the wall": (tank(_BENT), solved_by(_AUTOCAL, 2.0)),
    "cylinder": (
        board(3, frames=3, wall=_CYLINDER, targets={"columns": 5, "rows": 4}),
        solved_by(_AUTOCAL, 0.5, fit_rigid_motion),
    ),
    "chosen unknowns": (tank(TANKS["all of these"], frames=6), chooses),
    "factors": (board(6, wall=None), solved_by("linear_autocal", 1.0, fit_rigid_motion)),
    "factors, hidden points": (
        changed(board(6, wall=None), hide),
        solved_by("linear_autocal", 1.0, fit_rigid_motion),
    ),
    "parallax": (
        board(wall=None, **_TRAVERSED),
        solved_by("plane_parallax", 0.2, fit_rigid_motion),
    ),
    "parallax, hidden points": (
        changed(board(wall=None, **_TRAVERSED), hide),
        solved_by("plane_parallax", 0.2, fit_rigid_motion),
    ),
    "planes": (board(**_TRAVERSED), solved_by("polynomial_planes", 0.2, fit_rigid_motion)),
    "particles": (particles(0.025, 6, shift_px=2.0), self_calibrated(6)),
    "particles, turned cameras": (
        particles(0.025, 4, turn_deg=0.02),
        self_calibrated(4, reach_px=8.0),
    ),
    "particles, three cameras": (particles(0.03, 3, shift_px=2.0), self_calibrated(3)),
    "particles, far off": (particles(0.025, 4, shift_px=4.0), self_calibrated(4, reach_px=8.0)),
    "swapped cameras": (changed(board(), swap_cameras), refuses("camera_00", "camera_01")),
    "turned view": (changed(board(), turn_view), refuses("camera_02", "frame 1")),
    "turned frame": (changed(board(calibration=_start(0.02)), turn_frame), refuses("frame 1")),
    "mirrored": (changed(board(), mirror), refuses("mirror")),
    "no order": (changed(board(frames=3), shuffle), refuses()),
    "one plane": (board(frames=1, targets={"tilt_deg": 0.0}, calibration={"known": []}), refuses()),
    **{
        f"pictures, {pattern}": (pictures(pattern), detected)
        for pattern in ("checkerboard", "circles", "charuco", "wand", "glowing wand")
    },
}
