"""Figures 4-18 to 4-21: other points of the volume by estimated and by exact cameras; and by linear auto-calibration, even without refraction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.progress import track
from sabench.reproduce.chapter_4 import NOISES, STARTS, board, held_out, solved, stds
from sabench.reproduce.common import Row, claim, compared

SEEDS = 5
_CAMERAS, _BASELINE = 7, 0.3


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Scatter along Z of 500 points per draw."""
    linear = {}
    for noise in track(NOISES, "points in the volume"):
        pairs = [_pair("refractive_autocal", noise, 0.2, seed) for seed in seeds]
        estimated, exact = (float(stds([pair[i] for pair in pairs])[2]) for i in (0, 1))
        note = f"with the exact cameras {exact:.4g} mm"
        yield claim(f"{noise:g} px: scatter along Z by estimated over exact cameras", "the same", estimated / exact, estimated < 1.2 * exact, note)
        free = [_pair("linear_autocal", noise, 0.001, seed, wall=False) for seed in seeds]
        linear[noise] = float(stds([pair[0] for pair in free])[2])
        yield claim(
            f"{noise:g} px: linear auto-calibration without refraction over refractive auto-calibration with it", "at least as large",
            linear[noise] / estimated, linear[noise] > estimated, f"{linear[noise]:.4g} mm against {estimated:.4g}",
        )  # fmt: skip
    for start in STARTS:
        values = [float(stds([_pair("refractive_autocal", 0.5, start, seed)[0]])[2]) for seed in seeds]
        yield compared(f"0.5 px, start {start:g}: scatter along Z, mm", None, values, "thesis, figure 4-19: the same for every start")


def _pair(solver: str, noise: float, start: float, seed: int, *, wall: bool = True) -> tuple[np.ndarray, np.ndarray]:
    given = board(_CAMERAS, _BASELINE, noise, start, seed, wall)
    return held_out(solved(solver, given), given, noise, seed)
