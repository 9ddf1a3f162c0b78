"""Most probable light of one particle in all cameras.

The logarithms of a particle's light over a typical particle's follow a normal distribution of all
cameras: particles differ (their size), and each differs between cameras (its lobes of scattering).
A ghost, whose images are those of different particles, seldom does. The covariance is learned from
particles that stand alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.compiled import numba

_STEPS, _STILL = 12, 0.01  # of Newton's method, and the step whose next one is nothing
_LOW, _HIGH = -6.0, 4.0  # of the logarithms
_SPREAD = 0.2  # squared scatter between cameras, for the first guess
_CLIP = 0.97  # share of the particles that the covariance comes from
_OWN = 0.05  # error of the model of images, of a particle's light
_SHRINK = 20.0  # particles for each camera from which a covariance counts more than its average


def even_covariance(cameras: int, between: float, common: float) -> F64:
    """Make a covariance of equal scatter between cameras, and a common one."""
    return np.asarray(between**2 * np.eye(cameras) + common**2 * np.ones((cameras, cameras)))


def scatter_between(covariance: F64) -> float:
    """Compute the scatter of a camera's logarithm without what is common to all."""
    cameras = len(covariance)
    variance = np.trace(covariance) / cameras
    shared = (covariance.sum() - np.trace(covariance)) / max(cameras * (cameras - 1), 1)
    return math.sqrt(max(variance - shared, 0.0))


def learn_covariance(logarithms: F64) -> F64:
    """Learn the covariance of logarithms (n, camera) about their medians.

    The most unusual particles do not count, and few particles tell little more than the average
    variance and covariance.
    """
    off, cameras = logarithms - np.median(logarithms, axis=0), logarithms.shape[1]
    for _ in range(2):
        covariance = off.T @ off / len(off) + 1e-4 * np.eye(cameras)
        far = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
        off = off[far <= np.quantile(far, _CLIP)]
    covariance = off.T @ off / len(off)
    variance = np.trace(covariance) / cameras
    shared = (covariance.sum() - np.trace(covariance)) / max(cameras * (cameras - 1), 1)
    average = np.full((cameras, cameras), shared)
    np.fill_diagonal(average, variance)
    weight = _SHRINK * cameras / (_SHRINK * cameras + len(off))
    return np.asarray((1.0 - weight) * covariance + weight * average + _OWN**2 * np.eye(cameras))


@numba.njit(cache=True)
def guess_light(signal: Any, weight: Any, typical: Any, logs: Any) -> None:
    """Fill in logarithms (camera,) of one light that serves for all cameras.

    Parameters
    ----------
    signal, weight : (camera,) sums of weights times image times data, and times image squared; the
        data say light = signal / weight where the weight is not 0.
    typical : (camera,) a typical particle's light.
    """
    above, below = 0.0, 0.0
    for c in range(len(logs)):
        if weight[c] > 0.0:
            variance = 1.0 / weight[c] + _SPREAD * typical[c] ** 2
            above += signal[c] / weight[c] * typical[c] / variance
            below += typical[c] ** 2 / variance
    common = math.log(min(max(above / below, 0.05), 5.0)) if below > 0.0 else 0.0
    for c in range(len(logs)):
        logs[c] = common


@numba.njit(cache=True)
def light_cost(signal: Any, weight: Any, typical: Any, precision: Any, logs: Any) -> float:
    """Compute the cost of lights, minus the logarithm of their probability.

    It is relative to no light, without the constants of the normal distribution.
    """
    cost = 0.0
    for c in range(len(logs)):
        light = typical[c] * math.exp(logs[c])
        pull = 0.0
        for k in range(len(logs)):
            pull += precision[c, k] * logs[k]
        cost += light * (0.5 * light * weight[c] - signal[c]) + 0.5 * logs[c] * pull
    return cost


@numba.njit(cache=True)
def find_light(
    signal: Any, weight: Any, typical: Any, precision: Any, logs: Any, slope: Any, bend: Any
) -> float:
    """Improve logarithms (camera,) to the most probable ones by Newton's method.

    Returns their cost.

    Parameters
    ----------
    precision : (camera, camera) inverse of the covariance.
    slope, bend : (camera,) and (camera, camera), room to work in.
    """
    cameras = len(logs)
    for _ in range(_STEPS):
        for c in range(cameras):
            light = typical[c] * math.exp(logs[c])
            pull = 0.0
            for k in range(cameras):
                pull += precision[c, k] * logs[k]
                bend[c, k] = precision[c, k]
            square = light * light * weight[c]
            slope[c] = square - light * signal[c] + pull
            bend[c, c] += max(2.0 * square - light * signal[c], 0.5 * square)
        factorise(bend)
        _substitute(bend, slope)
        largest = 0.0
        for c in range(cameras):
            largest = max(largest, abs(slope[c]))
        share = min(1.0, 1.0 / max(largest, 1e-300))
        for c in range(cameras):
            logs[c] = min(max(logs[c] - share * slope[c], _LOW), _HIGH)
        if largest < _STILL:
            break
    return float(light_cost(signal, weight, typical, precision, logs))


@numba.njit(cache=True)
def factorise(matrix: Any) -> None:
    """Replace a positive definite matrix by its Cholesky factor."""
    for i in range(len(matrix)):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(value, 1e-12))
            else:
                matrix[i, j] = value / matrix[j, j]


@numba.njit(cache=True)
def log_determinant(factor: Any) -> float:
    """Compute the logarithm of the determinant of a factorised matrix."""
    total = 0.0
    for i in range(len(factor)):
        total += math.log(factor[i, i])
    return 2.0 * total


@numba.njit(cache=True)
def fill_inverse_diagonal(factor: Any, diagonal: Any, column: Any) -> None:
    """Fill in the diagonal (n,) of a factorised matrix's inverse.

    The column (n,) is room to work in.
    """
    count = len(factor)
    for k in range(count):
        diagonal[k] = 0.0
        for i in range(k, count):
            value = 1.0 if i == k else 0.0
            for j in range(k, i):
                value -= factor[i, j] * column[j]
            column[i] = value / factor[i, i]
            diagonal[k] += column[i] ** 2


@numba.njit(cache=True)
def _substitute(factor: Any, right: Any) -> None:
    """Replace the right side by the solution of a factorised system."""
    count = len(right)
    for i in range(count):
        value = right[i]
        for k in range(i):
            value -= factor[i, k] * right[k]
        right[i] = value / factor[i, i]
    for i in range(count - 1, -1, -1):
        value = right[i]
        for k in range(i + 1, count):
            value -= factor[k, i] * right[k]
        right[i] = value / factor[i, i]
