"""Search for bubbles: hypotheses from the images, fitted and verified.

Outlines of one view are followed along their lines of sight, and searched for in all others. The
best hypotheses are fitted first, and the others are fitted to the darkness that is left.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.bubbles import rim_fit
from sabench.algorithms.bubbles.backlit_images import Profile
from sabench.algorithms.bubbles.ellipse_detection import Votes, peaks
from sabench.algorithms.bubbles.rim_fit import RimModel, darken, fit_bubble
from sabench.api import Detections
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.utils.arrays import F32, F64, triple
from sabench.utils.compiled import numba
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores


def viewing_axes(cameras: Sequence[Camera]) -> F64:
    """Choose the world's axes (3, 3) as x, y and z of the cameras, one a row.

    z is the axis along which they look, x of the other two that along which columns of their images
    grow, both on the average; x, y and z are right-handed. An array that looks along +Z and is
    upright keeps the world's axes.
    """
    means = np.mean([camera.rotation for camera in cameras], axis=0)
    z = int(np.argmax(np.abs(means[2])))
    x = int(np.argmax(np.where(np.arange(3) == z, -1.0, np.abs(means[0]))))
    axes = np.zeros((3, 3))
    axes[2, z] = 1.0 if means[2, z] >= 0.0 else -1.0
    axes[0, x] = 1.0 if means[0, x] >= 0.0 else -1.0
    axes[1] = np.cross(axes[2], axes[0])
    return axes


def turn_camera(camera: Camera, axes: F64) -> Camera:
    """Rewrite a camera and its wall for coordinates along axes (3, 3), one a row."""
    x, y, z = np.asarray(camera.rotation) @ axes.T
    wall = camera.wall
    keys = ("point_mm", "normal") if isinstance(wall, Wall) else ("axis_point_mm", "axis")
    turned: dict[str, Any] = {}
    if wall is not None:
        turned = {key: triple(axes @ np.asarray(getattr(wall, key))) for key in keys}
    return replace(
        camera,
        center_mm=triple(axes @ np.asarray(camera.center_mm)),
        rotation=(triple(x), triple(y), triple(z)),
        wall=None if wall is None else replace(wall, **turned),
    )


def turn_grid(grid: Grid, axes: F64) -> Grid:
    """Rewrite a grid for coordinates along axes (3, 3) as of `viewing_axes`."""
    order = np.abs(axes).argmax(axis=1)
    ends = np.array([(along[0], along[-1]) for along in grid.axes_mm])[order]
    low = (ends * axes.sum(axis=1)[:, None]).min(axis=1)
    x, y, z = (grid.shape[::-1][k] for k in order)
    voxel = np.asarray(grid.voxel_mm)[order]
    crop = [grid.crop[k] for k in order]
    return Grid(triple(low), triple(voxel), (z, y, x), (crop[0], crop[1], crop[2]))


_PLANE_MM = 0.25  # between positions along a line of sight, at most
_AGREE = 0.75  # of the cameras that see a position count: those with the most votes
_SPREAD = 0.8  # px: votes are smoothed, since projections miss the exact pixels of other views
# of the radius with the most votes: a blurred edge is steepest outside the rim of a small bubble
_INWARD = 0.93
_PER_LINE = 3  # positions along each line that are kept


@dataclass(frozen=True)
class Hypotheses:
    """Possible bubbles, the best first.

    Centres (n, 3), long semi-axes, mean votes, and short over long axes, each (n,).
    """

    center_mm: F64
    radius_mm: F64
    vote: F64
    aspect: F64


def find_hypotheses(
    cameras: Sequence[Camera], votes: Sequence[Votes], grid: Grid, least_2d: float, least_3d: float
) -> Hypotheses:
    """Find balls with outlines that most views vote for.

    Parameters
    ----------
    least_2d, least_3d : least votes in one view, and least mean votes of a hypothesis.
    """
    maps = np.empty((len(votes), *votes[0].maps.shape), dtype=np.float32)
    for smoothed, view in zip(maps, votes, strict=True):
        for out, votes_of_radius in zip(smoothed, view.maps, strict=True):
            cv2.GaussianBlur(votes_of_radius, (0, 0), _SPREAD, dst=out)
    parts = [
        _along_lines(number, cameras, votes, maps, grid, least_2d, least_3d)
        for number in range(len(cameras))
    ]
    center, radius, vote = map(np.concatenate, zip(*parts, strict=True))
    return _drop_duplicates(Hypotheses(center, radius, vote, np.full(len(vote), votes[0].aspect)))


def join_hypotheses(parts: Sequence[Hypotheses]) -> Hypotheses:
    """Join hypotheses of several aspects."""
    center, radius, vote, aspect = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("center_mm", "radius_mm", "vote", "aspect")
    )
    return _drop_duplicates(Hypotheses(center, radius, vote, aspect))


def _along_lines(
    number: int,
    cameras: Sequence[Camera],
    votes: Sequence[Votes],
    maps: F32,
    grid: Grid,
    least_2d: float,
    least_3d: float,
) -> tuple[F64, F64, F64]:
    """Find the best positions of one view's outlines."""
    outlines = peaks(votes[number], least_2d)
    rays = cameras[number].back_project(outlines[:, :2])
    outlines, starts = outlines[rays.valid], rays.origins_mm[rays.valid, None]
    directions = rays.directions[rays.valid, None]
    if not len(outlines):
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    z = grid.axes_mm[2]
    depths = np.arange(z[0] - 1.0, z[-1] + 1.0, min(_PLANE_MM, grid.voxel_mm[2] * 1.25))
    positions = starts + directions * ((depths - starts[..., 2]) / directions[..., 2])[..., None]
    points = positions.reshape(-1, 3)
    radius = (
        _INWARD * outlines[:, 2:3] / px_per_mm(cameras[number], points).reshape(positions.shape[:2])
    )
    total = np.full((len(cameras), *positions.shape[:2]), np.nan, dtype=np.float32)
    radii = votes[0].radii_px
    first, step = float(np.log(radii[0])), float(np.log(radii[1] / radii[0]))
    for camera, view, smoothed, out in zip(cameras, votes, maps, total, strict=True):
        pixels, valid = camera.project(points)
        good = valid & camera.contains(pixels)
        size = radius.ravel() / _INWARD * px_per_mm(camera, points)
        places, votes = view.map_pixels(pixels), out.reshape(-1)
        on_cores(_sample, len(votes), smoothed, places, good, size, first, step, votes)
    low, high = np.asarray(grid.low_mm), np.array([axis[-1] for axis in grid.axes_mm])
    across = positions[..., :2]
    inside = ((across >= low[:2] - 1.0) & (across <= high[:2] + 1.0)).all(axis=-1)
    score = np.where(inside, _average_agreeing(total), 0.0)
    before, after = np.roll(score, 1, axis=1), np.roll(score, -1, axis=1)
    peak = (score >= least_3d) & (score >= before) & (score > after)
    ranked = np.sort(np.where(peak, score, 0.0), axis=1)[:, -_PER_LINE]
    i, j = np.nonzero(peak & (score >= ranked[:, None]))
    return positions[i, j], radius[i, j], score[i, j].astype(np.float64)


def px_per_mm(camera: Camera, points_mm: F64) -> F64:
    """Compute pixels per mm across the line of sight at points (n, 3)."""
    step = 0.5
    across = step * np.array([1.0, 0.0, 0.0])
    ends = [camera.project(points_mm + sign * across)[0] for sign in (-1.0, 1.0)]
    return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=1) / (2.0 * step))


def _average_agreeing(total: F32) -> F32:
    """Average the votes of the cameras that agree most; two at least."""
    visible = np.isfinite(total)
    count = visible.sum(axis=0)
    used = np.maximum(2, np.round(_AGREE * count)).astype(np.int64)
    ranked = -np.sort(-np.where(visible, total, -1.0), axis=0)
    sums = np.cumsum(ranked, axis=0)
    mean = np.take_along_axis(sums, np.minimum(used, len(total))[None] - 1, axis=0)[0] / used
    return np.where(count >= 2, mean, 0.0).astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sample(
    jobs: slice, maps: Any, pixels: Any, good: Any, size: Any, first: float, step: float, out: Any
) -> None:
    """Sample votes at the nearest pixels, linearly over the radius."""
    count, rows, columns = maps.shape
    for n in range(jobs.start, jobs.stop):
        if not good[n]:
            continue
        column, row = int(np.floor(pixels[n, 0] + 0.5)), int(np.floor(pixels[n, 1] + 0.5))
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        position = min(max((np.log(size[n]) - first) / step, 0.0), count - 1.001)
        low = int(position)
        out[n] = maps[low, row, column] * (low + 1.0 - position) + maps[low + 1, row, column] * (
            position - low
        )


def _drop_duplicates(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the best of the hypotheses of each bubble.

    Hypotheses of one bubble are closer than half a radius across and two along, and have similar
    radii.
    """
    center, radius, vote = hypotheses.center_mm, hypotheses.radius_mm, hypotheses.vote
    if not len(vote):
        return hypotheses
    order = np.argsort(-vote, kind="stable")
    squeezed = center * [1.0, 1.0, 0.35]
    tree, alive, keep = cKDTree(squeezed), np.ones(len(vote), dtype=np.bool_), []
    for n in order:
        if not alive[n]:
            continue
        keep.append(n)
        near = np.array(tree.query_ball_point(squeezed[n], 0.6 * radius[n] + 0.1))
        alive[near[(radius[near] < 1.6 * radius[n]) & (radius[near] > radius[n] / 1.6)]] = False
    return Hypotheses(center[keep], radius[keep], vote[keep], hypotheses.aspect[keep])


_FIRST, _MORE = 8, 6  # steps of a fit
_ANGLES = np.deg2rad(np.geomspace(6.0, 70.0, 26))  # of the diffuser
_LIKELY = 0.7  # part of the most votes
_LARGEST = 32  # likely bubbles fitted for the diffuser's angle
_SURE = 0.75  # gain of what is fitted first
_WORTH = 0.25  # part of the least gain below which no fit is tried
_SMALLER = 0.75  # their radius over its radius
_SIMPLER = 0.1  # relative misfit allowed for each replaced bubble


class Limits(NamedTuple):
    """Conditions that a fit must meet to count as a bubble.

    Attributes
    ----------
    smallest_mm, largest_mm : radius of a ball of the same volume.
    least_gain : part of its shadow that must be dark and not explained by others, median over the
        views.
    """

    smallest_mm: float
    largest_mm: float
    least_gain: float


def search_bubbles(
    images: F32,
    cameras: Sequence[Camera],
    profile_of: Callable[[float], Profile],
    half_angle: float | None,
    start: Hypotheses,
    limits: Limits,
    sweeps: int,
) -> Detections:
    """Find bubbles that explain the dark parts of images (camera, row, column).

    Parameters
    ----------
    profile_of : profile of a bubble in front of a diffuser of a half angle (rad).
    half_angle : of the diffuser seen from the bubbles; None: the one that fits the largest bubbles
        best.
    limits : what is a bubble. A fit that becomes smaller is the rest of another bubble's shadow.
    sweeps : number of times that all bubbles are fitted again, each with the others in place.
    """
    if half_angle is None:
        half_angle = _fit_diffuser(images, cameras, profile_of, start)
    model = RimModel(images, np.zeros_like(images), cameras, profile_of(half_angle))
    bubbles = _unite(model, _accept(model, start, limits), start, limits)
    for _ in range(sweeps):
        bubbles = _refine(model, bubbles, limits)
    parameters = np.array(bubbles).reshape(-1, 7)
    return Detections(
        parameters[:, :3].copy(), rim_fit.semi_axes_of(parameters), rim_fit.turn_of(parameters)
    )


def _fit_diffuser(
    images: F32,
    cameras: Sequence[Camera],
    profile_of: Callable[[float], Profile],
    start: Hypotheses,
) -> float:
    """Find the diffuser's half angle that fits the largest likely bubbles.

    Each has an unknown noise, so that the likelihood goes with the logarithm of its misfit.
    """
    likely = np.flatnonzero(start.vote >= _LIKELY * start.vote.max(initial=0.0))
    chosen = likely[np.argsort(-start.radius_mm[likely], kind="stable")][:_LARGEST]
    costs = np.zeros((len(_ANGLES), len(chosen)))
    for row, angle in zip(costs, progress_bar(_ANGLES.tolist(), "find the diffuser"), strict=True):
        model = RimModel(images, np.zeros_like(images), cameras, profile_of(angle))
        row[:] = [
            rim_fit.misfit(model, fit_bubble(model, _start(start, n), _FIRST)) for n in chosen
        ]
    seen = np.isfinite(costs).all(axis=0)
    return float(_ANGLES[np.log(costs[:, seen]).sum(axis=1).argmin()])


def _accept(model: RimModel, start: Hypotheses, limits: Limits) -> list[F64]:
    """Fit and judge hypotheses in the order of their gains."""
    order = np.argsort(-start.vote * start.radius_mm, kind="stable")
    accepted: list[F64] = []
    # what is sure goes first: a large bubble before the small ones that its rim could be
    for least in (max(_SURE, limits.least_gain), limits.least_gain):
        for n in progress_bar(order.tolist(), "fit bubbles"):
            first = _start(start, n)
            if _median_gain(model, first) < _WORTH * least:
                continue
            fitted = fit_bubble(model, first, _FIRST)
            if _is_bubble(model, fitted, limits._replace(least_gain=least)):
                darken(model, fitted, 1.0)
                accepted.append(fitted)
    return accepted


def _unite(model: RimModel, bubbles: list[F64], start: Hypotheses, limits: Limits) -> list[F64]:
    """Replace small bubbles along a rim by one that explains images as well."""
    order = np.argsort(-start.radius_mm * start.aspect, kind="stable")
    for n in progress_bar(order.tolist(), "unite bubbles"):
        first = _start(start, n)
        parts = _parts(bubbles, first)
        if not parts:
            continue
        ellipses = rim_fit.ellipses_of(model, first)
        most = rim_fit.unexplained(model, ellipses) * (1.0 + _SIMPLER * (len(parts) - 1))
        for part in parts:
            darken(model, bubbles[part], -1.0)
        whole = fit_bubble(model, first, _FIRST)
        if _is_bubble(model, whole, limits) and set(_parts(bubbles, whole)) >= set(parts):
            darken(model, whole, 1.0)
            if rim_fit.unexplained(model, ellipses) < most:
                bubbles = [bubble for k, bubble in enumerate(bubbles) if k not in parts] + [whole]
                continue
            darken(model, whole, -1.0)
        for part in parts:
            darken(model, bubbles[part], 1.0)
    return bubbles


def _parts(bubbles: list[F64], whole: F64) -> list[int]:
    """List the smaller bubbles within an outline; none if a similar bubble exists."""
    if not bubbles:
        return []
    every = np.stack(bubbles)
    radius, outer = np.exp(every[:, 3:5]).max(axis=1), float(np.exp(whole[3]))
    across, along = np.linalg.norm(every[:, :2] - whole[:2], axis=1), np.abs(every[:, 2] - whole[2])
    if ((across < 0.5 * outer) & (along < 1.5 * outer) & (radius > _SMALLER * outer)).any():
        return []
    inside = (across < 1.05 * outer) & (along < 2.0 * outer)
    return np.flatnonzero(inside & (radius <= _SMALLER * outer)).tolist()


def _start(start: Hypotheses, n: int) -> F64:
    return rim_fit.start_of(start.center_mm[n], float(start.radius_mm[n]), float(start.aspect[n]))


def _is_bubble(model: RimModel, fitted: F64, limits: Limits) -> bool:
    """Return whether a fit has a bubble's size, by volume, and explains enough."""
    radius = float(np.exp((2.0 * fitted[3] + fitted[4]) / 3.0))
    right_size = limits.smallest_mm <= radius <= limits.largest_mm
    return right_size and _median_gain(model, fitted) >= limits.least_gain


def _median_gain(model: RimModel, parameters: F64) -> float:
    """Compute the median gain over two or more views of a bubble, or -1."""
    gains = rim_fit.gain(model, parameters)
    gains = gains[np.isfinite(gains)]
    return float(np.median(gains)) if len(gains) >= 2 else -1.0


def _refine(model: RimModel, bubbles: list[F64], limits: Limits) -> list[F64]:
    """Fit all bubbles again and drop those that the others explain by now."""
    out = []
    for parameters in progress_bar(bubbles, "refine bubbles"):
        darken(model, parameters, -1.0)
        better = fit_bubble(model, parameters, _MORE)
        if _is_bubble(model, better, limits):
            darken(model, better, 1.0)
            out.append(better)
    return out
