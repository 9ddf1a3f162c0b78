"""Simulated calibrations: table 4.1 and figures 4-11 to 4-21."""

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.reproduction import Item, Row
from sabench.geometry.camera import Camera
from sabench.plotting.drawing import Curve, Figure, Histogram, Panel
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

from .chapter_4 import (
    BASELINE,
    CAMERAS,
    D_PIX,
    EVERY_NOISE,
    NOISES,
    SOLVERS,
    STARTS,
    Draws,
    board,
    draw_points,
    follow_rounds,
    held_out,
    measure,
    point_errors,
    solve_case,
    stds,
)
from .common import claim, make_row

_EDGE_MM = 50.0


def table_4_1(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure noise and initial errors as drawn, and sizes of array and boards."""
    for noise in EVERY_NOISE:
        drawn = [board(13, BASELINE, noise, 0.2, seed) for seed in seeds]
        yield make_row(
            f"noise of a pixel coordinate {noise:g} px: as drawn",
            noise,
            [float(np.nanstd(given.case.pixels - given.exact)) for given in drawn],
        )
    for start in STARTS:
        drawn = [board(13, BASELINE, 0.5, start, seed) for seed in seeds]
        values = [float(np.std(given.case.initial_mm - given.points_mm)) for given in drawn]
        yield make_row(
            f"initial error of a point {start:g} of the edge: as drawn",
            start,
            [value / _EDGE_MM for value in values],
            f"{np.mean(values):.3g} mm; cameras {200.0 * start:g} mm, {20.0 * start:g} degrees, "
            f"{30.0 * start:g} % of the focal length",
        )
    given = board(13, BASELINE, 0.5, 0.2, seeds[0])
    # compare the array and the boards with section 4.4.2
    camera, boards, points = given.cameras[0], *given.points_mm.shape[:2]
    wall = camera.wall
    thickness = wall.layers[0].thickness_mm if wall else 0.0
    yield make_row("calibration planes", 5.0, [float(boards)])
    yield make_row("points of a plane", 121.0, [float(points)], "11 x 11")
    yield make_row("thickness of the wall, mm", 5.0, [thickness])
    yield make_row(
        "pixel of the central camera in the middle of the volume, mm",
        D_PIX,
        [_pixel_mm(given.cameras[4])],
    )
    yield make_row(
        "combinations of cameras, noise and initial error",
        3.0 * 5.0 * 5.0,
        [float(len(CAMERAS) * len(EVERY_NOISE) * len(STARTS))],
        f"cameras {CAMERAS}, measured by `appendix-c`; noise and starts are those that the text, "
        "figure 4-12 and appendix C name",
    )


def _pixel_mm(camera: Camera) -> float:
    """Project a short line in the middle of the volume."""
    ends = np.array([[-0.5, 0.0, 35.0], [0.5, 0.0, 35.0]])
    image = camera.project(ends)[0]
    return float(1.0 / np.linalg.norm(image[1] - image[0]))


_MEAN, _STD = 0.33, 1.17  # largest mean and scatter with 7 cameras at 2 px, in D_PIX


def fig_4_12(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors per number of cameras and noise, over all initial guesses.

    The measured error is relative to the noise, the true error to the measured one. The thesis's
    alternation is compared with the joint adjustment.
    """
    panels = []
    for cameras in CAMERAS:
        draws = {}
        for noise in NOISES:
            draws[noise] = measure(cameras, noise, seeds)
            for name in SOLVERS:
                yield from _noise_rows(cameras, noise, name, draws[noise])
        if cameras == 7:
            yield from _point_rows(draws[2.0])
            yield draw_points(
                "fig-4-14", "Figures 4-14 and 4-15: errors of the points, 7 cameras", draws
            )
        panels.append(_errors_panel(cameras, draws))
    yield Figure("fig-4-12", "Figure 4-12: measured and true reprojection error", tuple(panels))
    yield from _rounds(seeds)


def _errors_panel(cameras: int, draws: dict[float, Draws]) -> Panel:
    """Draw figure 4-12: errors against the imposed noise, by initial guess."""
    imposed = [noise * float(np.sqrt(np.pi / 2.0)) for noise in NOISES]
    joint = [
        np.mean(
            [draw.measured_px.mean() for start in STARTS for draw in draws[noise]["joint", start]]
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
                float(np.mean([draw.true_px.mean() for draw in draws[noise][name, start]]))
                for noise in NOISES
            ]
            curves.append(Curve(f"true, {name}, start {start:g}", NOISES, true))
    return Panel(
        f"{cameras} cameras", "noise of a coordinate, px", "mean error, px", tuple(curves), "xy"
    )


def _noise_rows(cameras: int, noise: float, name: str, results: Draws) -> Iterator[Row]:
    every = [draw for start in STARTS for draw in results[name, start]]
    head = f"{cameras} cameras, {noise:g} px, {name}"
    imposed = noise * float(np.sqrt(np.pi / 2.0))
    yield make_row(
        f"{head}: mean measured error, px",
        imposed,
        [float(draw.measured_px.mean()) for draw in every],
        "thesis: equal to the imposed error",
        "smaller",
    )
    ratios = [float(draw.true_px.mean() / draw.measured_px.mean()) for draw in every]
    by_start = ", ".join(
        f"{start:g}: {np.mean([draw.true_px.mean() for draw in results[name, start]]):.3g}"
        for start in STARTS
    )
    yield claim(
        f"{head}: true / measured",
        "about 10 %",
        float(np.mean(ratios)),
        0.05 <= float(np.mean(ratios)) <= 0.15,
        f"true px by start: {by_start}",
    )


def _point_rows(by_start: Draws) -> Iterator[Row]:
    """Measure the last row of figures 4-14 and 4-15: 7 cameras, 2 px."""
    for name in SOLVERS:
        every = [draw.errors_mm for start in STARTS for draw in by_start[name, start]]
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
        before, after = (np.mean([rounds[end] for rounds in errors]) for end in (0, -1))
        note = f"largest mean error {before:.3g} px before, {after:.3g} px after"
        yield make_row(
            f"rounds of the alternation, 7 cameras, 0.5 px, start {start:g}",
            None,
            [float(len(rounds) - 1) for rounds in errors],
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


_SOLVERS = {
    "alternating": "refractive_autocal_alternating",
    "randomised": "refractive_autocal_randomised",
    "joint": "refractive_autocal",
}


def fig_4_16(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scatter of the points' errors over all initial guesses.

    Random subsets of eight cameras are compared with all cameras and with the joint adjustment. The
    thesis shows histograms without numbers.
    """
    better, panels = [], []
    for noise in NOISES:
        scatter = {}
        steps = [(start, seed) for start in STARTS for seed in seeds]
        errors: dict[str, dict[float, list[F64]]] = {
            name: {start: [] for start in STARTS} for name in _SOLVERS
        }
        for start, seed in progress_bar(steps, f"8 cameras, {noise:g} px"):
            given = board(8, 0.3, noise, start, seed)
            for name, solver in _SOLVERS.items():
                errors[name][start].append(point_errors(solve_case(solver, given), given))
        for name, by_start in errors.items():
            scatter[name] = stds([error for draws in by_start.values() for error in draws]) / D_PIX
            note = f"X, Y, Z: {', '.join(f'{value:.3g}' for value in scatter[name])}"
            yield make_row(
                f"8 cameras, {noise:g} px, {name}: scatter along Z, pixels of the middle",
                None,
                [float(scatter[name][2])],
                note,
            )
        curves = [
            Curve(name, STARTS, [float(stds(draws)[2]) / D_PIX for draws in by_start.values()])
            for name, by_start in errors.items()
        ]
        panels.append(
            Panel(
                f"{noise:g} px",
                "start",
                "scatter along Z, pixels of the middle",
                tuple(curves),
                "xy",
            )
        )
        better.append(float(scatter["randomised"][2] / scatter["alternating"][2]))
    yield claim(
        "randomised over alternating, scatter along Z",
        "smaller",
        float(np.mean(better)),
        bool(np.mean(better) < 1.0),
        f"by noise: {np.round(better, 2)}",
    )
    yield Figure("fig-4-16", "Figures 4-16 and 4-17: random subsets of 8 cameras", tuple(panels))


_CAMERAS, _BASELINE = 7, 0.3
_TITLES = {
    "fig-4-18": "Figure 4-18: other points by estimated and by exact cameras",
    "fig-4-19": "Figure 4-19: the same at 0.5 px by start",
    "fig-4-20": "Figure 4-20: linear auto-calibration without refraction",
    "fig-4-21": "Figure 4-21: the same at 0.5 px, one draw each",
}


def fig_4_18(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scatter along Z of 500 points per draw.

    Linear auto-calibration is compared, also without refraction.
    """
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
        values = [float(stds([error])[2]) for error in errors]
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
    return Histogram(label, np.concatenate([error[:, 2] - error[:, 2].mean() for error in errors]))


def _panel(title: str, *content: Histogram) -> Panel:
    return Panel(title, "error along Z without its mean, mm", "density, 1/mm", content)


def _pair(
    solver: str, noise: float, start: float, seed: int, *, wall: bool = True
) -> tuple[F64, F64]:
    given = board(_CAMERAS, _BASELINE, noise, start, seed, wall)
    return held_out(solve_case(solver, given), given, noise, seed)
