"""Plane and parallax: cameras on one plane, with unknown optics.

Images are mapped to a reference plane, which is parallel to that of the cameras. There the image of
a point at the distance Z behind the reference plane is, with D the distance of the cameras before
it and C the place of a camera along it,

    q = P / (1 + g Z) + m C,    m = g Z / (1 + g Z),    g = 1 / D,

so that the parallax of points against their mean over the cameras is a matrix of rank one.

Source: V. Vaish, B. Wilburn, N. Joshi and M. Levoy, Using plane + parallax for calibrating dense
camera arrays, CVPR 2004; thesis, section 2.2.3 and equations 2.1 to 2.3.
"""

from typing import NamedTuple

import cv2
import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import HARDLY
from sabench.algorithms.calibration.fit_checks import FEWEST, FLAT, correlated_part, neighbours
from sabench.geometry.projective_camera import Projective
from sabench.utils.arrays import F64, Bool, nested
from sabench.utils.errors import InputError


class RankOne(NamedTuple):
    """Product of rank one that is nearest to aligned images.

    Attributes
    ----------
    middles : (n, 2) mean of each point's images over all cameras.
    offsets : (camera, 2) places of the cameras about their mean, up to one factor; norm 1.
    parallax : (n,) that of each point; the image in a camera is middle + parallax * offset.
    """

    middles: F64
    offsets: F64
    parallax: F64


class DepthScale(NamedTuple):
    """Numbers that join parallax to lengths.

    Attributes
    ----------
    per_mm : g, the inverse of the cameras' distance from the reference plane.
    center : (2,) mean place of the cameras, times g.
    offset : factor from `RankOne.offsets` to places, times g.
    """

    per_mm: float
    center: F64
    offset: float


def plane_homography(name: str, plane_mm: F64, pixels: F64) -> F64:
    """Fit the homography (3, 3) from points of a plane (n, 2) to pixels (n, 2).

    The fit is one of least squares in the image.

    Raises
    ------
    InputError
        Fewer than four points, or points on one line.
    """
    matrix = None
    if len(plane_mm) >= FEWEST:
        spread = np.linalg.svd(plane_mm - plane_mm.mean(axis=0), compute_uv=False)
        if spread[-1] > FLAT * spread[0]:
            matrix = cv2.findHomography(plane_mm, pixels)[0]
    if matrix is None:
        raise InputError(
            f"{name}: expected {FEWEST} points or more of the reference plane that are not on one "
            f"line, got {len(pixels)} that determine no homography"
        )
    return np.asarray(matrix)


def align(homography: F64, pixels: F64) -> F64:
    """Map pixels (n, 2) to the reference plane by the inverse of its homography."""
    image = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(homography).T
    return np.asarray(image[:, :2] / image[:, 2:])


def factorise_parallax(aligned: F64, seen: Bool) -> RankOne:
    """Factorise aligned images (camera, n, 2), some unseen, into parallax."""
    cameras, count = seen.shape
    weight = seen / np.maximum(seen.sum(axis=0), 1)
    mean = np.einsum("cn,cnk->nk", weight, np.where(seen[..., None], aligned, 0.0))
    guess, change = np.broadcast_to(mean, aligned.shape), np.inf
    while change > HARDLY * np.abs(mean).max():
        filled = np.where(seen[..., None], aligned, guess)
        middles = filled.mean(axis=0)
        table = (filled - middles).transpose(0, 2, 1).reshape(2 * cameras, count)
        offsets = np.linalg.eigh(table @ table.T)[1][:, -1]
        parallax = offsets @ table
        product = np.outer(offsets, parallax).reshape(cameras, 2, count).transpose(0, 2, 1)
        change = np.abs(middles + product - guess)[~seen].max(initial=0.0)
        guess = middles + product
    return RankOne(middles, offsets.reshape(cameras, 2), parallax)


def fit_depth_scale(found: RankOne, points_mm: F64) -> DepthScale:
    """Fit the depth scale to known places (n, 3).

    Their Z counts from the reference plane. The fit is linear: middle (1 + g Z) = P + Z (g C) and
    parallax (1 + g Z) = Z (g times the factor).

    Raises
    ------
    InputError
        Places that are all on the reference plane.
    """
    z = points_mm[:, 2]
    if np.ptp(z) <= FLAT * np.ptp(points_mm[:, 0]):
        raise InputError("expected points at different depths, got all of them in one plane")
    x, y, zero = *found.middles.T, np.zeros_like(z)
    table = np.vstack([np.column_stack([-z * x, z, zero]), np.column_stack([-z * y, zero, z])])
    off = (found.middles - points_mm[:, :2]).T.ravel()
    per_mm, *center = np.linalg.lstsq(table, off, rcond=None)[0]
    offset = np.sum(found.parallax * (1.0 + per_mm * z) * z) / np.sum(z**2)
    return DepthScale(float(per_mm), np.asarray(center), float(offset))


def make_cameras(
    names_and_sizes: list[tuple[str, int, int]],
    homographies: F64,
    found: RankOne,
    scale: DepthScale,
    reference_z_mm: float,
) -> tuple[Projective, ...]:
    """Make projective cameras of homographies (camera, 3, 3) and offsets."""
    cameras, shift = [], np.eye(4)
    shift[2, 3] = -reference_z_mm
    for given, homography, offset in zip(names_and_sizes, homographies, found.offsets, strict=True):
        x, y = scale.center + scale.offset * offset
        to_plane = np.array([[1.0, 0.0, x, 0.0], [0.0, 1.0, y, 0.0], [0.0, 0.0, scale.per_mm, 1.0]])
        matrix = homography @ to_plane @ shift
        cameras.append(Projective(*given, nested(matrix / np.linalg.norm(matrix[2, :3]))))
    return tuple(cameras)


def misfit_px(errors_px: F64, target_mm: F64) -> tuple[float, float]:
    """Split errors (camera, frame, point, 2) into correlated part and noise."""
    shared = float(np.sqrt(np.mean(correlated_part(errors_px, neighbours(target_mm)) ** 2)))
    noise = max(float(np.nanmean(errors_px**2)) - shared**2, 0.0) ** 0.5
    return shared, noise
