"""Wall of coaxial cylinders around the fluid, with the cameras outside.

At the end are the types of walls of any shape as JSON keeps them.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Tag

from sabench.geometry.refraction import AnyWall, Layer, Paths, Rays, Wall
from sabench.utils.arrays import F64, Bool
from sabench.utils.validation import UNION_TAG


@dataclass(frozen=True)
class CylinderWall(AnyWall):
    """Coaxial cylindrical layers between the cameras' medium and the fluid inside.

    The cylinder has no ends.

    Attributes
    ----------
    axis_point_mm : a point on the axis, world frame.
    axis : unit vector along the axis, world frame.
    outer_radius_mm : of the outer face (the face that the cameras see).
    air_index, fluid_index : refractive indices on the cameras' side and in the tank.
    layers : the solid layers, from outside; may be empty (a bare surface).
    """

    axis_point_mm: tuple[float, float, float]
    axis: tuple[float, float, float]
    outer_radius_mm: float
    air_index: float
    layers: tuple[Layer, ...]
    fluid_index: float

    @property
    def radii_mm(self) -> F64:
        """Radii of all faces, from outside: (1 + layers,)."""
        thick = [layer.thickness_mm for layer in self.layers]
        return np.asarray(self.outer_radius_mm - np.cumsum([0.0, *thick]))

    def depth_of(self, points_mm: F64) -> F64:
        """Compute the signed distance of points (..., 3) behind the outer face, mm."""
        return np.asarray(self.outer_radius_mm - np.linalg.norm(self._across(points_mm), axis=-1))

    def normal_at(self, point_mm: F64) -> F64:
        """Compute the unit normal (3,) from a point (3,) to the axis."""
        across = self._across(point_mm)
        with np.errstate(invalid="ignore"):  # a point on the axis has none
            return np.asarray(-across / np.linalg.norm(across))

    def paths(self, pinhole_mm: F64, points_mm: F64) -> Paths:
        """Trace paths of light; those behind a caustic are left out.

        Not `valid` are also points in a shadow of the wall, near its limb.
        """
        from sabench.geometry import cylinder_kernels  # numba takes long to load

        leaving, arriving = np.full_like(points_mm, np.nan), np.full_like(points_mm, np.nan)
        with np.errstate(invalid="ignore"):  # infinite coordinates
            valid = np.asarray(self.depth_of(points_mm) > self.thickness_mm)
        gap = -float(self.depth_of(pinhole_mm))
        valid &= gap > 0.0
        if valid.any():
            frame = self._frame(pinhole_mm)
            local = (points_mm[valid] - pinhole_mm) @ frame.T - np.array([gap, 0.0, 0.0])
            first, last = np.zeros_like(local), np.zeros_like(local)
            reached = cylinder_kernels.find_light_paths(
                gap, self._faces(), self.indices, local, first, last
            )
            leaving[valid], arriving[valid] = first @ frame, last @ frame
            valid[valid] = reached
            leaving[~valid] = arriving[~valid] = np.nan
        return Paths(leaving, arriving, valid)

    def rays(self, pinhole_mm: F64, directions: F64) -> Rays:
        """Follow rays into the fluid; those that miss the inner face are not `valid`."""
        ends, arriving, _, _, valid = self._follow(pinhole_mm, directions)
        ends[~valid] = arriving[~valid] = np.nan
        return Rays(ends, arriving, valid)

    def lengths(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute lengths of light paths before the fluid."""
        _, _, lengths, _, valid = self._follow(pinhole_mm, leaving)
        return np.where(valid, lengths, np.nan)

    def transmittances(self, pinhole_mm: F64, leaving: F64) -> F64:
        """Compute transmitted fractions, 0 for rays that do not reach the fluid."""
        _, _, _, passed, valid = self._follow(pinhole_mm, leaving)
        return np.where(valid, passed, 0.0)

    def _follow(self, pinhole_mm: F64, directions: F64) -> tuple[F64, F64, F64, F64, Bool]:
        """Return ends, directions in the fluid, lengths, transmitted shares, validity."""
        from sabench.geometry import cylinder_kernels

        frame, gap = self._frame(pinhole_mm), -float(self.depth_of(pinhole_mm))
        along = np.ascontiguousarray(directions @ frame.T)
        ends, lengths, passed = np.zeros_like(along), np.zeros(len(along)), np.zeros(len(along))
        valid = cylinder_kernels.follow(
            gap, self._faces(), self.indices, along, ends, lengths, passed
        )
        valid &= gap > 0.0
        world = pinhole_mm + (ends + np.array([gap, 0.0, 0.0])) @ frame
        return np.asarray(world), np.asarray(along @ frame), lengths, passed, np.asarray(valid)

    def _frame(self, pinhole_mm: F64) -> F64:
        """Make the pinhole's own frame (3, 3): rows x, y and z."""
        towards, axis = self.normal_at(pinhole_mm), np.asarray(self.axis)
        return np.stack([towards, np.cross(axis, towards), axis])

    def _faces(self) -> F64:
        """List curvature and depth of each face: (1 + layers, 2)."""
        radii = self.radii_mm
        return np.ascontiguousarray(np.column_stack([1.0 / radii, radii[0] - radii]))

    def _across(self, points_mm: F64) -> F64:
        """Compute vectors (..., 3) from the axis to points, at right angles to it."""
        offset, axis = points_mm - np.asarray(self.axis_point_mm), np.asarray(self.axis)
        return np.asarray(offset - (offset @ axis)[..., None] * axis)


def _shape(value: Any) -> str:
    """Tell a list, a cylinder (it has an axis) and a plane wall apart."""
    if isinstance(value, list | tuple):
        return f"{UNION_TAG}faces"
    axis = "axis" in value if isinstance(value, dict) else isinstance(value, CylinderWall)
    return f"{UNION_TAG}{'cylinder' if axis else 'plane'}"


WallRecord = Annotated[
    Annotated[Wall, Tag(f"{UNION_TAG}plane")]
    | Annotated[CylinderWall, Tag(f"{UNION_TAG}cylinder")],
    Discriminator(_shape),
]
WallsRecord = Annotated[
    Annotated[Wall, Tag(f"{UNION_TAG}plane")]
    | Annotated[CylinderWall, Tag(f"{UNION_TAG}cylinder")]
    | Annotated[tuple[WallRecord | None, ...], Tag(f"{UNION_TAG}faces")],
    Discriminator(_shape),
]
