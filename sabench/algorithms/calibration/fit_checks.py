"""Checks of a calibration's end state, and correlated residuals.

Noise of detection differs from point to point; errors of a model change slowly over an image, so
that those of neighbours are correlated.
"""

from dataclasses import fields

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import rayleigh

from sabench.algorithms.calibration.bundle_adjustment import BoardImages
from sabench.algorithms.calibration.parameters import State, WallFrame
from sabench.geometry.refraction import Wall
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError

_LEAST_INDEX = 0.99  # of any medium
FEWEST = 4  # points that show the pose of a plane, or its homography
FLAT = 1e-3  # width over length of what counts as a line, thickness over width of a plane
# standard deviations of a coordinate that misses of right points exceed at the rate of false alarms
ODD = rayleigh.isf(FALSE_ALARMS)


def list_faults(state: State, views: BoardImages, frame: WallFrame) -> list[str]:
    """List the faults of a state in sentences that name the camera or frame.

    Numbers must be finite, principal distances, thicknesses and indices positive, cameras in front
    of a plane wall and boards behind it.
    """
    names = [camera.name for camera in frame.cameras]
    parts = {part.name: getattr(state, part.name) for part in fields(state) if part.name != "wall"}
    parts |= {"wall": np.append(state.wall.rotation, state.wall.shift)}
    for name, values in parts.items():
        if not np.isfinite(values).all():
            return [f"{name}: expected finite numbers, but the fit did not find any"]
    faults = [
        f"{name}: expected a positive principal distance, but the fit gives {focal:.3g} px"
        for name, focal in zip(names, state.lenses[:, 0].tolist(), strict=True)
        if focal <= 0.0
    ]
    return faults if frame.wall is None else faults + _wall_faults(state, views, names, frame.wall)


def check_state(state: State, views: BoardImages, frame: WallFrame) -> None:
    """Refuse an impossible state.

    Raises
    ------
    InputError
        The first sentence of `list_faults`.
    """
    if faults := list_faults(state, views, frame):
        raise InputError(faults[0])


def _wall_faults(state: State, views: BoardImages, names: list[str], wall: Wall) -> list[str]:
    layers = [layer.name for layer in wall.layers]
    media = ["the cameras' medium", *layers, "the fluid"]
    faults = [
        f"{name}: expected a positive thickness, but the fit gives {value:.4g} mm: the images do "
        "not determine it, so take it out of the unknowns"
        for name, value in zip(layers, state.thicknesses.tolist(), strict=True)
        if value <= 0.0
    ]
    faults += [
        f"{name}: expected a refractive index of 1 or more, but the fit gives {value:.4g}: the "
        "images do not determine it, so take it out of the unknowns"
        for name, value in zip(media, state.indices.tolist(), strict=True)
        if value < _LEAST_INDEX
    ]
    faults += [
        f"{name}: expected it in front of the wall, but the fit puts it {depth:.4g} mm behind the "
        "outer face"
        for name, depth in zip(names, state.centers[:, 2].tolist(), strict=True)
        if depth >= 0.0
    ]
    depths = depths_of(state, views)
    return faults + [
        f"frame {number}: expected its points in the fluid, but the fit puts {np.sum(deep <= 0.0)} "
        f"of {np.isfinite(deep).sum()} up to {-np.nanmin(deep):.4g} mm in front of the inner face; "
        "check target_mm, wall and known"
        for number, deep in enumerate(depths)
        if (deep <= 0.0).any()
    ]


def depths_of(state: State, views: BoardImages) -> F64:
    """Compute depths (K, m) of seen points behind the wall's inner face, mm."""
    depths = state.points(views.board)[..., 2] - state.thicknesses.sum()
    return np.where(views.weights.sum(axis=0) > 0.0, depths, np.nan)


_NEAREST = 3  # neighbours of a point: along rows and columns of a grid
_REACH = 1.5  # times the distance of the nearest one, beyond which a point is no neighbour


def neighbours(points_mm: F64) -> I64:
    """List pairs (n, 2) of neighbouring points (m, 3)."""
    count = min(_NEAREST + 1, len(points_mm))
    if count < 2:
        return np.zeros((0, 2), dtype=np.int64)
    distances, others = cKDTree(points_mm).query(points_mm, k=count)
    near = distances[:, 1:] <= _REACH * distances[:, 1:2]
    first, rank = np.nonzero(near)
    pairs = np.sort(np.column_stack([first, others[first, rank + 1]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int64)


def correlated_part(errors: F64, pairs: I64) -> F64:
    """Estimate the standard deviation (n,) of errors that neighbours share.

    Parameters
    ----------
    errors : (..., point, n) errors of points; NaN for none.
    pairs : neighbouring points, see `neighbours`.

    The mean product of neighbours' errors is the variance of what changes slowly. NaN without any
    pair.
    """
    products = errors[..., pairs[:, 0], :] * errors[..., pairs[:, 1], :]
    flat = products.reshape(-1, errors.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.full(errors.shape[-1], np.nan)
    return np.asarray(np.sqrt(np.maximum(flat.mean(axis=0), 0.0)))
