"""Traversed grid in three tests: figures 4-23 to 4-26 and 4-28 to 4-31.

The images are the same in all tests; the nominal spacing of the planes is right, half of the true
one, or a quarter of it.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import refine
from sabench.algorithms.calibration.parameters import FreeParameters, fit_similarity
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.algorithms.calibration.target_detection import detect_target
from sabench.api import Calibration
from sabench.evaluation.reproduction import Item
from sabench.evaluation.suite_loading import override
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.plotting.drawing import Cloud, Curve, Figure, Histogram, Panel, Picture
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.arrays import F64, U16
from sabench.utils.progress import progress_bar
from sabench.worlds.calibration_targets import pose_target

from . import chapter_4
from .common import AGREES, claim, make_row

SOLVERS = {"randomised": "refractive_autocal_randomised", "joint": "refractive_autocal"}
STEPS = {"test 1": 4.0, "test 2": 2.0, "test 3": 1.0}  # nominal mm between planes
PLANES, STEP_MM, MIDDLE_MM = 11, 4.0, 132.0
MIDDLE = PLANES // 2  # the reference plane
_DISTANCE_MM, _SPACING_MM = 760.0, 150.0
_PLACES = [
    (x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) != (-1, -1)
]  # the ninth camera's firmware was too old


@dataclass(frozen=True)
class Traversed:
    """Calibration of one test.

    Attributes
    ----------
    given : its case, with the truth.
    answer, points_mm : what a solver returns: cameras, and points (plane, point, 3).
    """

    given: chapter_4.Board
    answer: Calibration
    points_mm: F64


def make_traverse() -> Scene:
    """Make the scene: eight cameras behind a wall, a grid at eleven positions.

    Images have 1024 x 768 pixels; the level grid moves by 4 mm.
    """
    values: dict[str, Any] = load_scene("calibration").to_dict()
    array = MIDDLE_MM - _DISTANCE_MM
    positions = [{"center_mm": [x * _SPACING_MM, y * _SPACING_MM, array]} for x, y in _PLACES]
    values["cameras"] |= {
        "rows": 768,
        "columns": 1024,
        "pixel_mm": 0.00465,
        "focal_length_mm": 50.0,
        "layout": {"kind": "list", "places": positions},
    }
    depth = STEP_MM * (PLANES - 1)
    values["volume"] = {"center_mm": [0.0, 0.0, MIDDLE_MM], "size_mm": [55.0, 40.0, depth]}
    values["targets"] |= {
        "columns": 11,
        "rows": 9,
        "pitch_mm": 4.5,
        "tilt_deg": 0.0,
        "roll_deg": 0.0,
        "wander": 0.0,
    }
    measured = [{"frame": MIDDLE, "point": 49}]
    values["calibration"] = {
        "center_mm": 5.0,
        "turn_deg": 0.5,
        "focal_percent": 2.0,
        "known": measured,
    }
    return parse_scene(values | {"frames": PLANES}, "traversed grid")


@functools.cache
def calibrate(solver: str, step_mm: float, seed: int) -> Traversed:
    """Solve from a nominal distance of the planes, once for all figures."""
    given = chapter_4.draw(make_traverse(), seed)
    nominal = given.points_mm.copy()
    nominal[..., 2] = MIDDLE_MM + step_mm * (np.arange(PLANES) - MIDDLE)[:, None]
    start = chapter_4.with_points(given, nominal)
    answer = chapter_4.solve_case(solver, start)
    return Traversed(start, answer, chapter_4.places_of(answer, start))


_SMALL_PX = 0.4  # error of the mapping from which refocusing suffers, as chapter 4 says
_SHOWN = ((1, PLANES - 1), (3, MIDDLE))  # camera and plane of figure 4-24, a and b
_POINT = 27  # of the grid, shown in detail
_ZOOM_PX = 25
_LIGHT: Mapping[str, Any] = {
    "targets.pattern": "circles",
    "lighting": {"lamps": [{"center_mm": [side, 0.0, -400.0]} for side in (-300.0, 300.0)]},
    "sensor": {"read_noise_e": 10.0, "black_level_dn": 50.0},
    "render": {"samples_per_pixel": 16},
}


def fig_4_23(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure each camera's reprojection error, per solver and test.

    Figure 4-24 is drawn over rendered images of the grid, in which the circles are also detected:
    this shows what noise of measured points to expect.
    """
    means: dict[tuple[str, str], list[F64]] = {}
    scatters: dict[tuple[str, str], list[F64]] = {}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            for test, step in STEPS.items():
                done = calibrate(solver, step, seed)
                errors = chapter_4.reprojection(done.answer, done.given, done.given.case.pixels)
                means.setdefault((name, test), []).append(chapter_4.by_camera(errors))
                scatters.setdefault((name, test), []).append(np.nanstd(errors, axis=(1, 2)))
    for (name, test), draws in means.items():
        spread = float(np.mean([draw.mean() for draw in scatters[name, test]]))
        yield make_row(
            f"{name}, {test}: mean reprojection error, px",
            None,
            [float(draw.mean()) for draw in draws],
            f"standard deviation {spread:.3g} px; worst camera {np.max(draws):.3g} px",
        )
    for name in SOLVERS:
        yield from _claims(name, {test: np.array(means[name, test]) for test in STEPS})
    yield _bars(means, scatters)
    yield from _images(seeds[0])


def _claims(name: str, means: dict[str, F64]) -> Iterator[Item]:
    """Check the claims on figure 4-23; means are (seed, camera) per test."""
    first = means["test 1"]
    change = float(max(np.abs(draws / first - 1.0).max() for draws in means.values()))
    yield claim(
        f"{name}: largest change of a camera's mean error between the tests",
        "little impact of the initial planes",
        change,
        change <= AGREES,
        "as a share of test 1",
    )
    largest = float(max(draws.max() for draws in means.values()))
    yield claim(
        f"{name}: largest mean error of a camera, px",
        "relatively small in each camera",
        largest,
        largest < _SMALL_PX,
        f"0.1 px of noise make {0.1 * np.sqrt(np.pi / 2.0):.3g} px",
    )


def _bars(
    means: dict[tuple[str, str], list[F64]], scatters: dict[tuple[str, str], list[F64]]
) -> Figure:
    numbers = range(1, len(means["joint", "test 1"][0]) + 1)
    panels = [
        Panel(
            f"{name}: {what}",
            "camera",
            "px",
            tuple(
                Curve(test, numbers, np.mean(values[name, test], axis=0).tolist()) for test in STEPS
            ),
        )
        for name in SOLVERS
        for what, values in (("mean", means), ("standard deviation", scatters))
    ]
    return Figure(
        "fig-4-23", "Figure 4-23: reprojection error by camera and test", tuple(panels), across=2
    )


def _images(seed: int) -> Iterator[Item]:
    """Draw figure 4-24, and measure how well circles are detected in its images."""
    scene = override(make_traverse(), dict(_LIGHT), "traversed grid of circles")
    target = pose_target(scene, seed).target
    panels: list[Panel] = []
    for letter, (camera, plane) in zip("ab", _SHOWN, strict=True):
        image = chapter_4.photograph(scene, plane, camera - 1, seed)
        points = _points(camera - 1, plane, seed)
        title = f"({letter}) camera {camera}, plane {plane + 1}"
        panels += [_overlay(title, image, points), *_detail(title, image, points)]
        off = detect_target(image, target, points["true"]) - points["true"]
        yield make_row(
            f"{title}, rendered: noise of a detected coordinate, px",
            None,
            [float(np.nanstd(off))],
            f"{np.isfinite(off).all(axis=1).sum()} of {len(off)} circles",
        )
    words = "Figure 4-24: measured and reprojected points, randomised solver"
    yield Figure("fig-4-24", words, tuple(panels), across=3)


def _points(camera: int, plane: int, seed: int) -> dict[str, F64]:
    """Collect true, measured and reprojected pixels (point, 2) of a camera and plane."""
    done = {test: calibrate(SOLVERS["randomised"], step, seed) for test, step in STEPS.items()}
    given = done["test 1"].given
    points = {"true": given.exact[camera, plane], "measured": given.case.pixels[camera, plane]}
    return points | {
        test: traverse.answer.cameras[camera].project(traverse.points_mm[plane])[0]
        for test, traverse in done.items()
    }


def _overlay(title: str, image: U16, points: dict[str, F64]) -> Panel:
    clouds = (Cloud(name, *pixels.T) for name, pixels in points.items() if name != "true")
    rows, columns = image.shape
    picture = Picture(image.astype(np.float64), (0.0, 0.0), (columns - 1.0, rows - 1.0))
    return Panel(title, "px", "px", (picture, *clouds))


def _detail(title: str, image: U16, points: dict[str, F64]) -> tuple[Panel, Panel]:
    """Show one circle, and its points relative to the true one."""
    true = points["true"][_POINT]
    (left, top), (right, bottom) = (
        np.rint(true + side * _ZOOM_PX).astype(int).tolist() for side in (-1, 1)
    )
    cut = image[top : bottom + 1, left : right + 1].astype(np.float64)
    picture = Picture(cut, (float(left), float(top)), (float(right), float(bottom)))
    marks = [
        (name, pixels[_POINT].tolist(), (pixels[_POINT] - true).tolist())
        for name, pixels in points.items()
    ]
    circle = (Curve(name, [at[0]], [at[1]]) for name, at, _ in marks)
    near = tuple(Curve(name, [off[0]], [off[1]]) for name, _, off in marks)
    return (
        Panel(f"{title}, point {_POINT}", "px", "px", (picture, *circle)),
        Panel("relative to the true point", "columns, px", "rows, px", near),
    )


_FLUCTUATION_MM = 0.02


def fig_4_25(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of mean spacings per solver and test; compare the tests.

    The cameras are those of the vortex ring's experiment. The experiment's traverse moved the grid
    by 4 mm, to 0.01 mm; here it does so exactly, so that all that is left is the calibration's own.
    """
    spacings: dict[tuple[str, str], list[F64]] = {}
    turns: dict[tuple[str, str], list[float]] = {}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            first: F64 | None = None
            for test, step in STEPS.items():
                positions = calibrate(solver, step, seed).points_mm
                first = positions if first is None else first
                spacings.setdefault((name, test), []).append(
                    np.stack(
                        [
                            np.diff(positions[..., 2], axis=0).mean(axis=1),
                            np.asarray(np.diff(positions[..., 2], axis=0).std(axis=1)),
                        ]
                    )
                )
                turns.setdefault((name, test), []).append(_turn_deg(positions, first))
    for (name, test), draws in spacings.items():
        off = [float(np.abs(draw[0] - STEP_MM).max()) for draw in draws]
        head = f"{name}, {test} (nominal {STEPS[test]:g} mm)"
        yield make_row(
            f"{head}: largest error of a mean spacing, mm",
            None,
            off,
            f"points scatter by {np.mean([draw[1] for draw in draws]):.3g} mm",
        )
        if test == "test 1":
            continue
        between = [
            float(np.abs(draw[0] - ref[0]).max())
            for draw, ref in zip(draws, spacings[name, "test 1"], strict=True)
        ]
        mean = float(np.mean(between))
        yield claim(
            f"{head}: largest difference of a spacing to test 1, mm",
            "all tests alike to 0.02 mm",
            mean,
            mean <= _FLUCTUATION_MM,
        )
        yield make_row(
            f"{head}: turn of all points against test 1, degrees",
            None,
            turns[name, test],
            "thesis, figure 4-26: seen, without a number",
        )
    yield _figure(spacings)


def _turn_deg(positions: F64, reference: F64) -> float:
    turn = fit_rigid_motion(positions.reshape(-1, 3), reference.reshape(-1, 3)).rotation
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _figure(steps: dict[tuple[str, str], list[F64]]) -> Figure:
    """Draw the first seed, as the thesis shows its one experiment."""
    numbers = range(1, PLANES)
    panels = []
    for name in SOLVERS:
        curves = tuple(
            Curve(test, numbers, steps[name, test][0][0], steps[name, test][0][1]) for test in STEPS
        )
        panels.append(Panel(name, "k", "spacing of planes k and k + 1, mm", curves))
    return Figure("fig-4-25", "Figure 4-25: spacing of the planes, 0.1 px", tuple(panels))


_PAIRS = {
    "fig-4-29": ("test 1", "test 2"),
    "fig-4-30": ("test 1", "test 3"),
    "fig-4-31": ("test 2", "test 3"),
}
_SMALL = 0.5  # share of an error that is small beside it, or most of it when removed
_SCALE = 1e-3  # a scale this close to one is one

Tests = dict[str, Traversed]


@dataclass(frozen=True)
class Refit:
    """Mean errors of each camera (M,), px, after a refit to another test's points.

    Attributes
    ----------
    true, measured : of the new projections against test 1's projections, and against the pixels.
    original : of the test's own calibration against the pixels.
    """

    true: F64
    measured: F64
    original: F64


def fig_4_28(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure refits and differences between the tests, per solver.

    Cameras are refitted to the points of tests 2 and 3 and to the projections of test 1's points,
    which the thesis takes for true (figure 4-28). Points of two tests are compared before and after
    a similarity brings each test's reference plane to its known place (figures 4-29 to 4-31).
    """
    by_solver: dict[str, list[Tests]] = {name: [] for name in SOLVERS}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            by_solver[name].append(
                {test: calibrate(solver, step, seed) for test, step in STEPS.items()}
            )
    refits = {
        (name, test): [_refit(tests, test) for tests in draws]
        for name, draws in by_solver.items()
        for test in ("test 2", "test 3")
    }
    for (name, test), draws in refits.items():
        yield make_row(
            f"{name}, {test}: error against test 1 after the refit, px",
            None,
            [float(refit.true.mean()) for refit in draws],
        )
    for test in ("test 2", "test 3"):
        yield from _refit_claims(f"randomised, {test}", refits["randomised", test])
    yield _refit_figure(refits)
    for name, every in by_solver.items():
        yield from _plane_rows(name, every)
        for figure, pair in _PAIRS.items():
            # measure the differences before and after alignment
            head = f"{figure}, {name}, {pair[0]} and {pair[1]}"
            rms = _measure_differences(every, pair)
            for number, when in enumerate(("before", "after", "best rigid motion")):
                note = ", ".join(f"{value:.3g}" for value in rms[:, number].mean(axis=0))
                yield make_row(
                    f"{head}: difference, {when}, mm",
                    None,
                    np.linalg.norm(rms[:, number], axis=1).tolist(),
                    f"X, Y, Z: {note}",
                )
    for figure, pair in _PAIRS.items():
        yield from _difference_claims(figure, by_solver["randomised"], pair)
    yield _difference_figure(by_solver["randomised"][0])


def _refit(tests: Tests, name: str) -> Refit:
    """Fit cameras to a test's points and to the projections of test 1's points."""
    first, other = tests["test 1"], tests[name]
    flat = first.points_mm.reshape(-1, 3)
    true = np.stack([camera.project(flat)[0] for camera in first.answer.cameras])
    true = true.reshape(first.given.exact.shape)
    case = replace(other.given.case, pixels=true, initial_mm=other.points_mm)
    problem = CalibrationProblem.from_case(case, FreeParameters())
    fit = refine(problem.start, problem.seen, FreeParameters(), moving="cameras")
    answer = replace(problem.answer(fit.state), points_mm=other.points_mm)
    measured = other.given.case.pixels
    return Refit(
        chapter_4.by_camera(chapter_4.reprojection(answer, other.given, true)),
        chapter_4.by_camera(chapter_4.reprojection(answer, other.given, measured)),
        chapter_4.by_camera(chapter_4.reprojection(other.answer, other.given, measured)),
    )


def _refit_claims(head: str, draws: Sequence[Refit]) -> Iterator[Item]:
    """Decide what section 4.4.3 says of figure 4-28."""
    ratios = [float(refit.true.mean() / refit.original.mean()) for refit in draws]
    yield claim(
        f"{head}: error against test 1 over the original error",
        "relatively small",
        float(np.mean(ratios)),
        max(ratios) < _SMALL,
        f"largest of a seed {max(ratios):.3g}; holds below {_SMALL}",
    )
    change = max(float(np.abs(refit.measured / refit.original - 1.0).max()) for refit in draws)
    yield claim(
        f"{head}: change of the error against the measured pixels by the refit",
        "equal, with very small discrepancy",
        change,
        change <= AGREES,
        "largest of a camera, as a share of the original error",
    )


def _refit_figure(refits: dict[tuple[str, str], list[Refit]]) -> Figure:
    """Draw figure 4-28, mean over the seeds."""
    panels = []
    for (name, test), draws in refits.items():
        curves = tuple(
            Curve(label, range(1, len(values[0]) + 1), np.mean(values, axis=0).tolist())
            for label, values in (
                ("against test 1", [refit.true for refit in draws]),
                ("original, measured", [refit.original for refit in draws]),
                ("refitted, measured", [refit.measured for refit in draws]),
            )
        )
        panels.append(Panel(f"{name}, {test}", "camera", "mean error, px", curves))
    return Figure("fig-4-28", "Figure 4-28: cameras refitted to another test", tuple(panels))


def _plane_rows(name: str, draws: Sequence[Tests]) -> Iterator[Item]:
    """Measure scale and rotation of the similarity to the reference plane."""
    fits = [{test: _to_plane(traverse) for test, traverse in tests.items()} for tests in draws]
    off = max(
        abs(np.cbrt(np.linalg.det(fit[:3, :3])) - 1.0) for tests in fits for fit in tests.values()
    )
    yield claim(
        f"{name}: largest deviation of the similarity's scale from one",
        "one for each test",
        float(off),
        bool(off < _SCALE),
    )
    for test in STEPS:
        yield make_row(
            f"{name}, {test}: rotation to the reference plane, degrees",
            None,
            [_angle_deg(tests[test][:3, :3]) for tests in fits],
        )


def _angle_deg(matrix: F64) -> float:
    turn = matrix / np.cbrt(np.linalg.det(matrix))
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _to_plane(traverse: Traversed) -> F64:
    """Fit the similarity (4, 4) of the estimated reference plane to the known one."""
    return fit_similarity(traverse.points_mm[MIDDLE], traverse.given.points_mm[MIDDLE])


def _aligned(traverse: Traversed) -> F64:
    similarity = _to_plane(traverse)
    return np.asarray(traverse.points_mm @ similarity[:3, :3].T + similarity[:3, 3]).reshape(-1, 3)


def _differences(tests: Tests, pair: tuple[str, str]) -> tuple[F64, F64, F64]:
    """Subtract points (n, 3) of two tests, mm.

    Before alignment, after that of the reference plane, and after the best rigid motion between
    the two tests.
    """
    points, two = (tests[name].points_mm.reshape(-1, 3) for name in pair)
    first, second = (_aligned(tests[name]) for name in pair)
    return points - two, first - second, points - fit_rigid_motion(two, points)(two)


def _measure_differences(draws: Sequence[Tests], pair: tuple[str, str]) -> F64:
    """Measure root mean squares, mm: (seed, before / after / best motion, axis)."""
    return np.array(
        [
            [np.asarray(np.sqrt(np.mean(part**2, axis=0))) for part in _differences(tests, pair)]
            for tests in draws
        ]
    )


def _difference_claims(head: str, draws: Sequence[Tests], pair: tuple[str, str]) -> Iterator[Item]:
    """Decide what section 4.4.3 says of figures 4-29 to 4-31."""
    before, after, best = np.moveaxis(_measure_differences(draws, pair), 1, 0)
    ratios = (after / before).mean(axis=0)
    yield claim(
        f"{head}, {pair[0]} and {pair[1]}: difference after over before alignment, worst axis",
        "less dramatically reduced" if pair[0] == "test 2" else "significantly reduced",
        float(ratios.max()),
        bool(ratios.max() < 1.0 if pair[0] == "test 2" else ratios.max() < _SMALL),
        f"X, Y, Z: {', '.join(f'{value:.3g}' for value in ratios)}",
    )
    rest = np.linalg.norm(best, axis=1) / np.linalg.norm(before, axis=1)
    yield claim(
        f"{head}, {pair[0]} and {pair[1]}: share that no rigid motion removes",
        "a rotation and translation, no skewing",
        float(rest.mean()),
        bool(rest.max() < 0.1),
        "holds below a tenth",
    )


def _difference_figure(tests: Tests) -> Figure:
    """Draw the histograms of one seed, as the thesis shows its one experiment."""
    panels = []
    for figure, pair in _PAIRS.items():
        before, after, _ = _differences(tests, pair)
        panels += [
            Panel(
                f"{figure[4:]}: {pair[0]} - {pair[1]}",
                f"difference along {axis}, mm",
                "density, 1/mm",
                (Histogram("before", before[:, number]), Histogram("after", after[:, number])),
            )
            for number, axis in enumerate("XYZ")
        ]
    title = "Figures 4-29 to 4-31: differences between the tests, randomised solver"
    return Figure("fig-4-29", title, tuple(panels), across=3)
