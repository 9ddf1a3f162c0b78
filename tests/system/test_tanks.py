"""Round tanks and tanks of two faces, from the scene to the scores."""

import dataclasses
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench import plugins
from sabench.api import F64, DeclinedError, ImageSequence
from sabench.dataset import cameras as camera_files, schema
from sabench.dataset.reader import open_dataset
from sabench.geometry.camera_records import decode_cameras, encode_cameras
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.grid import Grid
from sabench.geometry.plane_polynomials import plane_maps, plane_points, terms
from sabench.geometry.volume_polynomials import fit_volume_polynomials, project_points
from sabench.interop import openlpt, openptv
from sabench.metrics.particle_detection import count_challenge
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import build_rig, find, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.simulation.pipeline import generate
from sabench.tasks.solver_call import call_solver
from tests.conftest import pinholes
from tests.helpers.calibration_cases import calibration_scene, case_of
from tests.helpers.refusals import check_sentence, refused

TANKS = ("cylinder-tank", "two-faces", "free-surface")


@pytest.fixture(scope="module")
def shots() -> dict[str, Shot]:
    found = {}
    for name in ("quick", *TANKS):
        scene = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
        scene["illumination"]["scattering"] = "isotropic"  # Q varies more by Mie's than by walls
        found[name] = simulate(parse_scene(scene, name), seed=1)
    return found


def solve(name: str, case: Any) -> Any:
    solver = plugins.load("solvers", name)
    return solver(solver.Parameters()).solve(case)


@pytest.mark.parametrize("name", TANKS)
def test_polynomials_are_the_exact_projection(name: str) -> None:
    """Most solvers project in polynomials of planes or of the volume."""
    rig = build_rig(load_scene(name))
    grid, rng = rig.grid, np.random.default_rng(1)
    low = np.asarray(grid.low_mm)
    high = low + (np.asarray(grid.shape[::-1]) - 1) * np.asarray(grid.voxel_mm)
    unit = rng.uniform(-1.0, 1.0, (300, 3))
    volume = fit_volume_polynomials(rig.cameras, low, high)
    planes = plane_maps(rig.cameras, Grid(grid.low_mm, grid.voxel_mm, (2, *grid.shape[1:])))
    for number, camera in enumerate(rig.cameras):
        exact = camera.project((low + high) / 2.0 + unit * (high - low) / 2.0)[0]
        found = project_points(volume, number, unit)
        assert np.linalg.norm(found - exact, axis=1).max() < 2e-3
        first = planes[0][number]
        exact = camera.project(plane_points(grid, grid.low_mm[2], unit[:, :2]))[0]
        found = terms(unit[:, :2], first.degree) @ first.coefficients.T
        assert np.linalg.norm(found - exact, axis=1).max() < 2e-3


def found_share(shot: Shot, points_mm: F64) -> float:
    """F1 of found particles by the challenge's rule."""
    grid = shot.observation.grid
    found, true = (grid.to_voxels(at) for at in (points_mm, shot.particles.position_mm))
    counts = count_challenge(found, true, grid.in_scored(found), grid.in_scored(true))
    return 2.0 * counts.precision * counts.recall / (counts.precision + counts.recall)


@pytest.mark.slow
@pytest.mark.parametrize("name", TANKS)
def test_particles_are_found_as_behind_a_plane_wall(name: str, shots: dict[str, Shot]) -> None:
    plane, own = (
        found_share(
            shots[one],
            solve("bayesian_ipr", ImageSequence.of([shots[one].observation]))[0].position_mm,
        )
        for one in ("quick", name)
    )
    assert own > plane - 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver"), [*((name, "msa") for name in TANKS), (TANKS[0], "block_mart")]
)
def test_volumes_are_as_behind_a_plane_wall(name: str, solver: str, shots: dict[str, Shot]) -> None:
    found = []
    for one in (shots["quick"], shots[name]):
        made = solve(solver, one.observation)
        found.append(score_frame(one.observation.grid, one.particles, one.views, made)["q"] or 0.0)
    assert found[1] > found[0] - 0.03


@pytest.mark.parametrize("name", ["cylinder-tank", "two-faces"])
def test_data_sets_keep_the_walls(name: str, tmp_path: Path) -> None:
    data = generate(load_scene(name), tmp_path / "data", seed=1, backend="splat")
    cameras = build_rig(load_scene(name)).cameras
    assert open_dataset(tmp_path / "data").setup.cameras == cameras
    assert data.true_cameras == cameras
    assert decode_cameras(encode_cameras(cameras)) == cameras


def test_damaged_walls_are_named(tmp_path: Path) -> None:
    cameras = pinholes(build_rig(load_scene("two-faces")).cameras)
    sensor = {"black_dn": 64.0, "white_dn": 4000.0, "bit_depth": 12}
    grid = build_rig(load_scene("two-faces")).grid
    keys = {"frames": 1, "interval_s": 1e-3, "grid": grid, "sensor": sensor}
    bent = [dataclasses.asdict(camera.wall) for camera in cameras if camera.wall]
    bent[1] |= {"normal": [0.0, 0.0, 2.0]}
    round_wall = CylinderWall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 40.0, 1.0, (), 1.333)
    for walls in (
        bent[:3],
        bent,
        [dataclasses.asdict(round_wall) | {"axis": [1.0, 1.0, 0.0]}] * 4,
        [dataclasses.asdict(round_wall) | {"outer_radius_mm": -1.0}] * 4,
    ):
        camera_files.write_cameras(tmp_path / schema.CAMERAS, cameras, wall=walls, **keys)
        with refused("wall"):
            camera_files.read_cameras(tmp_path)


@pytest.mark.parametrize("name", ["cylinder-tank", "two-faces"])
def test_what_needs_one_plane_wall_declines(name: str) -> None:
    cameras = pinholes(build_rig(load_scene(name)).cameras)
    scene = calibration_scene(cameras={"layout": {"kind": "line", "count": 4, "spacing_mm": 80.0}})
    case = replace(case_of(scene)[0], cameras=cameras)
    solver = plugins.load("solvers", "refractive_autocal_alternating")
    with refused(solver.name, kind=DeclinedError):
        call_solver(solver(solver.Parameters()), solver.name, case, object)


def test_programs_for_plane_walls_decline() -> None:
    cylinder, faces = (
        pinholes(build_rig(load_scene(name)).cameras) for name in ("cylinder-tank", "two-faces")
    )
    assert openptv.unlike(faces) is None
    other = dataclasses.replace(faces[2], wall=None)
    check_sentence(openlpt.unfit(cylinder[0]) or "", "OpenLPT")
    check_sentence(openptv.unfit(cylinder[0]) or "", "OpenPTV")
    check_sentence(openptv.unlike((*faces[:2], other)) or "", "camera_02", "camera_00")
