"""Bubbles fitted to all images simultaneously.

Light from behind several bubbles is dimmed by each of them. All bubbles together model the images
by the product of their transmissions. One bubble, a spheroid, is fitted while the others stay, by
Levenberg and Marquardt's method on the pixels around it in all views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.bubbles.backlit_profile import Profile
from sabench.algorithms.bubbles.ellipse_shadows import DIM, box_of, shade_at, slopes_at
from sabench.algorithms.bubbles.spheroids import images_of, linearise
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba

# of the parameters of a spheroid
_STEPS = np.array([1e-3, 1e-3, 5e-3, 1e-3, 1e-3, 2e-3, 2e-3])  # of differences
_PRIOR = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.15, 0.15])  # weight of the tilts: a ball has none
_ROBUST = 0.12  # transmission by which a pixel may be off before it counts less


@dataclass
class Model:
    """Images and the logarithm of the transmission of all bubbles so far.

    Images are (camera, row, column).
    """

    images: F32
    logs: F32
    cameras: Sequence[Camera]
    profile: Profile


def darken(model: Model, parameters: F64, sign: float) -> None:
    """Put a bubble into the model (1) or take it out (-1)."""
    ellipses = ellipses_of(model, parameters)
    _darken(model.logs, ellipses, model.profile.table, model.profile.blur_px, np.float32(sign))


def gain(model: Model, parameters: F64) -> F64:
    """Compute how much of a bubble's shadow is dark and not yet explained.

    Returns (camera,) from below 0 to 1; NaN out of view.
    """
    ellipses = ellipses_of(model, parameters)
    out = np.full(len(model.cameras), np.nan)
    _gains(model.images, model.logs, ellipses, model.profile.table, model.profile.blur_px, out)
    return out


def fit(model: Model, parameters: F64, steps: int) -> F64:
    """Fit the parameters of a bubble that is not in the model now."""
    linear = linearise(model.cameras, parameters[:3])
    best, damping = parameters.copy(), 1e-2
    value, normal, slope = _normal_equations(model, linear, best)
    for _ in range(steps):
        try:
            change = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), -slope)
        except np.linalg.LinAlgError:
            break
        tried = best + np.clip(change, -0.5, 0.5)
        tried[3:5] = np.clip(tried[3:5], np.log(0.02), np.log(20.0))
        tried[4] = min(tried[4], tried[3])
        tried[5:] = np.clip(tried[5:], -1.3, 1.3)
        there = _normal_equations(model, linear, tried)
        if there[0] < value:
            moved = float(np.abs(tried - best).max())
            best, (value, normal, slope), damping = tried, there, damping * 0.2
            if moved < 1e-3:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    return best


def unexplained(model: Model, ellipses: F64) -> float:
    """Compute the robust sum of squares of the residuals around images (camera, 5)."""
    return float(_robust_residual(model.images, model.logs, ellipses, model.profile.blur_px))


def ellipses_of(model: Model, parameters: F64) -> F64:
    """Compute a bubble's images (camera, 5), as from `images_of`."""
    return images_of(linearise(model.cameras, parameters[:3]), parameters)


def misfit(model: Model, parameters: F64) -> float:
    """Compute the mean square unexplained by a bubble over the pixels around it.

    The result is the median over the views, since other bubbles are in front of it in some.
    """
    ellipses = ellipses_of(model, parameters)
    out = np.full(len(model.cameras), np.nan)
    _squares(model.images, model.logs, ellipses, model.profile.table, model.profile.blur_px, out)
    return float(np.nanmedian(out)) if np.isfinite(out).any() else float("inf")


def _normal_equations(
    model: Model, linear: tuple[F64, F64, F64], parameters: F64
) -> tuple[float, F64, F64]:
    """Compute the robust sum of squares and its normal equations."""
    ellipses = images_of(linear, np.vstack([parameters, parameters + np.diag(_STEPS)]))
    normal, slope = np.zeros((len(parameters), len(parameters))), np.zeros(len(parameters))
    value = _normal(
        model.images,
        model.logs,
        ellipses,
        model.profile.table,
        model.profile.blur_px,
        _STEPS,
        normal,
        slope,
    )
    weight = _PRIOR**2
    return (
        value + float(np.sum(weight * parameters**2)),
        normal + np.diag(weight),
        slope + weight * parameters,
    )


@numba.njit(cache=True, error_model="numpy")
def _darken(logs: Any, ellipses: Any, table: Any, blur: float, sign: Any) -> None:
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0]):
            continue
        top, bottom, left, right, middle = box_of(ellipses[k], logs.shape[1:], blur)
        for row in range(top, bottom):
            for column in range(left, right):
                logs[k, row, column] += sign * np.float32(
                    np.log(max(shade_at(ellipses[k], column, row, middle, table, blur), DIM))
                )


@numba.njit(cache=True, error_model="numpy")
def _gains(images: Any, logs: Any, ellipses: Any, table: Any, blur: float, out: Any) -> None:
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0]):
            continue
        top, bottom, left, right, middle = box_of(ellipses[k], logs.shape[1:], blur)
        better = most = 0.0
        for row in range(top, bottom):
            for column in range(left, right):
                shade = max(shade_at(ellipses[k], column, row, middle, table, blur), DIM)
                behind = np.exp(logs[k, row, column])
                without = abs(images[k, row, column] - behind)
                with_it = abs(images[k, row, column] - behind * shade)
                better += without - with_it
                most += 1.0 - shade
        if most > 0.0 and bottom > top and right > left:
            out[k] = better / most


@numba.njit(cache=True, error_model="numpy")
def _robust_residual(images: Any, logs: Any, ellipses: Any, blur: float) -> Any:
    total = 0.0
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0]):
            continue
        top, bottom, left, right, _ = box_of(ellipses[k], logs.shape[1:], blur)
        for row in range(top, bottom):
            for column in range(left, right):
                off = np.exp(logs[k, row, column]) - images[k, row, column]
                total += off * off / (1.0 + (off / _ROBUST) ** 2)
    return total


@numba.njit(cache=True, error_model="numpy")
def _squares(images: Any, logs: Any, ellipses: Any, table: Any, blur: float, out: Any) -> None:
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0]):
            continue
        top, bottom, left, right, middle = box_of(ellipses[k], logs.shape[1:], blur)
        total = 0.0
        for row in range(top, bottom):
            for column in range(left, right):
                here = np.exp(logs[k, row, column]) * max(
                    shade_at(ellipses[k], column, row, middle, table, blur), DIM
                )
                total += (images[k, row, column] - here) ** 2
        if bottom > top and right > left:
            out[k] = total / ((bottom - top) * (right - left))


@numba.njit(cache=True, error_model="numpy")
def _normal(
    images: Any,
    logs: Any,
    ellipses: Any,
    table: Any,
    blur: float,
    steps: Any,
    normal: Any,
    slope: Any,
) -> Any:
    """Sum over views and pixels of Geman and McClure's function of the residuals.

    The weights of the normal equations are those of this function.
    """
    count = len(steps)
    change, own, moves = np.empty(count), np.empty(5), np.empty((count, 5))
    value = 0.0
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0, 0]):
            continue
        for i in range(count):
            for j in range(5):
                moves[i, j] = (ellipses[k, i + 1, j] - ellipses[k, 0, j]) / steps[i]
        top, bottom, left, right, middle = box_of(ellipses[k, 0], logs.shape[1:], blur)
        for row in range(top, bottom):
            for column in range(left, right):
                behind = np.exp(logs[k, row, column])
                here = behind * slopes_at(ellipses[k, 0], column, row, middle, table, blur, own)
                off = here - images[k, row, column]
                scale = 1.0 + (off / _ROBUST) ** 2
                value += off * off / scale
                weight = 1.0 / (scale * scale)
                for i in range(count):
                    change[i] = 0.0
                    for j in range(5):
                        change[i] += behind * own[j] * moves[i, j]
                for i in range(count):
                    slope[i] += weight * change[i] * off
                    for j in range(i + 1):
                        normal[i, j] += weight * change[i] * change[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return value
