"""Bundle adjustment behind walls that are not one plane wall."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench import plugins
from sabench.algorithms.calibration.bundle_adjustment import BoardImages, normal_equations
from sabench.algorithms.calibration.cramer_rao import compute_bound
from sabench.algorithms.calibration.parameters import FreeParameters, WallFrame
from sabench.algorithms.calibration.problem import fit_free_motion
from sabench.api import DeclinedError
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.metrics.calibration_error import calibration_scores
from sabench.scenes import Scene, load_scene, parse_scene
from tests.helpers.calibration_cases import board_images, case_of, misses
from tests.helpers.refusals import refused

GLASS = [{"index": 1.5, "thickness_mm": 5.0}]
FREE = FreeParameters(True, ("k1", "p1"))
PLANE = {"layers": GLASS, "fluid_index": 1.333}
ROUND = {"shape": "cylinder", "axis_point_mm": [0.0, 0.0, 90.0], "outer_radius_mm": 90.0}
FACES = [{"point_mm": [0.0, 0.0, -30.0], "normal": [side, 0.0, 1.0]} for side in (1.0, -1.0)]
WALLS: dict[str, Any] = {
    "plane": PLANE,
    "cylinder": PLANE | ROUND,
    "faces": [PLANE | face for face in FACES],
}


def scene_of(kind: str) -> Scene:
    """Four cameras and a board of few points."""
    values = load_scene("calibration").to_dict() | {"wall": WALLS[kind]}
    places = [[x, y, -490.0] for x in (-100.0, 100.0) for y in (-100.0, 100.0)]
    if kind == "faces":
        places = [[x, y, -330.0] for x in (-365.0, 365.0) for y in (-120.0, 120.0)]
    listed = [{"center_mm": center} for center in places]
    values["cameras"]["layout"] = {"kind": "list", "places": listed}
    values["targets"] |= {"columns": 5, "rows": 5, "pitch_mm": 9.0}
    values["calibration"]["known"] = [{"frame": 2, "point": 12}]
    return parse_scene(values, kind)


def bundle(kind: str) -> tuple[WallFrame, Any, BoardImages]:
    case, cameras, points, exact = case_of(scene_of(kind))
    frame, seen = WallFrame.from_cameras(cameras, points), board_images(case, exact)
    noise = np.random.default_rng(1).normal(0.0, 0.1, exact.shape)
    state = frame.state(case.target.points_mm, points)
    return frame, state, replace(seen, pixels=seen.pixels + noise)


@pytest.mark.parametrize("scale", [0.0, 0.3])
def test_a_plane_wall_gives_the_kernels_equations(scale: float) -> None:
    """Central differences of the cameras, next to analytic derivatives."""
    frame, state, seen = bundle("plane")
    assert frame.beyond_kernels is None
    cameras = replace(seen, frame=frame)
    one, other = (normal_equations(state, each, FREE, scale) for each in (seen, cameras))
    assert other.cost == pytest.approx(one.cost, rel=1e-9)
    for name in ("aa", "ab", "bb", "a", "d"):
        first, second = getattr(one, name), getattr(other, name)
        assert_allclose(second, first, rtol=1e-5, atol=1e-7 * np.abs(first).max())
    assert_allclose(misses(state, cameras), misses(state, seen), rtol=0, atol=1e-9)
    bounds = [compute_bound(state, each, FREE, 0.1) for each in (seen, cameras)]
    assert bounds[1].reprojection_px == pytest.approx(bounds[0].reprojection_px, rel=1e-4)
    assert_allclose(bounds[1].point_std_mm, bounds[0].point_std_mm, rtol=1e-3)


@pytest.mark.parametrize("kind", ["cylinder", "faces"])
def test_the_state_of_true_cameras_has_no_residuals(kind: str) -> None:
    frame, state, seen = bundle(kind)
    assert frame.beyond_kernels is frame
    seen = replace(seen, pixels=np.nan_to_num(case_of(scene_of(kind))[3]), frame=frame)
    assert np.abs(misses(state, seen)).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cylinder", "faces"])
def test_refractive_autocal_reaches_the_bound(kind: str) -> None:
    case, cameras, points, exact = case_of(scene_of(kind))
    solver = plugins.load("solvers", "refractive_autocal")
    answer = solver(solver.Parameters()).solve(case)
    scores: Any = calibration_scores(answer, case, cameras, points, exact, case.found)
    assert 0.5 < scores["true_px"] / scores["bound_px"] < 1.5
    assert all(one.wall == true.wall for one, true in zip(answer.cameras, cameras, strict=True))


def test_indices_are_unknowns_of_one_plane_wall_only() -> None:
    solver = plugins.load("solvers", "refractive_autocal")
    with refused("cylinder", kind=DeclinedError):
        solver(solver.Parameters(indices=(2,))).solve(case_of(scene_of("cylinder"))[0])


@pytest.mark.parametrize(("kind", "turn"), [("cylinder", 0.2), ("faces", 0.0)])
def test_free_motions_change_no_image(kind: str, turn: float) -> None:
    """They are found again; other motions are not."""
    frame, state, seen = bundle(kind)
    center = np.array([0.0, 0.0, 90.0 if kind == "cylinder" else 0.0])
    rotation = rotation_matrices(np.array([0.0, turn, 0.0]))
    shift = np.array([0.0, 7.0, 0.0])

    def moved(world: Any) -> Any:
        return (world - center) @ rotation.T + center + shift

    here = state.points(seen.board).reshape(-1, 3)
    world = frame.motion.inverse()(here)
    found = fit_free_motion(frame, here, frame.motion(moved(world)))
    assert_allclose(found(here), frame.motion(moved(world)), rtol=0, atol=1e-9)
    exact = replace(seen, pixels=np.nan_to_num(case_of(scene_of(kind))[3]), frame=frame)
    assert np.abs(misses(state.move(found), exact)).max() < 1e-6
    aside = frame.motion(world + np.array([0.0, 0.0, 5.0]))
    still: Any = fit_free_motion(frame, here, aside)
    assert np.abs(still(here) - here).max() < 2.5
