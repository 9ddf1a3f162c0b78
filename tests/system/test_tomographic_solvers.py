"""Tomographic solvers on small volumes, and on images with flaws."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.ndimage import maximum_filter

from benchmarks.flawed_images import VOLUMES, cases_of, measure, part_of_standard
from sabench import plugins
from sabench.api import Camera, Observation, Reconstruction
from sabench.dataset.reader import build_observation
from sabench.geometry.grid import Grid, synthesise
from sabench.images.preprocessing import Gaussian, SlidingMinimum
from sabench.metrics.quality_factor import quality
from sabench.metrics.reconstruction_error import score_frame, true_field
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from tests.conftest import pinholes

# least Q in air
SOLVERS = {
    "mlos_sart": 0.82,
    "mlos_smart": 0.92,
    "smart": 0.90,
    "block_mart": 0.93,
    "mart": 0.93,
    "mfg_mart": 0.93,
}


def scene_of(wall: bool) -> Scene:
    """Four cameras, 28 degrees off the axis, of 72 x 72 x 28 voxels. A voxel has a pixel's size."""
    values = load_scene("quick").to_dict()
    values["volume"] = {"center_mm": [0.0, 0.0, 30.0 if wall else 0.0], "size_mm": [3.6, 3.6, 1.4]}
    values["grid"] = {"voxel_mm": [0.05, 0.05, 0.05]}
    layout = {"kind": "ring", "count": 4, "radius_mm": 240.0}
    values["cameras"] |= {"rows": 112, "columns": 112, "particle_sigma_px": 0.85, "layout": layout}
    values["cameras"]["center_mm"] = [0.0, 0.0, -425.0 if wall else -450.0]
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 10.0}
    values["particles"] = {"generator": "uniform", "count": 80, "diameter_mm": 0.02}
    values["sensor"] = {"full_well_e": 1e7, "gain_dn_e": 0.2, "bit_depth": 16}
    values["sensor"] |= {"black_level_dn": 100.0, "shot_noise": False}
    if not wall:
        del values["wall"]
    return parse_scene(values, "test")


def solve(name: str, case: Observation, **parameters: Any) -> Reconstruction:
    solver = plugins.load("solvers", name)
    made: Reconstruction = solver(solver.Parameters(**parameters)).solve(case)
    return made


def scores(shot: Shot, made: Reconstruction) -> dict[str, float]:
    found = score_frame(shot.observation.grid, shot.particles, shot.views, made)
    return {key: -1.0 if value is None else value for key, value in found.items()}


@pytest.fixture(scope="module")
def in_air() -> Shot:
    return simulate(scene_of(wall=False), seed=100)


@pytest.fixture(scope="module")
def behind_glass() -> Shot:
    return simulate(scene_of(wall=True), seed=101)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_particles_are_reconstructed(name: str, in_air: Shot, behind_glass: Shot) -> None:
    for shot, slack in ((in_air, 0.0), (behind_glass, 0.03)):
        made = solve(name, shot.observation)
        assert made.volume.dtype == np.float32
        assert made.volume.shape == shot.observation.grid.shape
        assert made.particles_mm is None
        found = scores(shot, made)
        assert found["q"] > SOLVERS[name] - slack, found
        assert found["true_percent"] > 80.0
        assert found["ghost_percent"] < 25.0


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_bilinear_points_do_nearly_as_well(name: str, in_air: Shot) -> None:
    made = solve(name, in_air.observation, footprint="bilinear", floor=0.02)
    assert scores(in_air, made)["q"] > SOLVERS[name] - 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_particles_beyond_one_cameras_border_are_kept(name: str, in_air: Shot) -> None:
    """The first camera looks past half of the volume. There the other three find the particles."""
    case, aside = in_air.observation, 55
    images = case.images.copy()
    images[0] = np.roll(images[0], aside, axis=1)
    images[0, :, :aside] = 100
    column, row = pinholes(case.cameras)[0].principal_point_px
    moved = replace(pinholes(case.cameras)[0], principal_point_px=(column + aside, row))
    made = solve(name, replace(case, images=images, cameras=(moved, *case.cameras[1:])))
    past = in_air.views[0].pixel[:, 0] > case.cameras[0].columns - aside + 2
    hidden = in_air.particles.position_mm[past]
    voxels = np.rint(case.grid.to_voxels(hidden)).astype(int)
    around = maximum_filter(made.volume, 3)
    brightest = around[tuple(np.clip(voxels, 1, np.asarray(case.grid.shape[::-1]) - 2).T[::-1])]
    assert 15 < len(hidden) < 60
    assert (brightest > 0.0).mean() > 0.9


@pytest.mark.slow
def test_clipped_pixels_are_known_to_be_clipped(in_air: Shot) -> None:
    case = in_air.observation
    white = np.floor(np.quantile(case.images[case.images > 200], 0.7))
    clipped = np.minimum(case.images, np.uint16(white))
    given, unset = (replace(case, images=clipped, white_dn=level) for level in (white, 65535.0))
    truth = true_field(case.grid, in_air.particles, in_air.views)
    for name in ("block_mart", "mart", "mlos_sart"):
        better, worse = (quality(solve(name, view).volume, truth) for view in (given, unset))
        assert better > worse + 0.01, name


def test_long_voxels_are_split(in_air: Shot) -> None:
    """The same images, and voxels four times as long: as good as short ones added up."""
    grid = in_air.observation.grid
    long = Grid((*grid.low_mm[:2], grid.low_mm[2] + 1.5 * 0.05), (0.05, 0.05, 0.2), (7, 72, 72))
    made = solve("block_mart", replace(in_air.observation, grid=long))
    light = np.ones(len(in_air.particles))
    truth = synthesise(long, in_air.particles.position_mm, light, 0.85 * 0.05)
    assert made.volume.shape == long.shape
    assert quality(made.volume, truth) > 0.93


@pytest.mark.slow
def test_more_iterations_are_better_and_tolerance_ends_them(in_air: Shot) -> None:
    truth = true_field(in_air.observation.grid, in_air.particles, in_air.views)
    few, many, stopped = (
        quality(solve("mlos_smart", in_air.observation, iterations=n, tolerance=t).volume, truth)
        for n, t in ((1, 0.0), (20, 0.0), (20, 0.9))
    )
    assert few < many
    assert few <= stopped < many


@pytest.mark.parametrize("name", SOLVERS)
def test_nonsense_is_refused(name: str) -> None:
    wrong = {"iterations": 0, "tolerance": 1.0, "footprint": "disc", "sigma_px": 0.1, "floor": 1.0}
    for key, value in (*wrong.items(), ("relaxation", 0.0), ("relaxation", 2.5)):
        with pytest.raises(ValidationError):
            plugins.load("solvers", name).Parameters(**{key: value})


_LOSS = 0.01  # of Q, over what no reflection covers
_FEW = 0.05  # of F1: one of the few dozen particles that this small part leaves


@pytest.fixture(scope="module")
def shots() -> dict[float, Shot]:
    """Shots by particles per pixel: few for particle solvers, for volumes more in a larger part. In
    a smaller part, where the reflection covers most particles, Q scatters by more than the loss."""
    return {
        density: simulate(part_of_standard(small, density, 9), seed=2)
        for density, small in ((0.02, True), (0.05, False))
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["msa", "mlos_sart", "bayesian_ipr"])
def test_flaws_cost_next_to_nothing(name: str, shots: dict[float, Shot]) -> None:
    shot, kind = (shots[0.05], "q") if name in VOLUMES else (shots[0.02], "f1")
    cases = dict(cases_of(shot, 2))
    clean = measure(name, shot, cases["clean"], 2)
    assert float(clean[kind]) > 0.3
    for flaws in ("each", "all"):
        scores = measure(name, shot, cases[flaws], 2)
        whole = kind if flaws == "each" else f"{kind}_open"
        loss = _LOSS if name in VOLUMES else _FEW
        assert float(scores[whole]) > float(clean[whole]) - loss, flaws


def test_preprocessing_keeps_hot_pixels_and_reflections_apart(shots: dict[float, Shot]) -> None:
    case = dict(cases_of(shots[0.05], 2))["all"]
    nominal = tuple(camera for camera in case.cameras if isinstance(camera, Camera))
    steps = (SlidingMinimum(step="sliding_minimum"), Gaussian(step="gaussian"))
    made = build_observation(case.images, nominal, case.grid, (case.black_dn, case.white_dn), steps)
    raw = case.repaired.flaws
    assert made.flaws is not None
    assert raw.unknown.any()
    for before, after in zip(raw, made.repaired.flaws, strict=True):
        np.testing.assert_array_equal(before, after)
    levels = made.images[~raw.covered]
    assert levels.max() < 0.3 * made.white_dn  # full-well pixels are gone
