"""Ray tracer against formulas: `python benchmarks/renderers.py [scene]`.

For each camera thousands of particles are placed behind the wall so that their images lie on a
jittered lattice, at least 12 px apart; centroids, light and widths are taken in windows of their
own. Images are all that the scene makes of the particles: single particles' Mie scattering, rings,
mirror images. The error of a solver that ignores the wall is computed with the same cameras in air.
Prints JSON.
"""

import json
import sys
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera
from sabench.scenes import Rig, Scene, build_rig, load_scene
from sabench.simulation import camera_view
from sabench.simulation.frames import FrameContent, Tracers
from sabench.simulation.rendering.particle_light import scatterers_of
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


class Moments(NamedTuple):
    """Moments of the images of n particles.

    Attributes
    ----------
    light : (n,) sums over windows.
    centroid : (n, 2) column and row from the node.
    width_px : (n,) fourth root of the determinant of the second moments.
    """

    light: F64
    centroid: F64
    width_px: F64


def moments(image: F64, nodes: I64) -> Moments:
    """Measure the images in a window around each node."""
    offset = np.arange(-_HALF, _HALF + 1)
    windows = image[nodes[:, 1, None, None] + offset[:, None], nodes[:, 0, None, None] + offset]
    light = windows.sum(axis=(1, 2))
    share = windows / light[:, None, None]
    x, y = share.sum(axis=1) @ offset, share.sum(axis=2) @ offset
    across = share.sum(axis=1) @ offset**2 - x**2
    down = share.sum(axis=2) @ offset**2 - y**2
    both = np.einsum("nij,i,j->n", share, offset, offset) - x * y
    width = np.maximum(across * down - both**2, 0.0) ** 0.25
    return Moments(light, np.stack([x, y], axis=1), width)


class Comparison(NamedTuple):
    """Differences of the renderers' images of n particles, and seconds of the ray tracer.

    Attributes
    ----------
    shift_px : (n, 2) centroid by rays less that by formulas.
    error_px : (n, 2) centroid by rays less the exact projection.
    light : (n,) ratio.
    width : (n,) ratio.
    """

    shift_px: F64
    error_px: F64
    light: F64
    width: F64
    seconds: float


def compare_renderers(scene: Scene, rig: Rig, number: int) -> Comparison:
    """Compare rays with formulas in one camera."""
    particles, nodes = lattice(scene, rig.cameras[number], number)
    scatterers = scatterers_of(scene, rig.cameras, number)
    tracers = Tracers(particles, (particles.position_mm,), scatterers)
    views, seconds = [], 0.0
    for renderer in ("splat", "mitsuba"):
        start = time.perf_counter()
        frame = FrameContent(scene, rig, number, 0, renderer, tracers=tracers)
        views.append(camera_view.render_camera_view(frame, number))
        seconds = time.perf_counter() - start
    formula, traced = (moments(view.photons, nodes) for view in views)
    images = views[0].particles
    assert images is not None
    return Comparison(
        traced.centroid - formula.centroid,
        traced.centroid + nodes - images.pixel,
        traced.light / formula.light,
        traced.width_px / formula.width_px,
        seconds,
    )


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


def _ratio(values: F64) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "spread": float(values.std()),
        "lowest": float(values.min()),
        "highest": float(values.max()),
    }


def main() -> None:
    """Compare the renderers on a scene's frame."""
    name = sys.argv[1] if len(sys.argv) > 1 else "demo"
    scene = load_scene(name)
    rig = build_rig(scene)
    found = [
        compare_renderers(scene, rig, number)
        for number in progress_bar(range(len(rig.cameras)), "render with Mitsuba")
    ]
    shift, exact, light, width = (np.concatenate([part[i] for part in found]) for i in range(4))
    report = {
        "scene": name,
        "backend": backend.choose().why,
        "cameras": len(rig.cameras),
        "isolated_particles": len(light),
        "render_s_per_camera": round(float(np.median([part.seconds for part in found])), 3),
        "mitsuba_minus_splat": _spread(shift),
        "mitsuba_minus_exact_projection": _spread(exact),
        "flux_ratio": _ratio(light),
        "width_ratio": _ratio(width),
        "wall_removed": without_wall(rig, scene, 20_000),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
