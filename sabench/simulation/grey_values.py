"""Grey values of a rendered image: background, exposure and sensor of its camera."""

from __future__ import annotations

from sabench.simulation.camera_view import CameraView
from sabench.simulation.frame_content import FrameContent
from sabench.simulation.rendering.background import flicker, static_light
from sabench.simulation.rendering.sensor import expose, full_well_photons, make_pattern
from sabench.utils.arrays import F64, U16
from sabench.utils.rng import stream


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
