"""Ray tracer against formulas: `python benchmarks/renderers.py [scene]`.

For each camera thousands of particles are placed behind the wall so that their images lie on a
jittered lattice, at least 12 px apart; centroids and light are taken in windows of their own. The
error of a solver that ignores the wall is computed with the same cameras in air. Prints JSON.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera
from sabench.scenes import Rig, Scene, build_rig, load_scene
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import image_particles
from sabench.simulation.rendering.particles_traced import render
from sabench.utils import backend
from sabench.utils.arrays import F64, I64
from sabench.utils.progress import progress_bar

_PITCH, _JITTER, _HALF = (
    14,
    1.0,
    6,
)  # px: lattice, shift of each particle, half the window; neighbours are at least 12 px apart


def lattice(scene: Scene, camera: Camera, seed: int) -> tuple[Particles, I64]:
    """Place particles whose images lie near the nodes of a lattice.

    Returns particles in the volume's depth, and these nodes (column, row).
    """
    rng = np.random.default_rng(seed)
    column, row = np.meshgrid(
        np.arange(_PITCH, camera.columns - _PITCH, _PITCH),
        np.arange(_PITCH, camera.rows - _PITCH, _PITCH),
    )
    nodes = np.column_stack([column.ravel(), row.ravel()])
    rays = camera.back_project(nodes + rng.uniform(-_JITTER, _JITTER, nodes.shape))
    center, size = scene.volume.center_mm[2], scene.volume.size_mm[2]
    z = rng.uniform(center - size / 2.0, center + size / 2.0, len(nodes))
    positions = (
        rays.origins_mm
        + rays.directions * ((z - rays.origins_mm[:, 2]) / rays.directions[:, 2])[:, None]
    )
    diameter = np.full(len(nodes), float((scene.particles or {}).get("diameter_mm", 0.02)))
    return Particles(np.arange(len(nodes)), positions, diameter, np.zeros((len(nodes), 3))), nodes


def moments(image: F64, nodes: I64) -> tuple[F64, F64]:
    """Measure light and centroid (n, 2), relative to the node, in each window."""
    offset = np.arange(-_HALF, _HALF + 1)
    windows = image[nodes[:, 1, None, None] + offset[:, None], nodes[:, 0, None, None] + offset]
    light = windows.sum(axis=(1, 2))
    return light, np.stack(
        [windows.sum(axis=1) @ offset, windows.sum(axis=2) @ offset], axis=1
    ) / light[:, None]


def compare_renderers(scene: Scene, camera: Camera, seed: int) -> tuple[F64, F64, F64, float]:
    """Compare rays with formulas and with exact projection.

    Returns both centroid differences (n, 2), light ratios (n,), and seconds of the ray tracer.
    """
    particles, nodes = lattice(scene, camera, seed)
    images = image_particles(scene, camera, particles, None)
    start = time.perf_counter()
    picture = (
        render(camera, images, particles.position_mm, scene.render.samples_per_pixel)
        * camera.etendue()
    )
    seconds = time.perf_counter() - start
    traced, formula = (
        moments(picture, nodes),
        moments(particles_splatted.render(camera, images), nodes),
    )
    return traced[1] - formula[1], traced[1] + nodes - images.pixel, traced[0] / formula[0], seconds


def without_wall(rig: Rig, scene: Scene, count: int) -> dict[str, float]:
    """Compute the error of the same cameras in air without a wall, px.

    It is at random points of the volume, and also after each camera's best shift.
    """
    rng = np.random.default_rng(1)
    points = np.asarray(scene.volume.center_mm) + rng.uniform(-0.5, 0.5, (count, 3)) * np.asarray(
        scene.volume.size_mm
    )
    raw, shifted = [], []
    for camera in rig.cameras:
        through, valid = camera.project(points)
        error = (replace(camera, wall=None).project(points)[0] - through)[
            valid & camera.contains(through)
        ]
        raw.append(np.linalg.norm(error, axis=1))
        shifted.append(np.linalg.norm(error - error.mean(axis=0), axis=1))
    everything, rest = np.concatenate(raw), np.concatenate(shifted)
    return {
        "rms_px": _rms(everything),
        "largest_px": float(everything.max()),
        "rms_after_best_shift_px": _rms(rest),
        "largest_after_best_shift_px": float(rest.max()),
    }


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _spread(shift: F64) -> dict[str, Any]:
    return {
        "bias_px": shift.mean(axis=0).tolist(),
        "standard_error_px": (shift.std(axis=0) / np.sqrt(len(shift))).tolist(),
        "spread_px": shift.std(axis=0).tolist(),
        "largest_px": float(np.abs(shift).max()),
    }


def main() -> None:
    """Compare the renderers on a scene's frame."""
    name = sys.argv[1] if len(sys.argv) > 1 else "demo"
    loaded = load_scene(name)
    scene = loaded.model_copy(
        update={"illumination": loaded.light.model_copy(update={"scattering": "isotropic"})}
    )
    rig = build_rig(scene)
    found = [
        compare_renderers(scene, camera, i)
        for i, camera in enumerate(progress_bar(rig.cameras, "render with Mitsuba"))
    ]
    formula, exact, ratio = (np.concatenate([part[i] for part in found]) for i in range(3))
    report = {
        "scene": name,
        "backend": backend.choose().why,
        "cameras": len(rig.cameras),
        "isolated_particles": len(ratio),
        "render_s_per_camera": round(float(np.median([part[3] for part in found])), 3),
        "mitsuba_minus_splat": _spread(formula),
        "mitsuba_minus_exact_projection": _spread(exact),
        "flux_ratio": {
            "mean": float(ratio.mean()),
            "spread": float(ratio.std()),
            "lowest": float(ratio.min()),
            "highest": float(ratio.max()),
        },
        "wall_removed": without_wall(rig, scene, 20_000),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
