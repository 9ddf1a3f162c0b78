"""Figures of the particles' images: size, photons, noise and saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from sabench.api.truth import Particles
from sabench.evaluation.planning.optics import DIAMETER
from sabench.evaluation.planning.quantities import Advice, Quantity, Section
from sabench.scenes import Scene
from sabench.scenes.sensor import Sensor
from sabench.simulation.frames import FrameContent, Tracers
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles

_SAMPLE = 2000  # particles that are imaged
_LEAST_SNR, _MOST_SATURATED, _LEAST_LIT = 5.0, 0.01, 0.99
_SMALLEST_PX, _LARGEST_PX = 2.0, 4.0  # diameters of images whose centres can be measured well


@dataclass(frozen=True)
class Sample:
    """Some particles of the first frame, as every camera images them.

    Attributes
    ----------
    particles : all of the frame.
    images : of a sample of them, one entry for each camera.
    """

    frame: FrameContent
    particles: Particles
    images: tuple[ParticleImages, ...]

    @property
    def visible_share(self) -> float:
        """Share of the particles on an image, mean over the cameras."""
        return float(np.mean([one.visible.mean() for one in self.images]))

    @property
    def diameter_px(self) -> float:
        """Median e^-2 diameter of visible images, mean over the cameras."""
        sizes = [one.sigma_px[one.visible] for one in self.images if one.visible.any()]
        return DIAMETER * float(np.mean([np.median(one) for one in sizes]))

    @property
    def light_scatter(self) -> float:
        """Scatter of light between cameras, a deviation of logarithms."""
        photons = np.array([np.where(one.visible, one.photons, 0.0) for one in self.images])
        photons = photons[:, (photons > 0.0).all(axis=0)]
        if not photons.size:
            return 0.0
        return float(np.sqrt(np.mean(np.var(np.log(photons), axis=0))))


def sample_images(frame: FrameContent, tracers: Tracers) -> Sample | None:
    """Image a sample of a frame's particles; None where no camera sees one."""
    whole = tracers.particles
    some = np.unique(np.linspace(0, max(len(whole) - 1, 0), min(len(whole), _SAMPLE)).astype(int))
    given = Particles(
        whole.id[some], whole.position_mm[some], whole.diameter_mm[some], whole.velocity_mm_s[some]
    )
    images = tuple(
        image_particles(
            frame.scene, camera, given, tracers.scatterers, frame.rig.occluders_of(camera)
        )
        for camera in frame.rig.cameras
    )
    seen = any(one.visible.any() for one in images)
    return Sample(frame, whole, images) if seen else None


@dataclass(frozen=True)
class _Exposure:
    """Brightest pixels of one camera's particles: medians, saturated share."""

    photons: float
    electrons: float
    grey: float
    snr: float
    saturated: float
    constant_noise: float


def plan_light(sample: Sample) -> Section:
    """Compute photons, signal to noise and saturation of the particles' images."""
    scene = sample.frame.scene
    exposures = [
        _expose(scene.sensor.of_camera(number), images)
        for number, images in enumerate(sample.images)
        if images.visible.any()
    ]
    dim = min(exposures, key=lambda one: one.snr)
    brightest = max(one.photons for one in exposures)
    ratio = dim.photons / brightest if brightest else None
    lit = float(np.mean(np.concatenate([one.intensity for one in sample.images]) > 0.0))
    saturated = max(one.saturated for one in exposures)
    quantities = (
        Quantity(
            "image_px", sample.diameter_px, "e^-2 diameter of images", "Adrian and Yao (1985)"
        ),
        Quantity("photons", dim.photons, "photons of a median particle, darkest camera", _LIGHT),
        Quantity("light_ratio", ratio, "darkest / brightest camera", _LIGHT),
        Quantity(
            "light_scatter", sample.light_scatter, "deviation of log light over cameras", _LIGHT
        ),
        Quantity("peak_e", dim.electrons, "electrons of its brightest pixel", "EMVA 1288"),
        Quantity("peak_dn", dim.grey, "grey value of its brightest pixel", "EMVA 1288"),
        Quantity("peak_snr", dim.snr, "signal / noise of that pixel", "EMVA 1288"),
        Quantity(
            "saturated_share", saturated, "particles that saturate, brightest camera", "full well"
        ),
        Quantity("lit_share", lit, "share of the particles in the light", "illumination"),
    )
    advice = [*_advise_size(scene, sample.diameter_px), *_advise_light(dim, saturated, lit, scene)]
    return Section("light", quantities, tuple(advice))


_LIGHT = "Mie or isotropic scattering"


def _expose(sensor: Sensor, images: ParticleImages) -> _Exposure:
    """Expose centred images of lit particles, with all noise of the sensor."""
    lit = images.visible & (images.photons > 0.0)
    photons, sigma = images.photons[lit], images.sigma_px[lit]
    if not len(photons):
        photons, sigma = np.zeros(1), np.ones(1)
    share = erf(0.5 / (math.sqrt(2.0) * sigma)) ** 2
    electrons = sensor.quantum_efficiency * photons * share
    dark = sensor.dark_current_e_s * sensor.exposure_s
    constant = dark + sensor.read_noise_e**2 + 1.0 / (12.0 * sensor.gain_dn_e**2)
    middle = float(np.median(electrons))
    shot = middle if sensor.shot_noise else 0.0
    well = min(sensor.full_well_e, (sensor.white_dn - sensor.black_level_dn) / sensor.gain_dn_e)
    grey = sensor.black_level_dn + sensor.gain_dn_e * min(middle, well)
    return _Exposure(
        float(np.median(photons)),
        middle,
        grey,
        middle / math.sqrt(shot + constant),
        float(np.mean(electrons > well)),
        constant,
    )


def _advise_size(scene: Scene, diameter_px: float) -> list[Advice]:
    given = scene.cameras.particle_sigma_px is not None
    key = "cameras.particle_sigma_px" if given else "cameras.f_number"
    if diameter_px < _SMALLEST_PX:
        wrong = "less than 2 px, so positions lock to whole pixels"
        return [Advice(key, f"images are {diameter_px:.2g} px wide, {wrong}: raise {key}")]
    if diameter_px > _LARGEST_PX:
        wrong = "which lowers the density that can be resolved"
        change = f"set {key} so that they are 2 to 4 px wide"
        return [Advice(key, f"images are {diameter_px:.2g} px wide, {wrong}: {change}")]
    return []


def _advise_light(dim: _Exposure, saturated: float, lit: float, scene: Scene) -> list[Advice]:
    advice, key, energy = [], "illumination.pulse_energy_mj", scene.light.pulse_energy_mj
    if dim.snr < _LEAST_SNR:
        square = _LEAST_SNR**2
        needed = (square + math.sqrt(square**2 + 4.0 * square * dim.constant_noise)) / 2.0
        remedy = "set a position and direction of the laser that light the volume"
        if dim.electrons > 0.0:
            remedy = (
                f"raise {key} to {energy * needed / dim.electrons:.3g}, or lower cameras.f_number"
            )
        problem = f"a particle's brightest pixel has a signal / noise of {dim.snr:.2g}"
        advice.append(Advice(key, f"{problem}, less than {_LEAST_SNR:g}: {remedy}"))
    if saturated > _MOST_SATURATED:
        remedy = f"reduce {key} or sensor.gain_dn_e"
        advice.append(Advice(key, f"{saturated:.0%} of the particles saturate a camera: {remedy}"))
    if lit < _LEAST_LIT:
        thickness = "illumination.thickness_mm"
        problem = f"{1.0 - lit:.0%} of the particles are outside the light"
        advice.append(Advice(thickness, f"{problem}: raise {thickness}, or illumination.height_mm"))
    return advice
