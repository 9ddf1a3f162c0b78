"""A liquid jet in a cross-flow: the measured laws, motion along them, and overlaps."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.api.make import generator_of
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.rigid_motion import Domain
from sabench.worlds.library.jet_in_crossflow import Crossflow, Spray
from sabench.worlds.library.overlaps import overlapping, touching

NOZZLE = (5.0, 2.0, -1.0)
DOMAIN = Domain((35.0, -28.0, 0.0), (70.0, 60.0, 60.0), 1000)
FLOW = {"nozzle_mm": NOZZLE, "diameter_mm": 2.0, "momentum_ratio": 12.0}
JET: dict[str, Any] = FLOW | {"ligaments": 12}


def drops(time_s: float = 0.0, seed: int = 1, **more: Any) -> Bubbles:
    jet = generator_of({"generator": "jet_in_crossflow"} | JET | more)
    made: Bubbles = jet.bubbles(DOMAIN, seed, 0, time_s)
    return made


@pytest.fixture(scope="module")
def column() -> Solid:
    made: Solid = generator_of({"generator": "liquid_column", "step_mm": 0.25} | JET).body(1)
    return made


def test_the_column_is_one_closed_body_along_the_measured_path(column: Solid) -> None:
    import trimesh

    mesh = trimesh.Trimesh(column.vertices_mm, column.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0.0
    rise = 3.44 * np.sqrt(12.0) * 2.0
    places = column.vertices_mm - NOZZLE
    assert -places[:, 1].min() == pytest.approx(rise, abs=2.5)
    for y in np.linspace(2.0, 0.6 * rise, 5):  # below that ligaments pull the middle into the gas
        ring = places[(np.abs(places[:, 1] + y) < 0.4) & (np.abs(places[:, 2]) < 1.2)]
        windward = ring[:, 0].min()
        path = (y / 2.0 / 1.37) ** 2 / 12.0 * 2.0
        assert windward == pytest.approx(path - 1.0, abs=0.6)


@pytest.mark.slow
def test_drops_are_between_the_edges_and_off_the_column(column: Solid) -> None:
    made = drops()
    assert len(made) > 150
    assert len(overlapping(made)) == 0
    assert not touching(made, column).any()
    x, y, z = (made.center_mm - NOZZLE).T
    upper = 4.3 * 12.0**0.33 * (x / 2.0) ** 0.33 * 2.0
    width = 7.86 * 12.0**0.17 * (x / 2.0) ** 0.33 * 2.0
    assert (-y <= upper).all()
    assert (-y >= 0.4 * upper).all()
    assert (np.abs(z) <= width / 2.0).all()
    assert (made.center_mm[:, 0] + made.reach_mm([1.0, 0.0, 0.0]) <= 70.0).all()


def test_drops_move_with_their_velocities_and_the_gas_takes_them_along() -> None:
    """Motion obeys x'' = (gas - x') / response, by differences of positions at three times."""
    step = 2e-5
    early, now, late = (drops(1e-3 + k * step) for k in (-1, 0, 1))
    every = [one for one in now.id if one in early.id and one in late.id]
    a, b, c = (made[np.flatnonzero(np.isin(made.id, every))] for made in (early, now, late))
    assert len(b) > 100
    expected = b.velocity_mm_s
    assert_allclose((c.center_mm - a.center_mm) / (2.0 * step), expected, rtol=2e-3, atol=5.0)
    gain = (c.velocity_mm_s[:, 0] - a.velocity_mm_s[:, 0]) / (2.0 * step)
    assert_allclose(gain, (40_000.0 - b.velocity_mm_s[:, 0]) / 5e-3, rtol=1e-3)


def test_the_spray_stays_as_dense_however_late() -> None:
    counts = [len(drops(time)) for time in (0.0, 2e-3, 7e-3, 0.1)]
    assert max(counts) - min(counts) < 0.2 * counts[0]
    first, later = drops(), drops(0.1)
    assert not set(first.id) & set(later.id)


def test_lines_are_known_from_places() -> None:
    spray = Spray(Crossflow.model_validate(JET), 0.4, 40_000.0, 5e-3, 60.0)
    rng = np.random.default_rng(1)
    age, line = rng.uniform(1e-4, spray.ages[0][-1], 50), rng.random((50, 2))
    again, lines = spray.ages_and_lines(spray.positions(age, line))
    assert_allclose(again, age, rtol=1e-3)
    assert_allclose(lines, line, atol=1e-9)
    assert spray.ages[1][-1] == pytest.approx(60.0)
