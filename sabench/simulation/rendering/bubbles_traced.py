"""Renderer of bubbles, drops, bodies and tracers under a diffuser or lamps.

Pixels get passes of rays until the scatter of their means is as small as the requested accuracy.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.grid import AT_ONCE
from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.bubble_stage import Lights, Stager, Tank
from sabench.simulation.rendering.particle_images import ParticleImages, diffract
from sabench.utils.arrays import F64, I64, Bool, in_portions
from sabench.utils.compiled import numba
from sabench.utils.progress import report_share

# lattices of a pixel, whose passes take turns: the scatter of their means is the error
STREAMS = 4
# passes at least of pixels, and of those around them, with more than the error asked for
_ROUGH = 16
_GROWTH = 2  # factor of a pixel's passes, at most, from what they tell so far
_MOST = 1 << 14  # passes of a pixel at most: a guard


class PassTally:
    """Number, mean and scatter of every pixel's passes.

    Parameters
    ----------
    counted : (rows, columns) pixels that have to reach the mean error: those that show something.
        With a uniform background among them, errors elsewhere could be of any size.

    Attributes
    ----------
    count : (n,) of the pixels, row by row: a multiple of `STREAMS`.
    """

    def __init__(self, counted: Bool) -> None:
        size = counted.size
        self._shape, self._counted = counted.shape, counted.ravel()
        self.count = np.zeros(size, dtype=np.int64)
        self._sums = np.zeros((size, STREAMS))

    def add(self, where: I64, more: I64, values: F64) -> None:
        """Add passes of some pixels, so many `more` of each, one pixel's after the other."""
        _add_passes(self._sums, self.count, where, more, values)

    @property
    def mean(self) -> F64:
        """Means (n,) of the pixels."""
        return np.asarray(np.einsum("ij->i", self._sums) / self.count)

    def errors(self, floor: float) -> F64:
        """Compute standard errors over values, or over `floor` in darker pixels.

        A few streams that have found a pixel dark may have missed what its neighbours show: the
        variance of a pass is mixed with the mean over nine pixels, as one more stream.
        """
        from scipy.ndimage import uniform_filter  # takes long to load

        variance, error = np.empty((2, len(self.count)))
        _fill_variances(self._sums, self.count, variance)
        around = uniform_filter(variance.reshape(self._shape), 3).ravel()
        _fill_errors(self._sums, self.count, variance, around, max(floor, 1e-300), error)
        return np.asarray(error)

    def mean_error(self, off: F64) -> float:
        """Compute the mean of errors `off` (n,) over pixels that count; 0 without any."""
        return float(off[self._counted].mean()) if self._counted.any() else 0.0

    def wanted(self, off: F64, error: float) -> I64:
        """Estimate how many passes (n,) bring the mean of the errors `off` to `error`.

        The fewest rays do so if a pixel's passes go with the power 2/3 of a pass's error. Pixels
        that do not count get as many as others of their error, until that is `error`.
        """
        from scipy.ndimage import maximum_filter

        if self.mean_error(off) <= error:
            return self.count
        rough = maximum_filter((off > error).reshape(self._shape), 3).ravel()
        wanted = np.empty(len(off), dtype=np.int64)
        share, factor = _share_out(off, self.count, self._counted, error)
        _fill_wanted(off, self.count, self._counted, rough, share, factor, error, wanted)
        return wanted


@numba.njit(cache=True)
def _add_passes(
    sums: Any, count: Any, where: Any, more: Any, values: Any
) -> None:  # pragma: no cover
    """Add `more` passes of each pixel `where` to its streams, which take turns."""
    streams = sums.shape[1]
    total, n = np.empty(streams), 0
    for k in range(len(where)):
        total[:] = 0.0
        for turn in range(more[k]):
            total[turn % streams] += values[n]
            n += 1
        for stream in range(streams):
            sums[where[k], stream] += total[stream]
        count[where[k]] += more[k]


@numba.njit(cache=True)
def _fill_variances(sums: Any, count: Any, variance: Any) -> None:
    """Fill in the variances (n,) of passes, from the sums (n, stream) of streams."""
    streams = sums.shape[1]
    for n in range(len(sums)):
        mean, squares = 0.0, 0.0
        for k in range(streams):
            mean += sums[n, k] / streams
        for k in range(streams):
            squares += (sums[n, k] - mean) ** 2
        variance[n] = squares / (streams - 1) * streams / count[n]


@numba.njit(cache=True)
def _fill_errors(
    sums: Any, count: Any, variance: Any, around: Any, floor: float, error: Any
) -> None:
    """Fill in the errors (n,) of pixels over their values."""
    for n in range(len(sums)):
        mean = 0.0
        for k in range(sums.shape[1]):
            mean += sums[n, k]
        mixed = max(variance[n] + (around[n] - variance[n]) / sums.shape[1], 0.0)
        error[n] = math.sqrt(mixed / count[n]) / max(mean / count[n], floor)


@numba.njit(cache=True)
def _share_out(off: Any, count: Any, counted: Any, error: float) -> Any:
    """Share passes out among pixels: each one's share (n,), and passes of share 1."""
    share = np.empty(len(off))
    for n in range(len(off)):
        share[n] = (off[n] * off[n] * count[n]) ** (1.0 / 3.0)
    return share, (share[counted].mean() / error) ** 2


@numba.njit(cache=True)
def _fill_wanted(
    off: Any,
    count: Any,
    counted: Any,
    rough: Any,
    share: Any,
    factor: float,
    error: float,
    wanted: Any,
) -> None:
    """Fill in how many passes (n,) pixels get altogether."""
    for n in range(len(off)):
        asked = factor * share[n]
        if not counted[n]:
            asked = min(asked, (off[n] / error) ** 2 * count[n])
        if rough[n]:
            asked = max(asked, _ROUGH)
        passes = math.ceil(min(asked, float(min(_GROWTH * count[n], _MOST))))
        wanted[n] = max(STREAMS * -(-passes // STREAMS), count[n])


_RAYS = 4  # of a pixel in one pass
# of the diffuser: below this the error of a pixel is taken relative to it, not to the pixel
_DARK = 0.02


@dataclass(frozen=True)
class Exposed:
    """Rendered image: photons (rows, columns), and their error.

    `error` is the mean over the pixels that count of standard error over value.
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
    counted: Bool | None = None,
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
    counted : (rows, columns) the pixels of that mean, such as those that show bubbles; by default
        all.
    images, particles_mm : glowing particles among them, as `image_particles` gives them, and where
        they are.
    exposure_s : for how long the bubbles move.
    """
    scale = camera.etendue()
    stage_of = Stager(camera, tank, bubbles, bodies, lights, occluders, images, particles_mm)

    floor = _DARK * stage_of.brightest
    moments = 1  # of the exposure: one for each half pixel of the longest path
    if len(bubbles) and exposure_s and np.any(bubbles.velocity_mm_s):
        ends = [
            camera.project(bubbles.center_mm + sign * 0.5 * exposure_s * bubbles.velocity_mm_s)[0]
            for sign in (-1.0, 1.0)
        ]
        lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
        if np.isfinite(lengths).any():
            moments = int(np.ceil(2.0 * np.nanmax(lengths)))
    delays = exposure_s * ((np.arange(moments) + 0.5) / moments - 0.5)
    everywhere = np.ones((camera.rows, camera.columns), dtype=np.bool_)
    tally = PassTally(everywhere if counted is None else counted)
    more, needed = np.full(tally.count.size, STREAMS), math.inf
    while more.any():
        chosen = np.flatnonzero(more)
        for part in in_portions(more[chosen], AT_ONCE):  # memory does not grow with the image
            some = chosen[part]
            each = some, tally.count[some], more[some]
            tally.add(some, more[some], _passes(stage_of, camera, *each, delays, seed))
            report_share(tally.count.sum() / needed)
        off = tally.errors(floor)
        needed = tally.count.sum() * max((tally.mean_error(off) / error) ** 2, 1.0)
        more = tally.wanted(off, error) - tally.count
    photons = tally.mean.reshape(scale.shape) * scale
    wavelength = next(
        (light.wavelength_nm for light in (lights.backlight, lights.lighting) if light is not None),
        None,
    )
    blurred = photons if wavelength is None else diffract(camera, photons, wavelength)
    return Exposed(blurred, tally.mean_error(off))


def _passes(
    stage_of: Stager, camera: Camera, some: I64, before: I64, more: I64, delays: F64, seed: int
) -> F64:
    """Render so many more passes of some pixels (n,), one pixel after the other.

    A pass is some rays each, spread over the exposure. The passes of a pixel continue `STREAMS`
    lattices in turn; the points of a lattice do not depend on when they are rendered.
    """
    from sabench.simulation.rendering import bubble_integrator  # needs the variant

    pixels, turn, stream = np.empty((3, more.sum()), dtype=np.uint32)
    _list_passes(some, before, more, pixels, turn, stream)
    rays, total = -(-_RAYS // len(delays)), np.zeros(len(pixels))
    starts = turn * np.uint32(rays)
    for moment, delay in enumerate(delays.tolist()):
        own = np.array([(seed + k) * len(delays) + moment for k in range(STREAMS)])
        seeds = own.astype(np.uint32)[stream]
        total += bubble_integrator.radiance(
            stage_of(delay), camera, stage_of.origin, pixels, rays, seeds, starts
        )
    total /= len(delays)
    return total


@numba.njit(cache=True)
def _list_passes(
    some: Any, before: Any, more: Any, pixels: Any, turn: Any, stream: Any
) -> None:  # pragma: no cover
    n = 0
    for k in range(len(some)):
        for number in range(before[k], before[k] + more[k]):
            pixels[n], turn[n], stream[n] = some[k], number // STREAMS, number % STREAMS
            n += 1
