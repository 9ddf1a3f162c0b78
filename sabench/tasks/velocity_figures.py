"""Figures of velocity fields: slices, errors and profiles.

A slice shows the vorticity too, and a profile the exact velocity next to the measured one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api import Velocity
from sabench.geometry.grid import gradient, vorticity
from sabench.plotting.charts import Cloud, Curve, Figure, Panel, Slice
from sabench.utils.arrays import F64

_POINTS = 4000  # of a scatter plot at most


def field_figure(field: Velocity, exact_mm_s: F64, unit_mm_s: F64, solver: str) -> Figure:
    """Draw the middle plane of a field, its errors, and a profile.

    Parameters
    ----------
    exact_mm_s : (z, y, x, 3) the true velocities at its nodes.
    unit_mm_s : (3,) velocities of one voxel between the two volumes, in which errors are given.
    """
    errors = (field.velocity_mm_s - exact_mm_s) / unit_mm_s
    # find the axis with the most vorticity in the middle plane across it
    spin = _vorticity(field)
    normal = int(np.argmax([np.square(_middle(spin, axis)[..., axis]).mean() for axis in range(3)]))
    off = Slice("voxels", *_axes(field, normal), np.linalg.norm(_middle(errors, normal), axis=-1))
    panels = (
        slice_panel(field, normal),
        Panel("length of the error there", *_labels(normal), (off,)),
        error_scatter("errors", errors[field.valid]),
        profile_panel(field, exact_mm_s, normal),
    )
    return Figure("velocity", solver, panels, across=2)


def _vorticity(field: Velocity) -> F64:
    return np.asarray(np.nan_to_num(vorticity(gradient(field.velocity_mm_s, field.step_mm))))


def _middle(values: npt.NDArray[Any], normal: int) -> npt.NDArray[Any]:
    """Cut the middle plane across an axis out of values (z, y, x, ...).

    Its rows run along the later of the other two axes.
    """
    axis = 2 - normal
    return np.asarray(np.take(values, values.shape[axis] // 2, axis=axis))


def _across(normal: int) -> tuple[int, int]:
    """Return the axes of columns and rows of a plane."""
    first, second = (axis for axis in range(3) if axis != normal)
    return first, second


def _axes(field: Velocity, normal: int) -> tuple[F64, F64]:
    """Compute the coordinates of a plane's columns and rows."""
    columns, rows = (
        field.low_mm[axis] + field.step_mm[axis] * np.arange(field.valid.shape[2 - axis])
        for axis in _across(normal)
    )
    return np.asarray(columns, dtype=np.float64), np.asarray(rows, dtype=np.float64)


def _labels(normal: int) -> tuple[str, str]:
    columns, rows = (f"{'xyz'[axis]}, mm" for axis in _across(normal))
    return columns, rows


def slice_panel(field: Velocity, normal: int) -> Panel:
    """Draw vectors and vorticity in the middle plane across an axis (0 to 2).

    The vorticity is the one about that axis; invalid vectors are left out.
    """
    arrows = np.where(
        _middle(field.valid, normal)[..., None],
        _middle(field.velocity_mm_s, normal)[..., list(_across(normal))],
        np.nan,
    )
    position_mm = field.low_mm[normal] + field.step_mm[normal] * (
        field.valid.shape[2 - normal] // 2
    )
    spin = Slice(
        f"vorticity about {'xyz'[normal]}, 1/s",
        *_axes(field, normal),
        _middle(_vorticity(field), normal)[..., normal],
        True,
        arrows,
    )
    return Panel(f"measured, {'xyz'[normal]} = {position_mm:.4g} mm", *_labels(normal), (spin,))


def error_scatter(title: str, errors: F64) -> Panel:
    """Draw errors (n, 3) in voxels of v and w over those of u; thesis, figure 2-9."""
    some = np.random.default_rng(0).permutation(len(errors))[:_POINTS]
    u, v, w = errors[some].T
    return Panel(
        title, "error of u, voxels", "error of v or w, voxels", (Cloud("v", u, v), Cloud("w", u, w))
    )


def profile_panel(field: Velocity, exact_mm_s: F64, normal: int) -> Panel:
    """Draw the measured and exact components along a line through a plane's middle.

    The line runs along the columns' axis.
    """
    columns, _ = _axes(field, normal)
    curves = [
        Curve(
            f"{name}{note}",
            list(columns),
            list(_middle(values, normal)[len(_middle(values, normal)) // 2, :, number]),
        )
        for number, name in enumerate("uvw")
        for note, values in (("", field.velocity_mm_s), (" exact", exact_mm_s))
    ]
    along = "xyz"[_across(normal)[0]]
    return Panel(f"along {along} through the middle", f"{along}, mm", "mm/s", tuple(curves))
