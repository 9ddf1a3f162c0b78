"""Particle images in one camera: light paths and routes, position, photons, size.

All renderers start from these figures. The lens is a round aperture. Moving the pinhole over it
gives, through the wall, the directions of light from a particle that pass it: the spread of these
directions is the solid angle of the lens, the spread of the pixels is the defocus.

All but the pixel changes slowly over a volume. For many particles it is interpolated between the
exact paths of a lattice of Chebyshev's points in a box, and only the pixel is exact.
"""

import functools
import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sabench.api.arrays import Array
from sabench.api.truth import Particles, ParticleView
from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.lens import UPRIGHT, from_sensor, onto_sensor, stretch
from sabench.geometry.occluders import Disc
from sabench.geometry.projection_kernels import BLOCK
from sabench.geometry.refraction import Layer, Wall, trace_to_points, transmittance
from sabench.scenes import Scene
from sabench.simulation.rendering.particle_light import Scatterers, intensity
from sabench.utils.arrays import F64, I64, Bool, in_box, triple
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores

_CHUNK = 8192  # points at a time, of exact paths
_DEGREES = (4, 6, 8, 11)  # of polynomials over a box, tried in this order
_EXACT = 1e-7  # of a quantity's largest value: error of its polynomial that counts as none
# points at which it is compared with exact paths; it is worth its making for more particles
_CHECKS = 200
_LEAST_BLUR_PX2 = 0.01  # of images: an error of it is compared with no less
REACH = 4.5  # standard deviations to the end of a particle's light; 2e-5 of it lies outside


@dataclass(frozen=True)
class LightPaths:
    """Light paths from n points to one camera.

    Attributes
    ----------
    pixel, valid : (n, 2) column and row; (n,) whether light reaches the camera.
    leaving, arriving : (n, 3) unit directions away from the camera, at its pinhole and at the
        point.
    half_angle, solid_angle : (n,) of the lens as the point sees it, rad and sr.
    blur_px2 : (n, 3) variances of defocus along columns and rows, and their covariance: the image
        moves in proportion as the pinhole moves over the aperture, and over a disc of radius 1 each
        coordinate has the variance 1/4.
    magnification : (n,) px/mm, mean over the directions across the path.
    passed : (n,) share of the light that passes the wall.
    """

    pixel: F64
    valid: Bool
    leaving: F64
    arriving: F64
    half_angle: F64
    solid_angle: F64
    blur_px2: F64
    magnification: F64
    passed: F64


SMOOTH = {  # all but the pixel, and their columns in a table
    "leaving": 3,
    "arriving": 3,
    "half_angle": 1,
    "solid_angle": 1,
    "blur_px2": 3,
    "magnification": 1,
    "passed": 1,
}
_ENDS = dict(zip(SMOOTH, itertools.accumulate(SMOOTH.values()), strict=True))

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def find_paths(camera: Camera, points_mm: F64, box: Box | None = None) -> LightPaths:
    """Find the light paths from points (n, 3) to a camera.

    Parameters
    ----------
    box : least and largest coordinates between which paths are interpolated, to 1e-7, if they can
        be. Others are exact, as all are without a box.
    """
    smooth = None if box is None else _interpolate(camera, box)
    if box is None or smooth is None:
        return _find_exactly(camera, points_mm)
    low, high = np.asarray(box)
    inside = in_box(points_mm, low, high)
    pixel, valid = camera.project(points_mm)
    table = np.empty((len(smooth.coefficients), len(points_mm)))
    _evaluate_all(points_mm, low, high, smooth, table)
    parts = [table[end - SMOOTH[name] : end] for name, end in _ENDS.items()]
    paths = LightPaths(pixel, valid, *(part.T if len(part) > 1 else part[0] for part in parts))
    if inside.all():
        return paths
    exact = _find_exactly(camera, points_mm[~inside])
    changed = {name: value.copy() for name, value in vars(paths).items()}
    for name, value in changed.items():
        value[~inside] = getattr(exact, name)
    return LightPaths(**changed)


def _find_exactly(camera: Camera, points_mm: F64) -> LightPaths:
    """Find exact paths chunk by chunk.

    What lies between its steps then stays in the cache: three times as fast for many points.
    """
    pinhole, chunks = np.asarray(camera.center_mm), []
    for first in range(0, max(len(points_mm), 1), _CHUNK):
        points = points_mm[first : first + _CHUNK]
        paths = trace_to_points(camera.wall, pinhole, points)
        leaving, arriving = paths.leaving, paths.arriving
        seen = camera.pixels_of(leaving, paths.valid)
        half, blur, solid = _through_aperture(camera, points, arriving)
        magnification, _ = _object_shape(camera, points, arriving)
        passed = transmittance(camera.wall, pinhole, leaving)
        chunks.append((*seen, leaving, arriving, half, solid, blur, magnification, passed))
    return LightPaths(*(np.concatenate(parts) for parts in zip(*chunks, strict=True)))


@dataclass(frozen=True)
class _Smooth:
    """Polynomials over a box: degrees (term, 3), and coefficients (quantity, term)."""

    terms: I64
    coefficients: F64


@functools.lru_cache(maxsize=256)
def _interpolate(camera: Camera, box: Box) -> _Smooth | None:
    """Fit polynomials to all that changes slowly; None where no degree will do.

    They interpolate exact paths at Chebyshev's points, and are compared with others. A volume that
    light reaches in part, such as one cut by a face, has no polynomials.
    """
    low, high = np.asarray(box)
    places = np.random.default_rng(0).uniform(-1.0, 1.0, (_CHECKS, 3))
    exact = _find_exactly(camera, low + 0.5 * (places + 1.0) * (high - low))
    if not exact.valid.all():
        return None
    truth = np.column_stack([getattr(exact, name) for name in SMOOTH])
    scale = np.abs(truth).max(axis=0)
    blur = slice(_ENDS["blur_px2"] - SMOOTH["blur_px2"], _ENDS["blur_px2"])
    scale[blur] = max(float(scale[blur].max()), _LEAST_BLUR_PX2)
    for degree in _DEGREES:
        count = degree + 1
        angles = np.pi * (np.arange(count) + 0.5) / count
        nodes = np.stack(np.meshgrid(*[np.cos(angles)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        paths = _find_exactly(camera, low + 0.5 * (nodes + 1.0) * (high - low))
        if not paths.valid.all():
            return None
        table = np.column_stack([getattr(paths, name) for name in SMOOTH])
        values = table.reshape(count, count, count, -1)
        basis = np.cos(np.outer(np.arange(count), angles)) * 2.0 / count
        basis[0] *= 0.5
        weights = np.einsum("ai,bj,ck,ijkq->abcq", basis, basis, basis, values, optimize=True)
        every = itertools.product(range(count), repeat=3)
        terms = np.array([term for term in every if sum(term) <= degree])
        coefficients = np.ascontiguousarray(weights[tuple(terms.T)].T)
        # without the smallest, as many as there may be errors of half of what counts as none
        sizes = np.abs(coefficients) / scale[:, None]
        rising = np.argsort(sizes.max(axis=0))
        together = np.cumsum(sizes[:, rising], axis=1).max(axis=0)
        kept = np.sort(rising[together > _EXACT / 2.0])
        smooth = _Smooth(terms[kept], np.ascontiguousarray(coefficients[:, kept]))
        found = np.empty((truth.shape[1], len(truth)))
        _evaluate_all(places, -np.ones(3), np.ones(3), smooth, found)
        if (np.abs(found.T - truth).max(axis=0) <= _EXACT * scale).all():
            return smooth
    return None


def _evaluate_all(points: F64, low: F64, high: F64, smooth: _Smooth, out: F64) -> None:
    blocks = (len(points) + BLOCK - 1) // BLOCK
    on_cores(_evaluate, blocks, points, low, high, smooth.terms, smooth.coefficients, out)


@numba.njit(cache=True, nogil=True)
def _evaluate(
    jobs: slice, points: Any, low: Any, high: Any, terms: Any, coefficients: Any, out: Any
) -> None:
    """Fill in polynomials (quantity, n), in Chebyshev's basis, at points (n, 3)."""
    for block in range(jobs.start, jobs.stop):
        _evaluate_block(points, block * BLOCK, low, high, terms, coefficients, out)


@inner_kernel(fastmath={"contract", "nsz"})
def _evaluate_block(
    points: Any, first: int, low: Any, high: Any, terms: Any, coefficients: Any, out: Any
) -> None:
    degree, count, size = max(terms.max(), 1), len(terms), min(BLOCK, len(points) - first)
    powers, basis = np.ones((3, degree + 1, BLOCK)), np.empty((count, BLOCK))
    for a in range(3):
        scale = 2.0 / (high[a] - low[a])
        for n in range(size):
            powers[a, 1, n] = (points[first + n, a] - low[a]) * scale - 1.0
        for k in range(2, degree + 1):
            for n in range(BLOCK):
                twice = 2.0 * powers[a, 1, n]
                powers[a, k, n] = twice * powers[a, k - 1, n] - powers[a, k - 2, n]
    for t in range(count):
        x, y, z = powers[0, terms[t, 0]], powers[1, terms[t, 1]], powers[2, terms[t, 2]]
        for n in range(BLOCK):
            basis[t, n] = x[n] * y[n] * z[n]
    found = np.dot(coefficients, basis)
    for q in range(len(out)):
        for n in range(size):  # numba takes 2 s to compile the assignment of a part of an array
            out[q, first + n] = found[q, n]


def _through_aperture(camera: Camera, points: F64, chief: F64) -> tuple[F64, F64, F64]:
    """Compute half angle, defocus and solid angle at points, as `LightPaths` has."""
    radius, lenses = camera.aperture_radius_mm, camera.aperture_radius_mm * np.eye(2)
    upright, middle = replace(camera, tilt_deg=UPRIGHT), np.asarray(camera.principal_point_px)
    rotations, smears = [], []
    for axis, lens in enumerate(lenses):
        ends = []
        for sign in (1.0, -1.0):
            moved = upright.shifted(*(sign * lens).tolist())
            paths = trace_to_points(moved.wall, np.asarray(moved.center_mm), points)
            ends.append((paths.arriving, moved.pixels_of(paths.leaving, paths.valid)[0]))
        rotations.append((ends[0][0] - ends[1][0]) / 2.0)
        # both ends of the lens see a point in focus apart on sensors that move with them, and at
        # the same place of the true one
        if camera.tilt_deg == UPRIGHT:
            smear = ends[0][1] - ends[1][1]
            smear[:, axis] += 2.0 * radius * camera.focal_px / camera.focus_mm
        else:
            places = [
                onto_sensor(
                    camera.tilt_deg,
                    (pixel - middle) / camera.focal_px + sign * lens / camera.focus_mm,
                    sign * lens / camera.principal_distance_mm,
                )[0]
                for sign, (_, pixel) in zip((1.0, -1.0), ends, strict=True)
            ]
            smear = (places[0] - places[1]) * camera.focal_px
        smears.append(smear / 4.0)
    solid_angle = np.pi * np.abs(np.einsum("ij,ij->i", np.cross(rotations[0], rotations[1]), chief))
    return (
        np.linalg.norm(rotations[0], axis=1),
        np.sum([smear[:, [0, 1, 0]] * smear[:, [0, 1, 1]] for smear in smears], axis=0),
        solid_angle,
    )


def _object_shape(camera: Camera, points: F64, direction: F64) -> tuple[F64, F64]:
    """Compute magnification and the shifts that move the image by one pixel.

    In px/mm, mean over directions; shifts (n, 2, 3) lie across the light path.
    """
    step = 1e-3  # mm: far above float64's noise, far below any change of magnification
    # never along the path: a path in view is near the camera's Z axis
    first = np.cross(direction, camera.rotation[1])
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


# A reflection is unfolded: seen from the camera, a mirrored particle lies behind a thicker wall, on
# a straight route of refractions alone. What a face reflects is Fresnel's share for unpolarised
# light.


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


# sigma of the Gaussian nearest to Airy's disc / (lambda N (1 + M)): Adrian and Yao (1985)
_AIRY = 2.44 / np.sqrt(8 * 3.67)


@dataclass(frozen=True)
class ParticleImages(ParticleView):
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
        *ParticleView.ARRAYS[:-1],
        Array("spread_px2", ("n", 3), finite=False, file_dtype=np.float32),
        ParticleView.ARRAYS[-1],
    )

    intensity: F64
    direction: F64
    spread_px2: F64

    def shape_mm(self, camera: Camera, position_mm: F64) -> F64:
        """Compute vectors across the light path that span a particle's Gaussian.

        (n, 2, 3). They are two conjugate half axes of the ellipse that one standard deviation of
        the image has on the particle's side of the wall.
        """
        firsts = range(0, max(len(position_mm), 1), _CHUNK)
        parts = [slice(first, first + _CHUNK) for first in firsts]
        steps: F64 = np.concatenate(
            [_object_shape(camera, position_mm[one], self.direction[one])[1] for one in parts]
        )
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
    share: float = 1.0,
) -> ParticleImages:
    """Compute position, brightness and size of every particle's image.

    By default the route is the direct one. On a route with reflections, all is that of the unfolded
    particle, given by `Route.place` and `Route.behind`; the light is that of the particle. The
    camera records a share of the pulse.

    Photons = fluence (`lamps.fluence`) x scattered share per solid angle (`intensity`) x solid
    angle of the lens x Fresnel transmission of the wall (`find_paths` has both). The image is
    Gaussian with the summed variances of the particle's disc (M d / 4), of diffraction (Airy,
    `_AIRY`) and of defocus (an ellipse, axes / 4): Adrian and Yao (1985), Olsen and Adrian (2000).
    """
    route = route or Route(camera.wall)
    camera, place_mm = route.behind(camera), route.place(particles.position_mm)
    box: Box | None = None
    if len(particles) > _CHECKS:  # the apparent box of the volume
        half = np.asarray(scene.volume.size_mm) / 2.0
        corners = np.asarray(list(itertools.product((-1.0, 1.0), repeat=3))) * half
        apparent = route.place(np.asarray(scene.volume.center_mm) + corners)
        box = triple(apparent.min(axis=0)), triple(apparent.max(axis=0))
    seen = find_paths(camera, place_mm, box)
    pinhole = np.asarray(camera.center_mm)
    unobstructed = seen.valid
    for disc in occluders:
        unobstructed = unobstructed & ~disc.stops(pinhole, seen.leaving)
    leaving = route.at_particle(seen.arriving)
    sent = intensity(scene, particles, leaving, seen.half_angle, scatterers)
    sent *= route.reflected(seen.leaving)
    photons = np.where(unobstructed, sent * seen.solid_angle * seen.passed, 0.0) * share
    given = scene.cameras.particle_sigma_px
    spread = (
        _spread_px2(scene, camera, particles.diameter_mm, seen)
        if given is None
        else np.tile([given**2, given**2, 0.0], (len(particles), 1))
    )
    sigma = (spread[:, 0] * spread[:, 1] - spread[:, 2] ** 2) ** 0.25
    visible = unobstructed & camera.contains(seen.pixel) & (share > 0.0)
    return ParticleImages(seen.pixel, photons, sigma, visible, sent * share, seen.arriving, spread)


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
    variance. The kernel is the discrete one with an exact variance at any width (T. Lindeberg, IEEE
    Trans. Pattern Anal. Mach. Intell. 12, 234-254, 1990), whose transfer function is
    exp(sigma^2 (cos w - 1)). A cosine transform continues the image by its mirror image.
    """
    from scipy import fft  # takes long to load

    sigma = diffraction_px(camera, wavelength_nm)
    down, across = (np.cos(np.pi * np.arange(n) / n) - 1.0 for n in photons.shape)
    spectrum = fft.dctn(photons) * np.exp(sigma**2 * (down[:, None] + across))
    return np.asarray(np.maximum(fft.idctn(spectrum), 0.0))  # dark pixels may be rounded below 0


def defocus_px(camera: Camera, points_mm: F64) -> F64:
    """Compute the standard deviation (n,) of defocus alone at points (n, 3).

    It is the longer axis of the ellipse; NaN for points without a light path.
    """
    seen = find_paths(camera, points_mm)
    across, down, both = seen.blur_px2.T
    largest = (across + down) / 2.0 + np.hypot((across - down) / 2.0, both)
    return np.where(seen.valid, np.sqrt(largest), np.nan)
