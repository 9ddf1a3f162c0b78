"""Cameras that are known in the world, and a wall in front of them that is not."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.calibration.parameters import WALL, FreeParameters, State
from sabench.geometry.rotations import skew
from sabench.utils.arrays import F64


def follow_wall(state: State, free: FreeParameters) -> F64:
    """Differentiate cameras' and shared unknowns by the shared ones.

    In the frame of the wall, cameras that are known in the world move when the wall does: a turn r
    and a shift z of the wall R x + t move a point x by -R^-1 (r x R x + z), see
    `State.apply_steps`.

    Returns (M f + s, s).
    """
    own, shared = free.columns(len(state.indices))
    rows = np.zeros((len(state.rotations), len(own), len(shared)))
    if free.wall:
        first = int(np.flatnonzero(shared == 2 * len(state.indices) - 2)[0])
        part, back = slice(first, first + WALL), state.wall.rotation.T
        arms = skew(state.centers @ back)
        rows[:, 0:3, part][..., :2] = (state.rotations @ back)[..., :2]
        rows[:, 3:6, part] = back @ np.concatenate(
            [arms[..., :2], np.broadcast_to(-np.eye(3)[:, 2:], (len(arms), 3, 1))], axis=2
        )
    return np.vstack([rows.reshape(-1, len(shared)), np.eye(len(shared))])
