"""Routes of light from particles to a camera, with and without reflections.

A reflection is unfolded: seen from the camera, a mirrored particle lies behind a thicker wall, on
a straight route of refractions alone. What a face reflects is Fresnel's share for unpolarised
light.
"""

from dataclasses import dataclass, replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Layer, Wall
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Route:
    """Route of light to one camera.

    Attributes
    ----------
    wall : what the light crosses, unfolded; None in plain air.
    normal : (3,) unit vector across the faces that reflect.
    offset_mm : further distance of the unfolded particle along the normal: its own distance from
        the plane below, or none.
    mirror_mm : position along the normal of the plane that mirrors particles; None if an even
        number of faces reflects.
    faces : refractive indices on both sides of each face that reflects.
    """

    wall: Wall | CylinderWall | None
    normal: F64
    offset_mm: float = 0.0
    mirror_mm: float | None = None
    faces: tuple[tuple[float, float], ...] = ()

    def behind(self, camera: Camera) -> Camera:
        """Return the camera in front of the unfolded wall."""
        return camera if self.wall is camera.wall else replace(camera, wall=self.wall)

    def place(self, points_mm: F64) -> F64:
        """Compute where the camera sees particles (n, 3), unfolded."""
        if not self.faces:
            return points_mm
        along = self.offset_mm * self.normal
        if self.mirror_mm is None:
            return np.asarray(points_mm + along)
        depth = self.mirror_mm - points_mm @ self.normal
        return np.asarray(points_mm + 2.0 * depth[:, None] * self.normal + along)

    def at_particle(self, arriving: F64) -> F64:
        """Turn directions (n, 3) at unfolded particles into those at the particles."""
        if self.mirror_mm is None:
            return arriving
        return np.asarray(arriving - 2.0 * (arriving @ self.normal)[:, None] * self.normal)

    def reflected(self, leaving: F64) -> F64:
        """Compute the reflected share (n,) of light along unit directions (n, 3).

        They are those away from the pinhole, in its medium.
        """
        share = np.ones(len(leaving))
        if self.wall is None or not self.faces:
            return share
        square = (self.wall.air_index**2) * (1.0 - (leaving @ self.normal) ** 2)  # (n sin)^2
        for before, after in self.faces:
            # n cos
            inner, outer = (np.sqrt(np.maximum(n**2 - square, 0.0)) for n in (before, after))
            across = (inner - outer) / (inner + outer)
            along = (after**2 * inner - before**2 * outer) / (after**2 * inner + before**2 * outer)
            share *= np.asarray(0.5 * (across**2 + along**2))
        return share


def direct(wall: Wall | CylinderWall | None) -> Route:
    """Return the route without reflections."""
    return Route(wall, np.zeros(3))


def reflections(wall: Wall, rear: tuple[Layer, ...]) -> list[Route]:
    """List the routes with reflections: one behind the fluid or two before it.

    Behind it are the faces of the back wall, with layers ordered from the fluid to the air; before
    it, light goes to and fro once between two faces of the wall. Routes with more reflections carry
    less than a thousandth of the light.
    """
    indices, layers = wall.indices, wall.layers
    routes = []
    for outer in range(len(layers)):
        for inner in range(outer + 1, len(layers) + 1):
            there = layers[outer:inner]
            unfolded = (*layers[:inner], *there[::-1], *there, *layers[inner:])
            extra = 2.0 * sum(layer.thickness_mm for layer in there)
            faces = ((indices[outer + 1], indices[outer]), (indices[inner], indices[inner + 1]))
            routes.append(
                Route(
                    replace(wall, layers=unfolded, depth_mm=None),
                    np.asarray(wall.normal),
                    extra,
                    faces=tuple((float(a), float(b)) for a, b in faces),
                )
            )
    return [*routes, *_from_behind(wall, rear)]


def _from_behind(wall: Wall, rear: tuple[Layer, ...]) -> list[Route]:
    if wall.depth_mm is None:
        return []
    normal, fluid = np.asarray(wall.normal), wall.fluid_index
    inner_mm = float(np.asarray(wall.point_mm) @ normal) + wall.thickness_mm
    media = (fluid, *(layer.index for layer in rear), wall.air_index)
    routes = []
    for face in range(len(rear) + 1):
        passed = rear[:face]
        unfolded = (*wall.layers, Layer("fluid", fluid, wall.depth_mm), *passed, *passed[::-1])
        extra = 2.0 * sum(layer.thickness_mm for layer in passed)
        routes.append(
            Route(
                replace(wall, layers=unfolded, depth_mm=None),
                normal,
                extra,
                inner_mm + wall.depth_mm,
                ((media[face], media[face + 1]),),
            )
        )
    return routes
