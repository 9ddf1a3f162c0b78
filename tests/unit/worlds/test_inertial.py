"""Inertial particles against closed forms of the equation of Maxey and Riley.

dv/dt = b Du/Dt + (u - v) / tau + (1 - b) g,  b = 3 rho_f / (2 rho_p + rho_f)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sabench.api import Flow
from sabench.plugins import load
from sabench.scenes.materials import Inertia
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.validation import validate
from sabench.worlds.advection import InertialFlow, move_particles
from sabench.worlds.tracers import Motion, lattice, require_flow
from tests.unit.worlds.test_tracers import moving_scene

SIZES = np.array([0.02, 0.05, 0.1])
HEAVY = Inertia(particle_density_kg_m3=2500.0, gravity_m_s2=(0.0, 0.0, 0.0))
LIGHT = Inertia(particle_density_kg_m3=1.2, gravity_m_s2=(0.0, 0.0, 0.0))


def rigid(name: str, **parameters: Any) -> Flow:
    plugin = load("generators", name)
    made: Flow = plugin(validate(plugin.Parameters, parameters, name))
    return made


def numbers(inertia: Inertia) -> tuple[float, F64]:
    """Return b and tau of Maxey and Riley, from the densities."""
    ratio = inertia.particle_density_kg_m3 / inertia.fluid_density_kg_m3
    b = 3.0 / (2.0 * ratio + 1.0)
    return b, SIZES**2 / (12.0 * b * inertia.viscosity_mm2_s)


def test_particles_settle_at_stokes_s_velocity() -> None:
    """Glass beads of .1 mm in water: 8.2 mm/s, drops of 0.02 mm 0.33 mm/s."""
    glass = Inertia(particle_density_kg_m3=2500.0)
    there = move_particles(rigid("linear_flow"), glass, np.zeros((3, 3)), SIZES, 0.0, 2.0, 1e-8)
    expected = 1501.8 * 9.81 * (1e-3 * SIZES) ** 2 / (18.0 * 998.2 * 1e-6) * 1e3 * 2.0
    np.testing.assert_allclose(there[:, 1], expected, rtol=1e-6)
    np.testing.assert_allclose(there[:, [0, 2]], 0.0, atol=1e-12)


@pytest.mark.parametrize("inertia", [HEAVY, LIGHT])
def test_particles_spiral_out_of_a_vortex_or_into_it(inertia: Inertia) -> None:
    """In a core that turns at the rate w: l^2 + l / tau + b w^2 - i w / tau = 0."""
    vortex, rate = rigid("rankine_vortex", core_mm=10.0, peak_mm_s=100.0), 100.0 / 10.0
    start = np.tile([2.0, 0.0, 0.0], (3, 1))
    there = move_particles(vortex, inertia, start, SIZES, 0.0, 1.0, 1e-10)
    growth = np.log(np.linalg.norm(there[:, :2], axis=1) / 2.0)
    b, tau = numbers(inertia)
    roots = [np.roots([1.0, 1.0 / t, b * rate**2 - 1j * rate / t]) for t in tau]
    slow = [pair[np.argmin(np.abs(pair))].real for pair in roots]
    np.testing.assert_allclose(growth, slow, rtol=0.02)
    assert (np.sign(growth) == np.sign(inertia.particle_density_kg_m3 - 998.2)).all()


class Swing(Flow):
    """Fluid that swings to and fro."""

    name = "swing"
    rate = 40.0

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        return np.tile([100.0 * np.cos(self.rate * time_s), 0.0, 0.0], (len(points_mm), 1))

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        return np.zeros((len(points_mm), 3, 3))


@pytest.mark.parametrize("inertia", [HEAVY, LIGHT])
def test_amplitude_and_phase_in_a_flow_that_swings(inertia: Inertia) -> None:
    """v / u = (1 + i w b tau) / (1 + i w tau), to the second order in w tau."""
    own, points = InertialFlow(Swing(None), inertia, SIZES), np.zeros((3, 3))
    quarter = 0.5 * np.pi / Swing.rate
    now, later = (own.velocity(points, time)[:, 0] / 100.0 for time in (0.0, quarter))
    b, tau = numbers(inertia)
    exact = (1.0 + 1j * Swing.rate * b * tau) / (1.0 + 1j * Swing.rate * tau)
    np.testing.assert_array_less(
        np.abs(now - 1j * later - exact), 1.01 * np.abs(1 - b) * (Swing.rate * tau) ** 2 + 1e-8
    )
    slip = np.abs(exact - 1.0)
    np.testing.assert_allclose(np.abs(now - 1j * later - 1.0), slip, rtol=0.01)


def test_a_scene_s_particles_move_by_themselves_and_its_flow_is_the_fluid_s() -> None:
    inertia = {"particle_density_kg_m3": 2500.0}
    scene = moving_scene(inertia=inertia)
    first = Motion(scene, 1).at(0)
    flow = require_flow(scene)
    fluid, slopes = (one(first.position_mm, 0.0) for one in (flow.velocity, flow.gradient))
    force = [0.0, 9810.0, 0.0] - np.einsum("nij,nj->ni", slopes, fluid)
    slip = Inertia(**inertia).response_s(first.diameter_mm)[:, None] * force
    assert np.abs(slip).max() > 2.0
    np.testing.assert_allclose(first.velocity_mm_s, fluid + slip, atol=1e-5)
    field, _ = lattice(scene, 0, (5.0, 5.0, 2.0))
    exact = require_flow(scene).velocity(field.positions_mm.reshape(-1, 3), 0.0)
    np.testing.assert_array_equal(field.velocity_mm_s.reshape(-1, 3), exact)


def test_they_are_replaced_and_any_frame_is_the_same_by_itself() -> None:
    scene = moving_scene(inertia={"particle_density_kg_m3": 4000.0})
    motion = Motion(scene, 1)
    frames = [motion.at(frame) for frame in range(4)]
    np.testing.assert_array_equal(frames[3].position_mm, Motion(scene, 1).at(3).position_mm)
    assert abs(len(frames[3]) - 800) < 4.0 * np.sqrt(800.0)
    later = motion.move(frames[3], 3, 1e-4) - frames[3].position_mm
    np.testing.assert_allclose(later, 1e-4 * frames[3].velocity_mm_s, atol=1e-4)


def test_without_inertia_particles_are_the_fluid_s() -> None:
    first = Motion(moving_scene(), 1).at(0)
    fluid = require_flow(moving_scene()).velocity(first.position_mm, 0.0)
    np.testing.assert_array_equal(first.velocity_mm_s, fluid)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inertia": {"particle_density_kg_m3": 2500.0}, "flow": None}, "inertia: expected a flow"),
        (
            {
                "inertia": {"particle_density_kg_m3": 2500.0},
                "particles": {"generator": "uniform", "count": 20, "diameter_mm": 0.4},
            },
            "inertia: expected particles with a Stokes number",
        ),
        (
            {
                "inertia": {"particle_density_kg_m3": 9000.0},
                "particles": {"generator": "uniform", "count": 20, "diameter_mm": 0.2},
                "flow": {"generator": "linear_flow"},
            },
            "inertia: expected particles with a Reynolds number of their slip of at most 1, got",
        ),
    ],
)
def test_what_stokes_s_drag_does_not_describe_is_named(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Motion(moving_scene(**changes), 1).at(0)
