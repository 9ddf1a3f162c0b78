"""Brightness of single particles: accuracy against direct sums, memory, time, statistics.

`python benchmarks/mie.py [PARTICLES]` prints JSON for tracers of 20 um in water.

- **error**: root mean square of the relative difference from Mie's series at 101 chords of the
  aperture, for 300 particles of each spread of diameters.
- **seconds**: for PARTICLES (1,000,000) in nine cameras, tables included; and the tables' memory.
- **statistics**: standard deviation of the logarithm of the ratio of one particle's brightnesses
  in two cameras 20 degrees apart at f/16, and their correlation: of single particles, and of the
  mean over the distribution times d^2, which is a cloud's.
"""

import json
import sys
import time
from typing import Any

import numpy as np

from sabench.simulation.rendering.particle_light import Scattering, intensities
from sabench.utils.arrays import F64
from sabench.worlds.tracers import lattice_diameters_mm, size_numbers

_INDEX, _FLUID, _NM = 1.59, 1.333, 532.0
_RANGE = tuple(np.deg2rad([58.0, 122.0]))
_HALF = 0.0025  # rad in water: f/16 with 85 mm, from half a metre
_CAMERAS = 9


def main() -> None:
    """Measure and print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rng = np.random.default_rng(1)
    found: dict[str, Any] = {"particles": count, "cameras": _CAMERAS}
    for spread in (0.1, 0.3):
        found[f"spread {spread}"] = {
            "error": error(rng, spread),
            **cost(rng, spread, count),
            "statistics": statistics(rng, spread),
        }
    print(json.dumps(found, indent=1))


def draw(rng: np.random.Generator, spread: float, count: int) -> F64:
    """Draw diameters (count,) on the lattice."""
    return lattice_diameters_mm(size_numbers(0.02 * np.exp(spread * rng.standard_normal(count))))


def error(rng: np.random.Generator, spread: float) -> float:
    """Compare single particles with direct sums."""
    sizes, angles = draw(rng, spread, 300), np.deg2rad(rng.uniform(60.0, 120.0, 300))
    table = Scattering(_INDEX, _FLUID, _NM, _RANGE)
    got = table.cross_section(sizes, angles, np.full(300, _HALF), np.full(300, 0.5))
    turns, wavenumber = np.arange(1, 102) * np.pi / 102, 2.0 * np.pi * _FLUID / (_NM * 1e-6)
    weights = np.sin(turns) ** 2 / (np.sin(turns) ** 2).sum()
    direct = []
    for size, angle in zip(sizes, angles, strict=True):
        pair = intensities(
            _INDEX / _FLUID, np.array([wavenumber * size / 2.0]), angle + _HALF * np.cos(turns)
        )
        direct.append(weights @ (pair[0][0] + pair[1][0]) / 2.0 / wavenumber**2)
    return float(np.sqrt(np.mean((got / np.array(direct) - 1.0) ** 2)))


def cost(rng: np.random.Generator, spread: float, count: int) -> dict[str, float]:
    """Measure the time for all cameras, and the memory of the tables."""
    sizes, table = draw(rng, spread, count), Scattering(_INDEX, _FLUID, _NM, _RANGE)
    half, share, start = np.full(count, _HALF), np.full(count, 0.5), time.perf_counter()
    for _ in range(_CAMERAS):
        table.cross_section(sizes, np.deg2rad(rng.uniform(60.0, 120.0, count)), half, share)
    seconds = time.perf_counter() - start
    octaves = table._octaves.values()
    return {"seconds": seconds, "table_mb": sum(one.rows.nbytes for one in octaves) / 1e6}


def statistics(rng: np.random.Generator, spread: float) -> dict[str, list[float]]:
    """Compare two cameras' brightnesses of single particles, and of clouds."""
    sizes = draw(rng, spread, 20_000)
    table, half, share = Scattering(_INDEX, _FLUID, _NM, _RANGE), np.full(len(sizes), _HALF), 0.5
    pair = [
        table.cross_section(sizes, np.full(len(sizes), angle), half, np.full(len(sizes), share))
        for angle in np.deg2rad([80.0, 100.0])
    ]
    clouds = [np.mean(one / sizes**2) * sizes**2 for one in pair]
    return {"single": _compare(*pair), "cloud": _compare(*clouds)}


def _compare(first: F64, second: F64) -> list[float]:
    """Return the deviation of the logarithm of the ratio, and the correlation."""
    ratio = np.log(first / second)
    return [round(float(np.std(ratio)), 3), round(float(np.corrcoef(first, second)[0, 1]), 3)]


if __name__ == "__main__":
    main()
