"""Motion-tracking-enhanced MART.

The mean of an exposure's volume and of its neighbours', moved to its time by the measured
displacements, is the next initial guess. Particles coincide in it and stay as bright; ghosts move
differently from the fluid around them and fade.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.ndimage import map_coordinates

from sabench.algorithms.tomography.art_updates import Iterate, block_mart, iterate
from sabench.algorithms.tomography.problem import SparseParameters, TomographyProblem
from sabench.algorithms.tomography.supersampling import Splits
from sabench.algorithms.velocimetry.deformation import deform, spline_coefficients
from sabench.algorithms.velocimetry.multipass import Field
from sabench.api import Observation
from sabench.utils.arrays import F32, F64
from sabench.utils.threads import on_cores

_Place = tuple[float, float, float]
_FIXED_POINT = 3  # steps from the middle of an interval to its ends; each gains a digit or more


@dataclass(frozen=True)
class Exposure:
    """One exposure and its volume so far."""

    problem: TomographyProblem
    state: Iterate

    @classmethod
    def from_case(cls, case: Observation, parameters: SparseParameters) -> Exposure:
        """Start from multiplied lines of sight."""
        problem = TomographyProblem.from_case(case, parameters)
        return cls(problem, problem.mlos(parameters.threshold))

    def correct(self, parameters: SparseParameters, iterations: int, doing: str) -> None:
        """Correct the voxels by `block_mart`, in place."""
        measured = self.problem.measured
        step = partial(block_mart, self.state, measured, parameters.relaxation)
        for _ in iterate(step, measured, iterations, parameters.tolerance, doing):
            pass  # every iteration changes the voxels in place

    def volume(self, floor: float) -> F32:
        """Return the volume (z, y, x) on the requested grid."""
        return self.problem.volume(self.state, floor)

    def restart(self, guess: F32) -> Exposure:
        """Begin again from a guess (z, y, x) on the fine grid."""
        values = np.maximum(self.state.lines.support.sample(guess), np.float32(0.0))
        return replace(self, state=replace(self.state, values=values))


@dataclass(frozen=True)
class Displacement:
    """Displacements between two exposures, at the middle of the interval.

    Attributes
    ----------
    shift : (z, y, x, 3) voxels (x, y, z) of the fine grid, on a lattice.
    origin, step : position (z, y, x) of its first node and its spacing, fine voxels.
    """

    shift: F64
    origin: _Place
    step: _Place

    @classmethod
    def of(cls, field: Field, splits: Splits) -> Displacement:
        """Convert a field in voxels that are each split into fine ones."""
        axes = zip(field.windows.origin, field.windows.step, splits[::-1], strict=True)
        z, y, x = (((start + 0.5) * n - 0.5, float(step * n)) for start, step, n in axes)
        return cls(field.shift * np.asarray(splits), (z[0], y[0], x[0]), (z[1], y[1], x[1]))

    def at_end(self, share: float) -> F64:
        """Compute the displacements d' (z, y, x, 3) of particles at the nodes at an end.

        A particle there passes the middle of the interval at x + share d': d'(x) = d(x + share d').
        The share is 1/2 at the beginning and -1/2 at the end.
        """
        nodes = np.indices(self.shift.shape[:3]).astype(np.float64)
        moved = self.shift
        for _ in range(_FIXED_POINT):
            away = moved[..., ::-1] / np.asarray(self.step)
            places = nodes + share * np.moveaxis(away, -1, 0)
            axes = np.moveaxis(self.shift, -1, 0)
            read = [map_coordinates(axis, places, order=1, mode="nearest") for axis in axes]
            moved = np.stack(read, axis=-1)
        return moved

    def bring(self, volume: F32, own: F32, direction: int) -> F32:
        """Move a volume (z, y, x) to the time of its neighbour.

        Parameters
        ----------
        own : the neighbour's volume, which is kept where nothing is known of the other.
        direction : 1 moves the second volume to the time of the first, -1 the first to the second.
        """
        out, field = own.copy(), (self.at_end(0.5 * direction), self.origin, self.step)
        coefficients = spline_coefficients(volume)
        on_cores(deform, math.prod(out.shape[:2]), coefficients, *field, float(direction), out)
        return out


def enhanced_guesses(volumes: Sequence[F32], moves: Sequence[Displacement]) -> list[F32]:
    """Average each volume (z, y, x) with its neighbours, moved to its time.

    Source: Novara, Batenburg and Scarano, Meas. Sci. Technol. 21 (2010) 035401.

    Parameters
    ----------
    moves : from each volume to the next.
    """
    guesses = []
    for number, volume in enumerate(volumes):
        aligned = [volume]
        if number + 1 < len(volumes):
            aligned.append(moves[number].bring(volumes[number + 1], volume, 1))
        if number:
            aligned.append(moves[number - 1].bring(volumes[number - 1], volume, -1))
        guesses.append(np.asarray(sum(aligned) / np.float32(len(aligned)), dtype=np.float32))
    return guesses
