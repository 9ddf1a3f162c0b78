"""Rigid motions fitted to points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sabench.geometry.rigid_motion import (
    RigidMotion,
    fit_lateral_motion,
    fit_rigid_motion,
    rotation_matrices,
)
from sabench.utils.arrays import F64

Fit = Callable[[F64, F64], RigidMotion]


@pytest.mark.parametrize("fit", [fit_rigid_motion, fit_lateral_motion])
@pytest.mark.parametrize("far_mm", [0.0, 1e7])
def test_a_motion_is_recovered_also_far_from_the_origin(fit: Fit, far_mm: float) -> None:
    """At 10 km doubles are 2e-9 mm apart; both sets are centred, so that no more is lost."""
    turn = np.array([0.3, -0.2, 0.9]) if fit is fit_rigid_motion else np.array([0.0, 0.0, 0.9])
    motion = RigidMotion(rotation_matrices(turn), np.array([5.0, -7.0, 0.0]))
    near = np.random.default_rng(2).uniform(-20.0, 20.0, (12, 3))
    points = near + far_mm * np.array([-0.3, 0.9, 0.0])
    targets = motion(near) + far_mm * np.array([1.0, -0.7, 0.0])
    found = fit(points, targets)
    np.testing.assert_allclose(found.rotation, motion.rotation, atol=1e-9 if far_mm else 1e-13)
    np.testing.assert_allclose(found(points), targets, rtol=0.0, atol=1e-7)
