"""Figures 2-17 to 2-19: planar PIV of a light sheet next to 3-D PIV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.api import ImagePair, Velocity
from sabench.api.make import make_algorithm
from sabench.evaluation.thesis.common import Item, claim, coarsen, make_row
from sabench.evaluation.thesis.vortex_ring import (
    ASPECT,
    ORIFICE_MM,
    at_nodes,
    circulations,
    exact_velocity,
    half_planes,
    measure,
    reconstruct,
    ring_of,
    widths,
)
from sabench.metrics.vortex_rings import HalfPlane, core, sample, spin_of
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene
from sabench.simulation.in_memory import simulate
from sabench.tasks.figures.velocity import slice_panel
from sabench.utils.arrays import F64
from sabench.utils.confidence import mean_of
from sabench.utils.progress import console

SEEDS = 3
_SLICE_MM = 0.11 * ORIFICE_MM  # of the 3-D field, beside the ring's centre
_WINDOWS = {"first_window": (64, 64), "window": (32, 32), "overlap": 0.5, "passes": 2}  # thesis's
_SOLVERS = (("asa", "piv3d_plain"), ("block_mart", "piv3d"))
_WITHIN = 7.0  # percent, between the largest circulations
_PLANAR, _ACROSS = "piv2d", "3-D plane Z/D_o = 0.11"


@dataclass(frozen=True)
class _Cut:
    """Figures of a field in a plane through or beside a ring's axis.

    Attributes
    ----------
    distance : of the two cores, over the orifice.
    speed : largest along the ring's own motion, on the line through both cores, mm/s.
    spin : peak of the vorticity, mean of both cores, 1/s.
    circulation : largest over rectangles, mean of both cores, mm2/s.
    """

    distance: float
    speed: float
    spin: float
    circulation: float


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure cores, velocity, vorticity and circulation of planar and 3-D PIV."""
    sheet, volume = (
        coarsen(load_scene(name), pixels)
        for name in ("vortex-ring-sheet", "vortex-ring-experiment")
    )
    beside_mm = sheet.volume.center_mm[2] - float(ring_of(sheet)["center_mm"][2])
    planar: list[_Cut] = []
    exact: list[_Cut] = []
    solid: dict[tuple[str, str], list[_Solid]] = {one: [] for one in _SOLVERS}
    for seed in seeds:
        flat = _measure_sheet(sheet, seed)
        planar.append(_look(sheet, flat, beside_mm))
        exact.append(_look(sheet, at_nodes(sheet, flat), beside_mm))
        shots = [simulate(volume, seed=seed, frame=frame) for frame in range(2)]
        for volumes, solver in _SOLVERS:
            field = measure(solver, reconstruct(volumes, volume, shots))
            solid[volumes, solver].append(_Solid.of(volume, field))
            text = (
                f"seed {seed}, {volumes}, {solver}: {solid[volumes, solver][-1].cut.distance:.3f}"
            )
            console.print(
                f"{text}, piv2d: {planar[-1].distance:.3f}", markup=False, highlight=False
            )
    yield from _figures(sheet, flat, field, beside_mm)
    yield from _planar_rows(planar, exact)
    for (volumes, solver), found in solid.items():
        yield from _solid_rows(f"{volumes}, {solver}", found, planar)


def _measure_sheet(scene: Scene, seed: int) -> Velocity:
    first, second = (simulate(scene, seed=seed, frame=frame).observation for frame in range(2))
    algorithm: Any = make_algorithm("piv2d", _WINDOWS)
    made: Velocity = algorithm.solve(ImagePair(first, second, scene.time_s(1) - scene.time_s(0)))
    return made


@dataclass(frozen=True)
class _Solid:
    """Figures of a 3-D field.

    Attributes
    ----------
    cut : in the plane beside the ring's centre.
    speed_yz : largest along the ring's own motion on the line through its centre along Z, mm/s.
    circulation : largest of all planes through the ring's axis, mm2/s.
    """

    cut: _Cut
    speed_yz: float
    circulation: float

    @classmethod
    def of(cls, scene: Scene, field: Velocity) -> _Solid:
        """Look at a field in the planes of the thesis."""
        (deep,) = half_planes(scene, (90.0,))
        around = _around(scene, field, half_planes(scene))
        return cls(
            _look(scene, field, _SLICE_MM),
            _fastest(scene, field, [deep]),
            _largest(around),
        )


def _look(scene: Scene, field: Velocity, beside_mm: float) -> _Cut:
    ring, halves = ring_of(scene), half_planes(scene, (0.0, 180.0), beside_mm)
    radius = float(np.sqrt((ring["diameter_mm"] / 2.0) ** 2 - beside_mm**2))
    cores = [core(spin_of(field), half, radius, ring["core_mm"]) for half in halves]
    return _Cut(
        sum(r for r, _, _ in cores) / ORIFICE_MM,
        _fastest(scene, field, halves),
        float(np.mean([abs(spin) for _, _, spin in cores])),
        float(np.mean([_largest(line) for line in _around(scene, field, halves)])),
    )


def _around(scene: Scene, field: Velocity, halves: Sequence[HalfPlane]) -> F64:
    return circulations(scene, sample(field, field.velocity_mm_s), spin_of(field), halves)


def _fastest(scene: Scene, field: Velocity, halves: Sequence[HalfPlane]) -> float:
    """Find the largest velocity along the ring's motion on a line through its cores."""
    ring, velocity = ring_of(scene), sample(field, field.velocity_mm_s)
    r = np.linspace(0.0, ring["diameter_mm"], 400)
    lines = [
        velocity(half.points(r, np.zeros_like(r))) @ np.asarray(ring["axis"]) for half in halves
    ]
    return _largest(np.array(lines))


def _largest(values: F64) -> float:
    """Find the largest known value; NaN without any."""
    known = values[~np.isnan(values)]
    return float(known.max()) if len(known) else float("nan")


def _planar_rows(planar: list[_Cut], exact: list[_Cut]) -> Iterator[Item]:
    note = f"exact field at the same nodes {exact[0].distance:.3f}"
    distances = [one.distance for one in planar]
    yield make_row(f"{_PLANAR}: distance of the cores over the orifice", 0.82, distances, note)
    for key, text in (
        ("speed", "largest velocity along the ring's motion"),
        ("spin", "largest vorticity"),
        ("circulation", "largest circulation"),
    ):
        parts = [getattr(a, key) / getattr(b, key) for a, b in zip(planar, exact, strict=True)]
        yield make_row(f"{_PLANAR}: {text} over the exact field's at the same nodes", None, parts)


def _solid_rows(name: str, found: list[_Solid], planar: list[_Cut]) -> Iterator[Item]:
    pairs = list(zip(found, planar, strict=True))
    distances = [one.cut.distance for one in found]
    yield make_row(f"{name}: distance of the cores over the orifice, {_ACROSS}", 0.77, distances)
    for text, thesis, parts in (
        ("X-Y", 0.94, [one.cut.speed / flat.speed for one, flat in pairs]),
        ("Y-Z", 0.92, [one.speed_yz / flat.speed for one, flat in pairs]),
    ):
        yield make_row(f"{name}: largest velocity over piv2d's, {text} profile", thesis, parts)
    spins = mean_of([one.cut.spin / flat.spin for one, flat in pairs])
    turns = spins.mean if spins else None
    text = f"{name}: largest vorticity over piv2d's, X-Y profile"
    yield claim(text, "below 1", turns, turns is not None and turns < 1.0)
    for where, parts in (
        ("light sheet", [flat.circulation / one.circulation for one, flat in pairs]),
        (_ACROSS, [one.cut.circulation / one.circulation for one in found]),
    ):
        off = 100.0 * abs(float(np.mean(parts)) - 1.0)
        text = f"{name}: largest circulation of the {where} from that of planes through the axis, %"
        note = f"ratio {np.mean(parts):.3f}"
        yield claim(text, f"within {_WITHIN:g}", off, off <= _WITHIN, note)


def _figures(sheet: Scene, flat: Velocity, field: Velocity, beside_mm: float) -> Iterator[Item]:
    center = ring_of(sheet)["center_mm"][2]
    yield Figure(
        "fig-2-17",
        "3-D PIV near the light sheet, and planar PIV of it",
        (slice_panel(_plane_at(field, center + _SLICE_MM), 2), slice_panel(flat.in_own_axes(), 2)),
    )
    r = np.linspace(-1.2, 1.2, 121) * ring_of(sheet)["diameter_mm"]
    fields = (("planar", flat, beside_mm), ("3-D", field, _SLICE_MM))
    speeds, spins, areas = [], [], list(widths(sheet) ** 2 * ASPECT / 100.0)
    around = []
    for name, one, offset in fields:
        half, other = half_planes(sheet, (0.0, 180.0), offset)
        points = half.points(r, np.zeros_like(r))
        for what, values in (
            (name, sample(one, one.velocity_mm_s)),
            (f"{name}, exact", exact_velocity(sheet)),
        ):
            speeds.append(Curve(what, list(r), list(values(points) @ half.axis)))
        spins.append(Curve(name, list(r), list(spin_of(one)(points) @ half.normal)))
        for side, line in zip("+-", _around(sheet, one, (half, other)), strict=True):
            around.append(Curve(f"{name}, {side}X", areas, list(line / 100.0)))
    yield Figure(
        "fig-2-18-sheet",
        "profiles through the cores, planar and 3-D",
        (
            Panel("velocity along the axis", "mm", "mm/s", tuple(speeds)),
            Panel("vorticity", "mm", "1/s", tuple(spins)),
        ),
    )
    yield Figure(
        "fig-2-19-sheet",
        "circulation beside the ring's centre",
        (Panel("", "area, cm2", "cm2/s", tuple(around)),),
    )


def _plane_at(field: Velocity, z_mm: float) -> Velocity:
    """Cut the plane of nodes nearest to a coordinate Z out of a field."""
    number = round((z_mm - field.low_mm[2]) / field.step_mm[2])
    number = min(max(number, 0), len(field.valid) - 1)
    x, y, z = field.low_mm
    part = slice(number, number + 1)
    return replace(
        field,
        low_mm=(x, y, z + number * field.step_mm[2]),
        velocity_mm_s=field.velocity_mm_s[part],
        valid=field.valid[part],
    )
