"""Cameras whose projection Dr.Jit differentiates, exact through plane walls.

A copy of `camera.project` on Dr.Jit arrays in double precision; tied to it by
tests/system/test_inverse_rendering.py.

The path through the wall has one unknown, which Newton's method solves for (as in `refraction`).
Derivatives do not run through the iteration: one further step from the solution, whose start and
slope are constants, has the derivatives of the implicit function.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera import Camera
from sabench.geometry.lens import sensor_axes
from sabench.geometry.projection_kernels import media_of
from sabench.geometry.refraction import Wall
from sabench.utils.backend import drjit

_NEWTON = 12  # steps: each doubles the right digits, and grazing light starts with few
_ALIGN = 128  # bytes


def aligned(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Copy an array to memory whose start is a multiple of 128 bytes.

    Dr.Jit uses the memory of numpy arrays as it is, and compiles another kernel for memory that is
    not aligned.
    """
    room = np.empty(values.nbytes + _ALIGN, dtype=np.uint8)
    start = -room.ctypes.data % _ALIGN
    own = room[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    own[...] = values
    return own


def constants(values: Any) -> Any:
    """Copy numbers, in lists of any depth, to one array, and look them up there.

    Returns lists of the same shape, of Dr.Jit arrays of one number. Kernels with other numbers are
    the same kernels, compiled once.
    """
    dr, arrays = drjit()
    flat: list[float] = []
    places = _collect(values, flat)
    table = arrays.ad.Float64(aligned(np.array(flat)))
    return _map(places, lambda place: dr.gather(arrays.ad.Float64, table, arrays.ad.UInt32(place)))


def _collect(values: Any, flat: list[float]) -> Any:
    """Append numbers to a list, and return their places in it."""
    if isinstance(values, list | tuple | np.ndarray):
        return [_collect(one, flat) for one in values]
    flat.append(float(values))
    return len(flat) - 1


def _map(values: Any, function: Callable[[int], Any]) -> Any:
    """Apply a function to all entries of lists of any depth."""
    if isinstance(values, list):
        return [_map(one, function) for one in values]
    return function(values)


class DifferentiableCamera:
    """Camera in air or behind a plane wall, on Dr.Jit arrays."""

    def __init__(self, camera: Camera, shift_px: Any = (0.0, 0.0)) -> None:
        """Take a camera, and a shift (column, row) of its pixels, px.

        Raises
        ------
        ValueError
            A wall that is not plane.
        """
        lens, wall = camera.distortion, camera.wall
        if wall is not None and not isinstance(wall, Wall):
            raise ValueError(f"camera {camera.name}: expected a plane wall, got another shape")
        self._dr, _ = drjit()
        self._center, self._rotation, self._focal, self._principal = constants(
            [
                camera.center_mm,
                camera.rotation,
                camera.focal_px,
                np.add(camera.principal_point_px, shift_px),
            ]
        )
        self._lens, self._sensor, self._normal, self._media = constants(
            [
                [lens.k1, lens.k2, lens.k3, lens.p1, lens.p2],
                sensor_axes(camera.tilt_deg),
                wall.normal if wall else [],
                _media(wall, camera) if wall else [],
            ]
        )

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
        """Project world points x, y, z (n,) in mm to columns and rows (n,), px."""
        offset = [one - center for one, center in zip((x, y, z), self._center, strict=True)]
        along = self._through_wall(offset) if self._normal else offset
        right, down, forward = (_dot(row, along) for row in self._rotation)
        u, v = self._on_sensor(*self._distort(right / forward, down / forward))
        return u * self._focal + self._principal[0], v * self._focal + self._principal[1]

    def _through_wall(self, offset: list[Any]) -> list[Any]:
        """Compute directions that leave the pinhole towards points at an offset from it."""
        dr, (_, _, first, gap, _) = self._dr, self._media
        depth = _dot(self._normal, offset)
        lateral = [one - axis * depth for one, axis in zip(offset, self._normal, strict=True)]
        square = _dot(lateral, lateral)
        slope = self._slope(square, depth - gap)
        slope = slope * _inverse_root(dr, first + (first - 1.0) * slope * slope * square)
        return [one * slope + axis for one, axis in zip(lateral, self._normal, strict=True)]

    def _slope(self, square: Any, deep: Any) -> Any:
        """Solve for the slopes of paths: tangents over lateral distances, 1/mm.

        The tangent is that in the rarest medium.

        Parameters
        ----------
        square : (n,) lateral distances squared, mm2.
        deep : (n,) depths of points behind the wall's inner face, mm.
        """
        dr = self._dr
        with dr.suspend_grad():
            flat, depth = dr.detach(square), dr.detach(deep)
            slope = 1.0 / self._bridged(0.0, flat, depth)[0]  # of a path near the normal
            for _ in range(_NEWTON):
                bridged, gain = self._bridged(slope, flat, depth)
                slope = slope + (1.0 - bridged * slope) / gain
            gain = self._bridged(slope, flat, depth)[1]
        bridged, _ = self._bridged(slope, square, deep)
        return slope + (1.0 - bridged * slope) / gain

    def _bridged(self, slope: Any, square: Any, deep: Any) -> tuple[Any, Any]:
        """Compute b and g, where a path bridges b times slope of its lateral distance.

        g is the derivative of that share by the slope.
        """
        rare, fluid, _, _, others = self._media
        tangent = slope * slope * square
        bridged, gain = rare, rare
        for ratio, depth in [(fluid, deep), *others]:
            inverse = _inverse_root(self._dr, ratio + (ratio - 1.0) * tangent)
            part = depth * inverse
            bridged, gain = bridged + part, gain + part * inverse * inverse * ratio
        return bridged, gain

    def _distort(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Distort ideal image coordinates, by Brown and Conrady's model."""
        k1, k2, k3, p1, p2 = self._lens
        s = x * x + y * y
        radial = 1.0 + s * (k1 + s * (k2 + s * k3))
        u = x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x)
        return u, y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y

    def _on_sensor(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Intersect light through the lens's middle with the sensor, which may be tilted."""
        across, down, normal = self._sensor
        depth = normal[2] / (normal[0] * x + normal[1] * y + normal[2])
        place = [depth * x, depth * y, depth - 1.0]
        return _dot(across, place), _dot(down, place)


def _media(wall: Wall, camera: Camera) -> list[Any]:
    """List what the projection needs of a wall in front of a camera.

    The rarest medium's thickness, the fluid's ratio, the camera's, the gap, and the other media.
    Ratios are squared indices over the rarest one's, see `projection_kernels.media_of`.
    """
    rare, others, fluid, first, gap = media_of(wall, np.asarray(camera.center_mm))
    return [rare, fluid, 1.0 if first is None else first, gap, others]


def _inverse_root(dr: Any, value: Any) -> Any:
    """Compute 1 / sqrt.

    Dr.Jit's rsqrt has seven digits on a GPU, also in double precision.
    """
    return 1.0 / dr.sqrt(value)


def _dot(one: Any, other: Any) -> Any:
    """Compute the scalar product of two lists of three arrays."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
