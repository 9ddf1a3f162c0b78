"""Renderer of bubbles, drops, bodies and tracers, to a requested accuracy.

A diffuser or lamps illuminate the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, uniform_filter

from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Layer, Wall, transmittance
from sabench.scenes.illumination import Backlight, Lighting
from sabench.simulation.rendering.lamps import place_lamps
from sabench.simulation.rendering.mesh_intersection import mesh_of
from sabench.simulation.rendering.particle_images import ParticleImages, diffraction_px
from sabench.simulation.rendering.particles_traced import balls, glow_of
from sabench.utils import backend
from sabench.utils.arrays import F64, I64

if TYPE_CHECKING:
    from sabench.simulation.rendering import bubble_integrator

_RAYS = 16  # of a pixel in one pass
_PASSES = 4  # at least: their scatter is the error
_MOST = 1 << 16  # rays per pixel at most: a guard
_SEEDS = 1 << 22
# of the diffuser: below this the error of a pixel is taken relative to it, not to the pixel
_DARK = 0.02


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

    @property
    def fluid_over_air(self) -> float:
        """Refractive index of the fluid over that of the cameras' medium."""
        return self.wall.fluid_index / self.wall.air_index if self.wall else 1.0

    def straight(self) -> float:
        """Compute the share of light that both walls pass at normal incidence."""
        if self.wall is None:
            return 1.0
        back = replace(self.wall, layers=self.rear)
        normal = np.asarray(self.wall.normal)[None]
        return float(transmittance(self.wall, normal)[0] * transmittance(back, normal)[0])


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


@dataclass(frozen=True)
class Exposed:
    """Rendered image: photons (rows, columns), and their error.

    `error` is the mean over the pixels of standard error over value.
    """

    photons: F64
    error: float


def render(
    camera: Camera,
    tank: Tank,
    bubbles: Bubbles,
    bodies: Sequence[tuple[Solid, Material]],
    lights: Lights,
    error: float,
    seed: int,
    *,
    occluders: tuple[Disc, ...] = (),
    images: ParticleImages | None = None,
    particles_mm: F64 | None = None,
    exposure_s: float = 0.0,
) -> Exposed:
    """Render until the mean relative standard error of pixels reaches `error`.

    All pixels get some rays, those with a larger error than asked for get more. Bubbles that move
    during the exposure are moved from pass to pass.

    Parameters
    ----------
    images, particles_mm : glowing particles among them, as `image_particles` gives them, and where
        they are.
    exposure_s : for how long the bubbles move.
    """
    scale = camera.etendue()
    stage_of = _Stager(camera, tank, bubbles, bodies, lights, occluders, images, particles_mm)
    floor = _DARK * stage_of.brightest
    moments = _moments(camera, bubbles, exposure_s)
    delays = exposure_s * ((np.arange(moments) + 0.5) / moments - 0.5)
    tally = _Tally((camera.rows, camera.columns))
    chosen, number = np.arange(tally.count.size), 0
    while True:
        tally.add(chosen, _pass(stage_of, camera, chosen, delays, seed + number))
        number += 1
        if number < _PASSES:
            continue
        off = tally.errors(floor)
        rough = maximum_filter(
            (off > error).reshape(scale.shape), 3
        ).ravel()  # a pixel's error is that of its neighbours, too
        chosen = np.flatnonzero(rough & (tally.count * _RAYS < _MOST))
        if off.mean() <= error or not chosen.size:
            break
    photons = tally.mean.reshape(scale.shape) * scale
    wavelength = next(
        (light.wavelength_nm for light in (lights.backlight, lights.lighting) if light is not None),
        None,
    )
    blurred = (
        photons
        if wavelength is None
        else np.asarray(gaussian_filter(photons, diffraction_px(camera, wavelength)))
    )
    return Exposed(blurred, float(off.mean()))


def _pass(stage_of: _Stager, camera: Camera, chosen: I64, delays: F64, seed: int) -> F64:
    """Render pixels' radiance (n,) by some rays each, spread over the exposure."""
    from sabench.simulation.rendering import bubble_integrator  # needs the variant

    rays, total = -(-_RAYS // len(delays)), np.zeros(len(chosen))
    for number, delay in enumerate(delays.tolist()):
        total += bubble_integrator.radiance(
            stage_of(delay),
            camera,
            stage_of.origin,
            chosen,
            rays,
            (seed * len(delays) + number) % _SEEDS,
        )
    return np.asarray(total / len(delays))


def _moments(camera: Camera, bubbles: Bubbles, exposure_s: float) -> int:
    """Count the rendered moments: one for each half pixel of the longest path."""
    if not len(bubbles) or exposure_s == 0.0 or not np.any(bubbles.velocity_mm_s):
        return 1
    ends = [
        camera.project(bubbles.center_mm + sign * 0.5 * exposure_s * bubbles.velocity_mm_s)[0]
        for sign in (-1.0, 1.0)
    ]
    lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
    return int(np.ceil(2.0 * np.nanmax(lengths))) if np.isfinite(lengths).any() else 1


class _Tally:
    """Mean and scatter of every pixel's passes, updated by Welford's method."""

    def __init__(self, shape: tuple[int, int]) -> None:
        size = shape[0] * shape[1]
        self._shape = shape
        self.count, self.mean, self._squares = np.zeros(size), np.zeros(size), np.zeros(size)

    def add(self, where: Any, values: F64) -> None:
        self.count[where] += 1.0
        off = values - self.mean[where]
        self.mean[where] += off / self.count[where]
        self._squares[where] += off * (values - self.mean[where])

    def errors(self, floor: float) -> F64:
        """Compute standard errors over values, or over `floor` in darker pixels.

        A few rays that have found a pixel dark may have missed what its neighbours show: variances
        start from the mean over nine pixels, which counts as `_PASSES` passes.
        """
        variance = self._squares / (self.count * np.maximum(self.count - 1.0, 1.0))
        around = uniform_filter(variance.reshape(self._shape), 3).ravel()
        mixed = (self.count * variance + _PASSES * around) / (self.count + _PASSES)
        return np.asarray(
            np.sqrt(np.maximum(mixed, 0.0)) / np.maximum(self.mean, max(floor, 1e-300))
        )


class _Stager:
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
        from sabench.simulation.rendering import bubble_integrator as paths  # needs the variant

        self._paths = paths
        self.origin = lights.center_mm
        self._camera, self._tank, self._bubbles, self._lights, self._occluders = (
            camera,
            tank,
            bubbles,
            lights,
            occluders,
        )
        self._bodies = {
            f"body_{i}": _mesh(self._mi, solid, material, self.origin, tank)
            for i, (solid, material) in enumerate(bodies)
        }
        shadows = {
            name: self._bodies[name]
            for name, (_, material) in zip(self._bodies, bodies, strict=True)
            if material.kind != "liquid"
        }
        self._shadows = (
            self._mi.load_dict({"type": "scene", **shadows})
            if lights.lighting and shadows
            else None
        )
        self._cloud = _cloud(self._paths, camera, images, particles_mm, self.origin)
        full = lights.full_photons / float(camera.etendue().max())  # radiance
        self._panel = _panel(self._paths, lights.backlight, self.origin, full / tank.straight())
        facing = np.asarray(camera.wall.normal if camera.wall else camera.rotation[2])
        behind = full / float(transmittance(camera.wall, facing[None])[0])
        self._lamps = (
            place_lamps(lights.lighting, camera, self.origin, self.origin, behind)
            if lights.lighting
            else None
        )
        shining = [
            light.exposure for light in (lights.backlight, lights.lighting) if light is not None
        ]
        self.brightest = max(shining, default=1.0) * full
        corners = [
            np.linalg.norm(bubbles.center_mm - self.origin, axis=1)
            + bubbles.semi_axes_mm.max(axis=1, initial=0.0)
        ]
        corners += [np.linalg.norm(solid.vertices_mm - self.origin, axis=1) for solid, _ in bodies]
        if self._cloud is not None:
            corners.append(np.linalg.norm(self._cloud.centers, axis=1) + self._cloud.radii)
        self._reach = (
            1.01 * max((float(part.max(initial=0.0)) for part in corners), default=0.0) + 1.0
        )
        self._made: tuple[float, bubble_integrator.Stage] | None = None

    def __call__(self, delay_s: float) -> bubble_integrator.Stage:
        moving = bool(np.any(self._bubbles.velocity_mm_s)) and delay_s != 0.0
        moment = delay_s if moving else 0.0
        if self._made is None or self._made[0] != moment:
            self._made = (
                moment,
                self._stage(
                    replace(
                        self._bubbles,
                        center_mm=self._bubbles.center_mm + moment * self._bubbles.velocity_mm_s,
                    )
                ),
            )
        return self._made[1]

    def _stage(self, bubbles: Bubbles) -> bubble_integrator.Stage:
        mi, tank = self._mi, self._tank
        centers = bubbles.center_mm - self.origin
        shapes: dict[str, Any] = dict(self._bodies)
        if len(bubbles):
            shapes["bubbles"] = _ellipsoids(mi, centers, bubbles)
        if self._cloud is not None:
            shapes["balls"] = balls(mi, self._cloud.centers, self._cloud.radii)
        scene = mi.load_dict({"type": "scene", **shapes})
        named = {shape.id(): shape for shape in scene.shapes()}
        front, rear = _stacks(self._paths, tank, self.origin)
        normal = np.asarray(tank.wall.normal) if tank.wall else np.asarray(self._camera.rotation[2])
        return self._paths.Stage(
            scene,
            centers,
            bubbles.to_ball,
            bubbles.index / tank.fluid_index,
            tank.fluid_over_air,
            normal,
            front,
            rear,
            self._panel,
            self._reach,
            named.get("bubbles"),
            named.get("balls"),
            self._cloud,
            self._lamps,
            self._shadows,
            bool(self._bodies),
            self._occluders,
        )


def _ellipsoids(mi: Any, centers: F64, bubbles: Bubbles) -> dict[str, Any]:
    """Describe all bubbles as one shape."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_matrix(bubbles.turn.transpose(0, 2, 1)).as_quat()
    data = np.hstack([centers, bubbles.semi_axes_mm, rotations]).astype(np.float32)
    return {
        "type": "ellipsoids",
        "data": mi.TensorXf(data),
        "extent": 1.0,
        "bsdf": {"type": "diffuse"},
    }


def _mesh(mi: Any, solid: Solid, material: Material, origin: F64, tank: Tank) -> Any:
    """Convert a body to a mesh of Mitsuba's."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_bsdf(material, tank))
    return mesh_of(
        mi, solid, origin, has_vertex_normals=material.kind == "liquid", props=properties
    )


def _bsdf(material: Material, tank: Tank) -> dict[str, Any]:
    if material.kind == "liquid":
        return {"type": "dielectric", "int_ior": material.index, "ext_ior": tank.fluid_index}
    if material.kind == "measured":
        return {"type": "measured", "filename": material.measured}
    color = {"type": "uniform", "value": material.reflectance}
    if material.kind == "matte":
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}
    rest = {
        "roughness": material.roughness,
        "metallic": material.metallic,
        "specular": material.specular,
    }
    return {"type": "twosided", "bsdf": {"type": "principled", "base_color": color, **rest}}


def _cloud(
    paths: Any, camera: Camera, images: ParticleImages | None, positions_mm: F64 | None, origin: F64
) -> Any:
    if images is None or positions_mm is None:
        return None
    bright = (images.intensity > 0.0) & np.isfinite(images.sigma_px)
    if not bright.any():
        return None
    return paths.Cloud(
        positions_mm[bright] - origin,
        *glow_of(images, images.shape_mm(camera, positions_mm), bright),
    )


def _stacks(paths: Any, tank: Tank, origin: F64) -> tuple[Any, Any]:
    """List layers of both walls from the fluid outwards; None where there is no wall."""
    wall = tank.wall
    if wall is None:
        return None, None
    start = -float(
        wall.depth_of(origin)
    )  # of the outer face, along the normal, in the frame of the render
    front = paths.Stack(start + wall.interface_depths_mm[::-1], wall.indices[::-1])
    if wall.depth_mm is None:
        return front, None
    inner = start + wall.thickness_mm + wall.depth_mm
    faces = inner + np.cumsum([0.0, *(layer.thickness_mm for layer in tank.rear)])
    return front, paths.Stack(
        faces, np.array([wall.fluid_index, *(layer.index for layer in tank.rear), wall.air_index])
    )


def _panel(paths: Any, light: Backlight | None, origin: F64, full: float) -> Any:
    if light is None:
        return None
    normal = np.asarray(light.normal) / np.linalg.norm(light.normal)
    across = np.asarray(light.x_axis) - np.dot(light.x_axis, normal) * normal
    across /= np.linalg.norm(across)
    edges = np.stack(
        [across * light.size_mm[0] / 2.0, np.cross(normal, across) * light.size_mm[1] / 2.0]
    )
    return paths.Panel(np.asarray(light.center_mm) - origin, edges, light.exposure * full)
