"""Rates of `sabench.stream`, next to the least that they can cost, and memory of a long stream.

`python benchmarks/streaming.py [SECONDS]` prints Markdown tables and the memory as JSON.

- **Streams**: samples of two frames of one camera in air, particles of equal light and images of
  about 0.75 px, in windows of 9 x 9 pixels: pairs, megapixels and particle images a second of CPU
  time, by size of the images and particles per pixel; each for SECONDS (5). Streams of images below
  four megapixels use one thread.
- **Windows**: windows of 9 x 9 pixels a CPU second that a kernel adds to an image of the same size,
  with all profiles known, on one thread. No renderer can be faster; the share is the stream's, with
  truth, light, splat and noise.
- **SynthPix** (a generator of planar particle images in JAX), where it is installed: the same
  images with Gaussian noise, in single precision, of as many particles in as large windows; pairs a
  CPU second.
- **Frames**: images of one frame a second by number of threads, and milliseconds of CPU time of
  its noise per megapixel, next to a kernel that computes one Philox block for each pixel, reads its
  light and writes a grey value.
- **Memory**: of this process after 100 and after 2,000 samples of 128 x 128 pixels.
"""

import importlib.util
import itertools
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import FrameContent, Frames
from sabench.simulation.in_memory import record_frame
from sabench.simulation.shard_job import stream
from sabench.utils.philox import draw_key, fill_blocks

SIZES, DENSITIES = (128, 256, 512, 1024), (0.01, 0.05)
CPU = time.process_time  # of all threads: other programs on the machine change it little
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


@numba.njit(parallel=True)
def _least_noise(photons: Any, key: Any, grey: Any) -> None:
    """Compute a block for each pixel, and a grey value that holds both."""
    for row in numba.prange(len(photons)):
        _least_noise_row(photons[row], key, np.uint64(row), grey[row])


@numba.njit
def _least_noise_row(photons: Any, key: Any, row: Any, grey: Any) -> None:
    blocks, none = np.empty((4, len(photons)), np.uint32), np.uint64(0)
    fill_blocks(key, none, row, none, none, blocks)
    for column in range(len(photons)):
        grey[column] = np.uint16(min(0.2 * photons[column] + (blocks[0, column] & 1), 4095.0))


def rate(
    work: Callable[[], object], seconds: float, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Count calls a second, after one."""
    work()
    done, start = 0, clock()
    while clock() - start < seconds:
        work()
        done += 1
    return done / (clock() - start)


def windows_s(size: int, seconds: float) -> float:
    """Count windows a CPU second that one thread adds to an image of so many pixels."""
    rng, count = np.random.default_rng(1), 50_000
    rows = rng.integers(0, _BAND - _WINDOW, count)
    columns = rng.integers(0, size - _WINDOW, count)
    down, across = rng.random((2, count, _WINDOW))
    image = np.zeros((size, size))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    most = count * rate(lambda: _add(image, rows, columns, down, across), seconds, CPU)
    numba.set_num_threads(threads)
    return most


def synthpix_pairs_s(size: int, per_pixel: float, seconds: float) -> float | None:
    """Count pairs that SynthPix makes in a CPU second; None if it is not installed."""
    if importlib.util.find_spec("synthpix") is None:
        return None
    import jax
    from synthpix.generate import add_noise_to_image, img_gen_from_data

    count, widest = round(per_pixel * size**2), 2.0 * (_WINDOW // 2) / 3.0
    sigmas = jax.numpy.full(count, 2.0 * 0.75)  # its diameter is two standard deviations

    @jax.jit
    def pair(key: Any) -> Any:
        keys = jax.random.split(key, 3)
        places = size * jax.random.uniform(keys[0], (count, 2))
        images = [
            img_gen_from_data(places + shift, (size, size), widest, sigmas, sigmas)
            for shift in (0.0, 5.0)
        ]
        return [
            add_noise_to_image(own, image, noise_gaussian_std=5.0)
            for own, image in zip(keys[1:], images, strict=True)
        ]

    keys = iter(jax.random.split(jax.random.key(1), 100_000))
    return rate(lambda: [np.asarray(image) for image in pair(next(keys))], seconds, CPU)


def measure(size: int, per_pixel: float, seconds: float) -> dict[str, float]:
    """Measure the rates of a scene's stream."""
    batches = stream(planar_scene(size, per_pixel), seed=1, batch=4)
    first = next(batches)
    assert first.images.shape[1:] == (2, 1, size, size)
    pairs = images = 0
    start = CPU()
    while CPU() - start < seconds:
        for sample in next(batches).samples:
            pairs += 1
            images += sum(len(particles) for particles in sample.particles)
    spent = CPU() - start
    megapixels = 2e-6 * pairs * size**2 / spent
    return {"pairs": pairs / spent, "megapixels": megapixels, "images": images / spent}


def memory_mb(samples: int) -> float:
    """Stream a number of samples, and return the most memory this process had."""
    batches = stream(planar_scene(128, 0.05), seed=2, batch=10)
    for _ in itertools.islice(batches, samples // 10):
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def compare_streams(seconds: float) -> None:
    """Print the table of streams."""
    print(
        "| pixels | per pixel | pairs/s | megapixels/s | million images/s | of windows | SynthPix |"
    )
    print("|---|---|---|---|---|---|---|")
    for size, per_pixel in itertools.product(SIZES, DENSITIES):
        one, most = measure(size, per_pixel, seconds), windows_s(size, seconds / 5.0)
        other = synthpix_pairs_s(size, per_pixel, seconds)
        cells = [f"{size} x {size}", f"{per_pixel:g}", f"{one['pairs']:.0f}"]
        cells += [f"{one['megapixels']:.1f}", f"{1e-6 * one['images']:.2f}"]
        cells += [f"{100.0 * one['images'] / most:.1f} % of {1e-6 * most:.0f} million/s"]
        cells += ["not installed" if other is None else f"{other:.0f} pairs/s"]
        print(f"| {' | '.join(cells)} |", flush=True)


def frame_rates(frame: FrameContent, seconds: float) -> list[float]:
    """Count images a second, and passes of their noise and of a block for each pixel."""
    view, key = render_camera_view(frame, 0), draw_key(np.random.default_rng(1))
    grey = np.empty(view.photons.shape, dtype=np.uint16)
    return [
        rate(lambda: record_frame(frame), seconds),
        rate(lambda: record_image(frame, view, 0), seconds / 5.0, CPU),
        rate(lambda: _least_noise(view.photons, key, grey), seconds / 5.0, CPU),
    ]


def compare_threads(seconds: float) -> None:
    """Print the table of frames."""
    most = numba.get_num_threads()
    print("\n| pixels | per pixel | threads | images/s | noise, ms | block for each pixel, ms |")
    print("|---|---|---|---|---|---|")
    for size, per_pixel in itertools.product((256, 1024), DENSITIES):
        scene = planar_scene(size, per_pixel)
        frame = Frames(scene, build_rig(scene, scene.title), 1, "splat").at(0)
        for threads in sorted({1, most}):
            numba.set_num_threads(threads)
            images, *passes = frame_rates(frame, seconds)
            cells = [f"{size} x {size}", f"{per_pixel:g}", f"{threads}", f"{images:.1f}"]
            cells += [f"{1e9 / each / size**2:.1f}" for each in passes]
            print(f"| {' | '.join(cells)} |", flush=True)
    numba.set_num_threads(most)


def main() -> None:
    """Measure and print."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    memory = {str(samples): round(memory_mb(samples), 1) for samples in (100, 2000)}
    compare_streams(seconds)
    compare_threads(seconds)
    print(json.dumps({"memory_mb": memory, "threads": numba.get_num_threads()}))


if __name__ == "__main__":
    main()
