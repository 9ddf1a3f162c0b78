"""Motion of particles with flows, and of inertial ones."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

from sabench.api import Flow
from sabench.api.make import generator_of
from sabench.geometry.grid import divergence, vorticity
from sabench.scenes.materials import Inertia
from sabench.utils.arrays import F64
from sabench.worlds.advection import InertialFlow, advect, move_particles
from sabench.worlds.tracers import Motion, require_flow, sample_lattice
from tests.helpers.refusals import refused
from tests.unit.worlds.test_tracers import ABC, moving_scene

GRADIENT = ((1.0, 2.0, 3.0), (0.5, -2.0, 0.1), (0.0, 4.0, 1.0))
FLOWS: list[tuple[str, dict[str, Any]]] = [
    ("vortex_ring", {"axis": (1.0, 0.2, 0.4), "center_mm": (1.0, -2.0, 0.5)}),
    ("taylor_green", {"center_mm": (1.0, 2.0, 3.0)}),
    ("taylor_green", {"deep": False, "viscosity_mm2_s": 1.0}),
    ("abc_flow", {"center_mm": (0.3, 0.0, -1.0)}),
    ("rankine_vortex", {"axis": (0.3, -0.5, 1.0), "center_mm": (0.0, 1.0, 0.0)}),
    ("lamb_oseen_vortex", {"axis": (0.0, 1.0, 1.0), "viscosity_mm2_s": 1.0}),
    ("linear_flow", {"gradient_1_s": GRADIENT, "velocity_mm_s": (1.0, 2.0, 3.0)}),
    ("shear_wave", {"along": (0.0, 1.0, 0.0), "across": (1.0, 0.0, 1.0)}),
    ("turbulence", {"integral_mm": 8.0, "kolmogorov_mm": 0.5}),
]
FREE = [case for case in FLOWS if case[0] not in ("vortex_ring", "linear_flow")]  # of divergence


def flow(name: str, **parameters: Any) -> Flow:
    made: Flow = generator_of({"generator": name, **parameters})
    return made


def at(x: F64, y: float = 0.0, z: float = 0.0) -> F64:
    return np.column_stack([x, np.full_like(x, y), np.full_like(x, z)])


def points(count: int = 200) -> F64:
    return np.random.default_rng(0).uniform(-15.0, 15.0, (count, 3))


@pytest.mark.parametrize(("name", "parameters"), FLOWS)
def test_gradients_are_the_slopes_of_velocities(name: str, parameters: dict[str, Any]) -> None:
    field, places, step = flow(name, **parameters), points(), 1e-4
    exact = field.gradient(places, 0.3)
    assert exact.shape == (len(places), 3, 3)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        ends = [field.velocity(places + by, 0.3) for by in (-move, move)]
        slope = (ends[1] - ends[0]) / (2.0 * step)
        assert_allclose(exact[:, :, axis], slope, atol=1e-5 * np.abs(exact).max())


@pytest.mark.parametrize(("name", "parameters"), FREE)
def test_fields_without_divergence_have_none(name: str, parameters: dict[str, Any]) -> None:
    gradient = flow(name, **parameters).gradient(points(), 0.1)
    assert np.abs(divergence(gradient)).max() < 1e-12 * np.abs(gradient).max() * 10.0


def test_the_ring_is_equation_2_14() -> None:
    """Along a radius in the plane of the ring, and on its axis."""
    ring = flow("vortex_ring", diameter_mm=20.0, core_mm=4.0, peak_mm_s=100.0)
    distance = np.array([0.0, 1.0, 4.0, 9.0])
    expected = 100.0 * np.e * distance / 4.0 * np.exp(-distance / 4.0)
    found = ring.velocity(at(10.0 + distance), 0.0)
    assert_allclose(found, at(0.0 * distance) - np.outer(expected, [0.0, 0.0, 1.0]), atol=1e-10)
    assert ring.velocity(np.zeros((1, 3)), 0.0)[0, 2] > 0.0
    assert np.linalg.norm(ring.velocity(points(5000), 0.0), axis=1).max() <= 100.0 + 1e-9


def test_fluid_crosses_the_ring_s_axis_or_stays_beside_it() -> None:
    """With a fold above the ring, where fluid converges, its path could not be followed."""
    ring = flow("vortex_ring", peak_mm_s=100.0)
    assert np.isfinite(advect(ring, points(3000), 0.0, 0.1, 1e-6)).all()
    assert_allclose(ring.velocity(np.array([[1e-6, 0.0, -5.0]]), 0.0)[0, :2], 0.0, atol=1e-3)


def test_a_field_that_cannot_be_followed_is_named_before_long() -> None:
    asked = []

    class Trap(Flow):
        name = "trap"

        def velocity(self, points_mm: F64, time_s: float) -> F64:
            asked.append(time_s)
            return np.asarray(-np.sign(points_mm))

    with refused("flow trap", "10 s"):
        advect(Trap(None), points(10), 0.0, 10.0, 1e-9)
    assert len(asked) < 40_000  # twice those allowed


def test_paths_by_formula_follow_the_velocities() -> None:
    places = points()
    for name, parameters in FLOWS:
        assert (flow(name, **parameters).carry(places, 0.1, 0.6) is None) == (name != "linear_flow")
    field = flow("linear_flow", **dict(FLOWS)["linear_flow"])

    class Integrated(Flow):
        name = "integrated"

        def velocity(self, points_mm: F64, time_s: float) -> F64:
            return field.velocity(points_mm, time_s)

    there: Any = field.carry(places, 0.1, 0.6)
    assert_allclose(there, advect(Integrated(None), places, 0.1, 0.6, 1e-9), atol=1e-8)
    assert_array_equal(advect(field, places, 0.1, 0.6, 1e-9), there)
    assert_allclose(advect(field, there, 0.6, 0.1, 1e-9), places, atol=1e-10)


def test_abc_is_parallel_to_its_vorticity() -> None:
    field = flow("abc_flow", wavelength_mm=20.0)
    expected = 2.0 * np.pi / 20.0 * field.velocity(points(), 0.0)
    assert_allclose(vorticity(field.gradient(points(), 0.0)), expected, atol=1e-10)


def test_oseen_s_vortex_diffuses() -> None:
    """The vorticity equation d(omega)/dt = nu laplacian(omega), by differences."""
    field, step = flow("lamb_oseen_vortex", viscosity_mm2_s=1.0), 1e-2
    radius = np.linspace(0.5, 9.0, 12)

    def spin(time: float, x: float = 0.0, y: float = 0.0) -> F64:
        return vorticity(field.gradient(at(radius + x, y), time))[:, 2]

    rate = (spin(1.0 + step) - spin(1.0 - step)) / (2.0 * step)
    around = [spin(1.0, *move) for move in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))]
    laplacian = (np.sum(around, axis=0) - 4.0 * spin(1.0)) / step**2
    assert_allclose(rate, laplacian, atol=1e-3 * np.abs(rate).max())


@pytest.mark.parametrize(
    ("name", "start", "period"),
    [
        ("vortex_ring", (12.0, 0.0, 0.0), 2.0 * np.pi * 2.0 / (100.0 * np.e * 0.5 * np.exp(-0.5))),
        ("rankine_vortex", (2.0, 0.0, 1.0), 2.0 * np.pi * 4.0 / 100.0),
        ("rankine_vortex", (8.0, 0.0, 1.0), 2.0 * np.pi * 8.0 / 50.0),
    ],
)
def test_a_particle_carried_once_around_comes_back(
    name: str, start: tuple[float, float, float], period: float
) -> None:
    field, places = flow(name), np.array([start])
    assert np.linalg.norm(advect(field, places, 0.0, period, 2e-8) - places) < 1e-6 * 20.0
    assert np.linalg.norm(advect(field, places, 0.0, 0.5 * period, 2e-8) - places) > 1.0


def test_backwards_undoes_forwards() -> None:
    field, places = flow("abc_flow"), points(500)
    there = advect(field, places, 0.0, 0.2, 1e-8)
    assert np.linalg.norm(there - places, axis=1).max() > 10.0
    assert np.linalg.norm(advect(field, there, 0.2, 0.0, 1e-8) - places, axis=1).max() < 1e-5


SIZES = np.array([0.02, 0.05, 0.1])
HEAVY = Inertia(particle_density_kg_m3=2500.0, gravity_m_s2=(0.0, 0.0, 0.0))
LIGHT = Inertia(particle_density_kg_m3=1.2, gravity_m_s2=(0.0, 0.0, 0.0))


def numbers(inertia: Inertia) -> tuple[float, F64]:
    """Return b and tau of Maxey and Riley, from the densities."""
    ratio = inertia.particle_density_kg_m3 / inertia.fluid_density_kg_m3
    b = 3.0 / (2.0 * ratio + 1.0)
    return b, SIZES**2 / (12.0 * b * inertia.viscosity_mm2_s)


def test_particles_settle_at_stokes_s_velocity() -> None:
    """Glass beads of .1 mm in water: 8.2 mm/s, drops of 0.02 mm 0.33 mm/s."""
    glass = Inertia(particle_density_kg_m3=2500.0)
    there = move_particles(flow("linear_flow"), glass, np.zeros((3, 3)), SIZES, 0.0, 2.0, 1e-8)
    expected = 1501.8 * 9.81 * (1e-3 * SIZES) ** 2 / (18.0 * 998.2 * 1e-6) * 1e3 * 2.0
    assert_allclose(there[:, 1], expected, rtol=1e-6)
    assert_allclose(there[:, [0, 2]], 0.0, atol=1e-12)


@pytest.mark.parametrize("inertia", [HEAVY, LIGHT])
def test_particles_spiral_out_of_a_vortex_or_into_it(inertia: Inertia) -> None:
    """In a core that turns at the rate w: l^2 + l / tau + b w^2 - i w / tau = 0."""
    vortex, rate = flow("rankine_vortex", core_mm=10.0, peak_mm_s=100.0), 100.0 / 10.0
    start = np.tile([2.0, 0.0, 0.0], (3, 1))
    there = move_particles(vortex, inertia, start, SIZES, 0.0, 1.0, 1e-10)
    growth = np.log(np.linalg.norm(there[:, :2], axis=1) / 2.0)
    b, tau = numbers(inertia)
    roots = [np.roots([1.0, 1.0 / t, b * rate**2 - 1j * rate / t]) for t in tau]
    assert_allclose(growth, [pair[np.argmin(np.abs(pair))].real for pair in roots], rtol=0.02)
    assert (np.sign(growth) == np.sign(inertia.particle_density_kg_m3 - 998.2)).all()


class Swing(Flow):
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
    second_order = 1.01 * np.abs(1 - b) * (Swing.rate * tau) ** 2 + 1e-8
    assert_array_less(np.abs(now - 1j * later - exact), second_order)
    slip = np.abs(exact - 1.0)
    assert_allclose(np.abs(now - 1j * later - 1.0), slip, rtol=0.01)


def test_a_scene_s_particles_move_by_themselves_and_its_flow_is_the_fluid_s() -> None:
    inertia = {"particle_density_kg_m3": 2500.0}
    scene = moving_scene(inertia=inertia)
    first = Motion(scene, 1).at(0)
    flow = require_flow(scene)
    fluid, slopes = (one(first.position_mm, 0.0) for one in (flow.velocity, flow.gradient))
    force = [0.0, 9810.0, 0.0] - np.einsum("nij,nj->ni", slopes, fluid)
    slip = Inertia(**inertia).response_s(first.diameter_mm)[:, None] * force
    assert np.abs(slip).max() > 2.0
    assert_allclose(first.velocity_mm_s, fluid + slip, atol=1e-5)
    field, _ = sample_lattice(scene, 0, (5.0, 5.0, 2.0))
    exact = require_flow(scene).velocity(field.positions_mm.reshape(-1, 3), 0.0)
    assert_array_equal(field.velocity_mm_s.reshape(-1, 3), exact)


def test_they_are_replaced_and_any_frame_is_the_same_by_itself() -> None:
    scene = moving_scene(inertia={"particle_density_kg_m3": 4000.0})
    motion = Motion(scene, 1)
    frames = [motion.at(frame) for frame in range(4)]
    assert_array_equal(frames[3].position_mm, Motion(scene, 1).at(3).position_mm)
    assert abs(len(frames[3]) - 800) < 4.0 * np.sqrt(800.0)
    later = motion.move(frames[3], 3, 1e-4) - frames[3].position_mm
    assert_allclose(later, 1e-4 * frames[3].velocity_mm_s, atol=1e-4)


@pytest.mark.parametrize(
    ("density", "diameter_mm", "flow", "key"),
    [
        (2500.0, 0.1, None, "flow"),
        (2500.0, 0.4, ABC, "Stokes number"),
        (9000.0, 0.2, {"generator": "linear_flow"}, "Reynolds number"),
    ],
)
def test_what_stokes_s_drag_does_not_describe_is_named(
    density: float, diameter_mm: float, flow: dict[str, Any] | None, key: str
) -> None:
    particles = {"generator": "uniform", "count": 20, "diameter_mm": diameter_mm}
    inertia = {"particle_density_kg_m3": density}
    with refused("inertia", key):
        Motion(moving_scene(inertia=inertia, particles=particles, flow=flow), 1).at(0)
