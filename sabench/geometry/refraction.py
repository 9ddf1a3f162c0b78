"""Refraction at the wall between a camera and a fluid.

The functions take a wall of any shape (`AnyWall`), or None for plain air. `Wall` is a stack of
parallel plane layers, `cylinder_wall.CylinderWall` one of coaxial cylinders. This module is the
reference of the light path; for its copies see docs/developing/copies-of-the-projection.md.

Through plane layers, light between a point of the camera's medium and a point of the fluid stays in
the plane that holds both and the wall normal, so the path has one unknown. sabench takes t = tan of
the ray's angle in the RAREST medium of the stack: every other medium then has a relative index
r >= 1 and adds d t / sqrt(r^2 + (r^2 - 1) t^2) to the lateral distance, which increases and is
concave in t and has no pole, for any order of indices. Newton's iteration on an increasing concave
function climbs to the root from the left without overshooting; the bracket [t_low, R / d_rarest]
guards it against rounding all the same. (The thesis solves the same path for two unknowns per layer
pair, equations 4.14 and 4.15.)
"""

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sabench.utils.arrays import F64, Bool, all_in_row

HALLEY, NEWTON = 6, 100  # most steps; grazing rays in thin rare layers take dozens of Newton's


def solve_slope(indices: F64, depths_mm: list[F64 | float], radius_mm: F64) -> F64:
    """Solve for the tangent t of the angle in the rarest medium of paths.

    The paths have a given lateral distance.

    Parameters
    ----------
    indices : (m,) refractive indices.
    depths_mm : for each medium the distance that the path crosses along the normal; scalars or
        arrays (n,), positive or zero.
    radius_mm : (n,) lateral distance between the ends of the path.

    Returns t >= 0 (n,).
    """
    relative = indices / indices.min()
    quick = _halley(relative, depths_mm, radius_mm)
    if quick is not None:
        return quick
    rare = np.asarray(sum(depth for depth, r in zip(depths_mm, relative, strict=True) if r == 1.0))
    # an upper bound: the rarest medium alone cannot bridge more than R
    upper = radius_mm / np.maximum(rare, 1e-300)
    slowness = sum(depth / r for depth, r in zip(depths_mm, relative, strict=True))
    slope = low = radius_mm / np.asarray(slowness)  # paraxial root
    value, gradient = _lateral(relative, depths_mm, slope)
    for _ in range(NEWTON):
        low = np.where(value <= radius_mm, np.maximum(low, slope), low)
        upper = np.where(value >= radius_mm, np.minimum(upper, slope), upper)
        step = slope + (radius_mm - value) / gradient
        better = np.where((step >= low) & (step <= upper), step, 0.5 * (low + upper))
        moved = np.abs(better - slope)
        slope = better
        value, gradient = _lateral(relative, depths_mm, slope)
        if np.all(
            (moved <= 2e-16 * slope) | (np.abs(value - radius_mm) <= 2e-13 + 5e-16 * radius_mm)
        ):
            break
    return np.asarray(slope)


def _halley(relative: F64, depths_mm: list[F64 | float], radius_mm: F64) -> F64 | None:
    """Solve by a few of Halley's steps, without a bracket.

    Each step triples the right digits. Returns None where one path has not converged.
    """
    slope = _start(relative, depths_mm, radius_mm)
    for _ in range(HALLEY):
        value, gradient, curvature = _lateral_distance(relative, depths_mm, slope)
        miss = radius_mm - value
        step = 2.0 * miss * gradient / (2.0 * gradient * gradient - 3.0 * miss * curvature * slope)
        slope = slope + step
        if np.all(np.abs(step) <= 1e-5 * slope):
            value, _ = _lateral(relative, depths_mm, slope)
            near = np.abs(value - radius_mm) <= 2e-13 + 5e-16 * radius_mm
            return slope if near.all() else None
    return None


def _start(relative: F64, depths_mm: list[F64 | float], radius_mm: F64) -> F64:
    """Compute a first tangent.

    It is right to the third power for steep paths, and in the limit for flat ones, where the rarest
    medium dominates.
    """
    paraxial, rare, curvature = (np.zeros(np.shape(radius_mm)) for _ in range(3))
    for depth, r in zip(depths_mm, relative, strict=True):
        paraxial += depth / r
        if r == 1.0:
            rare += depth
        else:
            curvature += depth * (0.5 * (r * r - 1.0) / r**3)
    slope = radius_mm / paraxial
    square = slope * slope * curvature
    excess = paraxial - rare
    return np.asarray(
        slope * (1.0 + square * excess / (paraxial * excess + rare * square + 1e-300))
    )


def _lateral_distance(
    relative: F64, depths_mm: list[F64 | float], slope: F64
) -> tuple[F64, F64, F64]:
    """Compute lateral distance of a path with slope t, and derivatives.

    The slope is that in the rarest medium. The derivatives are the first, and the second over -3 t.
    """
    square = slope * slope
    value, gradient, curvature = np.zeros_like(slope), np.zeros_like(slope), np.zeros_like(slope)
    for depth, r in zip(depths_mm, relative, strict=True):
        if r == 1.0:
            value += depth
            gradient += depth
            continue
        inverse_square = 1.0 / (r * r + (r * r - 1.0) * square)
        part = depth * np.sqrt(inverse_square)
        value += part
        part *= inverse_square
        part *= r * r
        gradient += part
        part *= inverse_square
        part *= r * r - 1.0
        curvature += part
    return value * slope, gradient, curvature


def _lateral(relative: F64, depths_mm: list[F64 | float], slope: F64) -> tuple[F64, F64]:
    """Compute the lateral distance of a path and its derivative.

    The slope in the rarest medium is t.
    """
    square = slope * slope
    value, gradient = np.zeros_like(slope), np.zeros_like(slope)
    for depth, r in zip(depths_mm, relative, strict=True):
        if r == 1.0:
            value += depth * slope
            gradient += depth
            continue
        inverse = 1.0 / np.sqrt(r * r + (r * r - 1.0) * square)
        part = depth * inverse
        value += part * slope
        gradient += (r * r) * part * inverse * inverse
    return value, gradient


def angle_in(indices: F64, medium: int, slope: F64) -> tuple[F64, F64]:
    """Compute sine and cosine of the path's angle in one medium.

    The tangent in the rarest medium is given.
    """
    r, square = indices[medium] / indices.min(), slope * slope
    scale = 1.0 / np.sqrt(1.0 + square)
    if r == 1.0:
        return slope * scale, scale
    scale /= r
    square *= r * r - 1.0
    square += r * r
    return slope * scale, np.sqrt(square, out=square) * scale


_CHUNK = 1 << 14  # points per pass: the working arrays of one pass stay in the second-level cache


@dataclass(frozen=True)
class Layer:
    """Solid layer of a wall: its name, refractive index and thickness (mm)."""

    name: str
    index: float
    thickness_mm: float


@dataclass(frozen=True)
class Paths:
    """Light paths from a pinhole to points.

    Directions are unit vectors (n, 3) away from the pinhole, in its medium and in the fluid.
    """

    leaving: F64
    arriving: F64
    valid: Bool


@dataclass(frozen=True)
class Rays:
    """Rays in the fluid.

    Origins (n, 3) in mm on the wall's inner face (the pinhole without a wall), unit directions (n,
    3).
    """

    origins_mm: F64
    directions: F64
    valid: Bool


class AnyWall(Protocol):
    """Wall of any shape between a camera's medium and the fluid."""

    air_index: float
    layers: tuple[Layer, ...]
    fluid_index: float

    @property
    def thickness_mm(self) -> float:
        """Distance from the outer to the inner face."""
        return sum(layer.thickness_mm for layer in self.layers)

    @property
    def indices(self) -> F64:
        """Indices of all media along the way of light from a camera: (2 + layers,)."""
        return np.array([self.air_index, *(layer.index for layer in self.layers), self.fluid_index])

    def paths(self, pinhole_mm: F64, points_mm: F64) -> Paths:
        """Trace paths of light; see `trace_to_points`."""

    def rays(self, pinhole_mm: F64, directions: F64) -> Rays:
        """Follow rays into the fluid; see `trace_into_fluid`."""

    def lengths(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute lengths of paths before the fluid; see `length_to_fluid`."""

    def transmittances(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute transmitted fractions; see `transmittance`."""


@dataclass(frozen=True)
class Wall(AnyWall):
    """Stack of parallel layers between the cameras' medium and the fluid.

    Attributes
    ----------
    point_mm : a point on the outer face (the face that the cameras see), world frame.
    normal : unit vector from the cameras into the tank, world frame.
    air_index, fluid_index : refractive indices on the cameras' side and in the tank.
    layers : the solid layers, in the order along light from a camera; may be empty (a
        bare surface).
    depth_mm : free distance from the inner face to the back wall, or None where there is none.
    """

    point_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    air_index: float
    layers: tuple[Layer, ...]
    fluid_index: float
    depth_mm: float | None = None

    @property
    def interface_depths_mm(self) -> F64:
        """Depth of every interface behind the outer face: (1 + layers,)."""
        return np.cumsum([0.0, *(layer.thickness_mm for layer in self.layers)])

    def depth_of(self, points_mm: F64) -> F64:
        """Compute the signed distance of points (..., 3) behind the outer face, mm."""
        return np.asarray((points_mm - np.asarray(self.point_mm)) @ np.asarray(self.normal))

    def normal_at(self, point_mm: F64) -> F64:
        """Return the normal, which is the same everywhere."""
        return np.asarray(self.normal)

    def paths(self, pinhole_mm: F64, points_mm: F64) -> Paths:
        """Trace paths of light, by the one unknown that all their angles share."""
        normal, before = np.asarray(self.normal), -float(self.depth_of(pinhole_mm))
        leaving, arriving = np.empty_like(points_mm), np.empty_like(points_mm)
        valid = np.empty(len(points_mm), dtype=np.bool_)
        for start in range(0, len(points_mm), _CHUNK):
            part = slice(start, start + _CHUNK)
            # unit vectors (3, n) along the wall, lateral distances and the depths in each medium
            lateral = np.array(points_mm[part].T, order="C")  # numpy is slow on rows of three
            lateral -= pinhole_mm[:, None]
            with np.errstate(invalid="ignore"):  # infinite coordinates
                along = normal @ lateral
                behind = along - (before + self.thickness_mm)
                for axis in range(3):
                    lateral[axis] -= normal[axis] * along
            # a coordinate that is not finite makes the depth so, too
            good = np.isfinite(behind) & (behind > 0.0) & (before > 0.0)
            if not good.all():  # all is zero where there is no path
                lateral[:, ~good], behind[~good] = 0.0, 1.0
            radius = np.sqrt(lateral[0] ** 2 + lateral[1] ** 2 + lateral[2] ** 2)
            lateral *= 1.0 / np.where(radius > 0.0, radius, 1.0)
            layers = [layer.thickness_mm for layer in self.layers]
            slope = solve_slope(self.indices, [max(before, 1e-300), *layers, behind], radius)
            sine, cosine = angle_in(self.indices, 0, slope)
            last_sine, last_cosine = angle_in(self.indices, -1, slope)
            for axis in range(3):  # directions at these angles from the normal
                leaving[part, axis] = sine * lateral[axis] + cosine * normal[axis]
                arriving[part, axis] = last_sine * lateral[axis] + last_cosine * normal[axis]
            valid[part] = good
        if not valid.all():
            leaving[~valid] = arriving[~valid] = np.nan
        return Paths(leaving, arriving, valid)

    def rays(self, pinhole_mm: F64, directions: F64) -> Rays:
        """Follow rays into the fluid, layer by layer."""
        origins = np.broadcast_to(pinhole_mm, directions.shape).copy()
        valid: Bool = np.asarray(np.isfinite(directions).all(axis=1))
        normal, indices, current = np.asarray(self.normal), self.indices, directions
        gaps = np.diff(self.interface_depths_mm, prepend=self.depth_of(pinhole_mm))
        valid &= gaps[0] > 0.0
        with np.errstate(invalid="ignore", divide="ignore"):
            for gap, before, after in zip(gaps, indices[:-1], indices[1:], strict=True):
                cosine = current @ normal
                origins = origins + current * (gap / cosine)[:, None]
                tangential = (current - cosine[:, None] * normal) * (before / after)
                square = 1.0 - np.einsum("ij,ij->i", tangential, tangential)
                valid &= (cosine > 0.0) & (square > 0.0)
                current = tangential + np.sqrt(square)[:, None] * normal
        origins[~valid] = current[~valid] = np.nan
        return Rays(origins, current, valid)

    def lengths(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute lengths of light paths before the fluid."""
        cosine = leaving @ np.asarray(self.normal)
        sine = np.sqrt(np.maximum(0.0, 1.0 - cosine**2))
        total = -self.depth_of(pinhole_mm) / cosine
        for layer in self.layers:
            cosines = np.sqrt(1.0 - (sine * self.air_index / layer.index) ** 2)
            total = total + layer.thickness_mm / cosines
        return np.asarray(total)

    def transmittances(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute transmitted fractions, which do not depend on the pinhole's position."""
        indices, cosine = self.indices, leaving @ np.asarray(self.normal)
        result = np.ones(len(leaving))
        for before, after in itertools.pairwise(indices):
            sine = (before / after) * np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine))
            after_cosine = np.sqrt(np.maximum(0.0, 1.0 - sine * sine))
            a, b = before * cosine, after * after_cosine
            c, d = after * cosine, before * after_cosine
            result *= 1.0 - 0.5 * (((a - b) / (a + b)) ** 2 + ((c - d) / (c + d)) ** 2)
            cosine = after_cosine
        return result


def trace_to_points(wall: AnyWall | None, pinhole_mm: F64, points_mm: F64) -> Paths:
    """Trace paths of light from one pinhole (3,) to points (n, 3) through the wall.

    `valid` is False for points that are not in the fluid, that are not finite, that no path leads
    to, or when the pinhole itself lies in the wall or the fluid.
    """
    if wall is not None:
        return wall.paths(pinhole_mm, points_mm)
    offset = points_mm - pinhole_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = offset / np.sqrt(np.einsum("ij,ij->i", offset, offset))[:, None]
    return Paths(direction, direction, all_in_row(np.isfinite(direction)))


def trace_into_fluid(wall: AnyWall | None, pinhole_mm: F64, directions: F64) -> Rays:
    """Follow unit directions (n, 3) from a pinhole (3,) through the wall.

    Total reflection and misses are not `valid`.
    """
    if wall is not None:
        return wall.rays(pinhole_mm, directions)
    origins = np.broadcast_to(pinhole_mm, directions.shape).copy()
    return Rays(origins, directions.copy(), np.asarray(np.isfinite(directions).all(axis=1)))


def length_to_fluid(wall: AnyWall | None, pinhole_mm: F64, leaving: F64) -> F64:
    """Compute lengths (n,) of light paths from a pinhole to the wall's inner face.

    The pinhole is (3,); unit directions are (n, 3) in the camera's medium. Without a wall all
    lengths are 0.
    """
    return np.zeros(len(leaving)) if wall is None else wall.lengths(pinhole_mm, leaving)


def transmittance(wall: AnyWall | None, pinhole_mm: F64, leaving: F64) -> F64:
    """Compute the fraction of unpolarised power that passes all interfaces.

    The pinhole is (3,); unit directions are (n, 3) in the camera's medium.

    Fresnel's equations at every interface; light that is reflected twice inside a layer is not
    counted.
    """
    return np.ones(len(leaving)) if wall is None else wall.transmittances(pinhole_mm, leaving)
