"""Refocusing through bubbles or bodies by differences between the views."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from sabench.algorithms.bubbles import transmission
from sabench.algorithms.refocus import find_edge_on, refocus_log2, refocus_sum
from sabench.api import (
    F32,
    Flaws,
    Observation,
    Parameters,
    Reconstruction,
    SeeThroughSolver,
    make_solver,
)

_FLOOR = 0.02  # of transmission and of darkness: one camera cannot erase a point
_LEVELS = 4000.0  # grey values of the largest optical depth that the tomography is given
_DEEPEST = float(-np.log(_FLOOR))


class SeeThroughParameters(Parameters):
    """Method of joining the views."""

    method: Literal["additive", "multiplicative", "dark", "mart"] = Field(
        "dark",
        description="mean of the light; its product; product of the darkness, so that one open "
        "view is enough; optical depth by MART",
    )


class SeeThrough(SeeThroughSolver):
    """Refocused stack of transmission through bubbles or bodies.

    The stack is an additive or multiplicative one of light, a multiplicative one of darkness, or
    MART of the optical depth.
    """

    name = "see_through"
    references = ("J. Belden, MIT thesis, equations 3.3, 3.4 and 3.9, figure 1-3",)
    Parameters = SeeThroughParameters

    def skip(self, case: Observation) -> str | None:
        """Skip cameras that see planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Reconstruction:
        """Compute the transmission (z, y, x) of every voxel from the views."""
        light, count = np.clip(transmission(case), _FLOOR, 1.0), len(case.cameras)
        method = self.parameters.method
        if method == "additive":
            return Reconstruction(refocus_sum(light, case.cameras, case.grid) / np.float32(count))
        if method == "multiplicative":
            return Reconstruction(_product(light, case, count))
        if method == "dark":
            return Reconstruction(
                np.float32(1.0)
                - _product(np.maximum(np.float32(1.0) - light, np.float32(_FLOOR)), case, count)
            )
        no_flaws = Flaws.none(light.shape)
        depth = np.rint(-np.log(light) / _DEEPEST * _LEVELS).astype(np.uint16)
        volume = (
            make_solver("mart", {"floor": 0.0})
            .solve(
                replace(case, images=depth, black_dn=0.0, white_dn=2.0 * _LEVELS, flaws=no_flaws)
            )
            .volume
        )
        return Reconstruction(np.exp(-volume))


def _product(images: F32, case: Observation, count: int) -> F32:
    """Compute the geometric mean over the views."""
    volume = refocus_log2(images, case.cameras, case.grid, _FLOOR, outside=1.0)
    volume /= np.float32(count)
    return np.asarray(np.exp2(volume, out=volume))
