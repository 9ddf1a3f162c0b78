"""Errors of points against their true places, after the frames have been aligned in one of several ways."""

from __future__ import annotations

from typing import Literal

import numpy as np

from sabench.geometry.rigid_motion import RigidMotion, fit_lateral_motion, fit_rigid_motion
from sabench.utils.arrays import F64

Alignment = Literal["raw", "shift", "lateral", "rigid"]
ALIGNMENTS: tuple[Alignment, ...] = ("raw", "shift", "lateral", "rigid")


def alignment(how: Alignment, points: F64, truths: F64) -> RigidMotion:
    """The motion of points (n, 3) that brings them nearest to their true places (n, 3), both in the wall's frame.

    raw: none. shift: along X and Y, the thesis's (section 4.4.2). lateral: these and a turn about
    Z, all that a plane wall leaves open. rigid: any.
    """
    if how == "raw":
        return RigidMotion(np.eye(3), np.zeros(3))
    if how == "shift":
        return RigidMotion(np.eye(3), np.append((truths - points).mean(axis=0)[:2], 0.0))
    return (fit_lateral_motion if how == "lateral" else fit_rigid_motion)(points, truths)
