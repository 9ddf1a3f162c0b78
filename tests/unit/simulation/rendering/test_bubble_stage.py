"""Stages of the bubble renderer: walls of the tank, passes, and agreement on realistic scenes."""

import math
import tomllib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.renderers import Comparison, compare_renderers
from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.scenes import build_rig, find, parse_scene
from sabench.simulation.rendering.bubble_stage import LightPanel, Stack
from sabench.simulation.rendering.bubbles_traced import STREAMS, PassTally
from sabench.utils import backend
from sabench.utils.arrays import F64
from tests.unit.simulation.rendering.test_bubbles_traced import bubbles

ORIGIN = np.array([1.0, 2.0, 3.0])


def radius_of(what: Bubbles, solid: Solid | None = None) -> float:
    backend.mitsuba()
    from sabench.simulation.rendering.bubble_stage import _bounding_radius

    bodies = [] if solid is None else [(solid, Material())]
    return _bounding_radius(what, bodies, None, ORIGIN)


def test_the_ball_holds_everything_with_a_margin_of_a_percent_and_a_millimetre() -> None:
    small, far = [[1.3, 2.0, 3.0]], [[1.3, 2.0, 3.0], [1.0, 12.0, 3.0]]
    corners = np.array([[1.0, 2.0, 3.4], [1.1, 2.0, 3.0], [1.0, 2.1, 3.0]])
    body = Solid(corners, np.array([[0, 1, 2]]))
    assert radius_of(bubbles(small, [[0.2, 0.1, 0.1]])) == pytest.approx(1.01 * 0.5 + 1.0)
    assert radius_of(bubbles(far, [[0.2] * 3, [0.1, 0.4, 0.1]])) == pytest.approx(1.01 * 10.4 + 1.0)
    assert radius_of(bubbles([], []), body) == pytest.approx(1.01 * 0.4 + 1.0)


def device_of(radius: float) -> Any:
    """A front wall 25 mm before the origin, and a diffuser 80 mm behind it."""
    backend.mitsuba()
    import mitsuba as mi

    from sabench.simulation.rendering.bubble_integrator import layers_of, panel_of

    front = Stack(np.array([-25.0, -31.0]), np.array([1.333, 1.5, 1.0]))
    edges = np.array([[40.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    return SimpleNamespace(
        front=layers_of(front),
        rear=None,
        panel=panel_of(LightPanel(np.array([0.0, 0.0, 80.0]), edges, 2.0)),
        normal=mi.Vector3f(0.0, 0.0, 1.0),
        radius=mi.Float(radius),
    )


@pytest.mark.parametrize(("z", "seen"), [(79.0, 2.0), (80.0, 0.0), (81.0, 0.0)])
def test_the_diffuser_is_seen_from_before_it_only(z: float, seen: float) -> None:
    """Not from within it, and not backwards."""
    device = device_of(1.0)
    import mitsuba as mi

    from sabench.simulation.rendering.bubble_integrator import leave

    radiance, _, _ = leave(device, mi.Ray3f(mi.Point3f(1.0, 2.0, z), mi.Vector3f(0.0, 0.0, 1.0)))
    assert np.array(radiance) == seen


@pytest.mark.parametrize(("radius", "reflects"), [(0.5, False), (0.51, True)])
def test_walls_reflect_what_is_nearer_than_fifty_radii(radius: float, reflects: bool) -> None:
    """Light along the wall's normal: Fresnel's shares of both faces, and no light from outside."""
    device = device_of(radius)
    import mitsuba as mi

    from sabench.simulation.rendering.bubble_integrator import leave

    radiance, share, here = leave(device, mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, -1.0)))
    passed = 4.0 * 1.333 * 1.5 / (1.333 + 1.5) ** 2 * 4.0 * 1.5 / (1.0 + 1.5) ** 2
    np.testing.assert_allclose(np.array(share), (1.0 - passed) * reflects, atol=1e-6)
    np.testing.assert_allclose(np.array(here).ravel(), [0.0, 0.0, -25.0], atol=1e-5)
    assert np.array(radiance) == 0.0


_ALL = np.ones((2, 2), dtype=np.bool_)


def _run(tally: PassTally, scatter: F64, error: float) -> F64:
    """Add passes with the scatter (n,) until the error is reached; returns the errors."""
    random, more = np.random.default_rng(1), np.full(len(scatter), STREAMS)
    while more.any():
        chosen = np.flatnonzero(more)
        values = 1.0 + np.repeat(scatter[chosen], more[chosen]) * random.normal(size=more.sum())
        tally.add(chosen, more[chosen], values)
        off = tally.errors(0.1)
        more = tally.wanted(off, error) - tally.count
    return off


def test_pixels_with_larger_errors_get_more_rays() -> None:
    """The mean error is reached with most rays where bubbles are."""
    tally = PassTally(np.ones((20, 20), dtype=np.bool_))
    assert 0.006 < _run(tally, np.where(np.arange(400) < 40, 0.5, 0.002), 0.008).mean() <= 0.008
    assert tally.count[:20].mean() > 10.0 * tally.count[200:].mean()
    assert np.abs(tally.mean - 1.0).mean() < 0.01


def test_an_even_background_does_not_excuse_errors_of_what_is_shown() -> None:
    """The mean is over the pixels that count, and others do not take more rays than they need."""
    counted = np.zeros((40, 40), dtype=np.bool_)
    counted[:2] = True
    tally = PassTally(counted)
    off = _run(tally, np.where(counted.ravel(), 0.5, 0.02), 0.02)
    shown = off[counted.ravel()].mean()
    assert tally.mean_error(off) == shown
    assert 0.015 < shown <= 0.02
    assert tally.count[400:].mean() < 1.5 * STREAMS


def test_an_image_that_shows_nothing_is_done_at_once() -> None:
    """Nothing counts, and there is no mean to reach."""
    tally = PassTally(~_ALL)
    assert tally.mean_error(_run(tally, np.full(4, 0.5), 1e-3)) == 0.0
    assert tally.count.max() == STREAMS


def test_passes_that_come_in_parts_have_the_mean_and_scatter_of_all() -> None:
    """As if all had come at once, also if pixels get different numbers."""
    values = np.random.default_rng(2).normal(5.0, 1.0, size=(4, 12))
    parts, whole = PassTally(_ALL), PassTally(_ALL)
    pixels = np.arange(4)
    parts.add(pixels, np.full(4, 4), values[:, :4].ravel())
    parts.add(pixels[1:], np.full(3, 8), values[1:, 4:].ravel())
    parts.add(pixels[:1], np.array([8]), values[0, 4:])
    whole.add(pixels, np.full(4, 12), values.ravel())
    np.testing.assert_allclose(parts.mean, values.mean(axis=1))
    np.testing.assert_allclose(parts.errors(0.0), whole.errors(0.0))
    np.testing.assert_array_equal(parts.count, 12)


def test_errors_are_those_of_the_means_of_streams() -> None:
    """Passes that take turns belong to one stream each."""
    tally, streams = PassTally(_ALL[:1, :1]), np.array([1.0, 2.0, 3.0, 6.0])
    tally.add(np.array([0]), np.array([8]), np.concatenate([streams - 0.5, streams + 0.5]))
    expected = streams.std(ddof=1) / math.sqrt(STREAMS) / streams.mean()
    assert tally.errors(0.0)[0] == pytest.approx(expected)


def compare(name: str, samples: int) -> Comparison:
    """Compare the renderers in one camera of 100 x 130 pixels, at an edge of the array."""
    values = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 100, "columns": 130}
    values["volume"]["size_mm"] = [6.5, 5.0, 4.0]
    values["grid"]["crop_mm"] = [0.5, 0.5, 0.0]
    values["render"] = {"samples_per_pixel": samples}
    scene = parse_scene(values, name)
    return compare_renderers(scene, build_rig(scene), 2)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", ["standard-particles", "realistic-particles"])
def test_rays_and_formulas_agree(name: str) -> None:
    """Rays through the middles of n x n parts make a pixel narrower by 1 / 12 n2 px2."""
    found = compare(name, 9)
    assert len(found.light) > 40
    assert np.abs(found.shift_px).max() < 1e-3
    assert found.light == pytest.approx(1.0, abs=5e-4)
    fine = compare(name, 49)
    assert np.abs(fine.width - 1.0).max() < 0.3 * np.abs(found.width - 1.0).max()
    assert fine.width == pytest.approx(1.0, abs=2e-3)
