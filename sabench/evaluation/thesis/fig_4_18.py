"""Figures 4-18 to 4-21: held-out points by estimated and by exact cameras.

Linear auto-calibration is compared, also without refraction.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import NOISES, STARTS, board, held_out, solve_case, stds
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.plotting.charts import Figure, Histogram, Panel
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

SEEDS = 5
_CAMERAS, _BASELINE = 7, 0.3
_TITLES = {
    "fig-4-18": "Figure 4-18: other points by estimated and by exact cameras",
    "fig-4-19": "Figure 4-19: the same at 0.5 px by start",
    "fig-4-20": "Figure 4-20: linear auto-calibration without refraction",
    "fig-4-21": "Figure 4-21: the same at 0.5 px, one draw each",
}


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scatter along Z of 500 points per draw."""
    linear: dict[float, float] = {}
    panels: dict[str, list[Panel]] = {name: [] for name in _TITLES}
    for noise in progress_bar(NOISES, "points in the volume"):
        pairs = [_pair("refractive_autocal", noise, 0.2, seed) for seed in seeds]
        estimated, exact = (float(stds([pair[i] for pair in pairs])[2]) for i in (0, 1))
        note = f"with the exact cameras {exact:.4g} mm"
        yield claim(
            f"{noise:g} px: scatter along Z by estimated over exact cameras",
            "the same",
            estimated / exact,
            estimated < 1.2 * exact,
            note,
        )
        free = [_pair("linear_autocal", noise, 0.001, seed, wall=False) for seed in seeds]
        linear[noise] = float(stds([pair[0] for pair in free])[2])
        yield claim(
            f"{noise:g} px: linear auto-calibration without refraction "
            "over refractive auto-calibration with it",
            "at least as large",
            linear[noise] / estimated,
            linear[noise] > estimated,
            f"{linear[noise]:.4g} mm against {estimated:.4g}",
        )
        both = (
            _depths("refractive", [pair[0] for pair in pairs]),
            _depths("exact cameras", [pair[1] for pair in pairs]),
        )
        panels["fig-4-18"].append(_panel(f"{noise:g} px", *both))
        panels["fig-4-20"].append(
            _panel(
                f"{noise:g} px",
                _depths("linear, without refraction", [pair[0] for pair in free]),
                both[0],
            )
        )
        if noise == 0.5:
            panels["fig-4-21"] = [
                _panel(f"seed {seed}", _depths("linear", [pair[0]]))
                for seed, pair in zip(seeds, free, strict=True)
            ]
    for start in STARTS:
        errors = [_pair("refractive_autocal", 0.5, start, seed)[0] for seed in seeds]
        values = [float(stds([own])[2]) for own in errors]
        panels["fig-4-19"].append(_panel(f"start {start:g}", _depths("refractive", errors)))
        yield make_row(
            f"0.5 px, start {start:g}: scatter along Z, mm",
            None,
            values,
            "thesis, figure 4-19: the same for every start",
        )
    for name, words in _TITLES.items():
        yield Figure(name, words, tuple(panels[name]))


def _depths(label: str, errors: Sequence[F64]) -> Histogram:
    return Histogram(label, np.concatenate([own[:, 2] - own[:, 2].mean() for own in errors]))


def _panel(title: str, *content: Histogram) -> Panel:
    return Panel(title, "error along Z without its mean, mm", "density, 1/mm", content)


def _pair(
    solver: str, noise: float, start: float, seed: int, *, wall: bool = True
) -> tuple[F64, F64]:
    given = board(_CAMERAS, _BASELINE, noise, start, seed, wall)
    return held_out(solve_case(solver, given), given, noise, seed)
