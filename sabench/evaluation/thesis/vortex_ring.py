"""Common parts of tables of the vortex ring's experiment (thesis, section 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.api import Velocity, VolumePair
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.thesis.common import settings
from sabench.metrics.vortex_rings import HalfPlane, Sampled, circulation, core, half_plane
from sabench.scenes import Scene
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.worlds.tracers import require_flow

ANGLES = tuple(float(angle) for angle in np.linspace(0.0, 180.0, 9))
ORIFICE_MM = 30.0
_WINDOW, _OVERLAP = (64, 64, 32), 0.5  # the thesis's
ASPECT = 0.75  # height over width of rectangles


def reconstruct(solver: str, scene: Scene, shots: Sequence[Shot]) -> VolumePair:
    """Reconstruct the volumes of a pair of frames."""
    first, second = (make_solver(solver, {}).solve(shot.observation).volume for shot in shots)
    interval_s = scene.time_s(1) - scene.time_s(0)
    return VolumePair(first, second, shots[0].observation.grid, interval_s)


def measure(solver: str, pair: VolumePair) -> Velocity:
    """Measure the field between two volumes by the thesis's windows."""
    algorithm: Any = make_algorithm(solver, settings(solver, _WINDOW, _OVERLAP, pair.grid))
    made: Velocity = algorithm.solve(pair)
    return made


def ring_of(scene: Scene) -> dict[str, Any]:
    """Return the parameters of a scene's vortex ring."""
    if (ring := scene.particle_world.flow) is None:
        raise InputError(f"{scene.title}: flow: expected a vortex ring, got no flow")
    return ring


def half_planes(
    scene: Scene, angles: Sequence[float] = ANGLES, beside_mm: float = 0.0
) -> list[HalfPlane]:
    """Make half planes at angles from X to -X, where the whole ring is lit.

    They begin at the ring's axis, or at a line that is moved from it along Z.
    """
    ring = ring_of(scene)
    center = triple(np.add(ring["center_mm"], (0.0, 0.0, beside_mm)))
    axis = triple(-np.asarray(ring["axis"], dtype=np.float64))
    return [half_plane(center, axis, (1.0, 0.0, 0.0), angle) for angle in angles]


def exact_velocity(scene: Scene) -> Sampled:
    """Return the exact velocity in the middle of the interval."""
    flow = require_flow(scene)
    middle = (scene.time_s(0) + scene.time_s(1)) / 2.0
    return lambda points: flow.velocity(points, middle)


def at_nodes(scene: Scene, measured: Velocity) -> Velocity:
    """Compute the exact field at the nodes of the measured one."""
    values = exact_velocity(scene)(measured.positions_mm.reshape(-1, 3))
    exact = measured.components(values) @ measured.axes
    return replace(measured, velocity_mm_s=exact.reshape(measured.velocity_mm_s.shape))


def widths(scene: Scene) -> F64:
    """List widths of rectangles, up to half of a slice.

    None of them crosses the ring's axis.
    """
    return np.asarray(np.linspace(0.1, 0.98, 12) * ring_of(scene)["diameter_mm"])


def circulations(
    scene: Scene, velocity: Sampled, spin: Sampled, halves: Sequence[HalfPlane]
) -> F64:
    """Compute absolute circulations (half plane, size) about each half plane's core."""
    ring, out = ring_of(scene), []
    for half in halves:
        r, z, _ = core(spin, half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        out.append(circulations_about(scene, velocity, half, r, z))
    return np.array(out)


def circulations_about(scene: Scene, velocity: Sampled, half: HalfPlane, r: float, z: float) -> F64:
    """Compute absolute circulations (size,) about a point of a half plane."""
    return np.array(
        [abs(circulation(velocity, half, r, z, width, width * ASPECT)) for width in widths(scene)]
    )
