"""What every camera model can do, whatever its equations."""

from __future__ import annotations

from typing import Protocol

import numpy.typing as npt

from sabench.arrays import F64, Bool
from sabench.optics.wall import Rays


class CameraModel(Protocol):
    """A map of points onto an image and of pixels onto lines of sight; `Camera` is one, the polynomials of `empirical` are others."""

    @property
    def name(self) -> str:
        """Used in file names."""

    @property
    def rows(self) -> int:
        """Image height, px."""

    @property
    def columns(self) -> int:
        """Image width, px."""

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Pixels (n, 2) as (column, row) of world points (n, 3), and whether each has one."""

    @property
    def center_mm(self) -> tuple[float, float, float]:
        """Where it stands, roughly if the model does not say."""

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Where the lines of sight through points (n, 3) of the fluid meet the plane at `z_mm`: (n, 2); NaN for points without one."""

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """The lines of sight of pixels (n, 2) in the fluid."""

    def contains(self, pixels: F64, margin_px: float = 0.0) -> Bool:
        """Whether pixels (n, 2) lie on the sensor, or at most `margin_px` outside."""
