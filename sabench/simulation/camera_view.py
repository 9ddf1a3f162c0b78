"""View of one camera: photons, background light, truth, grey values."""

import functools
from dataclasses import dataclass, replace

import numpy as np

from sabench.api.truth import NOTHING, Bubbles, Sight
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes import Scene
from sabench.scenes.build import build_wall
from sabench.scenes.illumination import Background
from sabench.simulation.frames import FrameContent, Tracers, find_hidden
from sabench.simulation.rendering import (
    bubbles_traced,
    particles_splatted,
    particles_traced,
    targets_traced,
)
from sabench.simulation.rendering.bubble_stage import Lights, Tank
from sabench.simulation.rendering.particle_images import (
    REACH,
    ParticleImages,
    Route,
    image_particles,
    reflections,
)
from sabench.simulation.rendering.pixel_truth import see
from sabench.simulation.rendering.sensor import expose, make_pattern
from sabench.utils.arrays import F64, U16
from sabench.utils.rng import stream

_WAVES = 3  # of the smooth light along either axis


def static_light(background: Background, shape: tuple[int, int], rng: np.random.Generator) -> F64:
    """Make the light (row, column) of one camera, in fractions of the full well.

    Smooth light is a sum of cosines, glints are Gaussians and dust is uniform discs, all at random
    positions.
    """
    weights, phases = rng.standard_normal((_WAVES,) * 2), rng.uniform(0.0, np.pi, (2, _WAVES))
    down, across = (
        np.cos(np.pi * np.arange(_WAVES)[:, None] * np.arange(size) / size + phase[:, None])
        for size, phase in zip(shape, phases, strict=True)
    )
    field = np.einsum("ij,ir,jc->rc", weights, down, across)
    field -= field.mean()
    field *= background.variation / np.abs(field).max(initial=1e-300)
    light = np.asarray((background.level or 0.0) * (1.0 + field))
    for _ in range(background.glints):
        middle, sigma = rng.uniform(0.0, shape), rng.uniform(*background.glint_sigma_px)
        window, square = _around(middle, REACH * sigma, shape)
        light[window] += background.glint_level * np.exp(-square / (2.0 * sigma**2))
    for _ in range(background.dust):
        middle, level = rng.uniform(0.0, shape), rng.uniform(0.0, background.dust_level)
        window, square = _around(middle, background.dust_radius_px + 1.0, shape)
        light[window] += level * np.clip(background.dust_radius_px - np.sqrt(square) + 0.5, 0, 1)
    return light


def flicker(background: Background, rng: np.random.Generator) -> float:
    """Draw a frame's factor, one for all cameras, since the laser's pulses differ."""
    return max(1.0 + (background.flicker or 0.0) * rng.standard_normal(), 0.0)


def _around(middle: F64, radius: float, shape: tuple[int, int]) -> tuple[tuple[slice, slice], F64]:
    """Cut the window of a radius around a point; also return squared distances in it."""
    low = np.clip(np.floor(middle - radius), 0, shape).astype(int)
    high = np.clip(np.ceil(middle + radius) + 1, 0, shape).astype(int)
    row, column = (np.arange(a, b) for a, b in zip(low, high, strict=True))
    window = slice(low[0], high[0]), slice(low[1], high[1])
    return window, (row[:, None] - middle[0]) ** 2 + (column - middle[1]) ** 2


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


def render_camera_view(frame: FrameContent, camera: int) -> CameraView:
    """Render a frame as one camera of its rig sees it; `camera` is its number there."""
    scene, lens = frame.scene, frame.rig.cameras[camera]
    if frame.target is not None:
        if scene.lighting is None or frame.pose is None:
            raise ValueError(f"frame {frame.number}: expected a target under lamps")
        center, samples = np.asarray(scene.volume.center_mm), scene.render.samples_per_pixel
        saturation = targets_traced.render(
            lens, frame.target, frame.pose, scene.lighting, center, samples
        )
        return CameraView(lens, scene.sensor.full_well_photons * saturation)
    if frame.bubbles is not None:
        return _render_bubbles(frame, frame.bubbles, camera)
    if frame.tracers is None:
        raise ValueError(f"frame {frame.number}: expected something to render, got an empty frame")
    tracers = frame.tracers
    if tracers.exposed is not None:  # the camera records a part of the pulse
        particles, positions, share = tracers.exposed(camera)
        tracers = replace(tracers, particles=particles, positions_mm=positions, share=share)
    given = tracers.particles, tracers.scatterers, frame.rig.occluders_of(lens)
    images = image_particles(scene, lens, *given, None, tracers.share)
    if scene.cameras.airy_rings:
        photons = particles_splatted.render_with_rings(
            lens, scene.light.wavelength_nm, lambda fine: _collect_photons(frame, tracers, fine)
        )
    else:
        photons = _collect_photons(frame, tracers, lens, images)
    return CameraView(lens, photons, particles=images)


def _collect_photons(
    frame: FrameContent, tracers: Tracers, camera: Camera, known: ParticleImages | None = None
) -> F64:
    """Add the photons of all routes, and take the mean over the moments of the pulse.

    `known` are the images on the direct route at the middle of the pulse, if already computed.
    """
    scene, routes, occluders = frame.scene, [Route(camera.wall)], frame.rig.occluders_of(camera)
    if scene.plane is not None and scene.plane.mirrors and isinstance(camera.wall, Wall):
        rear = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in scene.rear)
        routes += reflections(camera.wall, rear)
    total = None
    for positions in tracers.positions_mm:
        middle, moment = positions is tracers.particles.position_mm, tracers.particles
        if not middle:
            moment = replace(moment, position_mm=positions)
        for route in routes:
            if known is not None and middle and not route.faces:
                images = known
            else:
                given = moment, tracers.scatterers, occluders, route, tracers.share
                images = image_particles(scene, camera, *given)
            unfolded = route.behind(camera)
            if frame.renderer == "splat":
                photons = particles_splatted.render(unfolded, images)
            else:
                photons = unfolded.etendue() * particles_traced.render(
                    unfolded,
                    images,
                    route.place(positions),
                    scene.render.samples_per_pixel,
                    frame.rig.occluders_of(unfolded),
                )
            total = photons if total is None else total + photons
    assert total is not None
    return total / len(tracers.positions_mm)


def _render_bubbles(frame: FrameContent, bubbles: Bubbles, number: int) -> CameraView:
    scene, camera, tracers = frame.scene, frame.rig.cameras[number], frame.tracers
    seed = int(stream(frame.seed, "light paths", frame.number, number).integers(1 << 20))
    (tank, lights), sight = tank_and_lights(scene), see(camera, bubbles, frame.solids)
    from scipy.ndimage import maximum_filter  # takes long to load

    render = functools.partial(
        bubbles_traced.render,
        camera,
        tank,
        bubbles,
        frame.bodies,
        occluders=frame.rig.occluders,
        # the error counts in pixels that show bubbles or bodies, or are next to them
        counted=np.asarray(maximum_filter(sight.number != NOTHING, 3)),
    )
    error, exposure_s = scene.render.relative_error or _ERROR, scene.sensor.exposure_s
    shown = render(lights, error, seed, exposure_s=exposure_s)
    sight = replace(sight, error=shown.error)
    if tracers is None:
        return CameraView(camera, shown.photons, sight=sight)
    places = tracers.particles.position_mm
    given = tracers.particles, tracers.scatterers, frame.rig.occluders_of(camera)
    images = image_particles(scene, camera, *given)
    lit = True if tracers.illuminated is None else tracers.illuminated
    images = replace(
        images,
        photons=images.photons * lit,
        intensity=images.intensity * lit,
        visible=images.visible & ~find_hidden(camera, places, images.pixel, sight),
    )
    dark, seed = replace(lights, backlight=None, lighting=None), seed + (1 << 20)
    glow = render(dark, _GLOW_ERROR, seed, images=images, particles_mm=places)
    photons = shown.photons + glow.photons
    return CameraView(camera, photons, particles=images, sight=sight)


def tank_and_lights(scene: Scene) -> tuple[Tank, Lights]:
    """Return the walls around bubbles and bodies, and the lights without the laser."""
    rear = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in scene.rear)
    tank = Tank(build_wall(scene.plane) if scene.plane else None, rear)
    center, full = np.asarray(scene.volume.center_mm), scene.sensor.full_well_photons
    return tank, Lights(scene.backlight, scene.lighting, center, full)


def record_image(frame: FrameContent, view: CameraView, camera: int) -> U16:
    """Record what a camera receives of a frame, by its number in the rig.

    Its sensor's pattern and the background are the same in every frame, and other ones in every
    camera: each has its own random stream.
    """
    scene, photons, seed = frame.scene, view.photons, frame.seed
    if scene.background is not None:
        light = static_light(scene.background, photons.shape, stream(seed, "background", camera))
        brightness = flicker(scene.background, stream(seed, "flicker", frame.number))
        photons = photons + brightness * scene.sensor.full_well_photons * light
    if scene.sensor.camera_exposure is not None:
        photons = photons * scene.sensor.camera_exposure[camera]
    sensor, pattern = scene.sensor.of_camera(camera), None
    if any((sensor.prnu, sensor.dsnu_e, sensor.hot_pixels, sensor.dead_pixels)):
        pattern = make_pattern(sensor, photons.shape, stream(seed, "sensor pattern", camera))
    return expose(sensor, photons, frame.sensor_noise(camera), pattern)
