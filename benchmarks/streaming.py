"""Rates of `sabench.stream`, beside a program that only adds windows, and memory of a long stream.

`python benchmarks/streaming.py [SECONDS]` prints a Markdown table and the memory as JSON.

- **Rates**: samples of two frames of one camera in air, particles of equal light and images of
  about 0.75 px, in windows of 9 x 9 pixels: pairs, megapixels and particle images a second, by size
  of the images and particles per pixel; each for SECONDS (5).
- **Roofline**: windows of 9 x 9 pixels a second that a kernel adds to an image of the same size,
  with all profiles known, on the same number of threads. No renderer can be faster; the last column
  is the stream's share of it, with truth, light, splat and noise.
- **Memory**: of this process after 100 and after 2,000 samples of 128 x 128 pixels.
"""

from __future__ import annotations

import itertools
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from sabench.scenes import Scene, parse_scene
from sabench.simulation.streaming import stream_samples

SIZES, DENSITIES = (128, 256, 512, 1024), (0.01, 0.05)
_WINDOW, _BAND = 9, 64
_PIXEL_MM = 0.05  # in the volume: the camera's magnification is 0.2


def planar_scene(size: int, per_pixel: float) -> Scene:
    """Make a scene of one camera of size x size pixels before a thin volume in air."""
    width = 0.9 * size * _PIXEL_MM
    return parse_scene(
        {
            "title": f"plane of {size} x {size} pixels",
            "frames": 2,
            "volume": {"center_mm": [0.0, 0.0, 0.0], "size_mm": [width, width, 1.0]},
            "grid": {"voxel_mm": [0.1, 0.1, 0.1]},
            "cameras": {
                "rows": size,
                "columns": size,
                "pixel_mm": 0.01,
                "focal_length_mm": 50.0,
                "f_number": 27.0,
                "center_mm": [0.0, 0.0, -300.0],
                "layout": {"kind": "list", "places": [{"center_mm": [0.0, 0.0, -300.0]}]},
            },
            "illumination": {
                "wavelength_nm": 532.0,
                "pulse_energy_mj": 30.0,
                "direction": [1.0, 0.0, 0.0],
                "sheet_normal": [0.0, 0.0, 1.0],
                "thickness_mm": 4.0,
                "height_mm": 4.0 * width,
                "scattering": "isotropic",
            },
            "particles": {"generator": "uniform", "per_pixel": per_pixel, "diameter_mm": 0.02},
            "flow": {"generator": "linear_flow", "velocity_mm_s": [100.0, 0.0, 0.0]},
        },
        "planar",
    )


@numba.njit(parallel=True, fastmath=True)
def _add(image: Any, rows: Any, columns: Any, down: Any, across: Any) -> None:
    """Add windows of known profiles to an image; each thread to a band of its own."""
    bands = image.shape[0] // _BAND
    each = len(rows) // bands
    for band in numba.prange(bands):
        for i in range(band * each, (band + 1) * each):
            top, left = band * _BAND + rows[i], columns[i]
            for j in range(_WINDOW):
                for k in range(_WINDOW):
                    image[top + j, left + k] += down[i, j] * across[i, k]


def roofline(size: int, seconds: float) -> float:
    """Count windows a second that threads add to an image of so many pixels."""
    rng, count = np.random.default_rng(1), 50_000
    rows = rng.integers(0, _BAND - _WINDOW, count)
    columns = rng.integers(0, size - _WINDOW, count)
    down, across = rng.random((2, count, _WINDOW))
    image, done = np.zeros((size, size)), 0
    _add(image, rows, columns, down, across)
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        _add(image, rows, columns, down, across)
        done += count
    return done / (time.perf_counter() - start)


def measure(size: int, per_pixel: float, seconds: float) -> dict[str, float]:
    """Measure the rates of a scene's stream."""
    stream = stream_samples(planar_scene(size, per_pixel), seed=1, batch=4)
    first = next(stream)
    assert first.images.shape[1:] == (2, 1, size, size)
    pairs = images = 0
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        for sample in next(stream).samples:
            pairs += 1
            images += sum(len(particles) for particles in sample.particles)
    spent = time.perf_counter() - start
    megapixels = 2e-6 * pairs * size**2 / spent
    return {"pairs": pairs / spent, "megapixels": megapixels, "images": images / spent}


def memory_mb(samples: int) -> float:
    """Stream a number of samples, and return the most memory this process had."""
    stream = stream_samples(planar_scene(128, 0.05), seed=2, batch=10)
    for _ in itertools.islice(stream, samples // 10):
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Measure and print."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    memory = {str(samples): round(memory_mb(samples), 1) for samples in (100, 2000)}
    print("| pixels | per pixel | pairs/s | megapixels/s | million images/s | windows/s | share |")
    print("|---|---|---|---|---|---|---|")
    for size, per_pixel in itertools.product(SIZES, DENSITIES):
        one, most = measure(size, per_pixel, seconds), roofline(size, seconds / 5.0)
        cells = [f"{size} x {size}", f"{per_pixel:g}", f"{one['pairs']:.0f}"]
        cells += [f"{one['megapixels']:.1f}", f"{1e-6 * one['images']:.2f}"]
        cells += [f"{1e-6 * most:.0f} million", f"{100.0 * one['images'] / most:.1f} %"]
        print(f"| {' | '.join(cells)} |", flush=True)
    print(json.dumps({"memory_mb": memory, "threads": numba.get_num_threads()}))


if __name__ == "__main__":
    main()
