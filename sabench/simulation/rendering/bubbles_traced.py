"""Renderer of bubbles, drops, bodies and tracers, to a requested accuracy.

A diffuser or lamps illuminate the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.bubble_stage_builder import Lights, Stager, Tank
from sabench.simulation.rendering.particle_images import ParticleImages, diffract
from sabench.simulation.rendering.pass_tally import STREAMS, PassTally
from sabench.utils.arrays import F64, I64, Bool, in_portions
from sabench.utils.compiled import numba

_RAYS = 4  # of a pixel in one pass
_AT_ONCE = 1 << 22  # passes of all pixels whose radiances are held
_SEEDS = 1 << 22
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
    moments = _moments(camera, bubbles, exposure_s)
    delays = exposure_s * ((np.arange(moments) + 0.5) / moments - 0.5)
    everywhere = np.ones((camera.rows, camera.columns), dtype=np.bool_)
    tally = PassTally(everywhere if counted is None else counted)
    more = np.full(tally.count.size, STREAMS)
    while more.any():
        chosen = np.flatnonzero(more)
        for part in in_portions(more[chosen], _AT_ONCE):  # memory does not grow with the image
            some = chosen[part]
            each = some, tally.count[some], more[some]
            tally.add(some, more[some], _passes(stage_of, camera, *each, delays, seed))
        off = tally.errors(floor)
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

    A pass is some rays each, spread over the exposure. The passes of a pixel take turns to go on
    with `STREAMS` lattices, whose points are the same whenever they are rendered.
    """
    from sabench.simulation.rendering import bubble_integrator  # needs the variant

    pixels, turn, stream = np.empty((3, more.sum()), dtype=np.uint32)
    _list_passes(some, before, more, pixels, turn, stream)
    rays, total = -(-_RAYS // len(delays)), np.zeros(len(pixels))
    starts = turn * np.uint32(rays)
    for moment, delay in enumerate(delays.tolist()):
        own = np.array([(seed + k) * len(delays) + moment for k in range(STREAMS)]) % _SEEDS
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
    """Fill in each pass's pixel, its stream, and the stream's passes before."""
    n = 0
    for k in range(len(some)):
        for number in range(before[k], before[k] + more[k]):
            pixels[n], turn[n], stream[n] = some[k], number // STREAMS, number % STREAMS
            n += 1


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
