"""Figures 2-16 to 2-19: vortex ring seen by eight cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sabench.api import Velocity, VolumePair
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.thesis.common import Item, coarsen, make_row, settings
from sabench.metrics.vortex_rings import (
    HalfPlane,
    Sampled,
    circulation,
    core,
    half_plane,
    sample,
    spin_of,
)
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene
from sabench.simulation.in_memory import simulate
from sabench.tasks.figures.velocity import slice_panel
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.progress import console
from sabench.worlds.tracers import require_flow

SEEDS = 3
_WINDOW, _OVERLAP = (64, 64, 32), 0.5  # the thesis's
_VOLUMES, _PIV = ("asa", "block_mart"), ("piv3d_plain", "piv3d")
_ANGLES = tuple(float(angle) for angle in np.linspace(0.0, 180.0, 9))
_ORIFICE_MM = 30.0
_ASPECT = 0.75  # height over width of rectangles
_THESIS = {"core": 0.77, "spread": 13.5}


@dataclass
class _Seen:
    """Figures of one solver's fields, one value for each seed."""

    distance: list[float] = field(default_factory=list)
    spread: list[float] = field(default_factory=list)
    peak: list[float] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)
    spin: list[float] = field(default_factory=list)
    known: list[float] = field(default_factory=list)
    seconds: list[tuple[float, float]] = field(default_factory=list)


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure core distance, circulation, speed and vorticity per solver.

    Each is relative to the exact value; circulation also has its spread over angles.
    """
    scene = coarsen(load_scene("vortex-ring-experiment"), pixels)
    found: dict[tuple[str, str], _Seen] = {}
    for seed in seeds:
        shots = [simulate(scene, seed=seed, frame=frame) for frame in range(2)]
        for volumes in _VOLUMES:
            start = time.perf_counter()
            made = [make_solver(volumes, {}).solve(shot.observation).volume for shot in shots]
            spent = time.perf_counter() - start
            pair = VolumePair(
                made[0], made[1], shots[0].observation.grid, scene.time_s(1) - scene.time_s(0)
            )
            for solver in _PIV:
                start = time.perf_counter()
                measured = _measure(solver, pair)
                own = found.setdefault((volumes, solver), _Seen())
                own.seconds.append((spent, time.perf_counter() - start))
                _look(own, scene, measured)
                figures = f"{own.distance[-1]:.3f}, {own.spread[-1]:.1f} %"
                console.print(
                    f"seed {seed}, {volumes}, {solver}: {figures}",
                    markup=False,
                    highlight=False,
                )
                if seed == seeds[-1] and (volumes, solver) == (_VOLUMES[-1], _PIV[-1]):
                    yield from _figures(scene, measured)
    for (volumes, solver), own in found.items():
        yield from _rows(scene, f"{volumes}, {solver}", own)


def _measure(solver: str, pair: VolumePair) -> Velocity:
    algorithm: Any = make_algorithm(solver, settings(solver, _WINDOW, _OVERLAP, pair.grid))
    made: Velocity = algorithm.solve(pair)
    return made


def _ring(scene: Scene) -> dict[str, Any]:
    if (ring := scene.particle_world.flow) is None:
        raise InputError(f"{scene.title}: flow: expected a vortex ring, got no flow")
    return ring


def _planes(scene: Scene) -> list[HalfPlane]:
    """List angles from X to -X on the side where the whole ring is lit."""
    ring = _ring(scene)
    axis = tuple(-float(part) for part in ring["axis"])
    return [
        half_plane(tuple(ring["center_mm"]), (axis[0], axis[1], axis[2]), (1.0, 0.0, 0.0), angle)
        for angle in _ANGLES
    ]


def _exact(scene: Scene) -> Sampled:
    flow = require_flow(scene)
    middle = (scene.time_s(0) + scene.time_s(1)) / 2.0
    return lambda points: flow.velocity(points, middle)


def _sizes(scene: Scene) -> F64:
    """List widths of rectangles, up to half of a slice.

    None of them crosses the ring's axis.
    """
    return np.asarray(np.linspace(0.1, 0.98, 12) * _ring(scene)["diameter_mm"])


def _circulations(scene: Scene, velocity: Sampled, spin: Sampled) -> F64:
    """Compute absolute circulations (angle, size) about each half plane's core."""
    ring, out = _ring(scene), []
    for half in _planes(scene):
        r, z, _ = core(spin, half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        out.append(
            [
                abs(circulation(velocity, half, r, z, width, width * _ASPECT))
                for width in _sizes(scene)
            ]
        )
    return np.array(out)


def _exact_circulations(scene: Scene) -> F64:
    """Compute those of the exact field about its core, for rectangles of all sizes.

    They are the same at all angles.
    """
    half, radius = _planes(scene)[0], _ring(scene)["diameter_mm"] / 2.0
    return np.array(
        [
            abs(circulation(_exact(scene), half, radius, 0.0, width, width * _ASPECT))
            for width in _sizes(scene)
        ]
    )


def _look(own: _Seen, scene: Scene, measured: Velocity) -> None:
    ring, spin, velocity = (
        _ring(scene),
        spin_of(measured),
        sample(measured, measured.velocity_mm_s),
    )
    cores = [
        core(spin, half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (_planes(scene)[0], _planes(scene)[-1])
    ]
    own.distance.append((cores[0][0] + cores[1][0]) / _ORIFICE_MM)
    around, true = _circulations(scene, velocity, spin), _exact_circulations(scene)
    known = ~np.isnan(around).any(axis=0)
    peaks = around[:, known].max(axis=1) if known.any() else np.full(len(around), np.nan)
    own.spread.append(100.0 * float((peaks.max() - peaks.min()) / peaks.max()))
    own.peak.append(float(peaks.mean() / true[known].max()) if known.any() else np.nan)
    r = np.linspace(0.0, ring["diameter_mm"], 400)
    points = _planes(scene)[0].points(r, np.zeros_like(r))
    speeds = [
        np.abs(values(points) @ np.asarray(ring["axis"])) for values in (velocity, _exact(scene))
    ]
    measured_there = ~np.isnan(speeds[0])
    own.speed.append(
        float(speeds[0][measured_there].max() / speeds[1].max()) if measured_there.any() else np.nan
    )
    exact = [
        core(spin_of(_at_nodes(scene, measured)), half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (_planes(scene)[0], _planes(scene)[-1])
    ]
    own.known.append((exact[0][0] + exact[1][0]) / _ORIFICE_MM)
    own.spin.append(abs(cores[0][2] / exact[0][2]))


def _at_nodes(scene: Scene, measured: Velocity) -> Velocity:
    """Compute the exact field at the nodes of the measured one."""
    values = _exact(scene)(measured.positions_mm.reshape(-1, 3)).reshape(
        measured.velocity_mm_s.shape
    )
    return replace(measured, velocity_mm_s=values)


def _rows(scene: Scene, name: str, own: _Seen) -> Iterator[Item]:
    before, after = np.mean(own.seconds, axis=0)
    exact = _ring(scene)["diameter_mm"] / _ORIFICE_MM
    same_nodes = np.mean(own.known)
    note = f"exact {exact:.3f}; of the exact field at the same nodes {same_nodes:.3f}"
    yield make_row(
        f"{name}: distance of the cores over the orifice",
        _THESIS["core"],
        own.distance,
        note,
        "neither",
    )
    yield make_row(
        f"{name}: spread of the circulation over angles, %",
        _THESIS["spread"],
        own.spread,
        "exact 0",
        "smaller",
    )
    yield make_row(
        f"{name}: largest circulation over the exact one of the same rectangles, mean over angles",
        None,
        own.peak,
    )
    yield make_row(
        f"{name}: largest speed on a line through both cores over the exact one", None, own.speed
    )
    yield make_row(f"{name}: largest vorticity over the exact one", None, own.spin)
    yield make_row(
        f"{name}: seconds of reconstruction over those of PIV",
        0.18,
        [before / after for before, after in own.seconds],
        f"{before:.3g} s and {after:.3g} s",
        "smaller",
    )


def _figures(scene: Scene, measured: Velocity) -> Iterator[Item]:
    velocity, spin, half = (
        sample(measured, measured.velocity_mm_s),
        spin_of(measured),
        _planes(scene)[0],
    )
    exact = _at_nodes(scene, measured)
    yield Figure(
        "fig-2-16",
        "vortex ring, block_mart and piv3d",
        (slice_panel(measured, 2), slice_panel(measured, 0)),
    )
    r = np.linspace(-1.4, 1.4, 141) * _ring(scene)["diameter_mm"]
    points = half.points(r, np.zeros_like(r))
    speeds = [
        Curve(f"{name}{note}", list(r), list(values(points) @ direction))
        for name, direction in (("outward", half.outward), ("along the axis", half.axis))
        for note, values in (("", velocity), (" exact", _exact(scene)))
    ]
    turns = [
        Curve(name, list(r), list(values(points) @ half.normal))
        for name, values in (("measured", spin), ("exact at the nodes", spin_of(exact)))
    ]
    yield Figure(
        "fig-2-18",
        "profiles through the cores",
        (
            Panel("velocity", "mm", "mm/s", tuple(speeds)),
            Panel("vorticity", "mm", "1/s", tuple(turns)),
        ),
    )
    areas = list(_sizes(scene) ** 2 * _ASPECT / 100.0)
    curves = [
        Curve(f"{angle:g} degrees", areas, list(line / 100.0))
        for angle, line in zip(_ANGLES, _circulations(scene, velocity, spin), strict=True)
    ]
    true = _exact_circulations(scene) / 100.0
    yield Figure(
        "fig-2-19",
        "circulation",
        (Panel("", "area, cm2", "cm2/s", (*curves, Curve("exact", areas, list(true)))),),
    )
