"""Pixels that show nothing of the particles: hot, dead, or under a reflection."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sabench.utils.arrays import U16, Bool


class Flaws(NamedTuple):
    """Pixels that show nothing of the particles.

    Attributes
    ----------
    points : (camera, row, column) hot and dead pixels.
    covered : the same shape, reflections.
    """

    points: Bool
    covered: Bool

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Flaws:
        """Make those of images (camera, row, column) without any."""
        return cls(np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_))

    @property
    def unknown(self) -> Bool:
        """Both kinds."""
        return np.asarray(self.points | self.covered)


class Repaired(NamedTuple):
    """Images in which flaws have been replaced.

    Attributes
    ----------
    images : (camera, row, column) grey values; hot and dead pixels have their neighbours' mean,
        reflections the black level.
    flaws : what has been replaced.
    """

    images: U16
    flaws: Flaws
