"""Figures of the density: particles per pixel, overlap and ghosts."""

from __future__ import annotations

import math

import numpy as np

from sabench.evaluation.planning.light import Sample
from sabench.evaluation.planning.quantities import Advice, Quantity, Section
from sabench.evaluation.planning.viewing import Viewing
from sabench.metrics.particle_detection import ghost_ratio
from sabench.scenes import Scene

_NEIGHBOUR = 0.55396  # mean distance of the nearest neighbour x (number density)^(1/3)
_MOST_COVERED = 0.5  # of the images
_DENSITIES = ("per_pixel", "per_mm3", "count")


def plan_density(scene: Scene, view: Viewing, sample: Sample) -> Section:
    """Compute particles per pixel, covered pixels and the ghosts of equation 3.14."""
    cameras, count = view.rig.cameras, len(sample.particles)
    per_mm3 = count / math.prod(scene.volume.size_mm)
    pixels = float(np.mean([one.rows * one.columns for one in cameras]))
    per_pixel = sample.visible_share * count / pixels
    path_mm = view.depth_mm / np.abs(view.directions @ view.forward)
    densest = per_mm3 * float(np.nanmean(path_mm * view.pixels_mm**2))
    area = math.pi / 4.0 * sample.diameter_px**2
    planes = view.rig.grid.shape[2 - view.axis]
    ghosts = ghost_ratio(densest, len(cameras), area, planes)
    covered = 1.0 - math.exp(-densest * area)
    quantities = (
        Quantity("particles", count, "particles in the volume", "scene"),
        Quantity("per_mm3", per_mm3, "their number density C, 1/mm3", "scene"),
        Quantity(
            "neighbour_mm",
            _NEIGHBOUR * per_mm3 ** (-1 / 3) if count else None,
            _NEAREST,
            "0.554 C^(-1/3)",
        ),
        Quantity("ppp", per_pixel, "particles per pixel of an image", "projected"),
        Quantity("ppp_center", densest, "particles per pixel at the images' middle", "C Z_o dX^2"),
        Quantity("source_density", densest * area, "particles per image area there", "ppp A_p"),
        Quantity("covered_share", covered, "share of pixels covered there", "1 - exp(-ppp A_p)"),
        Quantity("ghosts_per_particle", ghosts, "lit voxels; an upper limit", "(3.14)"),
    )
    advice = []
    if covered > _MOST_COVERED:
        key = density_key(scene)
        advice.append(
            Advice(
                key,
                f"images cover {covered:.0%} of the pixels at the middle: reduce {key} by a factor "
                f"of {densest * area / -math.log(1.0 - _MOST_COVERED):.2g}, or volume.size_mm",
            )
        )
    return Section("density", quantities, tuple(advice))


_NEAREST = "mean distance of nearest neighbours"


def density_key(scene: Scene) -> str:
    """Name the key that sets the number of particles."""
    given = scene.particle_world.particles
    return "particles." + next((key for key in _DENSITIES if key in given), "generator")
