"""Figures 4-28 to 4-31: differences between three tests of a traversed grid.

Cameras are refitted to the points of tests 2 and 3 and to the projections of test 1's points, which
the thesis takes for true (figure 4-28). Points of two tests are compared before and after a
similarity brings each test's reference plane to its known place (figures 4-29 to 4-31).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import refine
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.algorithms.calibration.wall_frame import fit_similarity
from sabench.evaluation.thesis.chapter_4 import by_camera, reprojection
from sabench.evaluation.thesis.common import AGREES, Item, claim, make_row
from sabench.evaluation.thesis.traverse import MIDDLE, SOLVERS, STEPS, Traversed, calibrate
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.plotting.charts import Curve, Figure, Histogram, Panel
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

SEEDS = 5
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


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure refits and differences between the tests, per solver."""
    found: dict[str, list[Tests]] = {name: [] for name in SOLVERS}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            found[name].append(
                {test: calibrate(solver, step, seed) for test, step in STEPS.items()}
            )
    refits = {
        (name, test): [_refit(own, test) for own in draws]
        for name, draws in found.items()
        for test in ("test 2", "test 3")
    }
    for (name, test), draws in refits.items():
        yield make_row(
            f"{name}, {test}: error against test 1 after the refit, px",
            None,
            [float(own.true.mean()) for own in draws],
        )
    for test in ("test 2", "test 3"):
        yield from _refit_claims(f"randomised, {test}", refits["randomised", test])
    yield _refit_figure(refits)
    for name, every in found.items():
        yield from _plane_rows(name, every)
        for figure, pair in _PAIRS.items():
            yield from _difference_rows(f"{figure}, {name}, {pair[0]} and {pair[1]}", every, pair)
    for figure, pair in _PAIRS.items():
        yield from _difference_claims(figure, found["randomised"], pair)
    yield _difference_figure(found["randomised"][0])


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
        by_camera(reprojection(answer, other.given, true)),
        by_camera(reprojection(answer, other.given, measured)),
        by_camera(reprojection(other.answer, other.given, measured)),
    )


def _refit_claims(head: str, draws: Sequence[Refit]) -> Iterator[Item]:
    """Decide what section 4.4.3 says of figure 4-28."""
    ratios = [float(own.true.mean() / own.original.mean()) for own in draws]
    yield claim(
        f"{head}: error against test 1 over the original error",
        "relatively small",
        float(np.mean(ratios)),
        max(ratios) < _SMALL,
        f"largest of a seed {max(ratios):.3g}; holds below {_SMALL}",
    )
    change = max(float(np.abs(own.measured / own.original - 1.0).max()) for own in draws)
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
                ("against test 1", [own.true for own in draws]),
                ("original, measured", [own.original for own in draws]),
                ("refitted, measured", [own.measured for own in draws]),
            )
        )
        panels.append(Panel(f"{name}, {test}", "camera", "mean error, px", curves))
    return Figure("fig-4-28", "Figure 4-28: cameras refitted to another test", tuple(panels))


def _plane_rows(name: str, draws: Sequence[Tests]) -> Iterator[Item]:
    """Measure scale and rotation of the similarity to the reference plane."""
    fits = [{test: _to_plane(one) for test, one in own.items()} for own in draws]
    off = max(
        abs(np.cbrt(np.linalg.det(fit[:3, :3])) - 1.0) for own in fits for fit in own.values()
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
            [_angle_deg(own[test][:3, :3]) for own in fits],
        )


def _angle_deg(matrix: F64) -> float:
    turn = matrix / np.cbrt(np.linalg.det(matrix))
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _to_plane(one: Traversed) -> F64:
    """Fit the similarity (4, 4) of the estimated reference plane to the known one."""
    return fit_similarity(one.points_mm[MIDDLE], one.given.points_mm[MIDDLE])


def _aligned(one: Traversed) -> F64:
    similarity = _to_plane(one)
    return np.asarray(one.points_mm @ similarity[:3, :3].T + similarity[:3, 3]).reshape(-1, 3)


def _differences(tests: Tests, pair: tuple[str, str]) -> tuple[F64, F64, F64]:
    """Subtract points (n, 3) of two tests, mm.

    Before alignment, after that of the reference plane, and after the best rigid motion between
    the two tests.
    """
    one, two = (tests[name].points_mm.reshape(-1, 3) for name in pair)
    first, second = (_aligned(tests[name]) for name in pair)
    return one - two, first - second, one - fit_rigid_motion(two, one)(two)


def _measure_differences(draws: Sequence[Tests], pair: tuple[str, str]) -> F64:
    """Measure root mean squares, mm: (seed, before / after / best motion, axis)."""
    return np.array([[_rms(part) for part in _differences(own, pair)] for own in draws])


def _difference_rows(head: str, draws: Sequence[Tests], pair: tuple[str, str]) -> Iterator[Item]:
    """Measure the differences before and after alignment."""
    rms = _measure_differences(draws, pair)
    for number, when in enumerate(("before", "after", "best rigid motion")):
        note = ", ".join(f"{value:.3g}" for value in rms[:, number].mean(axis=0))
        yield make_row(
            f"{head}: difference, {when}, mm",
            None,
            np.linalg.norm(rms[:, number], axis=1).tolist(),
            f"X, Y, Z: {note}",
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


def _rms(errors: F64) -> F64:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


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
