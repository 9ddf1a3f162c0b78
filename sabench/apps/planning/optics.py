"""Figures of a plan: the array's view, and the images of particles.

The view has resolution, depth, overlap and blur; the images have size, photons, noise and
saturation.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from sabench.api.truth import Particles
from sabench.apps.planning.viewing import Advice, Quantity, Section, Viewing
from sabench.geometry.camera import Camera
from sabench.geometry.common_view import pixel_size_mm
from sabench.scenes import Scene
from sabench.scenes.focusing import apparent_distance_mm
from sabench.scenes.illumination import Backlight
from sabench.scenes.sensor import Sensor
from sabench.simulation.frames import FrameContent, Tracers
from sabench.simulation.rendering.particle_images import (
    ParticleImages,
    defocus_px,
    diffraction_px,
    image_particles,
)
from sabench.utils.arrays import F64

DIAMETER = 4.0  # diameter of a Gaussian image in standard deviations: the e^-2 circle
NEARLY_ALL = 0.99  # of the volume or of the particles
_COARSE = 1.5  # pixels, or distances of focal planes: a larger voxel loses resolution
_SHARP_PX = 1.0  # harmless blur by defocus for any diffraction


def plan_view(scene: Scene, view: Viewing) -> Section:
    """Compute field of view, resolution and overlap of an array."""
    spec, pixel = scene.cameras, view.pixel_mm(0.5)
    voxels = math.prod(view.rig.grid.shape)
    shares = view.shares_seen
    quantities = (
        Quantity("cameras", len(view.rig.cameras), "cameras of the array", "scene"),
        Quantity("view_width_mm", spec.columns * pixel, "width of an image in the volume", "(2.5)"),
        Quantity("view_height_mm", spec.rows * pixel, "height of an image in the volume", "(2.5)"),
        Quantity("pixel_front_mm", view.pixel_mm(0.0), "pixel dX at the front face", "(2.5)"),
        Quantity("pixel_center_mm", pixel, "pixel dX at the middle, inner camera", "(2.5)"),
        Quantity("pixel_back_mm", view.pixel_mm(1.0), "pixel dX at the back face", "(2.5)"),
        Quantity("pixel_coarsest_mm", view.pixels_mm.max(), "of the farthest camera", "(2.5)"),
        Quantity(
            "voxel_over_pixel",
            max(size for edge, size in enumerate(scene.grid.voxel_mm) if edge != view.axis) / pixel,
            "voxel width / dX",
            "grid, (2.5)",
        ),
        Quantity(
            "voxel_length",
            scene.grid.voxel_mm[view.axis] / pixel,
            "voxel length / dX",
            "grid, (2.5)",
        ),
        Quantity("voxels_million", voxels / 1e6, "voxels of a volume", "grid"),
        Quantity("volume_mb", 4.0 * voxels / 1e6, "memory of one float32 volume, MB", "grid"),
        Quantity(
            "common_share", view.share_common, "share of the volume all cameras see", "traced"
        ),
        Quantity("scored_share", view.share_scored, "the same of its scored part", "traced"),
        Quantity("least_share", float(shares.min()), "share that the worst camera sees", "traced"),
    )
    return Section("view", quantities, tuple(_advise_view(scene, view, shares, quantities)))


def _advise_view(
    scene: Scene, view: Viewing, shares: F64, quantities: tuple[Quantity, ...]
) -> list[Advice]:
    advice, values = [], {quantity.key: quantity.value or 0.0 for quantity in quantities}
    if values["scored_share"] < NEARLY_ALL:
        worst = view.rig.cameras[int(np.argmin(shares))].name
        advice.append(
            Advice(
                "cameras.focal_length_mm",
                f"all cameras see {values['common_share']:.0%} of the volume together, and {worst} "
                f"sees {values['least_share']:.0%}: shorten cameras.focal_length_mm, set "
                "cameras.aim_mm to the volume's middle, or raise grid.crop_mm",
            )
        )
    if values["voxel_over_pixel"] > _COARSE:
        advice.append(
            Advice(
                "grid.voxel_mm",
                f"a voxel is {values['voxel_over_pixel']:.2g} pixels wide: reduce grid.voxel_mm to "
                f"{values['pixel_center_mm']:.3g} mm across the lines of sight",
            )
        )
    return advice


def plan_depth(scene: Scene, view: Viewing) -> Section:
    """Compute baseline, spacing and number of focal planes, and viewable depth."""
    pixel, ratio, pair = view.pixel_mm(0.5), view.plane_spacing_ratio, view.inner_pair
    spacing = None if ratio is None else ratio * pixel
    voxel, common = scene.grid.voxel_mm[view.axis], view.common_depth_mm
    field = min(depth_of_field_mm(scene, camera, view) for camera in view.rig.cameras)
    planes = None if spacing is None else view.depth_mm / spacing
    quantities = (
        Quantity(
            "baseline_ratio", _baseline(view, pair), "D of the two inner cameras", "dX_C / s_o"
        ),
        Quantity("plane_spacing_ratio", ratio, "dZ / dX at the middle", "(2.11), traced"),
        Quantity("plane_spacing_mm", spacing, "distance dZ of focal planes", "(2.11)"),
        Quantity("planes", planes, "focal planes in the volume's depth", "(2.12)"),
        Quantity("elongation", view.elongation, "length / width of a particle", "outer cameras"),
        Quantity("depth_mm", view.depth_mm, "depth of the volume", "volume.size_mm"),
        Quantity("common_depth_mm", common, "depth that all cameras see", "traced"),
        Quantity("depth_of_field_mm", field, "depth of field of one camera", _DEPTH_SOURCE),
        Quantity("viewable_depth_mm", min(common, field), "the smaller of the two", "2.2.3"),
    )
    advice = []
    if view.depth_mm > common:
        advice.append(
            Advice(
                "volume.size_mm",
                f"the cameras' views meet over {common:.3g} mm of depth and the volume has "
                f"{view.depth_mm:.3g} mm: reduce volume.size_mm or cameras.focal_length_mm",
            )
        )
    if spacing is not None and voxel > _COARSE * spacing:
        advice.append(
            Advice(
                "grid.voxel_mm",
                f"voxels are {voxel:.3g} mm long and focal planes {spacing:.3g} mm apart: reduce "
                f"grid.voxel_mm to {spacing:.3g} mm along the lines of sight",
            )
        )
    if pair is None:
        advice.append(
            Advice("cameras.layout", "one camera sees no depth: add cameras to cameras.layout")
        )
    return Section("depth", quantities, tuple(advice))


def _baseline(view: Viewing, pair: tuple[int, int] | None) -> float | None:
    """Compute D, two cameras' distance over that of the front face in air."""
    if pair is None:
        return None
    first, second = (view.rig.cameras[number] for number in pair)
    distance = float(np.linalg.norm(np.subtract(first.center_mm, second.center_mm)))
    return distance / apparent_distance_mm(first, view.at(0.0))


_DEPTH_SOURCE = "4.88 n lambda N^2 (1 + 1/M)^2, Raffel et al. (2018)"


def depth_of_field_mm(scene: Scene, camera: Camera, view: Viewing) -> float:
    """Compute the depth over which defocus widens images less than diffraction does.

    It is 4.88 lambda N^2 ((M + 1) / M)^2 in air (Raffel et al., Particle Image Velocimetry, 2018,
    section 2.6); in a fluid of index n it is n times as deep, as the apparent depth is 1 / n of the
    true one.
    """
    magnification = camera.pixel_mm / pixel_size_mm([camera], view.center_mm)
    optical = wavelength_nm(scene) * 1e-6 * (camera.f_number * (1.0 + 1.0 / magnification)) ** 2
    return 4.88 * scene.fluid_index * optical


def wavelength_nm(scene: Scene) -> float:
    """Return the wavelength of a scene's laser, or else of its lamps or of any lamp."""
    lights = (scene.illumination, scene.backlight, scene.lighting)
    lamp: float = Backlight.model_fields["wavelength_nm"].default
    return next((light.wavelength_nm for light in lights if light is not None), lamp)


def plan_sharpness(scene: Scene, view: Viewing) -> Section:
    """Compare the blur at the volume's faces with diffraction, in e^-2 diameters."""
    cameras, size = view.rig.cameras, np.asarray(scene.volume.size_mm)
    airy = DIAMETER * max(diffraction_px(camera, wavelength_nm(scene)) for camera in cameras)
    front, middle, back = (
        DIAMETER * max(_largest(defocus_px(camera, view.face(share, size))) for camera in cameras)
        for share in (0.0, 0.5, 1.0)
    )
    quantities = (
        Quantity("diffraction_px", airy, "e^-2 diameter of diffraction", "Adrian and Yao (1985)"),
        Quantity("blur_front_px", front, "of defocus, front face, worst camera", "traced"),
        Quantity("blur_center_px", middle, "of defocus, middle section", "traced"),
        Quantity("blur_back_px", back, "of defocus, back face", "traced"),
    )
    worst = max(front, back)
    advice = []
    allowed = max(airy, _SHARP_PX)
    if worst > allowed and scene.cameras.particle_sigma_px is None:
        stop = min(camera.f_number for camera in cameras) * math.sqrt(worst / allowed)
        advice.append(
            Advice(
                "cameras.f_number",
                f"defocus at the volume's faces is {worst:.2g} px wide and diffraction {airy:.2g} "
                f"px: raise cameras.f_number to {stop:.2g}, or set cameras.focus_normal",
            )
        )
    return Section("sharpness", quantities, tuple(advice))


def _largest(values: F64) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0


_SAMPLE = 2000  # particles that are imaged
_LEAST_SNR = 5.0
_SMALLEST_PX, _LARGEST_PX = 2.0, 4.0  # image diameters with precisely measurable centres


@dataclass(frozen=True)
class ParticleSample:
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
        return float(np.mean([image.visible.mean() for image in self.images]))

    @property
    def diameter_px(self) -> float:
        """Median e^-2 diameter of visible images, mean over the cameras."""
        sizes = [image.sigma_px[image.visible] for image in self.images if image.visible.any()]
        return DIAMETER * float(np.mean([np.median(size) for size in sizes]))

    @property
    def light_scatter(self) -> float:
        """Scatter of light between cameras, a deviation of logarithms."""
        photons = np.array([np.where(image.visible, image.photons, 0.0) for image in self.images])
        photons = photons[:, (photons > 0.0).all(axis=0)]
        if not photons.size:
            return 0.0
        return float(np.sqrt(np.mean(np.var(np.log(photons), axis=0))))

    @property
    def light_spread(self) -> float:
        """Spread of light between particles in a camera, a deviation of logarithms."""
        photons = [image.photons[image.visible & (image.photons > 0.0)] for image in self.images]
        spreads = [np.std(np.log(given)) for given in photons if len(given)]
        return float(np.mean(spreads)) if spreads else 0.0


def sample_images(frame: FrameContent, tracers: Tracers) -> ParticleSample | None:
    """Image a sample of a frame's particles; None where no camera sees one."""
    whole = tracers.particles
    some = np.unique(np.linspace(0, max(len(whole) - 1, 0), min(len(whole), _SAMPLE)).astype(int))
    given = whole.rows(some)
    images = tuple(
        image_particles(
            frame.scene, camera, given, tracers.scatterers, frame.rig.occluders_of(camera)
        )
        for camera in frame.rig.cameras
    )
    visible = any(image.visible.any() for image in images)
    return ParticleSample(frame, whole, images) if visible else None


@dataclass(frozen=True)
class _Exposure:
    """Brightest pixels of one camera's particles: medians, saturated share."""

    photons: float
    electrons: float
    grey: float
    snr: float
    saturated: float
    constant_noise: float


def plan_light(sample: ParticleSample) -> Section:
    """Compute photons, signal to noise and saturation of the particles' images."""
    scene = sample.frame.scene
    exposures = [
        _expose(scene.sensor.of_camera(number), images)
        for number, images in enumerate(sample.images)
        if images.visible.any()
    ]
    dim = min(exposures, key=lambda exposure: exposure.snr)
    brightest = max(exposure.photons for exposure in exposures)
    ratio = dim.photons / brightest if brightest else None
    lit = float(np.mean(np.concatenate([image.intensity for image in sample.images]) > 0.0))
    saturated = max(exposure.saturated for exposure in exposures)
    quantities = (
        Quantity(
            "image_px", sample.diameter_px, "e^-2 diameter of images", "Adrian and Yao (1985)"
        ),
        Quantity("photons", dim.photons, "photons of a median particle, darkest camera", _LIGHT),
        Quantity("light_ratio", ratio, "darkest / brightest camera", _LIGHT),
        Quantity(
            "light_scatter", sample.light_scatter, "deviation of log light over cameras", _LIGHT
        ),
        Quantity(
            "light_spread", sample.light_spread, "deviation of log light over particles", _LIGHT
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
        return [Advice(key, f"images are {diameter_px:.3g} px wide, {wrong}: raise {key}")]
    if diameter_px > _LARGEST_PX:
        wrong = "which lowers the density that can be resolved"
        change = f"set {key} so that they are 2 to 4 px wide"
        return [Advice(key, f"images are {diameter_px:.3g} px wide, {wrong}: {change}")]
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
    if saturated > 1.0 - NEARLY_ALL:
        remedy = f"reduce {key} or sensor.gain_dn_e"
        advice.append(Advice(key, f"{saturated:.0%} of the particles saturate a camera: {remedy}"))
    if lit < NEARLY_ALL:
        thickness = "illumination.thickness_mm"
        problem = f"{1.0 - lit:.0%} of the particles are outside the light"
        advice.append(Advice(thickness, f"{problem}: raise {thickness}, or illumination.height_mm"))
    return advice
