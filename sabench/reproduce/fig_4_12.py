"""Figures 4-11 to 4-15: errors of the auto-calibration against noise and start, for the thesis's alternation and the joint adjustment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.calibration.alternate import alternate
from sabench.calibration.problem import Problem
from sabench.calibration.state import Free
from sabench.progress import track
from sabench.reproduce.chapter_4 import D_PIX, NOISES, STARTS, Board, board, point_errors, reprojection, solved, stds
from sabench.reproduce.common import Row, claim, compared

SEEDS = 5
_CAMERAS = (3, 7, 13)
_BASELINE = 0.3
_SOLVERS = {"alternating": "refractive_autocal_alternating", "joint": "refractive_autocal"}
_MEAN, _STD = 0.33, 1.17  # largest mean and scatter with 7 cameras at 2 px, in D_PIX


@dataclass(frozen=True)
class Found:
    """One solver on one draw."""

    true_px: float
    measured_px: float
    errors_mm: np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Per number of cameras and noise: measured error against the noise, true against measured, over all starts."""
    for cameras in _CAMERAS:
        for noise in NOISES:
            found = _measured(cameras, noise, seeds)
            for name in _SOLVERS:
                yield from _noise_rows(cameras, noise, name, found)
            if (cameras, noise) == (7, 2.0):
                yield from _point_rows(found)
    yield from _rounds(seeds)


def _measured(cameras: int, noise: float, seeds: Sequence[int]) -> dict[tuple[str, float], list[Found]]:
    found: dict[tuple[str, float], list[Found]] = {}
    steps = [(start, seed) for start in STARTS for seed in seeds]
    for start, seed in track(steps, f"{cameras} cameras, {noise:g} px"):
        given = board(cameras, _BASELINE, noise, start, seed)
        for name, solver in _SOLVERS.items():
            answer = solved(solver, given)
            found.setdefault((name, start), []).append(Found(*reprojection(answer, given), point_errors(answer, given)))
    return found


def _noise_rows(cameras: int, noise: float, name: str, found: dict[tuple[str, float], list[Found]]) -> Iterator[Row]:
    every = [one for (own, _), draws in found.items() if own == name for one in draws]
    head = f"{cameras} cameras, {noise:g} px, {name}"
    imposed = noise * float(np.sqrt(np.pi / 2.0))
    yield compared(f"{head}: mean measured error, px", imposed, [one.measured_px for one in every], "thesis: equal to the imposed error")
    ratios = [one.true_px / one.measured_px for one in every]
    by_start = ", ".join(f"{start:g}: {np.mean([one.true_px for one in found[name, start]]):.3g}" for start in STARTS)
    yield claim(
        f"{head}: true / measured", "about 10 %", float(np.mean(ratios)), 0.05 <= float(np.mean(ratios)) <= 0.15, f"true px by start: {by_start}"
    )


def _point_rows(found: dict[tuple[str, float], list[Found]]) -> Iterator[Row]:
    """Figures 4-14 and 4-15, last row: 7 cameras, 2 px."""
    for name in _SOLVERS:
        every = [one.errors_mm for (own, _), draws in found.items() if own == name for one in draws]
        scatter = stds(every) / D_PIX
        means = np.abs([errors.mean(axis=0) for errors in every]).max(axis=0) / D_PIX
        note = f"X, Y, Z: {', '.join(f'{value:.3g}' for value in scatter)}"
        yield compared(f"7 cameras, 2 px, {name}: scatter along Z, pixels of the middle", _STD, [float(scatter[2])], note)
        yield compared(f"7 cameras, 2 px, {name}: largest mean along Z, the same unit", _MEAN, [float(means[2])], "one point known to 0.05 mm")
        yield claim(
            f"7 cameras, 2 px, {name}: the error is largest along Z",
            "yes",
            float(scatter[2] / scatter[:2].max()),
            bool(scatter[2] > scatter[:2].max()),
        )


def _rounds(seeds: Sequence[int]) -> Iterator[Row]:
    """Figure 4-11: rounds of the alternation with 7 cameras at 0.5 px."""
    for start in STARTS:
        counts, first, last = zip(*(_alternated(board(7, _BASELINE, 0.5, start, seed)) for seed in seeds), strict=True)
        note = f"largest mean error {np.mean(first):.3g} px before, {np.mean(last):.3g} px after"
        yield compared(f"rounds of the alternation, 7 cameras, 0.5 px, start {start:g}", None, [float(count) for count in counts], note)


def _alternated(given: Board) -> tuple[int, float, float]:
    problem = Problem.of(given.case, Free())
    rounds = alternate(problem.start, problem.seen, Free(), 0.001, 1000)
    return len(rounds.errors_px) - 1, rounds.errors_px[0], rounds.errors_px[-1]
