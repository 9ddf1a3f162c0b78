"""Walls of the tank and the diffuser at the limits of what they show."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sabench.simulation.rendering.bubble_stage import Panel, Stack
from sabench.utils import backend


def device_of(radius: float) -> Any:
    """A front wall 25 mm before the origin, and a diffuser 80 mm behind it."""
    backend.mitsuba()
    import mitsuba as mi

    from sabench.simulation.rendering.tank_walls import layers_of, panel_of

    front = Stack(np.array([-25.0, -31.0]), np.array([1.333, 1.5, 1.0]))
    edges = np.array([[40.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    return SimpleNamespace(
        front=layers_of(front),
        rear=None,
        panel=panel_of(Panel(np.array([0.0, 0.0, 80.0]), edges, 2.0)),
        normal=mi.Vector3f(0.0, 0.0, 1.0),
        radius=mi.Float(radius),
    )


@pytest.mark.parametrize(("z", "seen"), [(79.0, 2.0), (80.0, 0.0), (81.0, 0.0)])
def test_the_diffuser_is_seen_from_before_it_only(z: float, seen: float) -> None:
    """Not from within it, and not backwards."""
    device = device_of(1.0)
    import mitsuba as mi

    from sabench.simulation.rendering.tank_walls import leave

    radiance, _, _ = leave(device, mi.Ray3f(mi.Point3f(1.0, 2.0, z), mi.Vector3f(0.0, 0.0, 1.0)))
    assert np.array(radiance) == seen


@pytest.mark.parametrize(("radius", "reflects"), [(0.49, False), (0.5, False), (0.51, True)])
def test_walls_reflect_what_is_nearer_than_fifty_radii(radius: float, reflects: bool) -> None:
    """Light along the wall's normal: Fresnel's shares of both faces, and no light from outside."""
    device = device_of(radius)
    import mitsuba as mi

    from sabench.simulation.rendering.tank_walls import leave

    radiance, share, here = leave(device, mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, -1.0)))
    passed = 4.0 * 1.333 * 1.5 / (1.333 + 1.5) ** 2 * 4.0 * 1.5 / (1.0 + 1.5) ** 2
    np.testing.assert_allclose(np.array(share), (1.0 - passed) * reflects, atol=1e-6)
    np.testing.assert_allclose(np.array(here).ravel(), [0.0, 0.0, -25.0], atol=1e-5)
    assert np.array(radiance) == 0.0
