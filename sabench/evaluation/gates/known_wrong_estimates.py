"""Estimates that are wrong in a known way, and their scores: a bug in a metric that flatters every solver shows in these."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api import Calibration, Detections, Reconstruction, Velocity
from sabench.dataset.reader import Dataset
from sabench.dataset.results import ResultWriter, result_writer
from sabench.geometry.camera import Camera
from sabench.geometry.rotations import exponential
from sabench.metrics.synthesised_field import true_field
from sabench.tasks.solve_and_score import score
from sabench.tasks.velocimetry import true_velocity
from sabench.utils.arrays import triple
from sabench.worlds.readable_codes import code_of

_TURN = exponential(np.array([0.1, -0.2, 0.05]))  # of bubbles


def probe(data: Dataset, out: Path) -> dict[str, float]:
    """Scores of the wrong estimates of all tracks that a data set can be of, by names like `probe.reconstruction.q`; writes to `out` on its way."""
    figures: dict[str, float] = {}
    for track in _tracks(data):
        with result_writer(out, data, "probe", track, {}, overwrite=True) as writer:
            _WRONG[track](data, writer)
        scores = score(data, out)
        known = {
            key: value
            for key, value in scores.items()
            if isinstance(value, float | int) and not isinstance(value, bool)
        }
        figures |= {f"probe.{track}.{key}": float(value) for key, value in known.items()}
    return figures


def _tracks(data: Dataset) -> list[str]:
    if data.shows_target:
        return ["calibration"]
    own = {"particles": "reconstruction", "bubbles": "bubbles", "code": "see_through"}
    return [own[one] for one in data.shows] + (
        ["velocimetry"] if data.shows == ("particles",) and data.rig.pairs() else []
    )


def _volume(data: Dataset, writer: ResultWriter) -> None:
    """The true field, less than a voxel aside, with ghosts: a fainter copy of a part of it a few voxels away."""
    for frame in range(data.rig.frames):
        true = true_field(data.rig.grid, data.particles(frame), data.views(frame))
        ghosts = np.roll(true, (3, 11, 17), axis=(0, 1, 2))
        ghosts[:, :, : true.shape[2] // 2] = 0.0
        writer.add(
            frame,
            Reconstruction(
                np.asarray(
                    0.6 * true + 0.4 * np.roll(true, 1, axis=2) + 0.5 * ghosts, dtype=np.float32
                )
            ),
        )


def _cameras(data: Dataset, writer: ResultWriter) -> None:
    """Principal points a little off, each camera's elsewhere; the target's points stretched about their middle."""
    points = data.placed().points_mm
    middle = points.reshape(-1, 3).mean(axis=0)
    cameras = tuple(_aside(camera, number) for number, camera in enumerate(data.true_cameras))
    writer.add_calibration(Calibration(cameras, middle + (points - middle) * [1.001, 0.999, 1.003]))


def _aside(camera: Camera, number: int) -> Camera:
    column, row = camera.principal_point_px
    return replace(
        camera,
        principal_point_px=(column + 0.3 * math.cos(number), row + 0.2 * math.sin(2.0 * number)),
    )


def _field(data: Dataset, writer: ResultWriter) -> None:
    """The true velocity on a coarse lattice, a tenth too slow, with a wave on it, and not measured in one corner."""
    grid = data.rig.grid
    low, size = np.asarray(grid.low_mm), np.asarray(grid.voxel_mm) * grid.shape[::-1]
    counts = np.array([9, 8, 7])
    for pair in data.rig.pairs():
        empty = Velocity(
            triple(low + 0.1 * size),
            triple(0.8 * size / (counts - 1)),
            np.zeros((7, 8, 9, 3)),
            np.ones((7, 8, 9), dtype=np.bool_),
        )
        points = empty.positions_mm
        true = true_velocity(data, pair, points.reshape(-1, 3)).reshape(points.shape)
        wave = (
            0.05
            * np.abs(true).max()
            * np.sin(2.0 * np.pi * (points - low) / size * [1.0, 2.0, 1.5])
        )
        valid = (points - low < 0.7 * size).any(axis=-1)
        writer.add_velocity(pair[0], replace(empty, velocity_mm_s=0.9 * true + wave, valid=valid))


def _balls(data: Dataset, writer: ResultWriter) -> None:
    """Most true bubbles, aside, larger and turned, and some that are not there."""
    for frame in range(data.rig.frames):
        true = data.bubbles(frame)
        kept = np.flatnonzero(np.arange(len(true)) % 5 != 3)
        aside = (
            np.array([0.08, -0.05, 0.2])
            * true.radius_mm[kept, None]
            * (1.5 + np.sin(kept + frame)[:, None])
        )
        ghosts = np.asarray(true.center_mm)[::6] + 2.5 * true.radius_mm[::6, None]
        centers = np.concatenate([true.center_mm[kept] + aside, ghosts])
        sizes = np.concatenate(
            [true.semi_axes_mm[kept] * [1.05, 0.97, 1.02], true.semi_axes_mm[::6]]
        )
        turns = np.concatenate([true.turn[kept] @ _TURN, true.turn[::6]])
        writer.add_bubbles(frame, Detections(centers, sizes, turns))


def _planes(data: Dataset, writer: ResultWriter) -> None:
    """Noise, darker where the code is dark."""
    grid = data.rig.grid
    for frame in range(data.rig.frames):
        volume, code = (
            np.random.default_rng(frame).random(grid.shape, dtype=np.float32),
            code_of(data.scene, data.manifest.seed, frame),
        )
        places = np.rint(grid.to_voxels(code.points_mm[~code.dark].reshape(-1, 3))).astype(np.int64)
        x, y, z = places[((places >= 0) & (places < grid.shape[::-1])).all(axis=1)].T
        volume[z, y, x] += np.float32(0.5)
        writer.add(frame, Reconstruction(volume))


_WRONG: dict[str, Callable[[Dataset, ResultWriter], Any]] = {
    "reconstruction": _volume,
    "calibration": _cameras,
    "velocimetry": _field,
    "bubbles": _balls,
    "see_through": _planes,
}
