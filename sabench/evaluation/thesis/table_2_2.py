"""Table 2.2: 90 % precision intervals of the velocity in two vortex rings.

Volumes are reconstructed or synthesised.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Velocity, VolumePair
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.thesis.common import Item, cases, coarsen, make_row, settings
from sabench.metrics.synthesised_field import true_field
from sabench.metrics.velocity_error import precision_interval
from sabench.plotting.charts import Figure, Panel
from sabench.scenes import Scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.tasks.figures.velocity import error_scatter, slice_panel
from sabench.utils.arrays import F32, F64
from sabench.utils.progress import console
from sabench.worlds.advection import advect
from sabench.worlds.tracers import TOLERANCE, require_flow

SEEDS = 3
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
RINGS = (
    Ring(
        "case 1",
        _ONE,
        False,
        5.0,
        (0.0, 0.0, 1.0),
        0.3,
        (32, 32, 16),
        0.75,
        (0.37, 0.38, 0.20),
        (0.33, 0.34, 0.14),
    ),
    Ring(
        "case 1, 3 x displacement",
        _ONE,
        False,
        5.0,
        (0.0, 0.0, 1.0),
        0.9,
        (32, 32, 16),
        0.75,
        (1.69, 1.72, 0.90),
        (1.62, 1.62, 0.80),
    ),
    Ring(
        "case 2",
        _TWO,
        True,
        1.0,
        (1.0, 0.0, 0.0),
        0.37,
        (60, 60, 24),
        0.5,
        (0.54, 0.43, 0.19),
        (0.48, 0.36, 0.14),
    ),
)


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure intervals of u, v, w and seconds per ring, volumes and solver.

    Figures 2-8 to 2-11 are drawn, too.
    """
    for ring in RINGS:
        scene = coarsen(scene_of(ring), pixels)
        found: dict[tuple[str, str], list[F64]] = {}
        spent: dict[str, list[float]] = {}
        scattered: dict[tuple[str, str], Panel] = {}
        for seed in seeds:
            for volumes, pair, seconds in _pairs(scene, seed):
                spent.setdefault(volumes, []).append(seconds)
                for solver in ("piv3d_plain", "piv3d"):
                    start = time.perf_counter()
                    algorithm: Any = make_algorithm(
                        solver, settings(solver, ring.window, ring.overlap, pair.grid)
                    )
                    field = algorithm.solve(pair)
                    spent.setdefault(f"{volumes}, {solver}", []).append(time.perf_counter() - start)
                    off = errors(scene, field)
                    found.setdefault((volumes, solver), []).append(precision_interval(off))
                    scattered[volumes, solver] = error_scatter(f"{volumes}, {solver}", off)
                    if (volumes, solver) == ("block_mart", "piv3d"):
                        yield Figure(
                            f"ring-{_slug(ring)}",
                            f"{ring.name}: {volumes}, {solver}",
                            (slice_panel(field, 1), slice_panel(field, 0)),
                            across=1,
                        )
                    widths = np.round(found[volumes, solver][-1], 3)
                    console.print(
                        f"{ring.name}, {volumes}, {solver}: {widths}",
                        markup=False,
                        highlight=False,
                    )
        yield Figure(
            f"fig-2-9-{_slug(ring)}",
            f"{ring.name}: errors in voxels",
            tuple(scattered.values()),
            across=2,
        )
        yield from _ring_rows(ring, found, spent)


def _slug(ring: Ring) -> str:
    return ring.name.replace(",", "").replace(" ", "-")


def _ring_rows(
    ring: Ring, found: dict[tuple[str, str], list[F64]], spent: dict[str, list[float]]
) -> Iterator[Item]:
    for (volumes, solver), widths in found.items():
        thesis = ring.synthesised if volumes == "synthesised" else ring.reconstructed
        note = f"{np.mean(spent[f'{volumes}, {solver}']):.3g} s" + (
            f", reconstruction {np.mean(spent[volumes]):.3g} s a pair" if spent[volumes][0] else ""
        )
        for number, axis in enumerate("uvw"):
            yield make_row(
                f"{ring.name}, {volumes}, {solver}: {axis}, voxels",
                thesis[number],
                [float(own[number]) for own in widths],
                note,
                "smaller",
            )


def scene_of(ring: Ring) -> Scene:
    """Make the scene of a ring and its cameras, with two frames."""
    (case,) = [one for one in cases("table-2-1") if one.name == ring.array]
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
    yield (
        "synthesised",
        _pair(
            shots, [true_field(shot.observation.grid, shot.particles, shot.views) for shot in shots]
        ),
        0.0,
    )
    for name in _RECONSTRUCTIONS:
        start = time.perf_counter()
        volumes = [make_solver(name, {}).solve(shot.observation).volume for shot in shots]
        yield name, _pair(shots, volumes), time.perf_counter() - start


def _pair(shots: Sequence[Shot], volumes: Sequence[F32]) -> VolumePair:
    return VolumePair(volumes[0], volumes[1], shots[0].observation.grid, _INTERVAL_S)


def errors(scene: Scene, field: Velocity) -> F64:
    """Compute errors (n, 3) of u, v, w in voxels, of all vectors.

    As in the thesis, vectors that were filled in count, too.
    """
    flow, points = require_flow(scene), field.positions_mm.reshape(-1, 3)
    tolerance = TOLERANCE * max(scene.volume.size_mm)
    exact = advect(flow, points, _INTERVAL_S / 2.0, _INTERVAL_S, tolerance) - advect(
        flow, points, _INTERVAL_S / 2.0, 0.0, tolerance
    )
    return np.asarray(
        (field.velocity_mm_s.reshape(-1, 3) * _INTERVAL_S - exact) / np.asarray(scene.grid.voxel_mm)
    )
