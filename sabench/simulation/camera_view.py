"""View of one camera: photons of a frame, their truth, and grey values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sabench.api.truth import NOTHING, Bubbles, Sight
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes import Scene
from sabench.scenes.tank import build_wall
from sabench.simulation.frames import FrameContent, Tracers, find_hidden
from sabench.simulation.rendering import (
    bubbles_traced,
    particles_splatted,
    particles_traced,
    targets_traced,
)
from sabench.simulation.rendering.background import flicker, static_light
from sabench.simulation.rendering.bubble_stage import Lights, Tank
from sabench.simulation.rendering.light_routes import Route, direct, reflections
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles
from sabench.simulation.rendering.particles_splatted import render_with_rings
from sabench.simulation.rendering.pixel_truth import see
from sabench.simulation.rendering.sensor import expose, full_well_photons, make_pattern
from sabench.utils.arrays import F64, U16
from sabench.utils.rng import stream

_ERROR = 0.04  # of pixels that show bubbles and bodies, unless the scene says otherwise
_GLOW_ERROR = 1.0  # of tracers among bubbles: few rays, as their images are smooth


@dataclass(frozen=True)
class CameraView:
    """Photons that one camera receives of a frame, and the truth of its image.

    Attributes
    ----------
    photons : (rows, columns) mean number that each pixel receives in one exposure.
    particles : images of the tracers; None without any.
    sight : what each pixel sees of bubbles and bodies; None without any.
    """

    camera: Camera
    photons: F64
    particles: ParticleImages | None = None
    sight: Sight | None = None

    def radiance(self) -> F64:
        """Compute radiance (rows, columns) in front of the lens, photons / (mm2 sr).

        0 where a distorted lens shows nothing.
        """
        etendue, dark = self.camera.etendue(), np.zeros_like(self.photons)
        return np.divide(self.photons, etendue, out=dark, where=etendue > 0.0)


def render(frame: FrameContent, camera: int) -> CameraView:
    """Render a frame as one camera of its rig sees it; `camera` is its number there."""
    if frame.target is not None:
        return _render_target(frame, camera)
    if frame.bubbles is not None:
        return _render_bubbles(frame, frame.bubbles, camera)
    if frame.tracers is not None:
        return _render_tracers(frame, frame.tracers, camera)
    raise ValueError(f"frame {frame.number}: expected something to render, got an empty frame")


def _render_tracers(frame: FrameContent, tracers: Tracers, number: int) -> CameraView:
    """Render tracers alone."""
    camera, scene, tracers = frame.rig.cameras[number], frame.scene, tracers.of_camera(number)
    images = _image(frame, tracers, camera)
    if scene.cameras.airy_rings:
        wavelength = scene.light.wavelength_nm
        photons = render_with_rings(camera, wavelength, lambda fine: _take(frame, tracers, fine))
    else:
        photons = _take(frame, tracers, camera, images)
    return CameraView(camera, photons, particles=images)


def _take(
    frame: FrameContent, tracers: Tracers, camera: Camera, known: ParticleImages | None = None
) -> F64:
    """Take the photons of one exposure on all routes, the mean over the pulse.

    Parameters
    ----------
    known : images on the direct route at the middle of the pulse, where they were computed.
    """
    parts = _parts(frame, tracers, camera, known)
    total, moments = next(parts), len(tracers.positions_mm)
    for part in parts:
        total += part
    return total if moments == 1 else total / moments


def _parts(
    frame: FrameContent, tracers: Tracers, camera: Camera, known: ParticleImages | None
) -> Iterator[F64]:
    """Yield the photons of each moment of the pulse on each route."""
    for positions in tracers.positions_mm:
        middle, moment = positions is tracers.particles.position_mm, tracers
        if not middle:
            moment = replace(tracers, particles=replace(tracers.particles, position_mm=positions))
        for route in _routes(frame.scene, camera):
            images = (
                known
                if known is not None and middle and not route.faces
                else _image(frame, moment, camera, route)
            )
            yield _take_part(frame, route.behind(camera), images, route.place(positions))


def _routes(scene: Scene, camera: Camera) -> list[Route]:
    """List the routes of light to a camera that the scene asks for."""
    routes = [direct(camera.wall)]
    if scene.plane is not None and scene.plane.mirrors and isinstance(camera.wall, Wall):
        rear = [Layer(layer.name, layer.index, layer.thickness_mm) for layer in scene.rear]
        routes += reflections(camera.wall, tuple(rear))
    return routes


def _take_part(frame: FrameContent, camera: Camera, images: ParticleImages, at_mm: F64) -> F64:
    """Take the photons of one part of a pulse on one route."""
    if frame.renderer == "splat":
        return particles_splatted.render(camera, images)
    samples = frame.scene.render.samples_per_pixel
    occluders = frame.rig.occluders_of(camera)
    radiance = particles_traced.render(camera, images, at_mm, samples, occluders)
    return radiance * camera.etendue()


def _image(
    frame: FrameContent, tracers: Tracers, camera: Camera, route: Route | None = None
) -> ParticleImages:
    occluders = frame.rig.occluders_of(camera)
    given = (tracers.particles, tracers.scatterers, occluders, route)
    images = image_particles(frame.scene, camera, *given)
    if tracers.share == 1.0:
        return images
    return replace(
        images,
        photons=images.photons * tracers.share,
        intensity=images.intensity * tracers.share,
        visible=images.visible & (tracers.share > 0.0),
    )


def _render_bubbles(frame: FrameContent, bubbles: Bubbles, number: int) -> CameraView:
    """Render bubbles and bodies, with or without tracers among them."""
    scene, camera = frame.scene, frame.rig.cameras[number]
    tank, seed = tank_of(scene), frame.path_seed(number)
    lights, sight = lights_of(scene), see(camera, bubbles, frame.solids)
    # pixels that show bubbles or bodies, or are next to them
    from scipy.ndimage import maximum_filter  # takes long to load

    counted = np.asarray(maximum_filter(sight.number != NOTHING, 3))
    shown = bubbles_traced.render(
        camera,
        tank,
        bubbles,
        frame.bodies,
        lights,
        scene.render.relative_error or _ERROR,
        seed,
        counted=counted,
        occluders=frame.rig.occluders,
        exposure_s=scene.sensor.exposure_s,
    )
    sight = replace(sight, error=shown.error)
    if frame.tracers is None:
        return CameraView(camera, shown.photons, sight=sight)
    images = _image_tracers(frame, frame.tracers, camera, sight)
    glow = bubbles_traced.render(
        camera,
        tank,
        bubbles,
        frame.bodies,
        replace(lights, backlight=None, lighting=None),
        _GLOW_ERROR,
        seed + (1 << 20),
        counted=counted,
        occluders=frame.rig.occluders,
        images=images,
        particles_mm=frame.tracers.particles.position_mm,
    )
    photons = shown.photons + glow.photons
    return CameraView(camera, photons, particles=images, sight=sight)


def tank_of(scene: Scene) -> Tank:
    """Return the walls in front of and behind bubbles and bodies."""
    rear = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in scene.rear)
    return Tank(build_wall(scene.plane) if scene.plane else None, rear)


def lights_of(scene: Scene) -> Lights:
    """Return the lights of a scene without the laser."""
    center = np.asarray(scene.volume.center_mm)
    return Lights(scene.backlight, scene.lighting, center, full_well_photons(scene.sensor))


def _image_tracers(
    frame: FrameContent, tracers: Tracers, camera: Camera, sight: Sight
) -> ParticleImages:
    """Image tracers among bubbles and bodies.

    They are dark in shadows, and invisible behind bubbles and bodies.
    """
    images = _image(frame, tracers, camera)
    covered = find_hidden(camera, tracers.particles.position_mm, images.pixel, sight)
    reached = True if tracers.illuminated is None else tracers.illuminated
    return replace(
        images,
        photons=images.photons * reached,
        intensity=images.intensity * reached,
        visible=images.visible & ~covered,
    )


def _render_target(frame: FrameContent, number: int) -> CameraView:
    """Render a calibration target under lamps."""
    scene, camera = frame.scene, frame.rig.cameras[number]
    if scene.lighting is None or frame.target is None or frame.pose is None:
        raise ValueError(f"frame {frame.number}: expected a target under lamps")
    saturation = targets_traced.render(
        camera,
        frame.target,
        frame.pose,
        scene.lighting,
        np.asarray(scene.volume.center_mm),
        scene.render.samples_per_pixel,
    )
    return CameraView(camera, full_well_photons(scene.sensor) * saturation)


def record_image(frame: FrameContent, view: CameraView, camera: int) -> U16:
    """Record what a camera receives of a frame, by its number in the rig.

    Its sensor's pattern and the background are the same in every frame, and other ones in every
    camera: each has its own random stream.
    """
    scene, photons = frame.scene, _with_background(frame, view.photons, camera)
    sensor = scene.sensor.of_camera(camera)
    if scene.sensor.camera_exposure is not None:
        photons = photons * scene.sensor.camera_exposure[camera]
    pattern = None
    if sensor.has_pattern:
        rng = stream(frame.seed, "sensor pattern", camera)
        pattern = make_pattern(sensor, (view.camera.rows, view.camera.columns), rng)
    return expose(sensor, photons, frame.sensor_noise(camera), pattern)


def _with_background(frame: FrameContent, photons: F64, camera: int) -> F64:
    """Add the static light of a camera, as bright as it is in this frame."""
    table = frame.scene.background
    if table is None:
        return photons
    rows, columns = photons.shape
    light = static_light(table, (rows, columns), stream(frame.seed, "background", camera))
    bright = flicker(table, stream(frame.seed, "flicker", frame.number))
    return photons + bright * full_well_photons(frame.scene.sensor) * light
