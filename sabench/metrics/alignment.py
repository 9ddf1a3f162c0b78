"""Alignment of estimated with true points, before errors are counted."""

from __future__ import annotations

from typing import Literal

import numpy as np

from sabench.geometry.rigid_motion import RigidMotion, fit_lateral_motion, fit_rigid_motion
from sabench.utils.arrays import F64

Alignment = Literal["raw", "shift", "lateral", "rigid"]
ALIGNMENTS: tuple[Alignment, ...] = ("raw", "shift", "lateral", "rigid")


def fit_alignment(how: Alignment, estimate: F64, truth: F64) -> RigidMotion:
    """Fit the motion that brings estimated points (n, 3) nearest to true ones.

    Both are in the frame of the wall.

    Parameters
    ----------
    how : raw: no motion. shift: along X and Y, as in the thesis (section 4.4.2). lateral: also a
        rotation about Z, which is all that a plane wall leaves open. rigid: any rigid motion.
    """
    if how == "raw":
        return RigidMotion(np.eye(3), np.zeros(3))
    if how == "shift":
        return RigidMotion(np.eye(3), np.append((truth - estimate).mean(axis=0)[:2], 0.0))
    return (fit_lateral_motion if how == "lateral" else fit_rigid_motion)(estimate, truth)
