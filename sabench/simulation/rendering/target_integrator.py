"""Integrator of a calibration target behind dielectric planes.

Import this module only after sabench.utils.backend.mitsuba(), as `camera_rays`.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sabench.geometry.camera import Camera
from sabench.simulation.rendering.camera_rays import lens_rays, mean_of_rays, opaque
from sabench.simulation.rendering.lamps import Lamps
from sabench.utils.arrays import F32, F64, Bool

# irrational steps along columns and rows, so that neighbours differ much: of a pixel's lattice
# along columns, along rows, and of the rotation of the aperture's points
_STEPS = ((0.7548777, 0.5698403), (0.5698403, 0.2451223), (0.2451223, 0.8191725))


@dataclass(frozen=True)
class Paint:
    """Pattern of a target, in its own frame.

    Attributes
    ----------
    pattern : as in `world.Target`.
    squares : columns and rows of squares, or of circles.
    pitch_mm, mark_mm : as in `world.Target`.
    bits : (marker, 36) whether a cell of a ChArUco marker is white, for each marker in the order of
        the white squares; empty for other patterns.
    rotation : (3, 3) rows are the target's axes in the world.
    """

    pattern: str
    squares: tuple[int, int]
    pitch_mm: float
    mark_mm: float
    bits: Bool
    rotation: F64


def integrate_target(
    scene: Any,
    camera: Camera,
    origin: F64,
    paint: Paint,
    lamps: Lamps,
    interfaces: int,
    samples: int,
) -> F32:
    """Render relative radiance (rows, columns) in front of the lens.

    The rays of a pixel start all over the aperture. A pixel is sampled on a lattice without two
    points in a column or a row. The lattice is shifted from pixel to pixel, and the aperture's
    points are rotated. With one pattern for all, an edge that runs along the pixels would move by
    whole steps of it, and corners with it.

    Parameters
    ----------
    origin : world point that is the scene's (0, 0, 0): the target's own origin.
    interfaces : dielectric planes that a ray crosses before it may meet the target.
    """
    target, disc = _Target(paint, lamps, interfaces), camera.aperture_radius_mm * _spiral(samples)

    def trace(sub: Any, pixel: Any) -> Any:
        row, column = pixel // camera.columns, pixel % camera.columns
        shift_across, shift_down, rotation = (
            _fraction(c0 * mi.Float(column) + c1 * mi.Float(row)) for c0, c1 in _STEPS
        )
        lattice = (sub * _stride(samples, 0.618)) % samples
        in_column = _fraction((mi.Float(sub) + 0.5) / samples + shift_across)
        in_row = _fraction((mi.Float(lattice) + 0.5) / samples + shift_down)
        across, down = mi.Float(column) + in_column - 0.5, mi.Float(row) + in_row - 0.5
        sine, cosine = dr.sincos(2.0 * np.pi * rotation)
        a, b = (dr.gather(mi.Float, mi.Float(part.astype(np.float32)), sub) for part in disc.T)
        lens = cosine * a - sine * b, sine * a + cosine * b
        return _trace(scene, lens_rays(camera, origin, across, down, lens), target)

    size = camera.rows, camera.columns
    return mean_of_rays((np.arange(size[0] * size[1]),), samples, trace).reshape(size)


class _Target:
    """Device copy of a target and its lamps."""

    def __init__(self, paint: Paint, lamps: Lamps, interfaces: int) -> None:
        self.paint, self.interfaces = paint, dr.opaque(mi.UInt32, interfaces)
        self.axes = [opaque(axis) for axis in paint.rotation]
        self.bits = (
            mi.Float(paint.bits.astype(np.float32).ravel()) if paint.bits.size else mi.Float(0.0)
        )
        self.lamps = [
            (opaque(position), dr.opaque(mi.Float, power))
            for position, power in zip(lamps.positions, lamps.powers.tolist(), strict=True)
        ]
        self.ambient = dr.opaque(mi.Float, lamps.ambient)


def _spiral(count: int) -> F64:
    """Make points (count, 2) uniform over the unit disc, each with its opposite.

    Their order is far from that of a pixel's lattice.

    Their centroid is the pinhole: else everything out of focus would be shifted.
    """
    half = count // 2
    number = np.arange(half)
    radius, angle = np.sqrt((number + 0.5) / max(half, 1)), number * np.pi * (3.0 - np.sqrt(5.0))
    part = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points = np.vstack([part, -part, np.zeros((count % 2, 2))])
    return np.asarray(points[(np.arange(count) * _stride(count, 0.382)) % count])


def _fraction(value: Any) -> Any:
    return value - dr.floor(value)


def _stride(count: int, part: float) -> int:
    """Find a step near a share of `count` that visits all numbers below it."""
    return next(
        step for step in range(int(part * count) + 1, 2 * count + 2) if np.gcd(step, count) == 1
    )


@dr.syntax
def _trace(scene: Any, ray: Any, target: Any) -> Any:
    """Trace the radiance along rays to a matte surface under the lamps.

    Interfaces transmit by Mitsuba's rules.
    """
    ray = mi.Ray3f(ray)
    result, weight = mi.Float(0.0), mi.Float(1.0)
    crossed, active = mi.UInt32(0), mi.Bool(True)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DeltaTransmission
    while active:
        si = scene.ray_intersect(ray, mi.RayFlags.All, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        position = dr.fma(ray.d, si.t, ray.o)
        matte = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        normal = dr.select(dr.dot(si.n, ray.d) < 0.0, si.n, -si.n)
        result += dr.select(
            matte & (crossed == target.interfaces),
            weight * _reflectance(target, position) * _irradiance(target, position, normal),
            0.0,
        )
        wall = active & ~matte
        sampled, value = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5), wall)
        weight = dr.select(wall, weight * value.x, weight)
        crossed += dr.select(wall, mi.UInt32(1), mi.UInt32(0))
        ray.d = dr.select(wall, si.to_world(sampled.wo), ray.d)
        ray.o = dr.fma(ray.d, 1e-3, position)
        active &= wall & (weight > 0.0)
    return result


def _irradiance(target: Any, position: Any, normal: Any) -> Any:
    """Compute irradiance at positions; lamps are points."""
    total = mi.Float(target.ambient)
    for lamp, power in target.lamps:
        direction = lamp - position
        square = dr.squared_norm(direction)
        total += power * dr.maximum(dr.dot(normal, direction), 0.0) * dr.rsqrt(square) / square
    return total


def _reflectance(target: Any, position: Any) -> Any:
    """Compute reflectance at positions: 1 for white, 0.04 for black print."""
    paint = target.paint
    if paint.pattern == "wand":
        return mi.Float(1.0)
    columns, rows = paint.squares
    x, y = (dr.dot(mi.Vector3f(position), axis) / paint.pitch_mm for axis in target.axes[:2])
    if paint.pattern == "circles":
        i, j = (
            dr.clip(dr.round(v + 0.5 * (n - 1)), 0.0, n - 1.0) - 0.5 * (n - 1)
            for v, n in ((x, columns), (y, rows))
        )
        return dr.select(
            (x - i) * (x - i) + (y - j) * (y - j) <= (0.5 * paint.mark_mm / paint.pitch_mm) ** 2,
            0.04,
            1.0,
        )
    x, y = x + 0.5 * columns, y + 0.5 * rows
    i, j = dr.floor(x), dr.floor(y)
    inside = (i >= 0.0) & (j >= 0.0) & (i < columns) & (j < rows)
    black = inside & (mi.Int32(i + j) % 2 == 0)
    if paint.bits.size:
        part = paint.mark_mm / paint.pitch_mm
        cell_x, cell_y = ((v - w - 0.5 * (1.0 - part)) / part * 6.0 for v, w in ((x, i), (y, j)))
        within = (cell_x >= 0.0) & (cell_y >= 0.0) & (cell_x < 6.0) & (cell_y < 6.0)
        marker = mi.UInt32(j * columns + i) // 2
        cell = mi.UInt32(dr.clip(dr.floor(cell_y), 0, 5)) * 6 + mi.UInt32(
            dr.clip(dr.floor(cell_x), 0, 5)
        )
        on_marker = inside & ~black & within
        white = dr.gather(mi.Float, target.bits, marker * 36 + cell, on_marker)
        black |= on_marker & (white < 0.5)
    return dr.select(black, 0.04, 1.0)
