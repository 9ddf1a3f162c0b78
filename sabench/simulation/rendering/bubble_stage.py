"""Stage of a render: bubbles, drops, bodies, tracers, walls and lights.

Positions are relative to the lamps' centre, because Mitsuba has single precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Layer, Wall, transmittance
from sabench.scenes.illumination import Backlight, Lighting
from sabench.simulation.rendering.lamps import Lamps, facing_of, place_lamps
from sabench.simulation.rendering.particle_images import ParticleImages
from sabench.simulation.rendering.particles_traced import balls, ellipsoids, glow_of
from sabench.simulation.rendering.pixel_truth import mesh_of
from sabench.utils import backend
from sabench.utils.arrays import F64, unit

if TYPE_CHECKING:
    from sabench.simulation.rendering.particle_integrator import GlowingBalls


@dataclass(frozen=True)
class Stack:
    """Plane layers between the fluid and the air, in the order light leaves.

    Attributes
    ----------
    faces_mm : (m,) positions of the interfaces along the wall's normal, in the frame of the render.
    indices : (m + 1,) refractive indices, the fluid's first.
    """

    faces_mm: F64
    indices: F64


@dataclass(frozen=True)
class LightPanel:
    """Diffuser: centre in the frame of the render, half edges (2, 3), radiance."""

    center: F64
    edges: F64
    radiance: float


@dataclass(frozen=True)
class Stage:
    """Everything that light meets, in the frame of the render.

    Attributes
    ----------
    scene : Mitsuba's, with a shape for the bubbles (`bubbles`), one for glowing balls (`balls`) and
        the bodies; any may be missing.
    opaque_scene : Mitsuba's, of the bodies that throw shadows alone; None without lamps.
    centers, to_ball : of the bubbles (n, 3), (n, 3, 3), as in `world.Bubbles`.
    eta : refractive index in the bubbles over the fluid's; fluid : the fluid's over the air's.
    normal : of the walls, from the cameras into the tank; front, rear None: no wall there.
    radius : of a ball around the frame's origin that holds all of it.
    """

    scene: Any
    centers: F64
    to_ball: F64
    eta: float
    fluid: float
    normal: F64
    front: Stack | None
    rear: Stack | None
    panel: LightPanel | None
    radius: float
    bubbles: Any = None
    balls: Any = None
    cloud: GlowingBalls | None = None
    lamps: Lamps | None = None
    opaque_scene: Any = None
    bodies: bool = False
    occluders: tuple[Disc, ...] = ()


@dataclass(frozen=True)
class Tank:
    """Walls around the fluid.

    `wall` is in front of the cameras; `rear` are the layers of the back wall, the fluid's side
    first. None: no walls.
    """

    wall: Wall | None
    rear: tuple[Layer, ...] = ()

    @property
    def fluid_index(self) -> float:
        """Refractive index of the fluid."""
        return self.wall.fluid_index if self.wall else 1.0

    def straight(self) -> float:
        """Compute the share of light that both walls pass at normal incidence."""
        if self.wall is None:
            return 1.0
        back = replace(self.wall, layers=self.rear)
        normal, start = np.asarray(self.wall.normal)[None], np.asarray(self.wall.point_mm)
        passed = (transmittance(wall, start, normal)[0] for wall in (self.wall, back))
        return float(next(passed) * next(passed))


@dataclass(frozen=True)
class Lights:
    """Lights of a scene.

    `center_mm` is where the lamps' exposure holds; `full_photons` fill the well of a pixel in the
    image's middle.
    """

    backlight: Backlight | None
    lighting: Lighting | None
    center_mm: F64
    full_photons: float


class Stager:
    """Builder of Mitsuba's scene, anew for every moment if bubbles move."""

    def __init__(
        self,
        camera: Camera,
        tank: Tank,
        bubbles: Bubbles,
        bodies: Sequence[tuple[Solid, Material]],
        lights: Lights,
        occluders: tuple[Disc, ...],
        images: ParticleImages | None,
        particles_mm: F64 | None,
    ) -> None:
        self._mi = backend.mitsuba()
        self.origin = lights.center_mm
        self._camera, self._tank = camera, tank
        self._bubbles, self._occluders = bubbles, occluders
        self._bodies = {
            f"body_{i}": _mesh(self._mi, solid, material, self.origin, tank)
            for i, (solid, material) in enumerate(bodies)
        }
        opaque = {
            name: self._bodies[name]
            for name, (_, material) in zip(self._bodies, bodies, strict=True)
            if material.kind != "liquid"
        }
        throws = bool(opaque and lights.lighting)
        self._shadows = self._mi.load_dict({"type": "scene", **opaque}) if throws else None
        self._cloud = _cloud(camera, images, particles_mm, self.origin)
        full = lights.full_photons / float(camera.etendue().max())  # radiance
        self._panel = _panel(lights.backlight, self.origin, full / tank.straight())
        self._lamps = _lamps(lights.lighting, camera, self.origin, full)
        shining = [light.exposure for light in (lights.backlight, lights.lighting) if light]
        self.brightest = max(shining, default=1.0) * full
        self._radius = _bounding_radius(bubbles, bodies, self._cloud, self.origin)
        self._made: tuple[float, Stage] | None = None

    def __call__(self, delay_s: float) -> Stage:
        """Return the stage at a time from the middle of the exposure."""
        moving = bool(np.any(self._bubbles.velocity_mm_s)) and delay_s != 0.0
        moment = delay_s if moving else 0.0
        if self._made is None or self._made[0] != moment:
            center_mm = self._bubbles.center_mm + moment * self._bubbles.velocity_mm_s
            self._made = moment, self._stage(replace(self._bubbles, center_mm=center_mm))
        return self._made[1]

    def _stage(self, bubbles: Bubbles) -> Stage:
        mi, tank = self._mi, self._tank
        centers = bubbles.center_mm - self.origin
        shapes: dict[str, Any] = dict(self._bodies)
        if len(bubbles):
            from scipy.spatial.transform import Rotation

            rotations = Rotation.from_matrix(bubbles.turn.transpose(0, 2, 1)).as_quat()
            data = np.hstack([centers, bubbles.semi_axes_mm, rotations])
            shapes["bubbles"] = ellipsoids(mi, data)
        if self._cloud is not None:
            shapes["balls"] = balls(mi, self._cloud.centers, self._cloud.radii)
        scene = mi.load_dict({"type": "scene", **shapes})
        named = {shape.id(): shape for shape in scene.shapes()}
        front, rear = _stacks(tank, self.origin)
        normal = np.asarray(tank.wall.normal) if tank.wall else np.asarray(self._camera.rotation[2])
        return Stage(
            scene,
            centers,
            bubbles.to_ball,
            bubbles.index / tank.fluid_index,
            tank.wall.fluid_index / tank.wall.air_index if tank.wall else 1.0,
            normal,
            front,
            rear,
            self._panel,
            self._radius,
            named.get("bubbles"),
            named.get("balls"),
            self._cloud,
            self._lamps,
            self._shadows,
            bool(self._bodies),
            self._occluders,
        )


def _mesh(mi: Any, solid: Solid, material: Material, origin: F64, tank: Tank) -> Any:
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_bsdf(material, tank))
    smooth = material.kind == "liquid"
    return mesh_of(mi, solid, origin, has_vertex_normals=smooth, props=properties)


def _bsdf(material: Material, tank: Tank) -> dict[str, Any]:
    if material.kind == "liquid":
        return {"type": "dielectric", "int_ior": material.index, "ext_ior": tank.fluid_index}
    if material.kind == "measured":
        return {"type": "measured", "filename": material.measured}
    color = {"type": "uniform", "value": material.reflectance}
    if material.kind == "matte":
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}
    rest = {name: getattr(material, name) for name in ("roughness", "metallic", "specular")}
    return {"type": "twosided", "bsdf": {"type": "principled", "base_color": color, **rest}}


def _cloud(
    camera: Camera, images: ParticleImages | None, positions_mm: F64 | None, origin: F64
) -> GlowingBalls | None:
    if images is None or positions_mm is None:
        return None
    bright = (images.intensity > 0.0) & np.isfinite(images.sigma_px)
    if not bright.any():
        return None
    from sabench.simulation.rendering.particle_integrator import GlowingBalls  # needs the variant

    glow = glow_of(images, images.shape_mm(camera, positions_mm), bright)
    return GlowingBalls(positions_mm[bright] - origin, *glow)


def _stacks(tank: Tank, origin: F64) -> tuple[Stack | None, Stack | None]:
    """List layers of both walls from the fluid outwards; None where there is no wall."""
    wall = tank.wall
    if wall is None:
        return None, None
    start = -float(wall.depth_of(origin))  # of the outer face, along the normal
    front = Stack(start + wall.interface_depths_mm[::-1], wall.indices[::-1])
    if wall.depth_mm is None:
        return front, None
    inner = start + wall.thickness_mm + wall.depth_mm
    faces = inner + np.cumsum([0.0, *(layer.thickness_mm for layer in tank.rear)])
    indices = [wall.fluid_index, *(layer.index for layer in tank.rear), wall.air_index]
    return front, Stack(faces, np.array(indices))


def _panel(light: Backlight | None, origin: F64, full: float) -> LightPanel | None:
    if light is None:
        return None
    normal = unit(light.normal)
    across = np.asarray(light.x_axis) - np.dot(light.x_axis, normal) * normal
    across /= np.linalg.norm(across)
    width, height = light.size_mm
    edges = np.stack([across * width / 2.0, np.cross(normal, across) * height / 2.0])
    return LightPanel(np.asarray(light.center_mm) - origin, edges, light.exposure * full)


def _lamps(light: Lighting | None, camera: Camera, origin: F64, full: float) -> Lamps | None:
    if not light:
        return None
    # their exposure is seen through the front wall
    pinhole, facing = np.asarray(camera.center_mm), facing_of(camera)
    behind = full / float(transmittance(camera.wall, pinhole, facing[None])[0])
    return place_lamps(light, camera, origin, origin, behind)


def _bounding_radius(
    bubbles: Bubbles,
    bodies: Sequence[tuple[Solid, Material]],
    cloud: GlowingBalls | None,
    origin: F64,
) -> float:
    corners = [
        np.linalg.norm(bubbles.center_mm - origin, axis=1)
        + bubbles.semi_axes_mm.max(axis=1, initial=0.0)
    ]
    corners += [np.linalg.norm(solid.vertices_mm - origin, axis=1) for solid, _ in bodies]
    if cloud is not None:
        corners.append(np.linalg.norm(cloud.centers, axis=1) + cloud.radii)
    return 1.01 * max((float(part.max(initial=0.0)) for part in corners), default=0.0) + 1.0
