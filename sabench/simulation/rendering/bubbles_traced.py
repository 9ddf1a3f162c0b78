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
from sabench.utils.arrays import F64, I64

_RAYS = 16  # of a pixel in one pass
_PASSES = 4  # at least: their scatter is the error
_MOST = 1 << 16  # rays per pixel at most: a guard
_SEEDS = 1 << 22
# of the diffuser: below this the error of a pixel is taken relative to it, not to the pixel
_DARK = 0.02


@dataclass(frozen=True)
class Exposed:
    """Rendered image: photons (rows, columns), and their error.

    `error` is the mean over the pixels of standard error over value.
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
    images, particles_mm : glowing particles among them, as `image_particles` gives them, and where
        they are.
    exposure_s : for how long the bubbles move.
    """
    from scipy.ndimage import maximum_filter  # takes long to load

    scale = camera.etendue()
    stage_of = Stager(camera, tank, bubbles, bodies, lights, occluders, images, particles_mm)
    floor = _DARK * stage_of.brightest
    moments = _moments(camera, bubbles, exposure_s)
    delays = exposure_s * ((np.arange(moments) + 0.5) / moments - 0.5)
    tally = _Tally((camera.rows, camera.columns))
    chosen, number = np.arange(tally.count.size), 0
    while True:
        tally.add(chosen, _pass(stage_of, camera, chosen, delays, seed + number))
        number += 1
        if number < _PASSES:
            continue
        off = tally.errors(floor)
        rough = maximum_filter(
            (off > error).reshape(scale.shape), 3
        ).ravel()  # a pixel's error is that of its neighbours, too
        chosen = np.flatnonzero(rough & (tally.count * _RAYS < _MOST))
        if off.mean() <= error or not chosen.size:
            break
    photons = tally.mean.reshape(scale.shape) * scale
    wavelength = next(
        (light.wavelength_nm for light in (lights.backlight, lights.lighting) if light is not None),
        None,
    )
    blurred = photons if wavelength is None else diffract(camera, photons, wavelength)
    return Exposed(blurred, float(off.mean()))


def _pass(stage_of: Stager, camera: Camera, chosen: I64, delays: F64, seed: int) -> F64:
    """Render pixels' radiance (n,) by some rays each, spread over the exposure."""
    from sabench.simulation.rendering import bubble_integrator  # needs the variant

    rays, total = -(-_RAYS // len(delays)), np.zeros(len(chosen))
    for number, delay in enumerate(delays.tolist()):
        total += bubble_integrator.radiance(
            stage_of(delay),
            camera,
            stage_of.origin,
            chosen,
            rays,
            (seed * len(delays) + number) % _SEEDS,
        )
    return np.asarray(total / len(delays))


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


class _Tally:
    """Mean and scatter of every pixel's passes, updated by Welford's method."""

    def __init__(self, shape: tuple[int, int]) -> None:
        size = shape[0] * shape[1]
        self._shape = shape
        self.count, self.mean, self._squares = np.zeros(size), np.zeros(size), np.zeros(size)

    def add(self, where: Any, values: F64) -> None:
        self.count[where] += 1.0
        off = values - self.mean[where]
        self.mean[where] += off / self.count[where]
        self._squares[where] += off * (values - self.mean[where])

    def errors(self, floor: float) -> F64:
        """Compute standard errors over values, or over `floor` in darker pixels.

        A few rays that have found a pixel dark may have missed what its neighbours show: variances
        start from the mean over nine pixels, which counts as `_PASSES` passes.
        """
        from scipy.ndimage import uniform_filter

        variance = self._squares / (self.count * np.maximum(self.count - 1.0, 1.0))
        around = uniform_filter(variance.reshape(self._shape), 3).ravel()
        mixed = (self.count * variance + _PASSES * around) / (self.count + _PASSES)
        return np.asarray(
            np.sqrt(np.maximum(mixed, 0.0)) / np.maximum(self.mean, max(floor, 1e-300))
        )
