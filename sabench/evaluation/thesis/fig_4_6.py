"""Figure 4-6: error of camera models without refraction behind a wall.

Polynomial models are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import scene_at
from sabench.evaluation.thesis.common import Row, claim, make_row
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.polynomial_cameras import fit_planes, fit_soloff
from sabench.geometry.projective_camera import fit_projective
from sabench.scenes import build_rig
from sabench.utils.arrays import F64

SEEDS = 1
_MEAN, _STD = 0.411, 0.269
_BASELINES = (0.2, 0.3, 0.4)
_STEPS = ((1, 1), (2, 0), (2, 2))  # places in the 5 x 5 array, in baselines from its middle


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure mean and scatter of single cameras' errors.

    The thesis shows one camera of an array of chapter 2, and does not say which.
    """
    means = []
    for baseline in _BASELINES:
        for step in _STEPS:
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
            *size, [points[own] for own in by_plane], [images[own] for own in by_plane]
        ),
    }
    rng = np.random.default_rng(1)
    tried = np.column_stack([rng.uniform(-23.0, 23.0, (2000, 2)), rng.uniform(12.0, 58.0, 2000)])
    exact = camera.project(tried)[0]
    return {
        name: np.linalg.norm(model.project(tried)[0] - exact, axis=1)
        for name, model in models.items()
    }
