"""Wand with balls in a row, waved through the volume."""

import numpy as np
from pydantic import Field

from sabench.api import Domain, Parameters, Pose, Target, TargetGenerator, rotation_matrices, stream


class WandParameters(Parameters):
    """Balls of the wand; its positions and directions are random."""

    balls: int = Field(2, ge=2, le=20, description="number of balls in a row")
    pitch_mm: float = Field(20.0, gt=0.0, description="distance between neighbouring balls")
    ball_mm: float = Field(1.0, gt=0.0, description="diameter of a ball")


class Wand(TargetGenerator):
    """Two or more balls at known distances.

    Positions and directions are random.
    """

    name = "wand"
    Parameters = WandParameters

    def target(self) -> Target:
        """Return the balls in a row."""
        chosen: WandParameters = self.parameters
        return Target("wand", chosen.balls, 1, chosen.pitch_mm, chosen.ball_mm)

    def pose(self, domain: Domain, seed: int, frame: int, frames: int) -> Pose:
        """Draw a uniform direction; all balls lie in the volume if it is large enough."""
        rng = stream(seed, "targets", frame)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        across = np.cross([1.0, 0.0, 0.0], axis)
        sine = float(np.linalg.norm(across))
        rotation = (
            rotation_matrices(across / sine * np.arctan2(sine, axis[0]))
            if sine > 1e-12
            else np.eye(3)
        )
        margin = np.maximum(
            np.asarray(domain.size_mm) / 2.0
            - np.abs(self.target().points_mm @ rotation.T).max(axis=0),
            0.0,
        )
        return Pose(rotation, np.asarray(domain.center_mm) + margin * rng.uniform(-1.0, 1.0, 3))
