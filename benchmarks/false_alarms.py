"""False alarm rate and recall of detected particle images, for several sensors, as Markdown tables.

    python benchmarks/false_alarms.py [--frames N] [--output FILE] [--table FILE]

Images of 512 x 512 pixels without particles give the false alarm rates: peaks per pixel, of which
1e-5 are stated. Images with particles of a sensor of 12 bits give the share of them that is found.
"Before" is the threshold that `ray_triangulation` had before noise was measured by
`sabench.images.dark_noise`: the larger of 0.05 of a bright particle's peak and five standard
deviations by the median distance to the median of the image less black. `--table` prints the tables
of a record again.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.levels import normalise
from sabench.images.peaks import detect_particle_peaks, find_peaks
from sabench.images.preprocessing import preprocess, read_steps
from sabench.images.repair import find_points, repair
from sabench.interop.image_statistics import background_noise
from sabench.utils.arrays import F64, U16

RECORD = Path(__file__).with_name("records") / "false-alarms.json"
SIZE = 512
NEAR_PX = 1.5
SIGMA_PX, NOISE, BLACK, COUNT = 0.8, 4.0, 64.0, 400
RATIOS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0)
DENSITIES = (0.0015, 0.01, 0.05)
CHAIN = ({"step": "sliding_minimum", "window_px": 9}, {"step": "gaussian"})

Rng = np.random.Generator


def grey(values: F64, bits: int = 12) -> U16:
    """Round and clip to what a sensor of so many bits records."""
    return np.clip(np.rint(values), 0, (1 << bits) - 1).astype(np.uint16)


def normal(rng: Rng, mean: float | F64, sigma: float | F64) -> F64:
    """Draw an image of normal numbers."""
    return np.asarray(rng.normal(mean, sigma, (SIZE, SIZE)))


def poisson(rng: Rng, electrons: float | F64, gain: float, read_noise: float) -> F64:
    """Draw an image of photons with read noise, in grey values above 100."""
    counts = rng.poisson(np.broadcast_to(electrons, (SIZE, SIZE)))
    return 100.0 + gain * counts + normal(rng, 0.0, read_noise)


def uneven(rng: Rng) -> U16:
    """Draw photons of a bright spot and a slope."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    spot = 200.0 * np.exp(-((x - 0.4) ** 2 + (y - 0.6) ** 2) / 0.1)
    return grey(poisson(rng, 20.0 + spot + 60.0 * x, 2.0, 4.0))


def fixed_pattern(rng: Rng) -> U16:
    """Draw noise with an offset of each pixel and of each column."""
    columns = rng.normal(0.0, 1.0, (1, SIZE))
    return grey(normal(rng, 64.0, 2.0) + normal(rng, 0.0, 2.0) + columns)


def hot_pixels(rng: Rng) -> U16:
    """Draw noise in which one pixel of 5000 is 20 to 2000 grey values brighter."""
    hot = np.exp(rng.uniform(np.log(20.0), np.log(2000.0), (SIZE, SIZE)))
    return grey(normal(rng, 64.0, 2.0) + np.where(rng.random((SIZE, SIZE)) < 2e-4, hot, 0.0))


def chain(rng: Rng) -> U16:
    """Draw noise, cut it at black and smooth it, as preprocessing does."""
    image = grey(normal(rng, 64.0, 2.2))
    return np.asarray(preprocess(image[None], 64.0, 4095.0, read_steps(CHAIN, "chain"))[0])


SENSORS: dict[str, Callable[[Rng], U16]] = {
    "8 bits, black at 0, noise 0.2": lambda rng: grey(normal(rng, 0.0, 0.2), 8),
    "8 bits, black at 0, noise 0.8": lambda rng: grey(normal(rng, 0.0, 0.8), 8),
    "8 bits, black at 0, noise 3": lambda rng: grey(normal(rng, 0.0, 3.0), 8),
    "8 bits, black at 12.3, noise 0.3": lambda rng: grey(normal(rng, 12.3, 0.3), 8),
    "8 bits, black at 12.3, noise 1.2": lambda rng: grey(normal(rng, 12.3, 1.2), 8),
    "12 bits, noise 2.2": lambda rng: grey(normal(rng, 64.0, 2.2)),
    "12 bits, noise 6": lambda rng: grey(normal(rng, 100.0, 6.0)),
    "photon noise, 20 electrons": lambda rng: grey(poisson(rng, 20.0, 4.0, 4.0)),
    "photon noise, 5 electrons": lambda rng: grey(poisson(rng, 5.0, 8.0, 8.0)),
    "uneven background, photon noise": uneven,
    "fixed pattern of pixels and columns": fixed_pattern,
    "hot pixels, 200 a megapixel": hot_pixels,
    "smoothed noise": lambda rng: grey(64.0 + gaussian_filter(normal(rng, 0.0, 20.0), 1.0)),
    "smoothed noise, 8 bits, black at 0": lambda rng: grey(
        gaussian_filter(normal(rng, 0.0, 8.0), 1.0), 8
    ),
    "sliding minimum and Gaussian, cut at black": chain,
    "double exponential noise": lambda rng: grey(rng.laplace(64.0, 2.0, (SIZE, SIZE))),
}


def find_before(image: U16, black: float) -> F64:
    """Find peaks as before: over 0.05 of a bright one and five standard deviations."""
    good = repair(image[None], black, 65535.0)
    light = normalise(good.images, black, good.flaws.unknown)[0]
    return find_peaks(light, max(0.05, 5.0 * background_noise(light))).pixels


def find_after(image: U16) -> F64:
    """Detect peaks as solvers do, without pixels that repair takes for hot."""
    return detect_particle_peaks(image, find_points(image, float(np.median(image)))).pixels


def measure_sensor(draw: Callable[[Rng], U16], frames: int) -> dict[str, float]:
    """Count peaks per pixel of images without particles."""
    rng, counts = np.random.default_rng(7), np.zeros(2)
    for _ in range(frames):
        image = draw(rng)
        counts += len(find_before(image, float(np.median(image)))), len(find_after(image))
    before, after = (counts / (frames * SIZE**2)).tolist()
    return {"before": before, "after": after, "error": float(np.sqrt(counts[1])) / frames / SIZE**2}


def measure_recall(ratio: float, frames: int, count: int = COUNT) -> dict[str, float]:
    """Compute shares of particles that are found, and false peaks of an image.

    The ratio is that of the particles' peaks to the noise.
    """
    rng, found, false = np.random.default_rng(11), np.zeros(2), np.zeros(2)
    for _ in range(frames):
        place = rng.uniform(4.0, SIZE - 5.0, (count, 2))
        image = grey(normal(rng, BLACK, NOISE) + ratio * NOISE * draw_particles(place))
        for number, peaks in enumerate((find_before(image, BLACK), find_after(image))):
            if len(peaks):
                found[number] += (cKDTree(peaks).query(place)[0] < NEAR_PX).sum()
                false[number] += (cKDTree(place).query(peaks)[0] >= NEAR_PX).sum()
    shares, each = (found / (frames * count)).tolist(), (false / frames).tolist()
    return dict(zip(("before", "after", "false_before", "false_after"), shares + each, strict=True))


def draw_particles(place: F64) -> F64:
    """Draw Gaussians (n, 2) of columns and rows, whose peak is 1."""
    image = np.zeros((SIZE, SIZE))
    around = np.arange(-4, 5)
    for column, row in place:
        c, r = int(np.rint(column)), int(np.rint(row))
        across = np.exp(-0.5 * ((c + around - column) / SIGMA_PX) ** 2)
        down = np.exp(-0.5 * ((r + around - row) / SIGMA_PX) ** 2)
        image[r - 4 : r + 5, c - 4 : c + 5] += np.outer(down, across)
    return image


def measure(frames: int) -> dict[str, Any]:
    """Measure all sensors, ratios and densities."""
    dense = {f"{density:g}": int(density * SIZE**2) for density in DENSITIES}
    return {
        "frames": frames,
        "stated": FALSE_ALARMS,
        "sensors": {name: measure_sensor(draw, frames) for name, draw in SENSORS.items()},
        "recall": {f"{ratio:g}": measure_recall(ratio, 10) for ratio in RATIOS},
        "densities": {key: measure_recall(20.0, 2, count) for key, count in dense.items()},
    }


def tables(record: dict[str, Any]) -> str:
    """Write the record's tables in Markdown."""
    lines = ["| images without particles | before | now |", "|---|---|---|"]
    lines += [
        f"| {name} | {one['before']:.1e} | {one['after']:.1e} +- {one['error']:.0e} |"
        for name, one in record["sensors"].items()
    ]
    heads = ("peak over noise", "particles per pixel")
    for head, key in zip(heads, ("recall", "densities"), strict=True):
        heads_of = "| found before | false peaks | found now | false peaks |"
        lines += ["", f"| {head} {heads_of}", "|---|---|---|---|---|"]
        lines += [
            f"| {name} | {100.0 * one['before']:.1f} % | {one['false_before']:.1f} "
            f"| {100.0 * one['after']:.1f} % | {one['false_after']:.1f} |"
            for name, one in record[key].items()
        ]
    return "\n".join(lines)


def main() -> None:
    """Measure, write the record and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--table", type=Path)
    chosen = parser.parse_args()
    if chosen.table:
        record = json.loads(chosen.table.read_text(encoding="utf-8"))
    else:
        record = measure(chosen.frames)
    if chosen.output:
        chosen.output.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(tables(record))


if __name__ == "__main__":
    main()
