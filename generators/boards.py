"""Flat calibration board, held at another position in every frame."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from sabench.api import Domain, Parameters, Pose, Target, TargetGenerator, rotation_matrices, stream


class BoardsParameters(Parameters):
    """Type of the board and range of its poses.

    Over the frames it moves uniformly through the depth of the volume.
    """

    pattern: Literal["checkerboard", "circles", "charuco"] = Field(
        "checkerboard", description="pattern on the board"
    )
    columns: int = Field(11, ge=3, le=200, description="number of points along X")
    rows: int = Field(11, ge=3, le=200, description="number of points along Y")
    pitch_mm: float = Field(4.0, gt=0.0, description="distance between neighbouring points")
    mark_mm: float | None = Field(
        None,
        gt=0.0,
        description="diameter of a circle (by default half a pitch), edge of a ChArUco marker "
        "(0.7 of it)",
        examples=[2.0],
    )
    tilt_deg: float = Field(10.0, ge=0.0, le=60.0, description="largest rotation about X and Y")
    roll_deg: float = Field(
        5.0, ge=0.0, le=180.0, description="largest rotation about the board's own normal"
    )
    wander: float = Field(
        1.0,
        ge=0.0,
        le=1.0,
        description="how far it strays in X and Y, as a part of what the volume leaves it",
    )

    @model_validator(mode="after")
    def _fits(self) -> BoardsParameters:
        if self.mark_mm is not None and self.mark_mm >= self.pitch_mm:
            raise ValueError(
                f"mark_mm: expected less than pitch_mm = {self.pitch_mm:g}, got {self.mark_mm:g}"
            )
        return self


class Boards(TargetGenerator):
    """A checkerboard, grid of circles or ChArUco board at random poses.

    Over the frames it moves uniformly through the depth of the volume.
    """

    name = "boards"
    references = ("J. Belden, PhD thesis, MIT 2011, figure 4-10",)
    Parameters = BoardsParameters

    def target(self) -> Target:
        """Return the board."""
        chosen: BoardsParameters = self.parameters
        usual = {
            "checkerboard": 0.0,
            "circles": 0.5 * chosen.pitch_mm,
            "charuco": 0.7 * chosen.pitch_mm,
        }[chosen.pattern]
        return Target(
            chosen.pattern,
            chosen.columns,
            chosen.rows,
            chosen.pitch_mm,
            usual if chosen.mark_mm is None else chosen.mark_mm,
        )

    def pose(self, domain: Domain, seed: int, frame: int, frames: int) -> Pose:
        """Draw a rotation, then a position with all points in the volume, if possible."""
        chosen: BoardsParameters = self.parameters
        rng = stream(seed, "targets", frame)
        limits = np.deg2rad([chosen.tilt_deg, chosen.tilt_deg, chosen.roll_deg])
        rotation = rotation_matrices(rng.uniform(-limits, limits))
        margin = np.maximum(
            np.asarray(domain.size_mm) / 2.0
            - np.abs(self.target().points_mm @ rotation.T).max(axis=0),
            0.0,
        )
        along = 2.0 * frame / (frames - 1) - 1.0 if frames > 1 else 0.0
        return Pose(
            rotation,
            np.asarray(domain.center_mm)
            + margin * np.append(chosen.wander * rng.uniform(-1.0, 1.0, 2), along),
        )
