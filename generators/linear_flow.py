"""Flows that are linear in space: shear, rotation, strain."""

import functools

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters

Row = tuple[float, float, float]


class LinearParameters(Parameters):
    """Velocity at a point, and its gradient."""

    center_mm: Row = Field((0.0, 0.0, 0.0), description="point with the given velocity")
    velocity_mm_s: Row = Field((0.0, 0.0, 0.0), description="velocity at that point")
    gradient_1_s: tuple[Row, Row, Row] = Field(
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        description="velocity gradient: row i, column j is du_i / dx_j",
    )


class LinearFlow(Flow):
    """Flow with the same gradient du_i / dx_j everywhere.

    It is a uniform motion, shear, rigid rotation or strain, for tests of bias.
    """

    name = "linear_flow"
    Parameters = LinearParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute u + G (x - c)."""
        chosen: LinearParameters = self.parameters
        rate = np.asarray(chosen.gradient_1_s)
        shift = np.asarray(chosen.velocity_mm_s) - rate @ np.asarray(chosen.center_mm)
        return np.asarray(points_mm @ np.ascontiguousarray(rate.T) + shift)

    def carry(self, points_mm: F64, start_s: float, end_s: float) -> F64:
        """Compute c + exp(G t) (x - c) + (t + G t^2 / 2 + ...) u."""
        chosen: LinearParameters = self.parameters
        center = np.asarray(chosen.center_mm)
        motion = _motion(chosen.gradient_1_s, chosen.velocity_mm_s, end_s - start_s)
        turn, shift = motion[:3, :3], center - motion[:3, :3] @ center + motion[:3, 3]
        return np.asarray(points_mm @ np.ascontiguousarray(turn.T) + shift)

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Return the constant gradient G."""
        return np.tile(
            np.asarray(self.parameters.gradient_1_s, dtype=np.float64), (len(points_mm), 1, 1)
        )


@functools.lru_cache(maxsize=64)
def _motion(gradient_1_s: tuple[Row, Row, Row], velocity_mm_s: Row, time_s: float) -> F64:
    """Compute the affine map (4, 4) of points relative to the centre."""
    from scipy.linalg import expm  # takes long to load

    rate = np.zeros((4, 4))
    rate[:3, :3], rate[:3, 3] = gradient_1_s, velocity_mm_s
    return np.asarray(expm(time_s * rate))
