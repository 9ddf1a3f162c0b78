"""Particle images in one camera: position, photons, size.

Both renderers start from these figures.

The lens is a round aperture. Moving the pinhole over it gives, through the wall, the directions in
which light must leave a particle to pass it: the spread of these directions is the solid angle of
the lens, the spread of the pixels is the defocus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sabench.api.truth import Particles, View
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc, in_shadow
from sabench.geometry.refraction import trace_to_points, transmittance
from sabench.geometry.sensor_tilt import UPRIGHT, from_sensor, onto_sensor, stretch
from sabench.scenes import Scene
from sabench.simulation.rendering.light_routes import Route, direct
from sabench.simulation.rendering.particle_light import Scatterers, intensity
from sabench.utils.arrays import F64, Bool

_TAIL, _LEAST_REACH = 4.0, 4  # widths, and more pixels, to the end of a discrete Gaussian
_AIRY = 2.44 / np.sqrt(
    8 * 3.67
)  # sigma of the Gaussian nearest to Airy's disc / (lambda N (1 + M)): Adrian and Yao (1985)
_CHUNK = 8192  # points at a time


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

    intensity: F64
    direction: F64
    spread_px2: F64

    def shape_mm(self, camera: Camera, position_mm: F64) -> F64:
        """Compute vectors across the light path that span a particle's Gaussian.

        (n, 2, 3). They are two conjugate half axes of the ellipse that one standard deviation of
        the image has on the particle's side of the wall.
        """
        steps = _apply_in_chunks(_object_shape, camera, position_mm, self.direction)[1]
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
    seen = _LightPaths(*_apply_in_chunks(_see, camera, place_mm))
    pinhole = np.asarray(camera.center_mm)
    unobstructed = seen.valid & ~in_shadow(occluders, pinhole, seen.leaving)
    leaving = route.at_particle(seen.arriving)
    sent = intensity(scene, particles, leaving, seen.half_angle, scatterers)
    sent *= route.reflected(seen.leaving)
    passed = transmittance(camera.wall, pinhole, seen.leaving)
    photons = np.where(unobstructed, sent * seen.solid_angle * passed, 0.0)
    given = scene.cameras.particle_sigma_px
    spread = (
        _spread_px2(scene, camera, place_mm, particles.diameter_mm, seen)
        if given is None
        else np.tile([given**2, given**2, 0.0], (len(particles), 1))
    )
    sigma = (spread[:, 0] * spread[:, 1] - spread[:, 2] ** 2) ** 0.25
    visible = unobstructed & camera.contains(seen.pixel)
    return ParticleImages(seen.pixel, photons, sigma, visible, sent, seen.arriving, spread)


def _spread_px2(
    scene: Scene, camera: Camera, place_mm: F64, diameter_mm: F64, seen: _LightPaths
) -> F64:
    """Compute variances and covariance (n, 3) of images.

    They come from diffraction, disc and defocus. The disc is the particle's. Defocus alone may be
    longer than wide.
    """
    magnification = _apply_in_chunks(_object_shape, camera, place_mm, seen.arriving)[0]
    diffraction = diffraction_px(camera, scene.light.wavelength_nm)
    disc = magnification * diameter_mm / 4.0
    if camera.tilt_deg == UPRIGHT:
        round_part = diffraction**2 + disc**2
        return np.asarray(seen.blur_px2 + round_part[:, None] * [1.0, 1.0, 0.0])
    shape = _cone_on_sensor(camera, seen.pixel)
    area = np.sqrt(shape[:, 0] * shape[:, 1] - shape[:, 2] ** 2)  # in the magnification already
    return np.asarray(seen.blur_px2 + (diffraction**2 + disc**2 / area)[:, None] * shape)


def _cone_on_sensor(camera: Camera, pixel: F64) -> F64:
    """Compute the shape (n, 3) of a round cone on a tilted sensor, see `stretch`."""
    sensor = (pixel - np.asarray(camera.principal_point_px)) / camera.focal_px
    return stretch(camera.tilt_deg, from_sensor(camera.tilt_deg, sensor)[0])


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
    """Blur an image (row, column) of pixels by the lens's Airy disc, as a Gaussian of its width.

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
    seen = _LightPaths(*_apply_in_chunks(_see, camera, points_mm))
    across, down, both = seen.blur_px2.T
    largest = (across + down) / 2.0 + np.hypot((across - down) / 2.0, both)
    return np.where(seen.valid, np.sqrt(largest), np.nan)


class _LightPaths(NamedTuple):
    """Light paths from n points to one camera: arrays of n rows."""

    leaving: F64
    arriving: F64
    pixel: F64
    valid: Bool
    half_angle: F64
    blur_px2: F64
    solid_angle: F64


def _apply_in_chunks(
    function: Callable[..., tuple[F64 | Bool, ...]], camera: Camera, *points: F64
) -> list[Any]:
    """Apply a function of points (n, 3) chunk by chunk.

    What lies between its steps then stays in the cache: three times as fast for many points.
    """
    chunks = [
        function(camera, *(each[first : first + _CHUNK] for each in points))
        for first in range(0, max(len(points[0]), 1), _CHUNK)
    ]
    return [np.concatenate(parts) for parts in zip(*chunks, strict=True)]


def _see(camera: Camera, points: F64) -> tuple[F64 | Bool, ...]:
    paths = trace_to_points(camera.wall, np.asarray(camera.center_mm), points)
    pixel, valid = camera.pixels_of(paths.leaving, paths.valid)
    return (
        paths.leaving,
        paths.arriving,
        pixel,
        valid,
        *_through_aperture(camera, points, paths.arriving),
    )


def _through_aperture(camera: Camera, points: F64, chief: F64) -> tuple[F64, F64, F64]:
    """Compute the lens's half angle (rad), defocus (px2) and solid angle (sr).

    At each point (n,), in the fluid. Defocus is (n, 3), variances along columns and rows and their
    covariance: the image moves in proportion as the pinhole moves over the aperture, and over a
    disc of radius 1 each coordinate has the variance 1/4.
    """
    radius = camera.aperture_radius_mm
    upright = replace(camera, tilt_deg=UPRIGHT)
    rotations, smears = [], []
    for axis, (right, down) in enumerate(((radius, 0.0), (0.0, radius))):
        ends = []
        for sign in (1.0, -1.0):
            moved = upright.shifted(sign * right, sign * down)
            paths = trace_to_points(moved.wall, np.asarray(moved.center_mm), points)
            ends.append((paths.arriving, moved.pixels_of(paths.leaving, paths.valid)[0]))
        rotations.append((ends[0][0] - ends[1][0]) / 2.0)
        smears.append(_smear(camera, axis, ends[0][1], ends[1][1]) / 4.0)
    solid_angle = np.pi * np.abs(np.einsum("ij,ij->i", np.cross(rotations[0], rotations[1]), chief))
    return (
        np.linalg.norm(rotations[0], axis=1),
        np.sum([smear[:, [0, 1, 0]] * smear[:, [0, 1, 1]] for smear in smears], axis=0),
        solid_angle,
    )


def _smear(camera: Camera, axis: int, first: F64, second: F64) -> F64:
    """Subtract places on the sensor (n, 2) of light through both ends of a lens.

    `first` and `second` are the pixels of upright cameras that are moved there, along `axis`. A
    point in focus would shift on their sensors, and is at rest on the true one.
    """
    radius = camera.aperture_radius_mm
    if camera.tilt_deg == UPRIGHT:
        smear = first - second
        smear[:, axis] += 2.0 * radius * camera.focal_px / camera.focus_mm
        return smear
    lens = np.zeros(2)
    lens[axis] = radius
    places = [
        onto_sensor(
            camera.tilt_deg,
            (pixel - np.asarray(camera.principal_point_px)) / camera.focal_px
            + sign * lens / camera.focus_mm,
            sign * lens / camera.principal_distance_mm,
        )[0]
        for sign, pixel in ((1.0, first), (-1.0, second))
    ]
    return (places[0] - places[1]) * camera.focal_px


def _object_shape(camera: Camera, points: F64, direction: F64) -> tuple[F64, F64]:
    """Compute magnification and the shifts that move the image by one pixel.

    In px/mm, mean over directions; shifts (n, 2, 3) lie across the light path.
    """
    step = 1e-3  # mm: far above float64's noise, far below any change of magnification
    first = np.cross(
        direction, camera.rotation[1]
    )  # never along the path: a path in view is near the camera's Z axis
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    basis = np.stack([first, np.cross(direction, first)], axis=1)
    ends = [
        camera.project(points + sign * step * basis[:, i])[0]
        for i in (0, 1)
        for sign in (1.0, -1.0)
    ]
    jacobian = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=2) / (2.0 * step)
    determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        adjugate = np.stack(
            [jacobian[:, 1, 1], -jacobian[:, 0, 1], -jacobian[:, 1, 0], jacobian[:, 0, 0]], axis=1
        ).reshape(-1, 2, 2)
        inverse = adjugate / determinant[:, None, None]
    return np.sqrt(np.abs(determinant)), np.einsum("nba,nbk->nak", inverse, basis)
