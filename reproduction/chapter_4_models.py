"""Camera models, Newton's iteration, moved boards: figures 4-6, 4-9, 4-27."""

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import refine, residuals
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.evaluation.reproduction import Item, Row
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.polynomial_cameras import fit_planes, fit_soloff
from sabench.geometry.projective_camera import fit_projective
from sabench.geometry.refraction import trace_to_points
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import build_rig
from sabench.utils.arrays import F64

from .chapter_4 import Board, board, scene_at, scene_of, with_points
from .common import claim, make_row

_MEAN, _STD = 0.411, 0.269
_BASELINES = (0.2, 0.3, 0.4)
_PLACES = ((1, 1), (2, 0), (2, 2))  # places in the 5 x 5 array, in baselines from its middle


def fig_4_6(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure mean and scatter of single cameras' errors.

    The thesis shows one camera of an array of chapter 2, and does not say which. Polynomial models
    are compared.
    """
    means = []
    for baseline in _BASELINES:
        for step in _PLACES:
            (camera,) = build_rig(scene_at([step], baseline)).cameras
            head = f"D = {baseline:g}, camera at {step}"
            for name, errors in _errors(camera).items():
                mean, std = float(errors.mean()), float(errors.std())
                yield make_row(
                    f"{head}: mean error of {name}, px",
                    _MEAN if name == "projective" else None,
                    [mean],
                    f"std {std:.3g} px (thesis {_STD})",
                )
                means.append(mean if name == "projective" else 0.0)
    yield claim(
        "a model without refraction is not enough",
        "above 0.4 px",
        max(means),
        max(means) > 0.4,
        "the outermost cameras of the 5 x 5 array",
    )


def _errors(camera: CameraModel) -> dict[str, F64]:
    """Compute errors, px, of models fitted to exact points on nine planes.

    Errors are at random points; the exact points are a lattice.
    """
    planes = np.linspace(12.0, 58.0, 9)
    axis = np.linspace(-23.0, 23.0, 13)
    x, y, z = np.meshgrid(axis, axis, planes)
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    images = camera.project(points)[0]
    by_plane = [points[:, 2] == depth for depth in planes]
    size = (camera.name, camera.rows, camera.columns)
    models: dict[str, CameraModel] = {
        "projective": fit_projective(*size, points, images),
        "soloff": fit_soloff(*size, points, images),
        "planes": fit_planes(
            *size, [points[plane] for plane in by_plane], [images[plane] for plane in by_plane]
        ),
    }
    rng = np.random.default_rng(1)
    tried = np.column_stack([rng.uniform(-23.0, 23.0, (2000, 2)), rng.uniform(12.0, 58.0, 2000)])
    exact = camera.project(tried)[0]
    return {
        name: np.linalg.norm(model.project(tried)[0] - exact, axis=1)
        for name, model in models.items()
    }


_TOLERANCE, _MOST_STEPS = 1e-8, 10
_POINTS = 2000


def fig_4_9(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Count steps to 1e-8, and compare the paths of both methods.

    The thesis's equations 4.20 and 4.21 have two unknowns; sabench solves for one.
    """
    camera = build_rig(scene_of(9, 0.3, 0.0, 0.0)).cameras[0]
    rng = np.random.default_rng(seeds[0])
    points = np.array([0.0, 0.0, 35.0]) + 50.0 * (rng.random((_POINTS, 3)) - 0.5)
    wall, center = camera.wall, np.asarray(camera.center_mm)
    assert wall is not None
    radius = np.linalg.norm(points[:, :2] - center[:2], axis=1)
    depths = -center[2], wall.thickness_mm, points[:, 2] - wall.thickness_mm
    outer, steps = two_unknowns(wall.indices, depths, radius)
    yield claim(
        f"steps to {_TOLERANCE:g}, at most",
        "fewer than 10",
        float(steps.max()),
        bool(steps.max() < _MOST_STEPS),
        f"{_POINTS} points, mean {steps.mean():.2f}",
    )
    leaving = trace_to_points(wall, center, points).leaving
    ours = np.linalg.norm(leaving[:, :2], axis=1) / leaving[:, 2] * depths[0]
    yield make_row(
        "largest difference of the two ways on the wall's face, mm",
        None,
        [float(np.abs(ours - outer).max())],
        "two derivations of one path",
    )


def two_unknowns(indices: F64, depths: tuple[float, float, F64], radius: F64) -> tuple[F64, F64]:
    """Solve equations 4.20 to 4.23 with the derivatives of appendix B.

    It starts from the straight line. Returns r_A (n,) on the outer face, and the numbers of steps
    (n,).
    """
    first, second = indices[1] / indices[0], indices[2] / indices[1]
    straight = radius / (depths[0] + depths[1] + depths[2])
    a, b = straight * depths[0], straight * (depths[0] + depths[1])
    steps, open_ = np.zeros(len(radius)), np.ones(len(radius), dtype=np.bool_)
    for _ in range(50):
        (sa, da), (sb, db), (sp, dp) = (
            _sine(x, depth)
            for x, depth in ((a, depths[0]), (b - a, depths[1]), (radius - b, depths[2]))
        )
        f, g = sa - first * sb, sb - second * sp
        open_ &= np.maximum(np.abs(f), np.abs(g)) > _TOLERANCE
        if not open_.any():
            break
        fa, fb, ga, gb = da + first * db, -first * db, -db, db + second * dp
        determinant = fa * gb - fb * ga
        a, b = (
            a - np.where(open_, (f * gb - g * fb) / determinant, 0.0),
            b - np.where(open_, (g * fa - f * ga) / determinant, 0.0),
        )
        steps += open_
    return a, steps


def _sine(lateral: F64, depth: float | F64) -> tuple[F64, F64]:
    """Compute the sine of a path's angle, and its derivative by lateral distance."""
    length = np.sqrt(lateral**2 + np.square(depth))
    return lateral / length, np.square(depth) / length**3


_DEGREES = np.arange(-4.0, 4.01, 1.0)
_SHIFTS = np.arange(0.0, 50.1, 10.0)


def fig_4_27(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the mean reprojection error of nine cameras for every motion.

    Motions are rotations about the vertical axis and shifts along Z.

    The images stay as they were, which shows the motions that the wall does not leave open.
    """
    given, panels = board(9, 0.3, 0.0, 0.0, seeds[0]), []
    for name, moves in (("turn, degrees", _DEGREES), ("shift, mm", _SHIFTS)):
        errors = []
        for move in moves:
            errors.append(_refit(given, _move(given.points_mm, name, float(move))))
            yield make_row(f"{name} {move:g}: mean error, px", None, [errors[-1]])
        panels.append(Panel("", name, "mean error, px", (Curve(name, moves.tolist(), errors),)))
        still = float(errors[int(np.flatnonzero(moves == 0.0)[0])])
        least = min(error for error, move in zip(errors, moves, strict=True) if move != 0.0)
        yield claim(
            f"{name}: moved points cannot be fitted",
            "errors above zero",
            float(least),
            bool(still < 1e-4 < least),
            f"unmoved {still:.2g} px",
        )
    yield Figure("fig-4-27", "Figure 4-27: cameras refitted to moved boards", tuple(panels))


def _move(points: F64, name: str, move: float) -> F64:
    middle = points.mean(axis=(0, 1))
    if name.startswith("turn"):
        return np.asarray(
            (points - middle) @ rotation_matrices(np.deg2rad([0.0, move, 0.0])).T + middle
        )
    return np.asarray(points + np.array([0.0, 0.0, move]))


def _refit(given: Board, points: F64) -> float:
    problem = CalibrationProblem.from_case(with_points(given, points).case, FreeParameters())
    fit = refine(problem.start, problem.seen, FreeParameters(), moving="cameras")
    return float(
        np.nanmean(
            np.linalg.norm(residuals(fit.state, problem.seen), axis=-1)[problem.seen.weights > 0.0]
        )
    )
