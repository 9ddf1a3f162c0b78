"""Loss of Q by calibration: the same images, with the cameras of each one.

The thesis (figure 2-7b) shifts images; here the errors are those that calibrations make.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.api import Calibration
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.thesis.chapter_4 import Board, draw, places_of, solve_case
from sabench.evaluation.thesis.common import Row, cases, claim, make_row
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.rigid_motion import RigidMotion, fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.in_memory import Shot, simulate

SEEDS = 5
_NOISE_PX = 0.1
_CALIBRATIONS = (
    "refractive_autocal",
    "refractive_autocal_alternating",
    "soloff",
    "polynomial_planes",
    "pinhole_linear",
    "linear_autocal",
)
_RECONSTRUCTIONS = ("block_mart", "msa")
_SHIFT_PX = 2.0  # of the cameras that self-calibration starts from
_TRAVERSED = {"tilt_deg": 0.0, "roll_deg": 0.0, "wander": 0.5}


@dataclass(frozen=True)
class Judged:
    """Cameras, true particles in their frame, and mean reprojection error, px."""

    cameras: tuple[CameraModel, ...]
    motion: RigidMotion
    error_px: float


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure Q of each reconstruction with each set of cameras, and their errors."""
    found: dict[tuple[str, str], list[float]] = {}
    errors: dict[str, list[float]] = {}
    for seed in seeds:
        scene = particles_behind_glass(pixels)
        shot = simulate(scene, seed=seed)
        for name, one in _cameras(scene, shot, seed).items():
            errors.setdefault(name, []).append(one.error_px)
            for solver in _RECONSTRUCTIONS:
                found.setdefault((solver, name), []).append(_q(solver, shot, one))
    for (solver, name), values in found.items():
        yield make_row(
            f"{solver}: Q with the cameras of {name}",
            None,
            values,
            f"true error {np.mean(errors[name]):.3g} px",
        )
    for solver in _RECONSTRUCTIONS:
        for name in ("refractive_autocal", "volume_self_calibration"):
            lost = float(np.mean(found[solver, "exact"]) - np.mean(found[solver, name]))
            yield claim(f"{solver}: Q lost by {name}", "at most 0.01", lost, lost <= 0.01)


def particles_behind_glass(pixels: int | None) -> Scene:
    """Load the case with a wall of suites/left-out, at 0.05 particles per pixel."""
    (case,) = (case for case in cases("left-out") if case.name == "wall")
    values = case.scene.to_dict()
    if pixels is not None:
        scale = pixels / case.scene.cameras.columns
        values["cameras"] |= {"rows": pixels, "columns": pixels}
        values["volume"]["size_mm"] = [
            edge * scale if axis < 2 else edge
            for axis, edge in enumerate(values["volume"]["size_mm"])
        ]
        values["grid"]["crop_mm"] = [0.5, 0.5, 0.0]
    return parse_scene(values, "particles behind glass")


def boards_behind_glass(scene: Scene, level: bool) -> Scene:
    """Make a board of 11 x 11 points in the same volume, for the same cameras.

    Its nominal positions are 0.01 mm off, and three points are measured.
    """
    values: dict[str, Any] = scene.to_dict()
    for table in ("particles", "illumination", "tracer"):
        values.pop(table, None)
    edge = min(scene.volume.size_mm[:2])
    targets = {"generator": "boards", "pitch_mm": 0.075 * edge, **(_TRAVERSED if level else {})}
    known = [{"frame": 3, "point": point, "sigma_mm": 0.01} for point in (0, 10, 110)]
    calibration = {"points": 0.01 / max(scene.volume.size_mm), "known": known}
    return parse_scene(
        values
        | {
            "frames": 7,
            "targets": targets,
            "detection": {"noise_px": _NOISE_PX},
            "calibration": calibration,
        },
        "boards",
    )


def _cameras(scene: Scene, shot: Shot, seed: int) -> dict[str, Judged]:
    """Make exact, calibrated, perturbed and self-calibrated cameras.

    There is one calibration by boards per solver. Nominal cameras are two pixels off, and
    self-calibration starts from them.
    """
    true = build_rig(scene).cameras
    still = RigidMotion(np.eye(3), np.zeros(3))
    judged = {"exact": Judged(true, still, 0.0)}
    for name in _CALIBRATIONS:
        given = draw(boards_behind_glass(scene, name == "polynomial_planes"), seed)
        answer = solve_case(name, given)
        judged[name] = judge_cameras(answer.cameras, shot, true, _by_boards(answer, given))
    wrong = parse_scene(scene.to_dict() | {"calibration": {"shift_px": _SHIFT_PX}}, "shifted")
    off = simulate(wrong, seed=seed).observation
    judged["no calibration, 2 px off"] = judge_cameras(off.cameras, shot, true, None)
    algorithm: Any = make_algorithm("volume_self_calibration", {})
    made: Calibration = algorithm.solve(off)
    judged["volume_self_calibration"] = judge_cameras(made.cameras, shot, true, None)
    return judged


def _by_boards(answer: Calibration, given: Board) -> RigidMotion:
    return fit_rigid_motion(given.points_mm.reshape(-1, 3), places_of(answer, given).reshape(-1, 3))


def judge_cameras(
    cameras: tuple[CameraModel, ...],
    shot: Shot,
    true: tuple[CameraModel, ...],
    motion: RigidMotion | None,
) -> Judged:
    """Fit the motion from the true particles to these cameras' frame.

    A given motion is used instead.
    """
    truths = shot.particles.position_mm
    exact = np.stack([camera.project(truths)[0] for camera in true])
    if motion is None:
        found = triangulate(cameras, exact)
        known = np.isfinite(found).all(axis=1)
        motion = fit_rigid_motion(truths[known], found[known])
    again = np.stack([camera.project(motion(truths))[0] for camera in cameras])
    return Judged(cameras, motion, float(np.nanmean(np.linalg.norm(again - exact, axis=-1))))


def _q(solver: str, shot: Shot, judged: Judged) -> float:
    """Compute Q against the true particles, moved to the cameras' own frame.

    Particles do not determine where that frame is in the world.
    """
    guess = make_solver(solver, {}).solve(replace(shot.observation, cameras=judged.cameras))
    moved = replace(shot.particles, position_mm=judged.motion(shot.particles.position_mm))
    score = score_frame(shot.observation.grid, moved, shot.views, guess)["q"]
    assert score is not None
    return score
