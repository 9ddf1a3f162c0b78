"""Detection of dark ellipses and circles in images of bubbles.

Ellipses: edges are located to a fraction of a pixel, and every two of them may be the ends of a
major axis; all others vote for its minor axis (Y. Xie and Q. Ji, A new efficient ellipse detection
method, ICPR 2002). Here edges must also have the direction of the ellipse's inward normals, which
leaves few pairs and excludes the inner edges of rings; an outline is judged by the part of it that
has edges.

Circles: a vote is the part of a circle around a pixel that is an edge from dark inside to bright
outside. The direction of the gradient counts and its strength hardly does, as in Loy and Zelinsky's
radial symmetry (IEEE PAMI 25, 2003): a faint bubble with a complete outline has more votes than one
strong edge.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba

_BIN = 0.5  # px: of minor axes in the accumulator
_OFF = 0.75  # px: of an edge from the outline that it belongs to
_ALONG = np.cos(np.deg2rad(25.0))  # of an edge's direction and the outline's normal
_FLANK = 0.9  # of the major semi-axis: edges nearer to its ends do not determine the minor one
_LEAST_PX = 1.2  # semi-axis
_FEWEST = 6  # edges of an outline
_FITS = 2


def compute_gradient(image: F32, border: int = cv2.BORDER_REPLICATE) -> tuple[F32, F32]:
    """Compute the derivatives of an image along columns and rows, per pixel."""
    right, down = (
        cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=0.125, borderType=border)
        for dx in (1, 0)
    )
    return np.asarray(right), np.asarray(down)


def find_edges(dark: F32, least: float) -> F64:
    """Find edges (n, 4) in an image of darkness.

    Columns are column and row to a fraction of a pixel, and unit vectors towards the dark. Edges
    are the maxima of the gradient's length along its direction, located by a parabola through it
    and its neighbours on both sides.

    Parameters
    ----------
    least : gradient per pixel that makes an edge.
    """
    if min(dark.shape) < 3:
        return np.zeros((0, 4))
    right, down = compute_gradient(dark)
    strength = cv2.magnitude(right, down)
    rows, columns = np.nonzero(strength > least)
    if not len(rows):
        return np.zeros((0, 4))
    here = strength[rows, columns]
    gx, gy = right[rows, columns] / here, down[rows, columns] / here
    before, after = (
        cv2.remap(
            strength,
            (columns + side * gx).astype(np.float32)[None],
            (rows + side * gy).astype(np.float32)[None],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )[0]
        for side in (-1.0, 1.0)
    )
    peak = (here >= before) & (here > after)
    offset = 0.5 * (before - after)[peak] / (before - 2.0 * here + after)[peak]
    gx, gy = gx[peak], gy[peak]
    edges = np.column_stack([columns[peak] + offset * gx, rows[peak] + offset * gy, gx, gy])
    return edges.astype(np.float64)


def find_ellipses(points: F64, largest: float, least_aspect: float, least_part: float) -> F64:
    """Find outlines (n, 6) from edges (m, 4), the best one first.

    Columns are column, row, semi-axes, angle of the longer one from X, part that has edges. An
    outline removes its edges from the others, as the largest value of an accumulator is removed
    before the next one is searched for.

    Parameters
    ----------
    largest : semi-axis in px.
    least_aspect : short over long axis.
    least_part : of an outline that must have edges.
    """
    out = []
    while len(points) >= _FEWEST:
        ellipse, part = _vote_for_ellipse(points, largest, least_aspect)
        if part < least_part:
            break
        for _ in range(_FITS):
            ellipse = _fit_ellipse(points[_belongs(points, ellipse, _OFF)], ellipse)
        part = _edge_coverage(points, ellipse)
        if part >= least_part and ellipse[3] >= least_aspect * ellipse[2]:
            out.append(np.append(ellipse, part))
        on_outline = _belongs(points, ellipse, 2.0 * _OFF)
        if not on_outline.any():
            break
        points = points[~on_outline]
    return np.array(out, dtype=np.float64).reshape(-1, 6)


def _fit_ellipse(points: F64, first: F64) -> F64:
    """Fit an ellipse to edges by least squares; `first` without a similar one."""
    if len(points) < _FEWEST:
        return first
    (x, y), (width, height), degrees = cv2.fitEllipseDirect(points[:, :2].astype(np.float32))
    angle = np.deg2rad(degrees) + (0.0 if width >= height else np.pi / 2.0)
    fitted = np.array([x, y, max(width, height) / 2.0, min(width, height) / 2.0, angle])
    similar = np.abs(fitted[:4] - first[:4]).max() <= max(1.0, 0.3 * first[2])
    return fitted if np.isfinite(fitted).all() and similar and fitted[3] >= _LEAST_PX else first


@inner_kernel(error_model="numpy")
def _relation(points: Any, ellipse: Any) -> Any:
    """Compute distances of edges from an ellipse, cosines, eccentric angles."""
    x, y, a, b, angle = ellipse
    cosine, sine = np.cos(angle), np.sin(angle)
    out = np.empty((3, len(points)))
    for k in range(len(points)):
        dx, dy, gx, gy = points[k, 0] - x, points[k, 1] - y, points[k, 2], points[k, 3]
        u, w = dx * cosine + dy * sine, dy * cosine - dx * sine
        nu, nw = u / a**2, w / b**2
        length = max(np.hypot(nu, nw), 1e-12)
        part = np.hypot(u / a, w / b)
        out[0, k] = (part - 1.0) * part / length
        out[1, k] = -((gx * cosine + gy * sine) * nu + (gy * cosine - gx * sine) * nw) / length
        out[2, k] = np.arctan2(w / b, u / a)
    return out


@numba.njit(cache=True, error_model="numpy")
def _belongs(points: Any, ellipse: Any, off: float) -> Any:
    """Mark edges that are close to an ellipse and look inwards."""
    relation = _relation(points, ellipse)
    return (np.abs(relation[0]) <= off) & (relation[1] >= _ALONG)


@numba.njit(cache=True, error_model="numpy")
def _edge_coverage(points: Any, ellipse: Any) -> float:
    """Compute the part of an outline, in steps of about a pixel, that has edges."""
    a, b = ellipse[2], ellipse[3]
    steps = max(
        8, int(np.rint(np.pi * (3.0 * (a + b) - np.sqrt((3.0 * a + b) * (a + 3.0 * b)))))
    )  # Ramanujan's circumference
    covered = np.zeros(steps, dtype=np.bool_)
    relation = _relation(points, ellipse)
    for k in range(len(points)):
        if abs(relation[0, k]) <= _OFF and relation[1, k] >= _ALONG:
            covered[int((relation[2, k] / (2.0 * np.pi) + 0.5) * steps) % steps] = True
    return float(covered.sum()) / steps


@numba.njit(cache=True, error_model="numpy")
def _vote_for_ellipse(points: Any, largest: float, least_aspect: float) -> Any:
    """Find the ellipse (5,) with most votes, and its coverage."""
    best, best_part, most = np.zeros(5), 0.0, 0.0
    for i in range(len(points)):
        for j in range(i):
            dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            length = np.hypot(dx, dy)
            if length < 2.0 * _LEAST_PX or length > 2.0 * largest:
                continue
            if (
                points[j, 2] * dx + points[j, 3] * dy < _ALONG * length
                or points[i, 2] * dx + points[i, 3] * dy > -_ALONG * length
            ):
                continue
            axis = np.array(
                [
                    0.5 * (points[i, 0] + points[j, 0]),
                    0.5 * (points[i, 1] + points[j, 1]),
                    0.5 * length,
                    0.0,
                    np.arctan2(dy, dx),
                ]
            )
            axis[3] = _minor(points, axis, least_aspect)
            if axis[3] == 0.0:
                continue
            part = _edge_coverage(points, axis)
            worth = part**2 * np.sqrt(axis[2] * axis[3])
            if worth > most:
                best, best_part, most = axis, part, worth
    return best, best_part


@inner_kernel(error_model="numpy")
def _minor(points: Any, axis: Any, least_aspect: float) -> float:
    """Find the minor semi-axis with the most votes of three bins; 0 without votes."""
    x, y, a, _, angle = axis
    cosine, sine = np.cos(angle), np.sin(angle)
    votes = np.zeros(int(a / _BIN) + 4)
    for k in range(len(points)):
        dx, dy = points[k, 0] - x, points[k, 1] - y
        u, w = dx * cosine + dy * sine, dy * cosine - dx * sine
        if abs(u) > _FLANK * a:
            continue
        b = abs(w) / np.sqrt(1.0 - (u / a) ** 2)
        if b < max(least_aspect * a - _BIN, _LEAST_PX) or b > a + _BIN:
            continue
        nu, nw = u / a**2, w / b**2
        inward = -(
            (points[k, 2] * cosine + points[k, 3] * sine) * nu
            + (points[k, 3] * cosine - points[k, 2] * sine) * nw
        )
        if inward >= _ALONG * np.hypot(nu, nw):
            votes[int(b / _BIN)] += 1.0
    three = votes[:-2] + votes[1:-1] + votes[2:]
    top = three.argmax()
    if three[top] < 3.0:
        return 0.0
    mean = (
        votes[top] * (top + 0.5) + votes[top + 1] * (top + 1.5) + votes[top + 2] * (top + 2.5)
    ) / three[top]
    return float(min(mean * _BIN, a))


_STEP = 1.13  # between radii
_WIDTH = 0.6  # px: of the ring, and of the filter before
_WEAK = 0.04  # transmission per px: a gradient that counts half


@dataclass(frozen=True)
class Votes:
    """Votes (radius, row, column) from 0 to 1, stretched down by the aspect."""

    radii_px: F64
    maps: F32
    aspect: float = 1.0

    def map_pixels(self, pixels: F64) -> F64:
        """Map pixels (n, 2) to positions in the maps."""
        return np.column_stack([pixels[:, 0], (pixels[:, 1] + 0.5) / self.aspect - 0.5])


def radii_between(smallest_px: float, largest_px: float) -> F64:
    """List the radii that are tried."""
    count = max(2, int(np.ceil(np.log(largest_px / smallest_px) / np.log(_STEP))) + 1)
    return np.geomspace(smallest_px, largest_px, count)


def vote(image: F32, radii_px: F64, aspect: float = 1.0) -> Votes:
    """Vote for circles, or flat ellipses of an aspect, in a transmission."""
    if aspect != 1.0:
        image = cv2.resize(
            image, (image.shape[1], round(image.shape[0] / aspect)), interpolation=cv2.INTER_CUBIC
        )
    smooth = cv2.GaussianBlur(image, (0, 0), _WIDTH)
    right, down = compute_gradient(smooth)
    strength = cv2.magnitude(right, down) + np.float32(_WEAK)
    right /= strength
    down /= strength
    maps = np.empty((len(radii_px), *image.shape), dtype=np.float32)
    for out, radius in zip(maps, radii_px, strict=True):
        across, along = _ring(float(radius))
        cv2.filter2D(right, cv2.CV_32F, across, dst=out, borderType=cv2.BORDER_CONSTANT)
        out += cv2.filter2D(down, cv2.CV_32F, along, borderType=cv2.BORDER_CONSTANT)
    return Votes(radii_px, maps, aspect)


def _ring(radius: float) -> tuple[F32, F32]:
    """Make kernels that add up the outward parts of a field on a ring."""
    half = int(np.ceil(radius + 3.0 * _WIDTH))
    along = np.arange(-half, half + 1, dtype=np.float64)
    x, y = np.meshgrid(along, along)
    distance = np.hypot(x, y)
    weight = np.exp(-((distance - radius) ** 2) / (2.0 * _WIDTH**2))
    weight[half, half] = 0.0
    weight /= weight.sum()
    safe = np.maximum(distance, 1e-9)
    return (weight * x / safe).astype(np.float32), (weight * y / safe).astype(np.float32)


def peaks(votes: Votes, least: float, margin: int = 1) -> F64:
    """Find local maxima (n, 4): column, row, radius in px, vote."""
    maps, window = votes.maps, np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)
    spatial = np.stack([cv2.dilate(votes_of_radius, window) for votes_of_radius in maps])
    around = spatial.copy()
    around[1:] = np.maximum(around[1:], spatial[:-1])
    around[:-1] = np.maximum(around[:-1], spatial[1:])
    scale, row, column = np.nonzero((maps >= around) & (maps > least))
    image_row = (row + 0.5) * votes.aspect - 0.5
    maxima = [column, image_row, votes.radii_px[scale], maps[scale, row, column]]
    return np.column_stack(maxima).astype(np.float64)
