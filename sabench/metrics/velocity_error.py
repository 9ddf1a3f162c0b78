"""Errors of a velocity field against the true one."""

from __future__ import annotations

import numpy as np

from sabench.geometry.vector_calculus import divergence, gradient, inner, vorticity
from sabench.metrics.averages import root_mean_square
from sabench.utils.arrays import F64, Bool

_PRECISION = 90.0  # percent; thesis, table 2.2
_AXES = ("u", "v", "w")


def velocity_scores(
    estimate: F64,
    truth: F64,
    valid: Bool,
    fluid: Bool,
    step_mm: tuple[float, float, float],
    interval_s: float,
    voxel_mm: tuple[float, float, float],
) -> dict[str, float]:
    """Score a velocity field on a lattice; NaN where nothing was measured.

    Derivatives are compared at nodes whose neighbours along all axes were measured, too. In a
    lattice of one plane these are four, and the vorticity is the one about the plane's normal.

    Parameters
    ----------
    estimate, truth : (z, y, x, 3) velocities, mm/s.
    valid : (z, y, x) where the estimate was measured.
    fluid : (z, y, x) where there is fluid; what was measured in bodies does not count.
    step_mm : spacing of the nodes, as (x, y, z).
    interval_s : time between the two frames, which turns velocities into displacements.
    voxel_mm : spacing of the voxels in which displacements are counted, as (x, y, z).
    """
    valid = valid & fluid
    errors = ((estimate - truth) * interval_s / np.asarray(voxel_mm))[valid]
    scores = _displacement_figures(errors if len(errors) else np.full((1, 3), np.nan))
    scores["yield_percent"] = 100.0 * float(valid.sum() / max(fluid.sum(), 1))
    scores["response"] = response(estimate[valid], truth[valid])
    return scores | _derivative_figures(estimate, truth, valid, step_mm)


def _displacement_figures(errors: F64) -> dict[str, float]:
    """Compute precision, bias and root mean square of displacement errors (n, 3)."""
    bias = errors.mean(axis=0)
    figures = {
        "p90": precision_interval(errors),
        "bias": bias,
        "rms": np.sqrt((errors**2).mean(axis=0)),
    }
    scores = {
        f"{axis}_{name}_voxel": float(value)
        for name, values in figures.items()
        for axis, value in zip(_AXES, values, strict=True)
    }
    scores["bias_voxel"] = float(np.linalg.norm(bias))
    scores["rms_voxel"] = float(np.sqrt((errors**2).sum(axis=1).mean()))
    return scores


def _derivative_figures(
    estimate: F64, truth: F64, valid: Bool, step_mm: tuple[float, float, float]
) -> dict[str, float]:
    """Compute the root mean square errors of divergence and vorticity.

    The former is in 1/s, the latter in percent of the true vorticity.
    """
    known = _with_neighbours(valid)
    slopes, true = (gradient(field, step_mm)[known] for field in (estimate, truth))
    several = np.asarray(valid.shape[::-1]) > 1
    about = [axis for axis in range(3) if np.delete(several, axis).all()]
    spin, true_spin = vorticity(slopes)[..., about], vorticity(true)[..., about]
    return {
        "divergence_1_s": root_mean_square(divergence(slopes) - divergence(true)),
        "vorticity_percent": 100.0
        * root_mean_square(spin - true_spin)
        / max(root_mean_square(true_spin), 1e-300),
    }


def _with_neighbours(valid: Bool) -> Bool:
    """Mark the measured nodes (z, y, x) whose neighbours were measured."""
    known = valid & inner(valid.shape)
    for axis in np.flatnonzero(np.asarray(valid.shape) > 1):
        for shift in (1, -1):
            known &= np.roll(valid, shift, axis=axis)
    return np.asarray(known)


def precision_interval(errors: F64) -> F64:
    """Compute the half widths (3,) of intervals that hold 90 % of errors (n, 3).

    The intervals are about zero. Source: thesis, section 2.3.3.
    """
    return np.asarray(np.percentile(np.abs(errors), _PRECISION, axis=0))


def response(estimate: F64, truth: F64) -> float:
    """Compute the fraction of the true variation that an estimate shows.

    For a wave it is the ratio of the amplitudes. It is the slope of the estimated over the true
    velocities (n, 3), each less its mean.
    """
    about = (
        [values - values.mean(axis=0) for values in (estimate, truth)]
        if len(truth)
        else [estimate, truth]
    )
    power = float(np.sum(about[1] ** 2))
    return float(np.sum(about[0] * about[1])) / power if power > 0.0 else float("nan")
