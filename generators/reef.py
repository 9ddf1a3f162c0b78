"""Reef."""

import numpy as np
from pydantic import Field, field_validator

from sabench.api import F64, Solid, SolidGenerator, SolidParameters, Vector, stream
from sabench.worlds.library.implicit_surfaces import (
    capsules,
    largest_part,
    smooth_minimum,
    surface_of,
)

# radii of the first and of the thinnest branches, in the least of the half widths and the height
_THICK, _THIN = 0.25, 0.07
_LENGTH = 0.35  # of the longest branches, in the same
_BLEND = 0.03  # how round joints are, in the same
_JOINTS = 3.0  # growth of twenty branches in one place, in blends: log(20)
Cones = tuple[F64, F64, F64, F64]


class ReefParameters(SolidParameters):
    """Size and branches of the reef in its own frame.

    It stands on the plane Y = 0 and grows towards -Y, which is up where +Y is down.
    """

    size_mm: Vector = Field(
        (36.0, 20.0, 28.0),
        description="size of the box that holds it: width along X, height, depth along Z",
    )
    branches: int = Field(
        120, ge=1, le=5000, description="number of branches, which grow out of each other"
    )
    tunnels: int = Field(
        20, ge=0, le=1000, description="number of straight round tunnels through it"
    )
    step_mm: float = Field(
        0.3,
        gt=0.0,
        description="spacing of the lattice; a fifth of the thinnest branch's radius or less keeps "
        "all of them round",
    )

    @field_validator("size_mm")
    @classmethod
    def _is_a_box(cls, size: Vector) -> Vector:
        if min(size) <= 0.0:
            raise ValueError(f"expected positive lengths, got {min(size):g}")
        return size


class Reef(SolidGenerator):
    """Irregular mound of branches on a flat base, full of holes and overhangs."""

    name = "reef"
    references = ("S. M. LaValle, Iowa State University TR 98-11 (1998)",)
    Parameters = ReefParameters

    def body(self, seed: int) -> Solid:
        """Make the reef around the middle of its base."""
        half = np.asarray(self.parameters.size_mm) / [2.0, 1.0, 2.0]
        blend, step = _BLEND * half.min(), self.parameters.step_mm
        branches = self._branches(half, stream(seed, "reef", 0))
        tunnels = self._tunnels(half, stream(seed, "reef", 1))

        def body(points_mm: F64) -> F64:
            grown, bored = (capsules(points_mm, *cones, blend) for cones in (branches, tunnels))
            return np.maximum(-smooth_minimum([-grown, bored], blend), points_mm[:, 1])

        low = -(half + 2.0 * step)
        # the base lies between two planes of the lattice
        low[1] = -(np.ceil(half[1] / step) + 1.5) * step
        return largest_part(surface_of(body, low, [-low[0], 1.5 * step, -low[2]], step))

    def _branches(self, half: F64, rng: np.random.Generator) -> Cones:
        """Grow rounded cones towards random positions in half an ellipsoid.

        Each starts from the nearest end of another one (LaValle's random tree) and is thinner.
        """
        least, count = half.min(), self.parameters.branches
        room = half - _JOINTS * _BLEND * least
        ends, radii = np.zeros((count + 1, 3)), np.full(count + 1, _THICK * least)
        parents = np.zeros(count, dtype=np.int64)
        for n in range(count):
            direction = rng.normal(size=3)
            target = (
                room
                * np.cbrt(rng.random())
                * direction
                / np.linalg.norm(direction)
                * [1.0, -np.sign(direction[1]), 1.0]
            )
            parents[n] = np.argmin(np.linalg.norm(ends[: n + 1] - target, axis=1))
            start = ends[parents[n]]
            radii[n + 1] = max(_THIN * least, radii[parents[n]] * rng.uniform(0.7, 0.98))
            tip = start + (target - start) * min(
                1.0, _LENGTH * least / float(np.linalg.norm(target - start))
            )
            ends[n + 1] = tip / max(1.0, float(np.linalg.norm(tip / (room - radii[n + 1]))))
        return ends[parents], ends[1:], radii[parents], radii[1:]

    def _tunnels(self, half: F64, rng: np.random.Generator) -> Cones:
        """Draw capsules between random positions in and around the upper part."""
        count = self.parameters.tunnels
        starts, ends = rng.uniform([-1.0, -1.0, -1.0], [1.0, -0.25, 1.0], (2, count, 3)) * half
        radii = half.min() * rng.uniform(0.04, 0.1, (2, count))
        return starts, ends, *radii
