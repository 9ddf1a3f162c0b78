"""Flows that are linear in space: shear, rotation, strain."""

from __future__ import annotations

import numpy as np

from sabench.api import F64, Flow, Parameters

Row = tuple[float, float, float]


class LinearParameters(Parameters):
    """Velocity at a point, and its gradient."""

    center_mm: Row = (0.0, 0.0, 0.0)
    velocity_mm_s: Row = (0.0, 0.0, 0.0)
    gradient_1_s: tuple[Row, Row, Row] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class LinearFlow(Flow):
    """Flow with the same gradient du_i / dx_j everywhere.

    It is a uniform motion, shear, rigid rotation or strain, for tests of bias.
    """

    name = "linear_flow"
    Parameters = LinearParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute u + G (x - c)."""
        chosen: LinearParameters = self.parameters
        return np.asarray(
            np.asarray(chosen.velocity_mm_s)
            + (points_mm - np.asarray(chosen.center_mm)) @ np.asarray(chosen.gradient_1_s).T
        )

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Return the constant gradient G."""
        return np.tile(
            np.asarray(self.parameters.gradient_1_s, dtype=np.float64), (len(points_mm), 1, 1)
        )
