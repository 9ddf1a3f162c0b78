"""Particle images in one camera: position, photons, size.

Both renderers start from these figures.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from sabench.api.arrays import Array
from sabench.api.truth import Particles, View
from sabench.geometry.camera import Camera
from sabench.geometry.lens import UPRIGHT, from_sensor, stretch
from sabench.geometry.occluders import Disc, in_shadow
from sabench.scenes import Scene
from sabench.simulation.rendering.light_paths import Box, LightPaths, find_paths, object_steps
from sabench.simulation.rendering.light_routes import Route, direct
from sabench.simulation.rendering.particle_light import Scatterers, intensity
from sabench.utils.arrays import F64, triple

_TAIL, _LEAST_REACH = 4.0, 4  # widths, and more pixels, to the end of a discrete Gaussian
# sigma of the Gaussian nearest to Airy's disc / (lambda N (1 + M)): Adrian and Yao (1985)
_AIRY = 2.44 / np.sqrt(8 * 3.67)
_MANY = 200  # particles whose paths are worth an interpolation
_SLACK = 1.02  # of the volume: particles that have left it a little


@dataclass(frozen=True)
class ParticleImages(View):
    """Images of n particles in one camera, and the light that leaves for them.

    Attributes
    ----------
    intensity : (n,) photons per steradian that leave the particle towards the camera, before
        anything obstructs them.
    direction : (n, 3) unit direction of the light path at the particle, away from the camera.
    spread_px2 : (n, 3) variances of the image along the columns and along the rows, and their
        covariance; `sigma_px` is the geometric mean of the ellipse's two widths.
    """

    ARRAYS = (
        *View.ARRAYS[:-1],
        Array("spread_px2", ("n", 3), finite=False, file_dtype=np.float32),
        View.ARRAYS[-1],
    )

    intensity: F64
    direction: F64
    spread_px2: F64

    def shape_mm(self, camera: Camera, position_mm: F64) -> F64:
        """Compute vectors across the light path that span a particle's Gaussian.

        (n, 2, 3). They are two conjugate half axes of the ellipse that one standard deviation of
        the image has on the particle's side of the wall.
        """
        steps = object_steps(camera, position_mm, self.direction)
        across, down, both = self.spread_px2.T
        first = np.sqrt(across)
        slant = both / np.where(first > 0.0, first, 1.0)
        second = np.sqrt(np.maximum(down - slant**2, 0.0))
        shape: F64 = np.empty_like(steps)
        shape[:, 0] = first[:, None] * steps[:, 0] + slant[:, None] * steps[:, 1]
        shape[:, 1] = second[:, None] * steps[:, 1]
        return shape


def image_particles(
    scene: Scene,
    camera: Camera,
    particles: Particles,
    scatterers: Scatterers | None,
    occluders: tuple[Disc, ...] = (),
    route: Route | None = None,
) -> ParticleImages:
    """Compute position, brightness and size of every particle's image.

    By default the route is the direct one. On a route with reflections, all is that of the unfolded
    particle, which `Route.place` and `Route.behind` tell; the light is that of the particle.

    Photons = intensity x solid angle of the lens x Fresnel transmission of the wall. The image is
    Gaussian with the summed variances of the particle's disc (M d / 4), of diffraction (Airy,
    `_AIRY`) and of defocus (an ellipse, axes / 4): Adrian and Yao (1985), Olsen and Adrian (2000).
    """
    route = route or direct(camera.wall)
    camera, place_mm = route.behind(camera), route.place(particles.position_mm)
    box = _box(scene, route) if len(particles) > _MANY else None
    seen = find_paths(camera, place_mm, box)
    pinhole = np.asarray(camera.center_mm)
    unobstructed = seen.valid & ~in_shadow(occluders, pinhole, seen.leaving)
    leaving = route.at_particle(seen.arriving)
    sent = intensity(scene, particles, leaving, seen.half_angle, scatterers)
    sent *= route.reflected(seen.leaving)
    photons = np.where(unobstructed, sent * seen.solid_angle * seen.passed, 0.0)
    given = scene.cameras.particle_sigma_px
    spread = (
        _spread_px2(scene, camera, particles.diameter_mm, seen)
        if given is None
        else np.tile([given**2, given**2, 0.0], (len(particles), 1))
    )
    sigma = (spread[:, 0] * spread[:, 1] - spread[:, 2] ** 2) ** 0.25
    visible = unobstructed & camera.contains(seen.pixel)
    return ParticleImages(seen.pixel, photons, sigma, visible, sent, seen.arriving, spread)


def _box(scene: Scene, route: Route) -> Box:
    """Return the box in which a camera sees the scene's volume on a route."""
    half = _SLACK * np.asarray(scene.volume.size_mm) / 2.0
    corners = np.asarray(list(itertools.product((-1.0, 1.0), repeat=3))) * half
    seen = route.place(np.asarray(scene.volume.center_mm) + corners)
    return triple(seen.min(axis=0)), triple(seen.max(axis=0))


def _spread_px2(scene: Scene, camera: Camera, diameter_mm: F64, seen: LightPaths) -> F64:
    """Compute variances and covariance (n, 3) of images.

    They come from diffraction, disc and defocus. The disc is the particle's. Defocus alone may be
    longer than wide.
    """
    diffraction = diffraction_px(camera, scene.light.wavelength_nm)
    disc = seen.magnification * diameter_mm / 4.0
    if camera.tilt_deg == UPRIGHT:
        spread: F64 = np.array(seen.blur_px2, order="C")
        spread[:, 0] += diffraction**2 + disc**2
        spread[:, 1] += diffraction**2 + disc**2
        return spread
    sensor = (seen.pixel - np.asarray(camera.principal_point_px)) / camera.focal_px
    shape = stretch(camera.tilt_deg, from_sensor(camera.tilt_deg, sensor)[0])
    area = np.sqrt(shape[:, 0] * shape[:, 1] - shape[:, 2] ** 2)  # in the magnification already
    return np.asarray(seen.blur_px2 + (diffraction**2 + disc**2 / area)[:, None] * shape)


def diffraction_px(camera: Camera, wavelength_nm: float) -> float:
    """Compute the standard deviation of the Gaussian that approximates the Airy disc."""
    return float(
        _AIRY
        * wavelength_nm
        * 1e-6
        * camera.f_number
        * camera.principal_distance_mm
        / camera.focal_length_mm
        / camera.pixel_mm
    )


def diffract(camera: Camera, photons: F64, wavelength_nm: float) -> F64:
    """Blur an image (row, column) by a Gaussian as wide as the lens's Airy disc.

    Samples of a narrow Gaussian are narrower than it is: at 0.43 px they have two thirds of its
    variance. The kernel is the discrete one whose variance is exact at any width (T. Lindeberg,
    IEEE Trans. Pattern Anal. Mach. Intell. 12, 234-254, 1990).
    """
    from scipy.ndimage import convolve1d  # takes long to load
    from scipy.special import ive

    sigma = diffraction_px(camera, wavelength_nm)
    reach = math.ceil(_TAIL * sigma) + _LEAST_REACH
    kernel = ive(np.arange(-reach, reach + 1), sigma**2)
    kernel /= kernel.sum()
    return np.asarray(convolve1d(convolve1d(photons, kernel, axis=0), kernel, axis=1))


def defocus_px(camera: Camera, points_mm: F64) -> F64:
    """Compute the standard deviation (n,) of defocus alone at points (n, 3).

    It is the longer axis of the ellipse; NaN for points without a light path.
    """
    seen = find_paths(camera, points_mm)
    across, down, both = seen.blur_px2.T
    largest = (across + down) / 2.0 + np.hypot((across - down) / 2.0, both)
    return np.where(seen.valid, np.sqrt(largest), np.nan)
