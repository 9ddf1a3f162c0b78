"""Walls of the tank and the diffuser behind it, as rays meet them on the device.

Import this module only after sabench.utils.backend.mitsuba(), as `camera_rays`.

Walls are plane: rays cross them by Snell's and Fresnel's laws without a search.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sabench.simulation.rendering.bubble_stage import Panel, Stack
from sabench.simulation.rendering.camera_rays import opaque


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


def panel_of(panel: Panel | None) -> tuple[Any, ...] | None:
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
