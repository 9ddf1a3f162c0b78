"""Fit of spheroids to the shadows of bubbles in all images simultaneously.

Model. An image over its background is the product of all bubbles' transmissions: I_c(x) =
prod_b t(x; ellipse of b in camera c). The transmission t over the distance from the middle, in
radii, is a table (`backlit_images.Profile`): geometrical optics of a ball before a diffuser of some
half angle, blurred by lens and pixel.

Parameters of a spheroid are x, y, z of its centre, the logarithms of the long and of the short
semi-axis, and the tilts of the short axis about z and about x. Its image is an ellipse, since a
camera is almost linear over so small an object: column and row of the centre, and the inverse of
the shape matrix as xx, xy, yy.

Cost. Over the pixels around a bubble in all views, with r = model - image: sum of
r^2 / (1 + (r / 0.12)^2), Geman and McClure's function, which other bubbles' shadows change little,
plus (0.15 tilt)^2 for each tilt, which a ball does not show.

Course (`search`). Hypotheses are balls with outlines that most views vote for. The diffuser's angle
is the one that fits the largest of them best. In the order of vote times radius each is fitted
while the others stay, by Levenberg and Marquardt's method, and accepted if its radius is within
the limits and its gain is large enough: the median over the views of the darkness that it explains
and no other bubble does, over all of its darkness. Accepted bubbles darken the model for those that
follow. Small bubbles along a rim are replaced by one that explains the images as well, and all are
fitted again, `sweeps` times; those that the others explain by now are dropped.

Stopping. A fit ends when no parameter moves by more than 1e-3, or after its steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.bubbles.backlit_images import DIM, LARGEST, SMALLEST, Profile
from sabench.geometry.camera import Camera
from sabench.geometry.grid import REACH
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba

_MARGIN = 2.5  # px around a bubble that are looked at


@inner_kernel(error_model="numpy")
def _shade(table: Any, blur: float, distance: float, part: float) -> Any:
    """Interpolate transmission at a distance in px, a part of the radius."""
    radius = distance / part if part > 1e-9 else 1e9
    radius = min(max(radius, SMALLEST), LARGEST)
    across = distance / (radius + REACH * blur) * (table.shape[1] - 1)
    if across >= table.shape[1] - 1:
        return 1.0
    position = np.log(radius / SMALLEST) / np.log(LARGEST / SMALLEST) * (table.shape[0] - 1)
    i, j = min(int(position), table.shape[0] - 2), int(across)
    u, v = position - i, across - j
    upper = table[i, j] * (1.0 - v) + table[i, j + 1] * v
    lower = table[i + 1, j] * (1.0 - v) + table[i + 1, j + 1] * v
    return upper * (1.0 - u) + lower * u


@inner_kernel(error_model="numpy")
def shade_at(ellipse: Any, column: int, row: int, middle: float, table: Any, blur: float) -> Any:
    """Compute the transmission at a pixel; `middle` is the mean radius, px."""
    x, y = column - ellipse[0], row - ellipse[1]
    distance = np.sqrt(x * x + y * y)
    part = np.sqrt(max(ellipse[2] * x * x + 2.0 * ellipse[3] * x * y + ellipse[4] * y * y, 0.0))
    if distance < 1e-6:
        return (
            _shade(table, blur, 0.0, 0.0)
            if middle <= 0.0
            else _shade(table, blur, 1e-6 * middle, 1e-6)
        )
    return _shade(table, blur, distance, part)


@inner_kernel(error_model="numpy")
def slopes_at(
    ellipse: Any, column: int, row: int, middle: float, table: Any, blur: float, out: Any
) -> Any:
    """Compute the transmission at a pixel, at least `DIM`, and its derivatives."""
    out[:] = 0.0
    here = shade_at(ellipse, column, row, middle, table, blur)
    x, y = column - ellipse[0], row - ellipse[1]
    distance = np.sqrt(x * x + y * y)
    part = np.sqrt(max(ellipse[2] * x * x + 2.0 * ellipse[3] * x * y + ellipse[4] * y * y, 0.0))
    if here <= DIM or distance < 1e-6 or part <= 1e-9:
        return max(here, DIM)
    free = distance / part
    radius = min(max(free, SMALLEST), LARGEST)
    reach, most = radius + REACH * blur, table.shape[1] - 1
    across = distance / reach * most
    if across >= most:
        return here
    rate = (table.shape[0] - 1) / np.log(LARGEST / SMALLEST)
    position = np.log(radius / SMALLEST) * rate
    i, j = min(int(position), table.shape[0] - 2), int(across)
    u, v = position - i, across - j
    by_across = (table[i, j + 1] - table[i, j]) * (1.0 - u) + (
        table[i + 1, j + 1] - table[i + 1, j]
    ) * u
    by_position = (table[i + 1, j] - table[i, j]) * (1.0 - v) + (
        table[i + 1, j + 1] - table[i, j + 1]
    ) * v
    by_radius = by_position * rate / radius - by_across * across / reach if radius == free else 0.0
    by_distance = by_across * most / reach + by_radius / part
    by_part = -by_radius * distance / (part * part)
    out[0] = -by_distance * x / distance - by_part * (ellipse[2] * x + ellipse[3] * y) / part
    out[1] = -by_distance * y / distance - by_part * (ellipse[3] * x + ellipse[4] * y) / part
    out[2] = by_part * x * x / (2.0 * part)
    out[3] = by_part * x * y / part
    out[4] = by_part * y * y / (2.0 * part)
    return here


@inner_kernel(error_model="numpy")
def box_of(ellipse: Any, shape: Any, blur: float) -> Any:
    """Find the rows and columns that an ellipse's image reaches, and its mean radius."""
    determinant = ellipse[2] * ellipse[4] - ellipse[3] * ellipse[3]
    width, height = np.sqrt(ellipse[4] / determinant), np.sqrt(ellipse[2] / determinant)
    margin = REACH * blur + _MARGIN
    top = int(max(np.floor(ellipse[1] - height - margin), 0))
    bottom = int(min(np.ceil(ellipse[1] + height + margin) + 1, shape[0]))
    left = int(max(np.floor(ellipse[0] - width - margin), 0))
    right = int(min(np.ceil(ellipse[0] + width + margin) + 1, shape[1]))
    return top, bottom, left, right, determinant**-0.25


def start_of(center_mm: F64, radius_mm: float, aspect: float = 1.0) -> F64:
    """Return parameters of a ball, or of a spheroid that lies flat."""
    return np.array([*center_mm, np.log(radius_mm), np.log(aspect * radius_mm), 0.0, 0.0])


def turn_of(parameters: F64) -> F64:
    """Return the rotation (..., 3, 3) from the world to the axes of bubbles (..., 7).

    The second row is the short axis.
    """
    a, b = parameters[..., 5], parameters[..., 6]
    x, y, z = np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b), np.sin(b)
    length = np.hypot(x, y)
    right, ahead, level = y / length, -x / length, np.zeros_like(x)
    rows = [right, ahead, level, x, y, z, ahead * z, -right * z, right * y - ahead * x]
    return np.stack(rows, axis=-1).reshape(*x.shape, 3, 3)


def semi_axes_of(parameters: F64) -> F64:
    """Compute the semi-axes (..., 3) along the rows of `turn_of`."""
    long, short = np.exp(parameters[..., 3]), np.exp(parameters[..., 4])
    return np.stack([long, short, long], axis=-1)


def images_of(linear: tuple[F64, F64, F64], parameters: F64) -> F64:
    """Compute the ellipses (camera, ..., 5) of bubbles (..., 7).

    Parameters
    ----------
    linear : from `linearise`: a position, its pixels (camera, 2) and their derivatives (camera, 2,
        3).
    """
    position, pixels, jacobians = linear
    among = parameters.ndim - 1
    pixels = pixels.reshape(-1, *(1,) * among, 2)
    jacobians = jacobians.reshape(-1, *(1,) * among, 2, 3)
    rotation, axes = turn_of(parameters), semi_axes_of(parameters)
    half = jacobians @ (rotation.swapaxes(-1, -2) * axes[..., None, :])  # (camera, ..., 2, 3)
    xx, yy = np.sum(half[..., 0, :] ** 2, axis=-1), np.sum(half[..., 1, :] ** 2, axis=-1)
    xy = np.sum(half[..., 0, :] * half[..., 1, :], axis=-1)
    out = np.empty((*half.shape[:-2], 5))
    offset = parameters[..., :3] - position
    out[..., :2] = pixels + np.sum(jacobians * offset[..., None, :], axis=-1)
    determinant = xx * yy - xy**2
    out[..., 2], out[..., 3], out[..., 4] = yy / determinant, -xy / determinant, xx / determinant
    return out


def linearise(cameras: Sequence[Camera], position: F64) -> tuple[F64, F64, F64]:
    """Linearise every camera around a position."""
    step = 0.05
    points = np.vstack([position, position + step * np.eye(3), position - step * np.eye(3)])
    pixels = np.stack([camera.project(points)[0] for camera in cameras])
    jacobians = (pixels[:, 1:4] - pixels[:, 4:7]).transpose(0, 2, 1) / (2.0 * step)
    return position.copy(), pixels[:, 0], np.asarray(jacobians)


_STEP = np.sqrt(np.finfo(np.float64).eps)  # of differences that give derivatives of ellipses
_PRIOR = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.15, 0.15])  # weight of the tilts: a ball has none
_ROBUST = 0.12  # transmission: pixels with larger errors count less


@dataclass
class RimModel:
    """Images (camera, row, column), and the log of all bubbles' transmission."""

    images: F32
    logs: F32
    cameras: Sequence[Camera]
    profile: Profile


def darken(model: RimModel, parameters: F64, sign: float) -> None:
    """Put a bubble into the model (1) or take it out (-1)."""
    ellipses = ellipses_of(model, parameters)
    _darken(model.logs, ellipses, model.profile.table, model.profile.blur_px, np.float32(sign))


def gain(model: RimModel, parameters: F64) -> F64:
    """Compute the unexplained dark share (camera,) of a shadow, or NaN."""
    ellipses = ellipses_of(model, parameters)
    out = np.full(len(model.cameras), np.nan)
    _gains(model.images, model.logs, ellipses, model.profile.table, model.profile.blur_px, out)
    return out


def fit_bubble(model: RimModel, parameters: F64, steps: int) -> F64:
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
        equations = _normal_equations(model, linear, tried)
        if equations[0] < value:
            moved = float(np.abs(tried - best).max())
            best, (value, normal, slope), damping = tried, equations, damping * 0.2
            if moved < 1e-3:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    return best


def unexplained(model: RimModel, ellipses: F64) -> float:
    """Compute the robust sum of squares of the residuals around images (camera, 5)."""
    return float(_robust_residual(model.images, model.logs, ellipses, model.profile.blur_px))


def ellipses_of(model: RimModel, parameters: F64) -> F64:
    """Compute a bubble's images (camera, 5), as from `images_of`."""
    return images_of(linearise(model.cameras, parameters[:3]), parameters)


def misfit(model: RimModel, parameters: F64) -> float:
    """Compute the mean square unexplained by a bubble over the pixels around it."""
    ellipses = ellipses_of(model, parameters)
    out = np.full(len(model.cameras), np.nan)
    _squares(model.images, model.logs, ellipses, model.profile.table, model.profile.blur_px, out)
    # the median over the views: in some of them other bubbles are in front
    return float(np.nanmedian(out)) if np.isfinite(out).any() else float("inf")


def _normal_equations(
    model: RimModel, linear: tuple[F64, F64, F64], parameters: F64
) -> tuple[float, F64, F64]:
    """Compute the robust sum of squares and its normal equations."""
    ellipses = images_of(linear, np.vstack([parameters, parameters + _STEP * np.eye(7)]))
    normal, slope = np.zeros((len(parameters), len(parameters))), np.zeros(len(parameters))
    table, blur_px = model.profile.table, model.profile.blur_px
    value = _normal(model.images, model.logs, ellipses, table, blur_px, normal, slope)
    weight = _PRIOR**2
    value += float(np.sum(weight * parameters**2))
    return value, normal + np.diag(weight), slope + weight * parameters


@numba.njit(cache=True, error_model="numpy")
def _darken(logs: Any, ellipses: Any, table: Any, blur: float, sign: Any) -> None:
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0]):
            continue
        top, bottom, left, right, middle = box_of(ellipses[k], logs.shape[1:], blur)
        for row in range(top, bottom):
            for column in range(left, right):
                shade = max(shade_at(ellipses[k], column, row, middle, table, blur), DIM)
                logs[k, row, column] += sign * np.float32(np.log(shade))


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
                shade = max(shade_at(ellipses[k], column, row, middle, table, blur), DIM)
                total += (images[k, row, column] - np.exp(logs[k, row, column]) * shade) ** 2
        if bottom > top and right > left:
            out[k] = total / ((bottom - top) * (right - left))


@numba.njit(cache=True, error_model="numpy")
def _normal(
    images: Any, logs: Any, ellipses: Any, table: Any, blur: float, normal: Any, slope: Any
) -> Any:
    """Sum Geman and McClure's function of the residuals, and its normal equations."""
    count = len(slope)
    change, partial, moves = np.empty(count), np.empty(5), np.empty((count, 5))
    value = 0.0
    for k in range(len(ellipses)):
        if np.isnan(ellipses[k, 0, 0]):
            continue
        for i in range(count):
            for j in range(5):
                moves[i, j] = (ellipses[k, i + 1, j] - ellipses[k, 0, j]) / _STEP
        top, bottom, left, right, middle = box_of(ellipses[k, 0], logs.shape[1:], blur)
        for row in range(top, bottom):
            for column in range(left, right):
                behind = np.exp(logs[k, row, column])
                here = behind * slopes_at(ellipses[k, 0], column, row, middle, table, blur, partial)
                off = here - images[k, row, column]
                scale = 1.0 + (off / _ROBUST) ** 2
                value += off * off / scale
                weight = 1.0 / (scale * scale)
                for i in range(count):
                    change[i] = 0.0
                    for j in range(5):
                        change[i] += behind * partial[j] * moves[i, j]
                for i in range(count):
                    slope[i] += weight * change[i] * off
                    for j in range(i + 1):
                        normal[i, j] += weight * change[i] * change[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return value
