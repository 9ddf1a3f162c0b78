"""Path tracer of bubbles, drops, bodies and tracers, inside Mitsuba's scene.

Import this module only after sabench.utils.backend.mitsuba(), as `camera_rays`.

Bubbles are primitives of one `ellipsoids` shape. Mitsuba returns which one a ray enters; where it
leaves again, and the normals, follow from the ellipsoid's equation, so that spheroids are exact and
thousands need no triangles. At every surface a ray is either reflected or refracted, with Fresnel's
probability. Radiance is carried as L / n^2, which no interface changes but by what it reflects.
Walls of the tank are plane: rays cross them by Snell's and Fresnel's laws without a search.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sabench.geometry.camera import Camera
from sabench.simulation.rendering.bubble_stage import LightPanel, Stack, Stage
from sabench.simulation.rendering.camera_rays import (
    lens_rays,
    mark_unobstructed,
    mean_of_rays,
    opaque,
)
from sabench.simulation.rendering.lamps import Lamps
from sabench.utils.arrays import F32, F64, U32


def layers_of(stack: Stack | None) -> list[tuple[Any, Any, Any]] | None:
    """List position and index ratios, after over before and inverse, of each face."""
    if stack is None:
        return None
    indices = stack.indices.tolist()
    return [
        (
            dr.opaque(mi.Float, face),
            dr.opaque(mi.Float, after / before),
            dr.opaque(mi.Float, before / after),
        )
        for face, before, after in zip(
            stack.faces_mm.tolist(), indices[:-1], indices[1:], strict=True
        )
    ]


def panel_of(panel: LightPanel | None) -> tuple[Any, ...] | None:
    """Return centre, edges over their squared lengths, normal and radiance."""
    if panel is None:
        return None
    across, along = panel.edges
    lengths = [float(np.dot(edge, edge)) for edge in (across, along)]
    normal = np.cross(across, along)
    return (
        opaque(panel.center),
        opaque(across / lengths[0]),
        opaque(along / lengths[1]),
        opaque(normal / np.linalg.norm(normal)),
        dr.opaque(mi.Float, panel.radiance),
    )


def _cross(position: Any, direction: Any, normal: Any, layers: Any) -> tuple[Any, Any, Any]:
    """Cross plane layers: new positions, directions, and the transmitted share."""
    passed = mi.Float(1.0)
    for face, after_over_before, before_over_after in layers:
        along = dr.dot(direction, normal)
        position = dr.fma(direction, (face - dr.dot(position, normal)) / along, position)
        cosine = dr.abs(along)
        reflected, _, _, _ = mi.fresnel(cosine, after_over_before)
        passed *= dr.maximum(1.0 - reflected, 0.0)  # total reflection: GPUs round below 0
        across = (direction - along * normal) * before_over_after
        square = dr.maximum(1.0 - dr.squared_norm(across), 0.0)
        direction = across + dr.copysign(dr.sqrt(square), along) * normal
    return position, direction, passed


def enter(device: Any, ray: Any) -> tuple[Any, Any]:
    """Move camera rays behind the front wall; also the share of light it passes."""
    if device.front is None:
        return ray, mi.Float(1.0)
    inwards = [(face, before, after) for face, after, before in reversed(device.front)]
    position, direction, passed = _cross(ray.o, ray.d, device.normal, inwards)
    return mi.Ray3f(position, dr.normalize(direction)), passed


def _panel_radiance(device: Any, position: Any, direction: Any) -> Any:
    if device.panel is None:
        return mi.Float(0.0)
    center, across, along, normal, bright = device.panel
    distance = dr.dot(center - position, normal) / dr.dot(direction, normal)
    offset = dr.fma(direction, distance, position) - center
    on = (
        (distance > 0.0)
        & (dr.abs(dr.dot(offset, across)) <= 1.0)
        & (dr.abs(dr.dot(offset, along)) <= 1.0)
    )
    return dr.select(on, bright, 0.0)


def leave(device: Any, ray: Any) -> tuple[Any, Any, Any]:
    """Compute light that rays gather at the walls.

    Returns the radiance that comes in along them, the share that a wall reflects, and the position
    of that reflection.
    """
    if device.front is None:
        return _panel_radiance(device, ray.o, ray.d), mi.Float(0.0), ray.o
    along = dr.dot(ray.d, device.normal)
    back = along > 0.0
    _, _, out_in_front = _cross(ray.o, ray.d, device.normal, device.front)
    if device.rear is None:
        position, direction, out_behind = ray.o, ray.d, mi.Float(1.0)
        behind = mi.Float(device.front[0][0])
    else:
        position, direction, out_behind = _cross(ray.o, ray.d, device.normal, device.rear)
        behind = device.rear[0][0]
    face = dr.select(back, behind, device.front[0][0])
    here = dr.fma(ray.d, (face - dr.dot(ray.o, device.normal)) / along, ray.o)
    passed = dr.select(back, out_behind, out_in_front)
    seen = dr.select(
        back & (out_behind > 0.0), out_behind * _panel_radiance(device, position, direction), 0.0
    )
    near = dr.squared_norm(here) < (50.0 * device.radius) * (50.0 * device.radius)
    return seen, dr.select(near & ~_is_lost(device, ray, here, passed), 1.0 - passed, 0.0), here


def _is_lost(device: Any, ray: Any, here: Any, passed: Any) -> Any:
    """Say whether total reflections lead light away from all that may turn it.

    Both walls reflect an angle totally, or none does: beyond each is air. Without a wall behind,
    light passes there.
    """
    if device.rear is None:
        return mi.Bool(False)
    aside = here - dr.dot(here, device.normal) * device.normal
    away = dr.dot(aside, ray.d - dr.dot(ray.d, device.normal) * device.normal) > 0.0
    return away & (passed == 0.0) & (dr.squared_norm(aside) > device.radius * device.radius)


_EVENTS, _GLOWING = 64, 4096  # surfaces, and glowing balls, that a ray meets at most
_NONE = 0xFFFFFFFF
# mm: where a ray starts in front of the surface that it leaves; single precision at 100 mm
_OFF = 2e-5
_PRIMES = (
    2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89,
)  # fmt: skip
# numbers of a ray's position in its pixel and on the lens; events at surfaces take those that
# follow
_FIRST = 4


def radiance(
    stage: Stage, camera: Camera, origin: F64, pixels: U32, samples: int, seeds: U32, starts: U32
) -> F32:
    """Trace the mean radiance (n,) in front of the lens of some pixels.

    Pixels are numbered row by row. Each gets `samples` rays that share one random shift of a
    lattice, from the points `starts` (n,) of it on.

    Means of the same pixel under other seeds (n,) are independent, and their scatter estimates the
    error.
    """
    device = _Device(stage, camera, origin)

    def trace(ray: Any, pixel: Any, seed: Any, start: Any) -> Any:
        draw = _Draw(pixel, start + ray, seed)
        table = draw.table()
        u = [draw.number(table, mi.UInt32(dimension)) for dimension in range(_FIRST)]
        across = mi.Float(pixel % camera.columns) + u[0] - 0.5
        down = mi.Float(pixel // camera.columns) + u[1] - 0.5
        # balls of glow are as wide as the lens blurs them
        widest = camera.aperture_radius_mm if stage.cloud is None else 0.0
        radius = dr.opaque(mi.Float, widest) * dr.sqrt(u[2])
        sine, cosine = dr.sincos(2.0 * np.pi * u[3])
        rays = lens_rays(camera, origin, across, down, (radius * cosine, radius * sine))
        return _trace(device, rays, draw, mark_unobstructed(rays, stage.occluders, origin))

    return mean_of_rays((pixels, seeds, starts), samples, trace)


@dataclass
class _Draw:
    """Random numbers of rays: a shifted Kronecker lattice in each dimension."""

    pixel: Any
    ray: Any
    seed: Any

    def table(self) -> Any:
        return mi.Float(np.sqrt(np.array(_PRIMES, dtype=np.float64)) % 1.0)

    def number(self, table: Any, dimension: Any) -> Any:
        """Draw uniformly from [0, 1), for one dimension of all rays."""
        step = dr.gather(mi.Float, table, dimension % len(_PRIMES))
        shift = mi.sample_tea_float32(self.pixel, self.seed * 1024 + dimension)
        value = dr.fma(mi.Float(self.ray), step, shift)
        return value - dr.floor(value)


class _Device:
    """Device copy of a stage."""

    def __init__(self, stage: Stage, camera: Camera, origin: F64) -> None:
        self.stage = stage
        some = stage if len(stage.centers) else None
        centers = some.centers if some else np.zeros((1, 3))
        to_ball = some.to_ball if some else np.eye(3)[None]
        self.centers = mi.Point3f(np.ascontiguousarray(centers.T, dtype=np.float32))
        self.rows = [
            mi.Vector3f(np.ascontiguousarray(to_ball[:, row].T, dtype=np.float32))
            for row in range(3)
        ]
        self.eta = dr.opaque(mi.Float, stage.eta)
        self.normal = opaque(stage.normal)
        self.front, self.rear = (layers_of(stack) for stack in (stage.front, stage.rear))
        self.panel = panel_of(stage.panel)
        self.bubbles = mi.ShapePtr(stage.bubbles) if stage.bubbles is not None else None
        self.balls = mi.ShapePtr(stage.balls) if stage.balls is not None else None
        self.cloud: tuple[Any, ...] | None = None
        self.pace = mi.Float(0.0)  # of rays that go on behind a glowing ball
        if stage.cloud is not None:
            cloud = stage.cloud
            vectors = [
                mi.Point3f(np.ascontiguousarray(v.T, dtype=np.float32))
                for v in (cloud.centers, cloud.a, cloud.b)
            ]
            self.cloud = (*vectors, mi.Float(cloud.radiance.astype(np.float32)))
            self.pace = dr.opaque(mi.Float, 0.01 * float(np.median(cloud.radii)))
        lamps = stage.lamps or Lamps(np.zeros((0, 3)), np.zeros(0), 0.0)
        self.lamps = [
            (opaque(position), dr.opaque(mi.Float, power))
            for position, power in zip(lamps.positions, lamps.powers.tolist(), strict=True)
        ]
        self.ambient = dr.opaque(mi.Float, lamps.ambient)
        self.inverse_square = dr.opaque(mi.Float, 1.0 / stage.fluid**2)
        self.radius = dr.opaque(mi.Float, stage.radius)


@dr.syntax
def _trace(device: Any, ray: Any, draw: Any, free: Any) -> Any:
    """Trace the radiance along `free` rays from the lens."""
    table = draw.table()
    ray, weight = enter(device, ray)
    ahead = -dr.dot(ray.o, ray.d) - device.radius
    ray.o = dr.select(ahead > 0.0, dr.fma(ray.d, ahead, ray.o), ray.o)
    result = mi.Float(0.0)
    events, glowed, last = mi.UInt32(0), mi.UInt32(0), mi.UInt32(_NONE)
    number = mi.UInt32(0)
    inside = mi.Bool(False)
    active = mi.Bool(free & (weight > 0.0))
    while active:
        si, bubble, ball, body = _intersect(device, ray, active & ~inside)
        # bubbles: where the ray enters, or leaves again
        number = dr.select(bubble, si.prim_index, number)
        surface = bubble | inside
        position, normal = _on_bubble(device, ray, number, inside, surface)
        direction, refracted = _refract(
            device, ray.d, normal, draw.number(table, _FIRST + 2 * events), surface
        )
        # glowing balls: they let the ray pass
        result += dr.select(
            ball & (si.prim_index != last), weight * _glow(device, ray, si.prim_index, ball), 0.0
        )
        last = dr.select(ball, si.prim_index, last)
        # bodies
        result += dr.select(body, weight * _body_radiance(device, si, body), 0.0)
        onward, worth = _scatter(
            si,
            draw.number(table, _FIRST + 2 * events),
            draw.number(table, _FIRST + 1 + 2 * events),
            body,
            device,
        )
        # walls, and what is behind them
        out = active & ~surface & ~ball & ~body
        seen, sent_back, wall = leave(device, ray)
        result += dr.select(out, weight * seen, 0.0)
        mirrored = out & (draw.number(table, _FIRST + 2 * events) < sent_back)
        along = dr.dot(ray.d, device.normal)
        # the next part of the path
        weight = dr.select(body, weight * worth, weight)
        outwards = dr.select(dr.dot(direction, normal) > 0.0, 1.0, -1.0)
        beside = dr.fma(normal, outwards * _OFF, position)
        beyond = dr.fma(ray.d, device.pace, dr.fma(ray.d, si.t, ray.o))
        start = dr.select(
            surface, beside, dr.select(ball, beyond, dr.select(mirrored, wall, ray.o))
        )
        course = dr.select(
            surface, direction, dr.select(mirrored, ray.d - 2.0 * along * device.normal, ray.d)
        )
        ray.o = dr.select(body, onward.o, start)
        ray.d = dr.select(body, onward.d, course)
        inside = surface & (inside != refracted)
        glowed += dr.select(ball, mi.UInt32(1), mi.UInt32(0))
        events += dr.select(ball, mi.UInt32(0), mi.UInt32(1))
        active &= (
            (surface | ball | body | mirrored)
            & (weight > 0.0)
            & (events < _EVENTS)
            & (glowed < _GLOWING)
        )
    return result


def _intersect(device: Any, ray: Any, active: Any) -> tuple[Any, Any, Any, Any]:
    """Find what rays meet first: bubble, glowing ball, body, or none of them."""
    if device.stage.bodies:
        si = device.stage.scene.ray_intersect(ray, mi.RayFlags.All, active)
        shape, valid = si.shape, active & si.is_valid()
    else:
        si = device.stage.scene.ray_intersect_preliminary(ray, False, active)
        shape, valid = si.shape, active & si.is_valid()
    bubble = valid & (shape == device.bubbles) if device.bubbles is not None else mi.Bool(False)
    ball = valid & (shape == device.balls) if device.balls is not None else mi.Bool(False)
    return si, bubble, ball, (valid & ~bubble & ~ball if device.stage.bodies else mi.Bool(False))


def _on_bubble(device: Any, ray: Any, number: Any, inside: Any, active: Any) -> tuple[Any, Any]:
    """Cross the surface of a bubble: positions and outward normals.

    Distances are taken from the point nearest to the bubble's centre: Mitsuba's own are of single
    precision from the ray's start.
    """
    center = dr.gather(mi.Point3f, device.centers, number, active)
    rows = [dr.gather(mi.Vector3f, row, number, active) for row in device.rows]
    near = dr.fma(ray.d, dr.dot(center - ray.o, ray.d), ray.o)
    offset = mi.Vector3f(near - center)
    p = mi.Vector3f(*(dr.dot(row, offset) for row in rows))
    d = mi.Vector3f(*(dr.dot(row, ray.d) for row in rows))
    a, b, c = dr.squared_norm(d), dr.dot(p, d), dr.squared_norm(p) - 1.0
    root = dr.sqrt(dr.maximum(b * b - a * c, 0.0))
    step = (dr.select(inside, root, -root) - b) / a
    on = dr.fma(d, step, p)
    normal = dr.normalize(on.x * rows[0] + on.y * rows[1] + on.z * rows[2])
    return dr.fma(ray.d, step, near), dr.select(active, normal, mi.Vector3f(0.0, 0.0, 1.0))


def _refract(device: Any, direction: Any, normal: Any, chance: Any, active: Any) -> tuple[Any, Any]:
    """Reflect or refract at a bubble's surface; also whether light crosses it."""
    along = -dr.dot(direction, normal)
    reflected, cosine, _, ratio = mi.fresnel(along, device.eta)
    refracted = active & (chance >= reflected)
    bent = ratio * direction + (ratio * along + cosine) * normal
    return dr.normalize(dr.select(refracted, bent, direction + 2.0 * along * normal)), refracted


def _glow(device: Any, ray: Any, number: Any, active: Any) -> Any:
    """Compute L / n^2 of a glowing ball along rays."""
    if device.cloud is None:
        return mi.Float(0.0)
    centers, first, second, bright = device.cloud
    offset = ray.o - dr.gather(mi.Point3f, centers, number, active)
    offset -= dr.dot(ray.d, offset) * ray.d
    x, y = (
        dr.dot(dr.gather(mi.Point3f, covector, number, active), offset)
        for covector in (first, second)
    )
    return (
        dr.exp(-0.5 * (x * x + y * y))
        * dr.gather(mi.Float, bright, number, active)
        * device.inverse_square
    )


def _body_radiance(device: Any, si: Any, active: Any) -> Any:
    total = mi.Float(0.0)
    if not device.stage.bodies or not (device.lamps or device.stage.lamps):
        return total
    context, bsdf = mi.BSDFContext(), si.bsdf()
    for lamp, power in device.lamps:
        direction = lamp - si.p
        distance = dr.norm(direction)
        toward = direction / distance
        shadow = device.stage.opaque_scene.ray_test(si.spawn_ray_to(mi.Point3f(lamp)), active)
        value = bsdf.eval(context, si, si.to_local(toward), active)
        total += dr.select(shadow, 0.0, np.pi * value.x * power / (distance * distance))
    smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    reflectance = bsdf.eval_diffuse_reflectance(si, active).x
    return total + dr.select(smooth, device.ambient * reflectance, 0.0)


def _scatter(si: Any, chance: Any, other: Any, active: Any, device: Any) -> tuple[Any, Any]:
    if not device.stage.bodies:
        return mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0)), mi.Float(0.0)
    sampled, value = si.bsdf().sample(
        mi.BSDFContext(),
        si,
        chance,
        mi.Point2f(other, dr.fma(chance, 7919.0, -dr.floor(chance * 7919.0))),
        active,
    )
    return si.spawn_ray(si.to_world(sampled.wo)), value.x
