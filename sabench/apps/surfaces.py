"""Images of a surface, refocused from one frame of a data set.

The result is a folder: image.exr and image.png in the surface's own coordinates, points.exr with
the world point of each pixel, and surface.json.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from sabench.algorithms.bubbles import transmission
from sabench.algorithms.refocus import Join, SurfaceImage, refocus_on_surface
from sabench.api import Observation
from sabench.dataset.reader import Dataset, open_dataset
from sabench.geometry.grid import Grid
from sabench.geometry.surfaces import SURFACES, Plane, Surface
from sabench.images.tiff_exr import write_exr, write_exr_channels
from sabench.plotting import pictures
from sabench.utils.arrays import F32, F64
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, refuse_existing
from sabench.utils.validation import validate

JOINS: tuple[Join, ...] = get_args(Join)


@dataclass(frozen=True)
class RefocusedSurface:
    """Image of a surface and where its pixels lie.

    Attributes
    ----------
    image : values and views (row, column).
    points_mm : (row, column, 3) in the world frame.
    summary : the contents of surface.json.
    """

    image: SurfaceImage
    points_mm: F64
    summary: dict[str, Any]


def refocus(
    dataset: Dataset | Path | str,
    out: Path,
    surface: str = "plane",
    parameters: dict[str, Any] | None = None,
    *,
    join: Join = "additive",
    frame: int = 0,
    overwrite: bool = False,
) -> RefocusedSurface:
    """Refocus a frame of a data set on a surface and write the folder `out`.

    Parameters
    ----------
    surface : plane, cylinder or height_map.
    parameters : of the surface, see `sabench.geometry.surfaces`. What is not given comes from the
        data set: the middle, the size along X and Y and the voxel of its volume.
    join : how the views are joined, see `refocus_on_surface`.

    Raises
    ------
    InputError
        An unknown surface, join or frame, wrong parameters, or a surface that no camera sees.
    """
    refuse_existing(out, overwrite=overwrite)
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    if join not in JOINS:
        raise InputError(f"--join: expected one of {', '.join(JOINS)}, got {join!r}")
    chosen = make_surface(surface, parameters or {}, data.setup.grid)
    case = data.observation(frame)
    image, points = refocus_frame(case, chosen, join)
    if not image.views.any():
        raise InputError(
            f"surface {surface}: expected cameras to see its front, the side of its own -Z, but "
            "none does: check center_mm and turn_deg"
        )
    summary = {
        "dataset": data.content_hash,
        "frame": frame,
        "surface": surface,
        "join": join,
        **_describe(chosen, image, points),
    }
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        partial.mkdir()
        _write(partial, image, points, summary)
    return RefocusedSurface(image, points, summary)


def make_surface(name: str, parameters: dict[str, Any], grid: Grid) -> Surface:
    """Make a surface by name; what is not given comes from a grid."""
    if name not in SURFACES:
        raise InputError(f"--surface: expected one of {', '.join(SURFACES)}, got {name!r}")
    model, values = SURFACES[name], {"pixel_mm": min(grid.voxel_mm[:2])}
    if issubclass(model, Plane):
        ends = np.array([(axis[0], axis[-1]) for axis in grid.axes_mm])
        values |= {
            "center_mm": ends.mean(axis=1).tolist(),
            "size_mm": np.ptp(ends[:2], axis=1).tolist(),
        }
    return validate(model, values | parameters, f"surface {name}")


def refocus_frame(case: Observation, surface: Surface, join: Join) -> tuple[SurfaceImage, F64]:
    """Refocus an observation on a surface.

    Returns the image, in shares of the sensor's range (of the diffuser's light where darkness is
    joined), and the world points (row, column, 3).
    """
    points = surface.points_mm()
    covered = None if case.flaws is None else case.flaws.covered
    return refocus_on_surface(_light(case, join), case.cameras, points, join, covered), points


def _light(case: Observation, join: Join) -> F32:
    """Scale images to 0 for black and 1 for white, or for the diffuser's light."""
    if join == "dark":
        return np.clip(transmission(case), 0.0, 1.0)
    span = np.float32(case.white_dn - case.black_dn)
    light = (case.images.astype(np.float32) - np.float32(case.black_dn)) / span
    return np.asarray(np.clip(light, 0.0, 1.0))


def _describe(surface: Surface, image: SurfaceImage, points_mm: F64) -> dict[str, Any]:
    """Describe the pixel positions of a surface's image, and the visible share."""
    u, v = surface.axes_mm
    rotation = surface.pose.rotation
    visible = image.views > 0
    return {
        "parameters": surface.model_dump(mode="json"),
        "rows": len(v),
        "columns": len(u),
        "first_pixel_mm": [u[0], v[0]],
        "pixel_mm": surface.pixel_mm,
        "x_direction": rotation[:, 0].tolist(),
        "y_direction": rotation[:, 1].tolist(),
        "z_direction": rotation[:, 2].tolist(),
        "corners_mm": {
            f"{row},{column}": _number(points_mm[row, column])
            for row in (0, len(v) - 1)
            for column in (0, len(u) - 1)
        },
        "seen_percent": 100.0 * float(visible.mean()),
        "views_mean": float(image.views[visible].mean()) if visible.any() else 0.0,
        "views_most": int(image.views.max()),
    }


def _number(point: F64) -> list[float] | None:
    return point.tolist() if np.isfinite(point).all() else None


def _write(folder: Path, image: SurfaceImage, points: F64, summary: dict[str, Any]) -> None:
    values = image.values.astype(np.float64)
    shown = np.where(np.isnan(values), np.nanmin(values), values)
    write_exr(folder / "image.exr", image.values)
    (folder / "image.png").write_bytes(pictures.grey_picture(shown, 1))
    x, y, z = np.moveaxis(points, -1, 0)
    write_exr_channels(folder / "points.exr", {"X": x, "Y": y, "Z": z, "views": image.views})
    (folder / "surface.json").write_text(canonical_json(summary), encoding="utf-8")
