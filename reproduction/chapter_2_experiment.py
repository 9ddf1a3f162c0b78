"""Vortex ring behind glass, seen by eight cameras: figures 2-16 to 2-19."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sabench.api import ImagePair, Velocity, VolumePair
from sabench.evaluation.reproduction import Item
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.tasks.velocimetry import slice_panel
from sabench.utils.arrays import F64, triple
from sabench.utils.confidence import mean_of
from sabench.utils.errors import InputError
from sabench.worlds.tracers import require_flow

from .common import claim, coarsen, make_row, reconstruct, report, run, settings
from .vortex_rings import (
    HalfPlane,
    Sampled,
    circulation,
    core,
    half_plane,
    interpolate_field,
    spin_of,
)

ANGLES = tuple(float(angle) for angle in np.linspace(0.0, 180.0, 9))
ORIFICE_MM = 30.0
_WINDOW, _OVERLAP = (64, 64, 32), 0.5  # the thesis's
ASPECT = 0.75  # height over width of rectangles


def _reconstruct(solver: str, scene: Scene, shots: Sequence[Shot]) -> VolumePair:
    interval_s = scene.time_s(1) - scene.time_s(0)
    return reconstruct(solver, [shot.observation for shot in shots], interval_s)


def measure(solver: str, pair: VolumePair) -> Velocity:
    """Measure the field between two volumes by the thesis's windows."""
    velocity: Velocity = run(solver, pair, **settings(solver, _WINDOW, _OVERLAP, pair.grid))
    return velocity


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


def fig_2_18(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure core distance, circulation, speed and vorticity per solver.

    Each is relative to the exact value; circulation also has its spread over angles.
    """
    scene = coarsen(load_scene("vortex-ring-experiment"), pixels)
    by_solver: dict[tuple[str, str], _Seen] = {}
    for seed in seeds:
        shots = [simulate(scene, seed=seed, frame=frame) for frame in range(2)]
        for volumes in _VOLUMES:
            start = time.perf_counter()
            pair = _reconstruct(volumes, scene, shots)
            spent = time.perf_counter() - start
            for solver in _PIV:
                start = time.perf_counter()
                measured = measure(solver, pair)
                record = by_solver.setdefault((volumes, solver), _Seen())
                record.seconds.append((spent, time.perf_counter() - start))
                _look(record, scene, measured)
                figures = f"{record.distance[-1]:.3f}, {record.spread[-1]:.1f} %"
                report(f"seed {seed}, {volumes}, {solver}: {figures}")
                if seed == seeds[-1] and (volumes, solver) == (_VOLUMES[-1], _PIV[-1]):
                    yield from _figures(scene, measured)
    for (volumes, solver), record in by_solver.items():
        yield from _rows(scene, f"{volumes}, {solver}", record)


def _exact_circulations(scene: Scene) -> F64:
    """Compute those of the exact field about its core, for rectangles of all sizes.

    They are the same at all angles.
    """
    radius = ring_of(scene)["diameter_mm"] / 2.0
    return circulations_about(scene, exact_velocity(scene), half_planes(scene)[0], radius, 0.0)


def _look(record: _Seen, scene: Scene, measured: Velocity) -> None:
    ring = ring_of(scene)
    spin = spin_of(measured)
    velocity = interpolate_field(measured, measured.velocity_mm_s)
    cores = [
        core(spin, half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (half_planes(scene)[0], half_planes(scene)[-1])
    ]
    record.distance.append((cores[0][0] + cores[1][0]) / ORIFICE_MM)
    around = circulations(scene, velocity, spin, half_planes(scene))
    true = _exact_circulations(scene)
    valid = ~np.isnan(around).any(axis=0)
    peaks = around[:, valid].max(axis=1) if valid.any() else np.full(len(around), np.nan)
    record.spread.append(100.0 * float((peaks.max() - peaks.min()) / peaks.max()))
    record.peak.append(float(peaks.mean() / true[valid].max()) if valid.any() else np.nan)
    r = np.linspace(0.0, ring["diameter_mm"], 400)
    points = half_planes(scene)[0].points(r, np.zeros_like(r))
    speeds = [
        np.abs(values(points) @ np.asarray(ring["axis"]))
        for values in (velocity, exact_velocity(scene))
    ]
    measured_there = ~np.isnan(speeds[0])
    record.speed.append(
        float(speeds[0][measured_there].max() / speeds[1].max()) if measured_there.any() else np.nan
    )
    exact = [
        core(spin_of(at_nodes(scene, measured)), half, ring["diameter_mm"] / 2.0, ring["core_mm"])
        for half in (half_planes(scene)[0], half_planes(scene)[-1])
    ]
    record.known.append((exact[0][0] + exact[1][0]) / ORIFICE_MM)
    record.spin.append(abs(cores[0][2] / exact[0][2]))


def _rows(scene: Scene, name: str, record: _Seen) -> Iterator[Item]:
    before, after = np.mean(record.seconds, axis=0)
    exact = ring_of(scene)["diameter_mm"] / ORIFICE_MM
    same_nodes = np.mean(record.known)
    note = f"exact {exact:.3f}; of the exact field at the same nodes {same_nodes:.3f}"
    yield make_row(
        f"{name}: distance of the cores over the orifice", _THESIS["core"], record.distance, note
    )
    yield make_row(
        f"{name}: spread of the circulation over angles, %",
        _THESIS["spread"],
        record.spread,
        "exact 0",
        "smaller",
    )
    yield make_row(
        f"{name}: largest circulation over the exact one of the same rectangles, mean over angles",
        None,
        record.peak,
    )
    yield make_row(
        f"{name}: largest speed on a line through both cores over the exact one", None, record.speed
    )
    yield make_row(f"{name}: largest vorticity over the exact one", None, record.spin)
    yield make_row(
        f"{name}: seconds of reconstruction over those of PIV",
        0.18,
        [before / after for before, after in record.seconds],
        f"{before:.3g} s and {after:.3g} s",
        "smaller",
    )


def _figures(scene: Scene, measured: Velocity) -> Iterator[Item]:
    velocity = interpolate_field(measured, measured.velocity_mm_s)
    spin = spin_of(measured)
    half = half_planes(scene)[0]
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


_SLICE_MM = 0.11 * ORIFICE_MM  # of the 3-D field, beside the ring's centre
_WINDOWS = {"first_window": (64, 64), "window": (32, 32), "overlap": 0.5, "passes": 2}  # thesis's
_SOLVERS = (("asa", "piv3d_plain"), ("block_mart", "piv3d"))
_WITHIN = 7.0  # percent, between the largest circulations
_PLANAR, _ACROSS = "piv2d", "3-D plane Z/D_o = 0.11"


@dataclass(frozen=True)
class _Cut:
    """Figures of a field in a plane through or next to a ring's axis.

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


def fig_2_17(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure cores, velocity, vorticity and circulation of planar and 3-D PIV."""
    sheet, volume = (
        coarsen(load_scene(name), pixels)
        for name in ("vortex-ring-sheet", "vortex-ring-experiment")
    )
    beside_mm = sheet.volume.center_mm[2] - float(ring_of(sheet)["center_mm"][2])
    planar: list[_Cut] = []
    exact: list[_Cut] = []
    solid: dict[tuple[str, str], list[_Solid]] = {key: [] for key in _SOLVERS}
    for seed in seeds:
        first, second = (simulate(sheet, seed=seed, frame=frame).observation for frame in range(2))
        pair = ImagePair(first, second, sheet.time_s(1) - sheet.time_s(0))
        flat: Velocity = run("piv2d", pair, **_WINDOWS)
        planar.append(_look_at_planes(sheet, flat, beside_mm))
        exact.append(_look_at_planes(sheet, at_nodes(sheet, flat), beside_mm))
        shots = [simulate(volume, seed=seed, frame=frame) for frame in range(2)]
        for volumes, solver in _SOLVERS:
            field = measure(solver, _reconstruct(volumes, volume, shots))
            solid[volumes, solver].append(_Solid.of(volume, field))
            distance = solid[volumes, solver][-1].cut.distance
            text = f"seed {seed}, {volumes}, {solver}: {distance:.3f}"
            report(f"{text}, piv2d: {planar[-1].distance:.3f}")
    yield from _sheet_figures(sheet, flat, field, beside_mm)
    yield from _planar_rows(planar, exact)
    for (volumes, solver), solids in solid.items():
        yield from _solid_rows(f"{volumes}, {solver}", solids, planar)


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
            _look_at_planes(scene, field, _SLICE_MM),
            _fastest(scene, field, [deep]),
            _largest(around),
        )


def _look_at_planes(scene: Scene, field: Velocity, beside_mm: float) -> _Cut:
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
    return circulations(
        scene, interpolate_field(field, field.velocity_mm_s), spin_of(field), halves
    )


def _fastest(scene: Scene, field: Velocity, halves: Sequence[HalfPlane]) -> float:
    """Find the largest velocity along the ring's motion on a line through its cores."""
    ring, velocity = ring_of(scene), interpolate_field(field, field.velocity_mm_s)
    r = np.linspace(0.0, ring["diameter_mm"], 400)
    lines = [
        velocity(half.points(r, np.zeros_like(r))) @ np.asarray(ring["axis"]) for half in halves
    ]
    return _largest(np.array(lines))


def _largest(values: F64) -> float:
    """Find the largest known value; NaN without any."""
    finite = values[~np.isnan(values)]
    return float(finite.max()) if len(finite) else float("nan")


def _planar_rows(planar: list[_Cut], exact: list[_Cut]) -> Iterator[Item]:
    note = f"exact field at the same nodes {exact[0].distance:.3f}"
    distances = [cut.distance for cut in planar]
    yield make_row(f"{_PLANAR}: distance of the cores over the orifice", 0.82, distances, note)
    for key, text in (
        ("speed", "largest velocity along the ring's motion"),
        ("spin", "largest vorticity"),
        ("circulation", "largest circulation"),
    ):
        parts = [getattr(a, key) / getattr(b, key) for a, b in zip(planar, exact, strict=True)]
        yield make_row(f"{_PLANAR}: {text} over the exact field's at the same nodes", None, parts)


def _solid_rows(name: str, solids: list[_Solid], planar: list[_Cut]) -> Iterator[Item]:
    pairs = list(zip(solids, planar, strict=True))
    distances = [solid.cut.distance for solid in solids]
    yield make_row(f"{name}: distance of the cores over the orifice, {_ACROSS}", 0.77, distances)
    for text, thesis, parts in (
        ("X-Y", 0.94, [solid.cut.speed / flat.speed for solid, flat in pairs]),
        ("Y-Z", 0.92, [solid.speed_yz / flat.speed for solid, flat in pairs]),
    ):
        yield make_row(f"{name}: largest velocity over piv2d's, {text} profile", thesis, parts)
    spins = mean_of([solid.cut.spin / flat.spin for solid, flat in pairs])
    turns = spins.mean if spins else None
    text = f"{name}: largest vorticity over piv2d's, X-Y profile"
    yield claim(text, "below 1", turns, turns is not None and turns < 1.0)
    for where, parts in (
        ("light sheet", [flat.circulation / solid.circulation for solid, flat in pairs]),
        (_ACROSS, [solid.cut.circulation / solid.circulation for solid in solids]),
    ):
        off = 100.0 * abs(float(np.mean(parts)) - 1.0)
        text = f"{name}: largest circulation of the {where} from that of planes through the axis, %"
        note = f"ratio {np.mean(parts):.3f}"
        yield claim(text, f"within {_WITHIN:g}", off, off <= _WITHIN, note)


def _sheet_figures(
    sheet: Scene, flat: Velocity, field: Velocity, beside_mm: float
) -> Iterator[Item]:
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
    for name, velocity, offset in fields:
        half, other = half_planes(sheet, (0.0, 180.0), offset)
        points = half.points(r, np.zeros_like(r))
        for what, values in (
            (name, interpolate_field(velocity, velocity.velocity_mm_s)),
            (f"{name}, exact", exact_velocity(sheet)),
        ):
            speeds.append(Curve(what, list(r), list(values(points) @ half.axis)))
        spins.append(Curve(name, list(r), list(spin_of(velocity)(points) @ half.normal)))
        for side, line in zip("+-", _around(sheet, velocity, (half, other)), strict=True):
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
