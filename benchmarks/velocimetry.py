"""Speed and response of 3-D PIV: `benchmarks/velocimetry.py [WIDTH DEPTH]`.

Two volumes of WIDTH x WIDTH x DEPTH voxels (1000 x 1000 x 100) with 20 particles per window of 32 x
32 x 16 voxels are evaluated; everything is compiled on a small pair first. The first pass is
compared with its three Fourier transforms per window alone; a later pass (volumes moved by cubic
splines, correlation, validation) with scipy's `map_coordinates` moving the same two volumes once.
Then the response: the measured amplitude of sinusoidal shears, over the wavelength, compared with
that of the mean over a window; and how well a particle closes its path about a ring's core.
"""

import json
import sys
import timeit
from typing import Any

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from sabench.algorithms.velocimetry.windows import Windows, by_spectra
from sabench.api import Velocity, VolumePair
from sabench.geometry.grid import Grid, synthesise
from sabench.metrics.velocity_error import response
from sabench.plugins import load
from sabench.utils.arrays import F32, F64
from sabench.utils.progress import progress_bar
from sabench.worlds.advection import advect
from sabench.worlds.tracers import TOLERANCE

WINDOW = (16, 32, 32)
_PER_WINDOW, _SIGMA_MM, _VOXEL_MM = 20.0, 0.034, (0.05, 0.05, 0.1)
_WAVES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0)  # windows
_SHIFT = 1.0  # voxels: amplitude of the waves
_SAMPLE = 2_000_000  # voxels that scipy moves


def pair_of(grid: Grid, flow: Any, seed: int = 0) -> tuple[F32, F32]:
    """Make volumes of particles before and after a flow of one second."""
    size = np.asarray(grid.shape[::-1]) * np.asarray(grid.voxel_mm)
    low = np.asarray(grid.low_mm) - 0.5 * np.asarray(grid.voxel_mm) - 1.0  # some enter and leave
    count = round(
        float(np.prod(size + 2.0))
        * _PER_WINDOW
        / float(np.prod(np.asarray(WINDOW[::-1]) * np.asarray(grid.voxel_mm)))
    )
    start = np.random.default_rng(seed).uniform(low, low + size + 2.0, (count, 3))
    before, after = (advect(flow, start, 0.5, time, 1e-6) for time in (0.0, 1.0))
    return synthesise(grid, before, np.ones(count), _SIGMA_MM), synthesise(
        grid, after, np.ones(count), _SIGMA_MM
    )


def grid_of(width: int, height: int, depth: int) -> Grid:
    """Make a centred grid."""
    x, y, z = (
        -(count - 1) / 2.0 * voxel
        for count, voxel in zip((width, height, depth), _VOXEL_MM, strict=True)
    )
    return Grid((x, y, z), _VOXEL_MM, (depth, height, width))


def flow_of(name: str, **parameters: Any) -> Any:
    """Make a flow by its name."""
    plugin = load("generators", name)
    return plugin(plugin.Parameters(**parameters))


def best(work: Any, repeats: int = 3) -> float:
    """Measure the seconds of the fastest of a few runs."""
    return min(timeit.repeat(work, number=1, repeat=repeats))


def run_passes(pair: VolumePair, passes: int) -> Velocity:
    """Solve with `piv3d`'s defaults, except for first window and passes."""
    plugin = load("solvers", "piv3d")
    made: Velocity = plugin(
        plugin.Parameters(first_window=WINDOW[::-1], window=WINDOW[::-1], passes=passes)
    ).solve(pair)
    return made


def speed(width: int, depth: int) -> dict[str, float]:
    """Measure vectors a second of the first and of a later pass, and references."""
    flow = flow_of("taylor_green", wavelength_mm=20.0, peak_mm_s=0.1)
    small, grid = grid_of(96, 96, 48), grid_of(width, width, depth)
    run_passes(VolumePair(*pair_of(small, flow), small, 1.0), 1)
    first, second = pair_of(grid, flow)
    pair = VolumePair(first, second, grid, 1.0)
    shape = (depth, width, width)
    coarse, fine = Windows.over(shape, WINDOW, 0.5), Windows.over(shape, WINDOW, 0.75)
    spectra = best(lambda: by_spectra(first, second, coarse))
    rates = [best(lambda passes=passes: run_passes(pair, passes), 2) for passes in (1, 5)]
    later = (rates[1] - rates[0]) / 4.0
    batch = np.zeros((64, *WINDOW), dtype=np.float32)
    transformed = scipy.fft.rfftn(batch, axes=(1, 2, 3), workers=-1)
    there = best(lambda: scipy.fft.rfftn(batch, axes=(1, 2, 3), workers=-1), 50)
    back = best(lambda: scipy.fft.irfftn(transformed, s=WINDOW, axes=(1, 2, 3), workers=-1), 50)
    positions = np.random.default_rng(0).uniform(2.0, np.array(shape)[:, None] - 3.0, (3, _SAMPLE))
    moved = (
        best(lambda: map_coordinates(first, positions, order=3, prefilter=False))
        / _SAMPLE
        * 2.0
        * first.size
    )
    count, many = int(np.prod(coarse.counts)), int(np.prod(fine.counts))
    return {
        "first_pass_vectors_per_s": round(count / spectra),
        "first_pass_over_its_transforms": round(spectra / (count / 64 * (2.0 * there + back)), 2),
        "later_pass_vectors_per_s": round(many / later),
        "scipy_s_moving_volumes_over_a_later_pass": round(moved / later, 1),
    }


def amplitude(solver: str, across: tuple[float, float, float], wavelength_mm: float) -> float:
    """Measure the fraction of a wave's amplitude that a solver finds."""
    along = (1.0, 0.0, 0.0) if across[0] == 0.0 else (0.0, 1.0, 0.0)
    flow = flow_of(
        "shear_wave",
        along=along,
        across=across,
        wavelength_mm=wavelength_mm,
        peak_mm_s=_SHIFT * _VOXEL_MM[0],
    )
    grid = grid_of(288, 288, 112)
    plugin = load("solvers", solver)
    field = plugin(plugin.Parameters()).solve(VolumePair(*pair_of(grid, flow), grid, 1.0))
    exact: F64 = flow.velocity(field.positions_mm.reshape(-1, 3), 0.5).reshape(
        field.velocity_mm_s.shape
    )
    return response(field.velocity_mm_s[field.valid], exact[field.valid])


def once_around() -> float:
    """Measure by how much a particle misses its start after one revolution.

    The thesis's ring carries it once around the core; the distance is relative to the ring's
    diameter.
    """
    ring = flow_of("vortex_ring", diameter_mm=20.0, core_mm=4.0, peak_mm_s=100.0)
    start = np.array([[14.0, 0.0, 0.0], [10.0, 0.0, 2.0], [7.0, 0.0, 0.0]])
    radii = np.hypot(start[:, 0] - 10.0, start[:, 2])
    periods = 2.0 * np.pi * radii / np.linalg.norm(ring.velocity(start, 0.0), axis=1)
    tolerance = TOLERANCE * 50.0
    ends = [
        advect(ring, position[None], 0.0, float(period), tolerance)[0]
        for position, period in zip(start, periods, strict=True)
    ]
    return float(np.linalg.norm(np.array(ends) - start, axis=1).max() / 20.0)


def main() -> None:
    """Print one JSON object."""
    width, depth = (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) == 3 else (1000, 100)
    out: dict[str, Any] = {
        "volume": [width, width, depth],
        "window": WINDOW[::-1],
        "once_around_over_ring": once_around(),
        **speed(width, depth),
        "response": [],
    }
    for size in progress_bar(_WAVES, "waves"):
        row = {"wavelength_over_window": size, "top_hat": round(float(np.sinc(1.0 / size)), 3)}
        for solver in ("piv3d_plain", "piv3d"):
            for name, across, window in (
                ("y", (0.0, 1.0, 0.0), WINDOW[1] * _VOXEL_MM[1]),
                ("z", (0.0, 0.0, 1.0), WINDOW[0] * _VOXEL_MM[2]),
            ):
                row[f"{solver}, across {name}"] = round(amplitude(solver, across, size * window), 3)
        out["response"].append(row)
    print(json.dumps(out, indent=1))


if __name__ == "__main__":
    main()
