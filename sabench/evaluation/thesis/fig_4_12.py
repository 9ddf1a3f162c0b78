"""Figures 4-11 to 4-15: errors of the auto-calibration against noise.

They also vary with the initial guess; the thesis's alternation is compared with the joint
adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import (
    BASELINE,
    CAMERAS,
    D_PIX,
    NOISES,
    SOLVERS,
    STARTS,
    Draws,
    board,
    draw_points,
    follow_rounds,
    measure,
    stds,
)
from sabench.evaluation.thesis.common import Item, Row, claim, make_row
from sabench.plotting.charts import Curve, Figure, Panel

SEEDS = 5
_MEAN, _STD = 0.33, 1.17  # largest mean and scatter with 7 cameras at 2 px, in D_PIX


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors per number of cameras and noise, over all initial guesses.

    The measured error is relative to the noise, the true error to the measured one.
    """
    panels = []
    for cameras in CAMERAS:
        found = {}
        for noise in NOISES:
            found[noise] = measure(cameras, noise, seeds)
            for name in SOLVERS:
                yield from _noise_rows(cameras, noise, name, found[noise])
        if cameras == 7:
            yield from _point_rows(found[2.0])
            yield draw_points(
                "fig-4-14", "Figures 4-14 and 4-15: errors of the points, 7 cameras", found
            )
        panels.append(_errors_panel(cameras, found))
    yield Figure("fig-4-12", "Figure 4-12: measured and true reprojection error", tuple(panels))
    yield from _rounds(seeds)


def _errors_panel(cameras: int, found: dict[float, Draws]) -> Panel:
    """Draw figure 4-12: errors against the imposed noise, by initial guess."""
    imposed = [noise * float(np.sqrt(np.pi / 2.0)) for noise in NOISES]
    joint = [
        np.mean(
            [one.measured_px.mean() for start in STARTS for one in found[noise]["joint", start]]
        )
        for noise in NOISES
    ]
    curves = [
        Curve("imposed", NOISES, imposed),
        Curve("measured, joint", NOISES, [float(value) for value in joint]),
    ]
    for name, starts in (("joint", (0.2,)), ("alternating", (0.001, 0.01, 0.1, 0.2))):
        for start in starts:
            true = [
                float(np.mean([one.true_px.mean() for one in found[noise][name, start]]))
                for noise in NOISES
            ]
            curves.append(Curve(f"true, {name}, start {start:g}", NOISES, true))
    return Panel(
        f"{cameras} cameras", "noise of a coordinate, px", "mean error, px", tuple(curves), "xy"
    )


def _noise_rows(cameras: int, noise: float, name: str, found: Draws) -> Iterator[Row]:
    every = [one for (own, _), draws in found.items() if own == name for one in draws]
    head = f"{cameras} cameras, {noise:g} px, {name}"
    imposed = noise * float(np.sqrt(np.pi / 2.0))
    yield make_row(
        f"{head}: mean measured error, px",
        imposed,
        [float(one.measured_px.mean()) for one in every],
        "thesis: equal to the imposed error",
        "smaller",
    )
    ratios = [float(one.true_px.mean() / one.measured_px.mean()) for one in every]
    by_start = ", ".join(
        f"{start:g}: {np.mean([one.true_px.mean() for one in found[name, start]]):.3g}"
        for start in STARTS
    )
    yield claim(
        f"{head}: true / measured",
        "about 10 %",
        float(np.mean(ratios)),
        0.05 <= float(np.mean(ratios)) <= 0.15,
        f"true px by start: {by_start}",
    )


def _point_rows(found: Draws) -> Iterator[Row]:
    """Measure the last row of figures 4-14 and 4-15: 7 cameras, 2 px."""
    for name in SOLVERS:
        every = [one.errors_mm for (own, _), draws in found.items() if own == name for one in draws]
        scatter = stds(every) / D_PIX
        means = np.abs([errors.mean(axis=0) for errors in every]).max(axis=0) / D_PIX
        note = f"X, Y, Z: {', '.join(f'{value:.3g}' for value in scatter)}"
        yield make_row(
            f"7 cameras, 2 px, {name}: scatter along Z, pixels of the middle",
            _STD,
            [float(scatter[2])],
            note,
            "smaller",
        )
        yield make_row(
            f"7 cameras, 2 px, {name}: largest mean along Z, the same unit",
            _MEAN,
            [float(means[2])],
            "one point known to 0.05 mm",
            "smaller",
        )
        yield claim(
            f"7 cameras, 2 px, {name}: the error is largest along Z",
            "yes",
            float(scatter[2] / scatter[:2].max()),
            bool(scatter[2] > scatter[:2].max()),
        )


def _rounds(seeds: Sequence[int]) -> Iterator[Item]:
    """Draw figure 4-11: rounds of the alternation with 7 cameras at 0.5 px."""
    curves = []
    for start in STARTS:
        errors = [follow_rounds(board(7, BASELINE, 0.5, start, seed)) for seed in seeds]
        before, after = (np.mean([own[end] for own in errors]) for end in (0, -1))
        note = f"largest mean error {before:.3g} px before, {after:.3g} px after"
        yield make_row(
            f"rounds of the alternation, 7 cameras, 0.5 px, start {start:g}",
            None,
            [float(len(own) - 1) for own in errors],
            note,
        )
        curves.append(Curve(f"start {start:g}", range(len(errors[0])), errors[0]))
    panel = Panel(
        "7 cameras, 0.5 px, first seed",
        "round",
        "largest mean error of a camera, px",
        tuple(curves),
        "y",
    )
    yield Figure("fig-4-11", "Figure 4-11: convergence of the alternation", (panel,))
