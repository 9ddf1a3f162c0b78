"""Light paths from particles to a camera, and what the lens gathers along them.

The lens is a round aperture. Moving the pinhole over it gives, through the wall, the directions in
which light must leave a particle to pass it: the spread of these directions is the solid angle of
the lens, the spread of the pixels is the defocus.

All but the pixel changes slowly over a volume. For many particles it is interpolated between the
exact paths of a lattice of Chebyshev's points in a box, and only the pixel is exact.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.lens import UPRIGHT, onto_sensor
from sabench.geometry.refraction import trace_to_points, transmittance
from sabench.utils.arrays import F64, I64, Bool, in_box
from sabench.utils.compiled import numba

_CHUNK, _BLOCK = 8192, 256  # points at a time: of exact paths, and of polynomials
_DEGREES = (4, 6, 8, 11)  # of polynomials over a box, tried in this order
_EXACT = 1e-7  # of a quantity's largest value: error of its polynomial that counts as none
_CHECKS = 200  # points at which it is compared with exact paths
_LEAST_BLUR_PX2 = 0.01  # of images: an error of it is compared with no less


@dataclass(frozen=True)
class LightPaths:
    """Light paths from n points to one camera.

    Attributes
    ----------
    pixel, valid : (n, 2) column and row; (n,) whether light reaches the camera.
    leaving, arriving : (n, 3) unit directions away from the camera, at its pinhole and at the
        point.
    half_angle, solid_angle : (n,) of the lens as the point sees it, rad and sr.
    blur_px2 : (n, 3) variances of defocus along columns and rows, and their covariance: the image
        moves in proportion as the pinhole moves over the aperture, and over a disc of radius 1 each
        coordinate has the variance 1/4.
    magnification : (n,) px/mm, mean over the directions across the path.
    passed : (n,) share of the light that passes the wall.
    """

    pixel: F64
    valid: Bool
    leaving: F64
    arriving: F64
    half_angle: F64
    solid_angle: F64
    blur_px2: F64
    magnification: F64
    passed: F64


SMOOTH = {  # all but the pixel, and their columns in a table
    "leaving": 3,
    "arriving": 3,
    "half_angle": 1,
    "solid_angle": 1,
    "blur_px2": 3,
    "magnification": 1,
    "passed": 1,
}
_ENDS = dict(zip(SMOOTH, itertools.accumulate(SMOOTH.values()), strict=True))

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def find_paths(camera: Camera, points_mm: F64, box: Box | None = None) -> LightPaths:
    """Find the light paths from points (n, 3) to a camera.

    Parameters
    ----------
    box : least and largest coordinates between which paths are interpolated, to 1e-7, if they can
        be. Others are exact, as all are without a box.
    """
    smooth = None if box is None else _interpolate(camera, box)
    if box is None or smooth is None:
        return _find_exactly(camera, points_mm)
    low, high = np.asarray(box)
    inside = in_box(points_mm, low, high)
    pixel, valid = camera.project(points_mm)
    table = np.empty((len(smooth.coefficients), len(points_mm)))
    _evaluate(points_mm, low, high, smooth.terms, smooth.coefficients, table)
    paths = LightPaths(pixel, valid, *_columns(table))
    return (
        paths
        if inside.all()
        else _replace(paths, ~inside, _find_exactly(camera, points_mm[~inside]))
    )


def object_steps(camera: Camera, points_mm: F64, direction: F64) -> F64:
    """Compute the shifts (n, 2, 3) of points, mm, that move their images by a pixel.

    Along columns and rows; they lie across the light paths, of which the directions (n, 3) are
    given.
    """
    steps: F64 = _apply_in_chunks(_object_shape, camera, points_mm, direction)[1]
    return steps


def _find_exactly(camera: Camera, points_mm: F64) -> LightPaths:
    return LightPaths(*_apply_in_chunks(_see, camera, points_mm))


def _replace(paths: LightPaths, rows: Bool, others: LightPaths) -> LightPaths:
    """Replace the paths of some rows by others."""
    changed = {name: value.copy() for name, value in vars(paths).items()}
    for name, value in changed.items():
        value[rows] = getattr(others, name)
    return LightPaths(**changed)


@dataclass(frozen=True)
class _Smooth:
    """Polynomials over a box: degrees (term, 3), and coefficients (quantity, term)."""

    terms: I64
    coefficients: F64


@functools.lru_cache(maxsize=256)
def _interpolate(camera: Camera, box: Box) -> _Smooth | None:
    """Fit polynomials to all that changes slowly; None where no degree will do.

    A volume that light reaches in part, such as one cut by a face, has no polynomials.
    """
    low, high = np.asarray(box)
    places = np.random.default_rng(0).uniform(-1.0, 1.0, (_CHECKS, 3))
    exact = _find_exactly(camera, low + 0.5 * (places + 1.0) * (high - low))
    if not exact.valid.all():
        return None
    truth = _table(exact)
    scale = np.abs(truth).max(axis=0)
    blur = slice(_ENDS["blur_px2"] - SMOOTH["blur_px2"], _ENDS["blur_px2"])
    scale[blur] = max(float(scale[blur].max()), _LEAST_BLUR_PX2)
    for degree in _DEGREES:
        if (every := _fit(camera, low, high, degree)) is None:
            return None
        sizes = np.abs(every.coefficients) / scale[:, None]
        rising = np.argsort(sizes.max(axis=0))
        together = np.cumsum(sizes[:, rising], axis=1).max(axis=0)
        kept = np.sort(rising[together > _EXACT / 2.0])
        smooth = _Smooth(every.terms[kept], np.ascontiguousarray(every.coefficients[:, kept]))
        found = np.empty((truth.shape[1], len(truth)))
        _evaluate(places, -np.ones(3), np.ones(3), smooth.terms, smooth.coefficients, found)
        if (np.abs(found.T - truth).max(axis=0) <= _EXACT * scale).all():
            return smooth
    return None


def _fit(camera: Camera, low: F64, high: F64, degree: int) -> _Smooth | None:
    """Interpolate exact paths at Chebyshev's points; None if one has no path."""
    count = degree + 1
    angles = np.pi * (np.arange(count) + 0.5) / count
    nodes = np.stack(np.meshgrid(*[np.cos(angles)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    paths = _find_exactly(camera, low + 0.5 * (nodes + 1.0) * (high - low))
    if not paths.valid.all():
        return None
    values = _table(paths).reshape(count, count, count, -1)
    basis = np.cos(np.outer(np.arange(count), angles)) * 2.0 / count
    basis[0] *= 0.5
    weights = np.einsum("ai,bj,ck,ijkq->abcq", basis, basis, basis, values, optimize=True)
    every = itertools.product(range(count), repeat=3)
    terms = np.array([term for term in every if sum(term) <= degree])
    return _Smooth(terms, np.ascontiguousarray(weights[tuple(terms.T)].T))


def _table(paths: LightPaths) -> F64:
    """Collect the slow quantities of n paths, (n, quantity)."""
    return np.column_stack([getattr(paths, name) for name in SMOOTH])


def _columns(table: F64) -> list[F64]:
    """Take a table (quantity, n) apart, in the order of `LightPaths`."""
    parts = [table[end - SMOOTH[name] : end] for name, end in _ENDS.items()]
    return [part.T if len(part) > 1 else part[0] for part in parts]


@numba.njit(cache=True, parallel=True)
def _evaluate(points: Any, low: Any, high: Any, terms: Any, coefficients: Any, out: Any) -> None:
    """Fill in polynomials (quantity, n), in Chebyshev's basis, at points (n, 3)."""
    for block in numba.prange((len(points) + _BLOCK - 1) // _BLOCK):
        _evaluate_block(points, block * _BLOCK, low, high, terms, coefficients, out)


@numba.njit(cache=True, fastmath={"contract", "nsz"})
def _evaluate_block(
    points: Any, first: int, low: Any, high: Any, terms: Any, coefficients: Any, out: Any
) -> None:
    degree, count, size = max(terms.max(), 1), len(terms), min(_BLOCK, len(points) - first)
    powers, basis = np.ones((3, degree + 1, _BLOCK)), np.empty((count, _BLOCK))
    for a in range(3):
        scale = 2.0 / (high[a] - low[a])
        for n in range(size):
            powers[a, 1, n] = (points[first + n, a] - low[a]) * scale - 1.0
        for k in range(2, degree + 1):
            for n in range(_BLOCK):
                twice = 2.0 * powers[a, 1, n]
                powers[a, k, n] = twice * powers[a, k - 1, n] - powers[a, k - 2, n]
    for t in range(count):
        x, y, z = powers[0, terms[t, 0]], powers[1, terms[t, 1]], powers[2, terms[t, 2]]
        for n in range(_BLOCK):
            basis[t, n] = x[n] * y[n] * z[n]
    found = np.dot(coefficients, basis)
    for q in range(len(out)):
        for n in range(size):  # numba takes 2 s to compile the assignment of a part of an array
            out[q, first + n] = found[q, n]


def _apply_in_chunks(
    function: Callable[..., tuple[F64 | Bool, ...]], camera: Camera, *points: F64
) -> list[Any]:
    """Apply a function of points (n, 3) chunk by chunk.

    What lies between its steps then stays in the cache: three times as fast for many points.
    """
    chunks = [
        function(camera, *(each[first : first + _CHUNK] for each in points))
        for first in range(0, max(len(points[0]), 1), _CHUNK)
    ]
    return [np.concatenate(parts) for parts in zip(*chunks, strict=True)]


def _see(camera: Camera, points: F64) -> tuple[F64 | Bool, ...]:
    """Find exact paths, in the order of the attributes of `LightPaths`."""
    pinhole = np.asarray(camera.center_mm)
    paths = trace_to_points(camera.wall, pinhole, points)
    pixel, valid = camera.pixels_of(paths.leaving, paths.valid)
    half, blur, solid = _through_aperture(camera, points, paths.arriving)
    magnification, _ = _object_shape(camera, points, paths.arriving)
    passed = transmittance(camera.wall, pinhole, paths.leaving)
    return pixel, valid, paths.leaving, paths.arriving, half, solid, blur, magnification, passed


def _through_aperture(camera: Camera, points: F64, chief: F64) -> tuple[F64, F64, F64]:
    """Compute half angle, defocus and solid angle at points, as `LightPaths` has."""
    radius = camera.aperture_radius_mm
    upright = replace(camera, tilt_deg=UPRIGHT)
    rotations, smears = [], []
    for axis, (right, down) in enumerate(((radius, 0.0), (0.0, radius))):
        ends = []
        for sign in (1.0, -1.0):
            moved = upright.shifted(sign * right, sign * down)
            paths = trace_to_points(moved.wall, np.asarray(moved.center_mm), points)
            ends.append((paths.arriving, moved.pixels_of(paths.leaving, paths.valid)[0]))
        rotations.append((ends[0][0] - ends[1][0]) / 2.0)
        smears.append(_smear(camera, axis, ends[0][1], ends[1][1]) / 4.0)
    solid_angle = np.pi * np.abs(np.einsum("ij,ij->i", np.cross(rotations[0], rotations[1]), chief))
    return (
        np.linalg.norm(rotations[0], axis=1),
        np.sum([smear[:, [0, 1, 0]] * smear[:, [0, 1, 1]] for smear in smears], axis=0),
        solid_angle,
    )


def _smear(camera: Camera, axis: int, first: F64, second: F64) -> F64:
    """Subtract places on the sensor (n, 2) of light through both ends of a lens.

    `first` and `second` are the pixels of upright cameras that are moved there, along `axis`. A
    point in focus would shift on their sensors, and is at rest on the true one.
    """
    radius = camera.aperture_radius_mm
    if camera.tilt_deg == UPRIGHT:
        smear = first - second
        smear[:, axis] += 2.0 * radius * camera.focal_px / camera.focus_mm
        return smear
    lens = np.zeros(2)
    lens[axis] = radius
    places = [
        onto_sensor(
            camera.tilt_deg,
            (pixel - np.asarray(camera.principal_point_px)) / camera.focal_px
            + sign * lens / camera.focus_mm,
            sign * lens / camera.principal_distance_mm,
        )[0]
        for sign, pixel in ((1.0, first), (-1.0, second))
    ]
    return (places[0] - places[1]) * camera.focal_px


def _object_shape(camera: Camera, points: F64, direction: F64) -> tuple[F64, F64]:
    """Compute magnification and the shifts that move the image by one pixel.

    In px/mm, mean over directions; shifts (n, 2, 3) lie across the light path.
    """
    step = 1e-3  # mm: far above float64's noise, far below any change of magnification
    # never along the path: a path in view is near the camera's Z axis
    first = np.cross(direction, camera.rotation[1])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    basis = np.stack([first, np.cross(direction, first)], axis=1)
    ends = [
        camera.project(points + sign * step * basis[:, i])[0]
        for i in (0, 1)
        for sign in (1.0, -1.0)
    ]
    jacobian = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=2) / (2.0 * step)
    determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        adjugate = np.stack(
            [jacobian[:, 1, 1], -jacobian[:, 0, 1], -jacobian[:, 1, 0], jacobian[:, 0, 0]], axis=1
        ).reshape(-1, 2, 2)
        inverse = adjugate / determinant[:, None, None]
    return np.sqrt(np.abs(determinant)), np.einsum("nba,nbk->nak", inverse, basis)
