"""Routes of light from particles to a camera, with and without reflections.

A reflection is unfolded: seen from the camera, a mirrored particle lies behind a thicker wall, on
a straight route of refractions alone. What a face reflects is Fresnel's share for unpolarised
light.
"""

import functools
from dataclasses import dataclass, field, replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Layer, Wall
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Route:
    """Route of light to one camera, by default the one without reflections.

    Attributes
    ----------
    wall : what the light crosses, unfolded; None in plain air.
    normal : (3,) unit vector across the faces that reflect; any if there are none.
    offset_mm : further distance of the unfolded particle along the normal: its own distance from
        the plane below, or none.
    mirror_mm : position along the normal of the plane that mirrors particles; None if an even
        number of faces reflects.
    faces : refractive indices on both sides of each face that reflects.
    """

    wall: Wall | CylinderWall | None
    normal: F64 = field(default_factory=functools.partial(np.zeros, 3))
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


def reflections(wall: Wall, rear: tuple[Layer, ...]) -> list[Route]:
    """List the routes with reflections: one behind the fluid or two before it.

    Behind it are the faces of the back wall, with layers ordered from the fluid to the air; before
    it, light goes to and fro once between two faces of the wall. Routes with more reflections carry
    less than a thousandth of the light.
    """
    indices, layers, normal = wall.indices, wall.layers, np.asarray(wall.normal)
    routes = []
    for outer in range(len(layers)):
        for inner in range(outer + 1, len(layers) + 1):
            there = layers[outer:inner]
            layers_unfolded = (*layers[:inner], *there[::-1], *there, *layers[inner:])
            unfolded = replace(wall, layers=layers_unfolded, depth_mm=None)
            extra = 2.0 * sum(layer.thickness_mm for layer in there)
            faces = ((indices[outer + 1], indices[outer]), (indices[inner], indices[inner + 1]))
            pairs = tuple((float(a), float(b)) for a, b in faces)
            routes.append(Route(unfolded, normal, extra, faces=pairs))
    if wall.depth_mm is None:
        return routes
    inner_mm = float(np.asarray(wall.point_mm) @ normal) + wall.thickness_mm
    mirror_mm = inner_mm + wall.depth_mm
    fluid = Layer("fluid", wall.fluid_index, wall.depth_mm)
    media = (wall.fluid_index, *(layer.index for layer in rear), wall.air_index)
    for face in range(len(rear) + 1):
        passed = rear[:face]
        layers_unfolded = (*layers, fluid, *passed, *passed[::-1])
        unfolded = replace(wall, layers=layers_unfolded, depth_mm=None)
        extra = 2.0 * sum(layer.thickness_mm for layer in passed)
        routes.append(Route(unfolded, normal, extra, mirror_mm, ((media[face], media[face + 1]),)))
    return routes
