"""Velocity of simulated vortex rings: table 2.2 and section 2.4."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Velocity, VolumePair
from sabench.evaluation.reproduction import Item, Row
from sabench.evaluation.suite_loading import override
from sabench.metrics.averages import root_mean_square
from sabench.metrics.reconstruction_error import true_field
from sabench.metrics.velocity_error import precision_interval
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.tasks.velocimetry import error_scatter, slice_panel
from sabench.utils.arrays import F64
from sabench.utils.confidence import mean_of

from . import common
from .theory import plane_spacing_ratio

_INTERVAL_S = 1e-3
_RECONSTRUCTIONS = ("asa", "block_mart")


@dataclass(frozen=True)
class Ring:
    """Vortex ring of the thesis.

    Attributes
    ----------
    array : case of table 2.1 whose cameras look at it; `corners` of the 5 x 5 are left out where
        the thesis has 21.
    axis : of the ring.
    peak_mm : largest displacement.
    window, overlap : of the last pass.
    reconstructed, synthesised : the thesis's intervals of u, v, w in voxels.
    """

    name: str
    array: str
    corners: bool
    per_mm3: float
    axis: tuple[float, float, float]
    peak_mm: float
    window: tuple[int, int, int]
    overlap: float
    reconstructed: tuple[float, float, float]
    synthesised: tuple[float, float, float]


_ONE, _TWO = "50x50x10-D0.5-uneven", "40x40x30-D0.4-uneven"
_SMALL, _LARGE = (32, 32, 16), (60, 60, 24)  # windows
_Z, _X = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
_CASES = (
    ("case 1", _ONE, False, 5.0, _Z, 0.3, _SMALL, 0.75),
    ("case 1, 3 x displacement", _ONE, False, 5.0, _Z, 0.9, _SMALL, 0.75),
    ("case 2", _TWO, True, 1.0, _X, 0.37, _LARGE, 0.5),
)
_INTERVALS = (
    ((0.37, 0.38, 0.20), (0.33, 0.34, 0.14)),
    ((1.69, 1.72, 0.90), (1.62, 1.62, 0.80)),
    ((0.54, 0.43, 0.19), (0.48, 0.36, 0.14)),
)
RINGS = tuple(Ring(*case, *both) for case, both in zip(_CASES, _INTERVALS, strict=True))


def table_2_2(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure intervals of u, v, w and seconds per ring, volumes and solver.

    Volumes are reconstructed or synthesised.
    """
    for ring in RINGS:
        scene = common.coarsen(scene_of(ring), pixels)
        intervals: dict[tuple[str, str], list[F64]] = {}
        spent: dict[str, list[float]] = {}
        scattered: dict[tuple[str, str], Panel] = {}
        for seed in seeds:
            for volumes, pair, seconds in _pairs(scene, seed):
                spent.setdefault(volumes, []).append(seconds)
                for solver in ("piv3d_plain", "piv3d"):
                    start = time.perf_counter()
                    chosen = common.settings(solver, ring.window, ring.overlap, pair.grid)
                    field = common.run(solver, pair, **chosen)
                    spent.setdefault(f"{volumes}, {solver}", []).append(time.perf_counter() - start)
                    off = errors(scene, field)
                    intervals.setdefault((volumes, solver), []).append(precision_interval(off))
                    scattered[volumes, solver] = error_scatter(f"{volumes}, {solver}", off)
                    if (volumes, solver) == ("block_mart", "piv3d"):
                        yield Figure(
                            f"ring-{_slug(ring)}",
                            f"{ring.name}: {volumes}, {solver}",
                            (slice_panel(field, 1), slice_panel(field, 0)),
                            across=1,
                        )
                    widths = np.round(intervals[volumes, solver][-1], 3)
                    common.report(f"{ring.name}, {volumes}, {solver}: {widths}")
        yield Figure(
            f"fig-2-9-{_slug(ring)}",
            f"{ring.name}: errors in voxels",
            tuple(scattered.values()),
            across=2,
        )
        yield from _ring_rows(ring, intervals, spent)


def _slug(ring: Ring) -> str:
    return ring.name.replace(",", "").replace(" ", "-")


def _ring_rows(
    ring: Ring, intervals: dict[tuple[str, str], list[F64]], spent: dict[str, list[float]]
) -> Iterator[Item]:
    for (volumes, solver), widths in intervals.items():
        thesis = ring.synthesised if volumes == "synthesised" else ring.reconstructed
        note = f"{np.mean(spent[f'{volumes}, {solver}']):.3g} s" + (
            f", reconstruction {np.mean(spent[volumes]):.3g} s a pair" if spent[volumes][0] else ""
        )
        for number, axis in enumerate("uvw"):
            yield common.make_row(
                f"{ring.name}, {volumes}, {solver}: {axis}, voxels",
                thesis[number],
                [float(width[number]) for width in widths],
                note,
                "smaller",
            )


def scene_of(ring: Ring) -> Scene:
    """Make the scene of a ring and its cameras, with two frames."""
    (case,) = [case for case in common.cases("table-2-1") if case.name == ring.array]
    values: dict[str, Any] = case.scene.to_dict()
    values["particles"] = {
        **{
            key: value
            for key, value in values["particles"].items()
            if key not in ("count", "per_pixel")
        },
        "per_mm3": ring.per_mm3,
    }
    values["flow"] = {
        "generator": "vortex_ring",
        "axis": list(ring.axis),
        "peak_mm_s": ring.peak_mm / _INTERVAL_S,
    }
    values |= {"frames": 2, "interval_s": _INTERVAL_S}
    if not ring.corners:
        layout = values["cameras"]["layout"]
        middle = values["cameras"]["center_mm"]
        ends = {min(layout["x_mm"]), max(layout["x_mm"])}
        places = [
            (x, y) for y in layout["y_mm"] for x in layout["x_mm"] if not (x in ends and y in ends)
        ]
        values["cameras"]["layout"] = {
            "kind": "list",
            "places": [{"center_mm": [middle[0] + x, middle[1] + y, middle[2]]} for x, y in places],
        }
    return parse_scene(values, ring.name)


def _pairs(scene: Scene, seed: int) -> Iterator[tuple[str, VolumePair, float]]:
    """Make the synthesised pair and one of each reconstruction, with seconds."""
    shots = [simulate(scene, seed=seed, frame=frame) for frame in range(2)]
    yield "synthesised", _synthesise(shots, _INTERVAL_S), 0.0
    for name in _RECONSTRUCTIONS:
        start = time.perf_counter()
        pair = common.reconstruct(name, [shot.observation for shot in shots], _INTERVAL_S)
        yield name, pair, time.perf_counter() - start


def _synthesise(shots: Sequence[Shot], interval_s: float) -> VolumePair:
    """Make the volumes that a perfect reconstruction would give."""
    grid = shots[0].observation.grid
    first, other = (true_field(grid, shot.particles, shot.views) for shot in shots)
    return VolumePair(first, other, grid, interval_s)


def errors(scene: Scene, field: Velocity) -> F64:
    """Compute errors (n, 3) of u, v, w in voxels, of all vectors.

    As in the thesis, vectors that were filled in count, too.
    """
    points = field.positions_mm.reshape(-1, 3)
    exact = common.exact_displacements(scene, points, 0.0, _INTERVAL_S)
    return np.asarray(
        (field.velocity_mm_s.reshape(-1, 3) * _INTERVAL_S - exact) / np.asarray(scene.grid.voxel_mm)
    )


BASELINES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)  # D: spacing of the cameras over their distance
SPACINGS = (0.5, 1.0, 2.0, 4.0)  # of the planes, over equation 2.10
_BASELINE = 0.4  # at which the spacing varies; its own spacing is that of all baselines, too
_VOLUMES = ("asa", "msa", "synthesised")
_DISTANCE_MM, _VOXEL_MM = 510.0, 0.05
_WINDOW_MM, _OVERLAP, _MARGIN_MM = 2.0, 0.5, 3.0
_SIZE_MM, _PIXELS = (14.0, 14.0, 10.0), 440  # outer cameras see the cut's depth from the side
_FLOW = {"generator": "vortex_ring", "center_mm": [-10.0, 0.0, 0.0], "peak_mm_s": 300.0}


@dataclass(frozen=True)
class Setup:
    """Baseline D and distance of the planes."""

    baseline: float
    plane_mm: float

    @property
    def label(self) -> str:
        """Name of its rows."""
        return f"D = {self.baseline:g}, planes {self.plane_mm:.3g} mm apart"


def plane_mm(baseline: float) -> float:
    """Compute the distance of the planes in the middle by equation 2.10."""
    return _VOXEL_MM * plane_spacing_ratio(baseline, _VOXEL_MM, 0.0, _DISTANCE_MM)


_FIXED = tuple(Setup(baseline, plane_mm(_BASELINE)) for baseline in BASELINES)
_OWN = tuple(Setup(baseline, plane_mm(baseline)) for baseline in BASELINES)
_FINE = tuple(Setup(baseline, plane_mm(_BASELINE) / 2.0) for baseline in (0.2, 0.6))
_SPACED = tuple(Setup(_BASELINE, spacing * plane_mm(_BASELINE)) for spacing in SPACINGS)


def section_2_4(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors over the baseline and over the spacing of the planes.

    Baselines are compared with the same planes, some of them with planes twice as fine, and with
    the planes of equation 2.10 for each.

    The thesis expects better resolution in Z of larger baselines, and leaves the smallest and
    largest acceptable ones to further work. Here a core of its first vortex ring is measured in a
    part of its first volume, by windows that are the same in mm whatever the voxels.
    """
    rms: _Found = {}
    for setup in dict.fromkeys(_FIXED + _OWN + _FINE + _SPACED):
        rms[setup] = _measure(setup, seeds, pixels)
        for name, values in rms[setup].items():
            for number, axis in enumerate("uvw"):
                of_axis = [float(error[number]) for error in values]
                yield common.make_row(
                    f"{setup.label}, {name}: r.m.s. error of {axis}, pixels", None, of_axis
                )
    for name in _VOLUMES[:2]:
        yield from _claims(name, rms)
    yield Figure(
        "section-2-4",
        "r.m.s. error of the velocity, pixels",
        (
            *_panels("D, the same planes", BASELINES, _FIXED, rms),
            *_panels("D, planes of equation 2.10", BASELINES, _OWN, rms),
            *_panels("planes over equation 2.10, D = 0.4", SPACINGS, _SPACED, rms),
        ),
        across=2,
    )


_Found = dict[Setup, dict[str, list[F64]]]


def _measure(setup: Setup, seeds: Sequence[int], pixels: int | None) -> dict[str, list[F64]]:
    """Measure r.m.s. errors (3,) of u, v, w in pixels, of all volumes and seeds."""
    scene = common.coarsen(scene_at_baseline(setup), pixels)
    by_name: dict[str, list[F64]] = {name: [] for name in _VOLUMES}
    for seed in seeds:
        shots = [simulate(scene, seed=seed, frame=frame) for frame in range(2)]
        for name, draws in by_name.items():
            pair = (
                _synthesise(shots, scene.interval_s)
                if name == "synthesised"
                else common.reconstruct(
                    name, [shot.observation for shot in shots], scene.interval_s
                )
            )
            across, along = round(_WINDOW_MM / _VOXEL_MM), round(_WINDOW_MM / setup.plane_mm)
            chosen = common.settings("piv3d", (across, across, along), _OVERLAP, pair.grid)
            field = common.run("piv3d", pair, **chosen)
            places = field.positions_mm.reshape(-1, 3)
            inner = np.abs(places[:, :2]).max(axis=1) <= _SIZE_MM[0] / 2.0 - _MARGIN_MM
            voxels = np.asarray(scene.grid.voxel_mm) / scene.grid.voxel_mm[0]
            draws.append(
                np.array([root_mean_square(e) for e in (errors(scene, field)[inner] * voxels).T])
            )
            common.report(f"{setup.label}, {name}, seed {seed}: {draws[-1].round(3)}")
    return by_name


def scene_at_baseline(setup: Setup) -> Scene:
    """Make the thesis's array over a core of its ring, with the voxels of a setup."""
    step = setup.baseline * _DISTANCE_MM
    offsets = [step * number for number in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    values: dict[str, Any] = {
        "volume.size_mm": list(_SIZE_MM),
        "grid.voxel_mm": [_VOXEL_MM, _VOXEL_MM, setup.plane_mm],
        "cameras.rows": _PIXELS,
        "cameras.columns": _PIXELS,
        "cameras.layout": {"kind": "grid", "x_mm": offsets, "y_mm": offsets},
        "frames": 2,
        "flow": _FLOW,
    }
    return override(load_scene("thesis-50x50x10"), values, setup.label)


def _mean(values: Sequence[F64], axis: int) -> float:
    return float(np.mean([value[axis] for value in values]))


def _claims(name: str, rms: _Found) -> Iterator[Row]:
    """Say which baseline and which spacing are best."""
    for setups, planes in ((_FIXED, "the same planes"), (_OWN, "planes of equation 2.10")):
        across = {setup.baseline: _mean(rms[setup][name], 0) for setup in setups}
        depth = {setup.baseline: _mean(rms[setup][name], 2) for setup in setups}
        ratio = depth[max(depth)] / depth[min(depth)]
        yield common.claim(
            f"{name}: error of w, {planes}",
            "a larger baseline resolves Z better",
            ratio,
            ratio < 1.0,
            f"largest over smallest D; least at D = {min(depth, key=depth.__getitem__):g}, "
            f"of u at D = {min(across, key=across.__getitem__):g}",
        )
    spaced = {
        spacing: _mean(rms[setup][name], 2)
        for spacing, setup in zip(SPACINGS, _SPACED, strict=True)
    }
    yield common.make_row(
        f"{name}: error of w with planes of equation 2.10, over the least of all spacings",
        None,
        [spaced[1.0] / min(spaced.values())],
        f"least at {min(spaced, key=spaced.__getitem__):g} times that of equation 2.10",
    )


def _panels(
    label: str, x: Sequence[float], setups: Sequence[Setup], rms: _Found
) -> Iterator[Panel]:
    for number, axis in ((0, "u"), (2, "w")):
        curves = []
        for name in _VOLUMES:
            means = [mean_of([float(off[number]) for off in rms[setup][name]]) for setup in setups]
            y = [mean.mean if mean else float("nan") for mean in means]
            spread = [(mean.half_width or 0.0) if mean else 0.0 for mean in means]
            curves.append(Curve(name, x, y, spread))
        yield Panel(f"error of {axis}", label, "pixels", tuple(curves))
