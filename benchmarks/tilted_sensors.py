"""Sensors tilted against their lenses: sharpness, and calibrations of the tilt.

`python benchmarks/tilted_sensors.py [draws]` prints JSON: widths of images in the scene
`scheimpflug`, with its tilts and without; and errors of calibrated tilts over their Cramer-Rao
bound, for nine cameras and five boards with 0.1 px of noise.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import (
    BoardImages,
    normal_equations,
    refine,
)
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.api.truth import Particles
from sabench.geometry.lens import UPRIGHT
from sabench.scenes import build_rig, load_scene
from sabench.simulation.rendering.particle_images import image_particles
from sabench.utils.arrays import F64

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from reproduction.chapter_4 import draw, scene_of

_NOISE_PX = 0.1
_TILTS = ((8.0, 0.0), (0.0, -6.0), (5.0, 5.0), (-4.0, 7.0), (3.0, -8.0), (-7.0, -2.0))


def measure_widths(f_number: float) -> dict[str, Any]:
    """Measure quantiles of the widths of images of all particles, px."""
    scene, rng = load_scene("scheimpflug"), np.random.default_rng(1)
    camera = replace(build_rig(scene).cameras[1], f_number=f_number)
    half = np.asarray(scene.volume.size_mm) / 2.0
    places = scene.volume.center_mm + rng.uniform(-half, half, (2000, 3))
    numbers, diameters = np.arange(len(places)), np.full(len(places), 0.02)
    particles = Particles(numbers, places, diameters, np.zeros_like(places))
    widths = {}
    for name, tilt in (("tilted", camera.tilt_deg), ("upright", UPRIGHT)):
        images = image_particles(scene, replace(camera, tilt_deg=tilt), particles, None)
        found = np.percentile(images.sigma_px[images.visible], [10, 50, 90])
        widths[name] = found.round(3).tolist()
    return {"f_number": f_number, "sigma_px_p10_p50_p90": widths}


def measure_calibration(draws: int) -> dict[str, Any]:
    """Measure the root mean square of errors of tilts, and of their ratio to the bound."""
    free, errors, ratios = FreeParameters(tilt=True), [], []
    for seed in range(1, draws + 1):
        given = draw(scene_of(9, 0.3, _NOISE_PX, 0.1), seed)
        cameras = tuple(
            replace(camera, tilt_deg=_TILTS[number % len(_TILTS)])
            for number, camera in enumerate(given.cameras)
        )
        pixels = [camera.project(given.points_mm.reshape(-1, 3))[0] for camera in cameras]
        exact = np.stack(pixels).reshape(given.exact.shape)
        there = np.isfinite(given.exact).all(axis=-1) & np.isfinite(exact).all(axis=-1)
        noise = _NOISE_PX * np.random.default_rng(seed).standard_normal(exact.shape)
        board_mm = given.case.target.points_mm
        weights = np.asarray(there, dtype=np.float64)
        seen = BoardImages(board_mm, np.nan_to_num(exact) + noise, weights)
        frame = WallFrame.from_cameras(cameras, given.points_mm)
        state = frame.state(board_mm, given.points_mm)
        found = refine(_perturb(state, seed), seen, free)
        errors.append(np.rad2deg(found.state.lenses[:, 8:] - state.lenses[:, 8:]))
        ratios.append(errors[-1] / _expected_deg(state, seen, free))
    rms = [float(np.sqrt(np.mean(np.square(values)))) for values in (errors, ratios)]
    return {
        "draws": draws,
        "noise_px": _NOISE_PX,
        "rms_tilt_deg": round(rms[0], 4),
        "rms_over_bound": round(rms[1], 3),
    }


def _perturb(state: State, seed: int) -> State:
    """Perturb the tilts by half a degree."""
    lenses = state.lenses.copy()
    lenses[:, 8:] += np.deg2rad(0.5) * np.random.default_rng(seed).standard_normal((len(lenses), 2))
    return replace(state, lenses=lenses)


def _expected_deg(state: State, seen: BoardImages, free: FreeParameters) -> F64:
    """Compute standard deviations (M, 2) of tilts by the Cramer-Rao bound."""
    normal = normal_equations(state, seen, free)
    solved = np.linalg.pinv(normal.bb, hermitian=True)
    part = np.einsum("kpa,kab,kqb->pq", normal.ab, solved, normal.ab)
    information = normal.aa - part
    scale = 1.0 / np.sqrt(np.diagonal(information))
    scaled = np.linalg.pinv(information * scale * scale[:, None], rcond=1e-11, hermitian=True)
    variances = (np.diagonal(scaled) * scale**2).reshape(-1, free.per_camera)[:, -2:]
    return np.asarray(np.rad2deg(_NOISE_PX * np.sqrt(variances)))


if __name__ == "__main__":
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    rows = [*(measure_widths(number) for number in (11.0, 5.6)), measure_calibration(draws)]
    print(json.dumps(rows, indent=1))
