"""The velocimetry track: pairs of frames are reconstructed, and two volumes become a velocity field."""

from __future__ import annotations

import time

import numpy as np

from sabench.api import Reconstruction, Solver, VelocimetrySolver, Velocity, VolumePair
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.metrics.averages import finite_or_none
from sabench.metrics.velocity_error import velocity_scores
from sabench.plotting import pictures
from sabench.plotting.charts import draw
from sabench.tasks.figures.velocity import field_figure
from sabench.tasks.reconstruction import reconstruct
from sabench.tasks.solver_call import attempt
from sabench.utils import memory
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.progress import track
from sabench.worlds.advection import advect
from sabench.worlds.tracers import TOLERANCE, flow_of

_NEIGHBOURS = 8  # true particles whose mean stands for the flow where it is not known otherwise


def run(
    algorithm: VelocimetrySolver, name: str, data: Dataset, writer: ResultWriter
) -> list[float]:
    """Reconstruct every pair of frames and measure its field; returns the seconds that each took, without the reconstruction.

    Raises
    ------
    InputError
        A data set without pairs, what the reconstruction refuses, or a solver that declines,
        raises, or returns something else.
    """
    pairs = data.rig.pairs()
    if not pairs:
        raise InputError(
            f"{data.root}: expected pairs of frames, got {data.rig.frames} that make none"
        )
    maker = _maker(algorithm.parameters.reconstruction)
    kept: dict[int, Reconstruction] = {}
    seconds, spent = [], []
    for pair in track(pairs, f"velocity by {name}"):
        for frame in set(kept) - set(pair):
            del kept[frame]
        for frame in pair:
            if frame not in kept:
                kept[frame], took = reconstruct(
                    maker, algorithm.parameters.reconstruction, data, frame
                )
                spent.append(took)
        interval = data.rig.time_s(pair[1]) - data.rig.time_s(pair[0])
        case = VolumePair(kept[pair[0]].volume, kept[pair[1]].volume, data.rig.grid, interval)
        start = time.perf_counter()
        field = _attempt(algorithm, name, case, pair[0])
        seconds.append(time.perf_counter() - start)
        writer.add_velocity(pair[0], field)
        memory.trim()
    writer.set_reconstruction(float(np.mean(spent)))
    return seconds


def _maker(name: str) -> Solver:
    from sabench.api.make import make_solver  # it finds tracks, and this is one

    return make_solver(name, {})


def _attempt(algorithm: VelocimetrySolver, name: str, case: VolumePair, frame: int) -> Velocity:
    field: Velocity = attempt(algorithm, name, case, Velocity, f" on frame {frame}")
    if (
        field.velocity_mm_s.shape != (*field.valid.shape, 3)
        or not np.isfinite(field.velocity_mm_s).all()
    ):
        raise InputError(
            f"solver {name}: expected finite velocities (z, y, x, 3) on {field.valid.shape} nodes, got {field.velocity_mm_s.shape}"
        )
    return field


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write the field of every pair of a foreign result anew; reading checks it."""
    for first, _ in data.rig.pairs():
        writer.add_velocity(first, result.velocity(first))


def score_result(data: Dataset, result: Result) -> dict[str, float | None]:
    """All scores: the means over the pairs."""
    pairs = [
        score_pair(data, pair, result.velocity(pair[0]))
        for pair in track(data.rig.pairs(), "score")
    ]
    scores = {key: float(np.mean([one[key] for one in pairs])) for key in pairs[0]}
    return {
        **{key: finite_or_none(value) for key, value in scores.items()},
        "reconstruction_s": result.reconstruction_s,
    }


def score_pair(data: Dataset, pair: tuple[int, int], field: Velocity) -> dict[str, float]:
    """Score one pair's field."""
    points = field.positions_mm
    truth = true_velocity(data, pair, points.reshape(-1, 3)).reshape(points.shape)
    return velocity_scores(
        field.velocity_mm_s,
        truth,
        field.valid,
        field.step_mm,
        data.rig.time_s(pair[1]) - data.rig.time_s(pair[0]),
        data.rig.grid.voxel_mm,
    )


def true_velocity(data: Dataset, pair: tuple[int, int], points_mm: F64) -> F64:
    """The displacement over the pair's interval of the fluid that is at points (n, 3) in the middle of it, over the interval.

    Where the data set has no flow, it is the mean of the nearest true particles.
    """
    flow, (start, end) = flow_of(data.scene), (data.rig.time_s(frame) for frame in pair)
    if flow is None:
        return _among_particles(data, pair, points_mm)
    middle, tolerance = (start + end) / 2.0, TOLERANCE * max(data.scene.volume.size_mm)
    after, before = (advect(flow, points_mm, middle, time, tolerance) for time in (end, start))
    return (after - before) / (end - start)


def _among_particles(data: Dataset, pair: tuple[int, int], points_mm: F64) -> F64:
    from scipy.spatial import cKDTree

    first, second = (data.particles(frame) for frame in pair)
    _, one, other = np.intersect1d(first.id, second.id, return_indices=True)
    if not len(one):
        raise InputError(
            f"{data.root}: frames {pair[0]} and {pair[1]}: expected particles that are in both, got none"
        )
    places = (first.position_mm[one] + second.position_mm[other]) / 2.0
    moves = (second.position_mm[other] - first.position_mm[one]) / (
        data.rig.time_s(pair[1]) - data.rig.time_s(pair[0])
    )
    count = min(_NEIGHBOURS, len(places))
    near = cKDTree(places).query(points_mm, k=count)[1].reshape(len(points_mm), count)
    return np.asarray(moves[near].mean(axis=1))


def images(data: Dataset) -> bytes:
    """What the cameras saw, as a PNG."""
    seen = data.observation(0)
    return pictures.montage(seen.images, seen.black_dn, seen.white_dn)


def picture(data: Dataset, result: Result) -> bytes:
    """The first pair's field, its errors and a profile, as a PNG."""
    pair = data.rig.pairs()[0]
    field, interval = result.velocity(pair[0]), data.rig.time_s(pair[1]) - data.rig.time_s(pair[0])
    exact = true_velocity(data, pair, field.positions_mm.reshape(-1, 3)).reshape(
        field.velocity_mm_s.shape
    )
    return draw(
        field_figure(field, exact, np.asarray(data.rig.grid.voxel_mm) / interval, result.solver)
    )
