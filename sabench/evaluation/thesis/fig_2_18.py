"""Figures 2-16 to 2-19: vortex ring seen by eight cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sabench.api import Velocity
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.evaluation.thesis.vortex_ring import (
    ANGLES,
    ASPECT,
    ORIFICE_MM,
    at_nodes,
    circulations,
    circulations_about,
    exact_velocity,
    half_planes,
    measure,
    reconstruct,
    ring_of,
    widths,
)
from sabench.metrics.vortex_rings import core, sample, spin_of
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene
from sabench.simulation.in_memory import simulate
from sabench.tasks.figures.velocity import slice_panel
from sabench.utils.arrays import F64
from sabench.utils.progress import console

SEEDS = 3
_VOLUMES, _PIV = ("asa", "block_mart"), ("piv3d_plain", "piv3d")
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
            pair = reconstruct(volumes, scene, shots)
            spent = time.perf_counter() - start
            for solver in _PIV:
                start = time.perf_counter()
                measured = measure(solver, pair)
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


def _exact_circulations(scene: Scene) -> F64:
    """Compute those of the exact field about its core, for rectangles of all sizes.

    They are the same at all angles.
    """
    radius = ring_of(scene)["diameter_mm"] / 2.0
    return circulations_about(scene, exact_velocity(scene), half_planes(scene)[0], radius, 0.0)


def _look(own: _Seen, scene: Scene, measured: Velocity) -> None:
    ring, spin, velocity = (
        ring_of(scene),
        spin_of(measured),
        sample(measured, measured.velocity_mm_s),
    )
    cores = [
        core(spin, half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (half_planes(scene)[0], half_planes(scene)[-1])
    ]
    own.distance.append((cores[0][0] + cores[1][0]) / ORIFICE_MM)
    around, true = (
        circulations(scene, velocity, spin, half_planes(scene)),
        _exact_circulations(scene),
    )
    known = ~np.isnan(around).any(axis=0)
    peaks = around[:, known].max(axis=1) if known.any() else np.full(len(around), np.nan)
    own.spread.append(100.0 * float((peaks.max() - peaks.min()) / peaks.max()))
    own.peak.append(float(peaks.mean() / true[known].max()) if known.any() else np.nan)
    r = np.linspace(0.0, ring["diameter_mm"], 400)
    points = half_planes(scene)[0].points(r, np.zeros_like(r))
    speeds = [
        np.abs(values(points) @ np.asarray(ring["axis"]))
        for values in (velocity, exact_velocity(scene))
    ]
    measured_there = ~np.isnan(speeds[0])
    own.speed.append(
        float(speeds[0][measured_there].max() / speeds[1].max()) if measured_there.any() else np.nan
    )
    exact = [
        core(spin_of(at_nodes(scene, measured)), half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (half_planes(scene)[0], half_planes(scene)[-1])
    ]
    own.known.append((exact[0][0] + exact[1][0]) / ORIFICE_MM)
    own.spin.append(abs(cores[0][2] / exact[0][2]))


def _rows(scene: Scene, name: str, own: _Seen) -> Iterator[Item]:
    before, after = np.mean(own.seconds, axis=0)
    exact = ring_of(scene)["diameter_mm"] / ORIFICE_MM
    same_nodes = np.mean(own.known)
    note = f"exact {exact:.3f}; of the exact field at the same nodes {same_nodes:.3f}"
    yield make_row(
        f"{name}: distance of the cores over the orifice",
        _THESIS["core"],
        own.distance,
        note,
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
        half_planes(scene)[0],
    )
    exact = at_nodes(scene, measured)
    yield Figure(
        "fig-2-16",
        "vortex ring, block_mart and piv3d",
        (slice_panel(measured, 2), slice_panel(measured, 0)),
    )
    r = np.linspace(-1.4, 1.4, 141) * ring_of(scene)["diameter_mm"]
    points = half.points(r, np.zeros_like(r))
    speeds = [
        Curve(f"{name}{note}", list(r), list(values(points) @ direction))
        for name, direction in (("outward", half.outward), ("along the axis", half.axis))
        for note, values in (("", velocity), (" exact", exact_velocity(scene)))
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
    areas = list(widths(scene) ** 2 * ASPECT / 100.0)
    curves = [
        Curve(f"{angle:g} degrees", areas, list(line / 100.0))
        for angle, line in zip(
            ANGLES, circulations(scene, velocity, spin, half_planes(scene)), strict=True
        )
    ]
    true = _exact_circulations(scene) / 100.0
    yield Figure(
        "fig-2-19",
        "circulation",
        (Panel("", "area, cm2", "cm2/s", (*curves, Curve("exact", areas, list(true)))),),
    )
