"""Images of particles that Dr.Jit renders and differentiates, and their cost.

Particles have a position and a light in every camera. Their images are Gaussians integrated over
pixels. The cost is minus the logarithm of the probability of images and lights, up to a constant:
that of `joint_fit`, but of all particles at a time and of cameras without polynomials.

Sums over particles run in a fixed order (a table holds the windows that cover each pixel), so that
the same positions have the same cost, bit for bit: sums by atomic additions have not.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sabench.algorithms.particles.differentiable_projection import DifferentiableCamera, constants
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, F64, I64
from sabench.utils.backend import drjit

_REACH = 3.1  # of a particle's image in widths
_MARGIN_PX = 0.9  # that a particle may move before windows are laid out again


class ImageModel(NamedTuple):
    """Images, and what is known of particles' images before any particle is.

    Attributes
    ----------
    cameras : exact cameras.
    shifts : (camera, 2) shifts of their pixels as (column, row), px.
    images : (camera, row, column) less black.
    weight : the same shape, 1 / variance of a pixel; 0 where it is unknown.
    widths : (camera, 2, 4) widths of particle images along columns and rows, px: in the box's
        middle, and their change along each of its coordinates.
    typical : (camera,) a typical particle's light.
    precision : (camera, camera) inverse covariance of the logarithms of light over that.
    middle_mm, half_mm : (3,) centre and half edges of the box.
    """

    cameras: Sequence[Camera]
    shifts: F64
    images: F32
    weight: F32
    widths: F64
    typical: F64
    precision: F64
    middle_mm: F64
    half_mm: F64


class DifferentiableImages:
    """Renderer of all cameras, with windows of pixels around particles.

    The windows stay where they are until `lay_out` is called again, so that the cost is smooth.
    """

    def __init__(self, model: ImageModel) -> None:
        """Prepare the cameras; `lay_out` comes next."""
        self._dr, arrays = drjit()
        self._float, self._index = arrays.ad.Float64, arrays.ad.UInt32
        half = math.ceil(_REACH * float(model.widths[:, :, 0].max()) + _MARGIN_PX)
        self._model, self._window = model, 2 * half + 1
        self._precision = constants(model.precision)
        self._views = [_View(self, number) for number in range(len(model.cameras))]

    def lay_out(self, position_mm: F64) -> None:
        """Lay out windows around positions (n, 3)."""
        for view, pixel in zip(self._views, self._project(position_mm), strict=True):
            view.lay_out(np.rint(pixel).astype(np.int64) - self._window // 2)

    def farthest_px(self, position_mm: F64) -> float:
        """Measure how far positions (n, 3) are from the middles of their windows."""
        return max(
            float(np.abs(pixel - self._window // 2 - view.corner).max(initial=0.0))
            for view, pixel in zip(self._views, self._project(position_mm), strict=True)
        )

    def _project(self, position_mm: F64) -> list[F64]:
        """Project positions (n, 3) to the pixels (n, 2) of each camera."""
        place = self._leaves(position_mm)
        both = [view.camera.project(*place) for view in self._views]
        return [np.column_stack([one.numpy() for one in pixel]) for pixel in both]

    def cost_and_slopes(self, position_mm: F64, logarithms: F64) -> tuple[float, F64, F64]:
        """Compute the cost and its derivatives by positions and logarithms of light.

        Parameters
        ----------
        position_mm : (n, 3)
        logarithms : (n, camera) of light over a typical particle's.
        """
        dr = self._dr
        place, logs = self._leaves(position_mm), self._leaves(logarithms)
        for leaf in (*place, *logs):
            dr.enable_grad(leaf)
        cost = 0.0
        for view, own in zip(self._views, logs, strict=True):
            part = view.cost(place, own)
            dr.backward(part)
            dr.eval([dr.grad(one) for one in (*place, own)])  # so that cameras share kernels
            cost += view.dark + float(part[0])
        part = self._prior(logs)
        dr.backward(part)
        by_place, by_log = (
            np.column_stack([dr.grad(one).numpy() for one in leaves]) for leaves in (place, logs)
        )
        return cost + float(part[0]), by_place, by_log

    def curvatures(self, position_mm: F64, logarithms: F64) -> F64:
        """Compute each particle's own Gauss-Newton matrix (n, 3 + camera, 3 + camera).

        The unknowns are its position in mm and its logarithms of light; other particles count as
        known. Derivatives of its images come from Dr.Jit's forward mode.
        """
        cameras = len(self._views)
        blocks = np.zeros((len(position_mm), 3 + cameras, 3 + cameras))
        blocks[:, 3:, 3:] = self._model.precision
        blocks[:, :3, :3] = np.diag(3.0 / self._model.half_mm**2)  # anywhere in the box
        for camera, view in enumerate(self._views):
            slopes, weight = view.slopes(position_mm, logarithms[:, camera])
            rows = np.array([0, 1, 2, 3 + camera])
            own = np.einsum("nwa,nw,nwb->nab", slopes, weight, slopes)
            blocks[:, rows[:, None], rows] += own
        return blocks

    def render(self, position_mm: F64, logarithms: F64) -> F64:
        """Render the images (camera, row, column)."""
        place, logs = self._leaves(position_mm), self._leaves(logarithms)
        return np.stack(
            [view.render(place, own) for view, own in zip(self._views, logs, strict=True)]
        )

    def spread(self, values: list[Any]) -> Any:
        """Repeat arrays (n,) of particles for each of their window pixels."""
        return self._dr.custom(_repeat(), values, self._window**2)

    def _prior(self, logs: list[Any]) -> Any:
        """Compute the cost of lights: that of a normal distribution."""
        total = self._float(0.0)
        for one, row in zip(logs, self._precision, strict=True):
            pull = sum(each * other for each, other in zip(row, logs, strict=True))
            total += 0.5 * self._dr.sum(one * pull)
        return total

    def _leaves(self, columns: F64) -> list[Any]:
        """Copy the columns of an array (n, k) into k arrays."""
        return [self._float(np.ascontiguousarray(column)) for column in columns.T]


@functools.cache
def _repeat() -> Any:
    """Make the operation that repeats the values of arrays; its derivatives are sums.

    They are added up in a fixed order. Arrays share kernels.
    """
    dr, _ = drjit()

    class Repeat(dr.CustomOp):  # type: ignore[misc]
        def eval(self, arrays: list[Any], count: int) -> list[Any]:
            self.count = count
            return self.repeat(dr.detach(arrays))

        def repeat(self, arrays: list[Any]) -> list[Any]:
            dr.eval(arrays)
            return [dr.repeat(one, self.count) for one in arrays]

        def forward(self) -> None:
            self.set_grad_out(self.repeat(self.grad_in("arrays")))

        def backward(self) -> None:
            slopes = self.grad_out()
            dr.eval(slopes)
            self.set_grad_in("arrays", [dr.block_sum(one, self.count) for one in slopes])

    return Repeat


class _View:
    """One camera's part of the cost."""

    def __init__(self, owner: DifferentiableImages, number: int) -> None:
        self._owner, model = owner, owner._model
        self.camera = DifferentiableCamera(model.cameras[number], model.shifts[number])
        self._image, self._weight = model.images[number], model.weight[number]
        per_mm = model.widths[number, :, 1:] / model.half_mm
        middle = model.widths[number, :, 0] - per_mm @ model.middle_mm
        terms = np.column_stack([middle, per_mm])
        self._typical, self._widths = constants([model.typical[number], terms])

    def lay_out(self, corner: I64) -> None:
        """Lay out windows from corners (n, 2), (column, row) of their first pixels.

        The table (pixel, slot) lists the window pixels that cover each pixel of the image; a slot
        that is not used refers to a zero behind them all.
        """
        self.corner, owner, window = corner, self._owner, self._owner._window
        steps = np.arange(window)
        column = corner[:, :1] + np.tile(steps, window)
        row = corner[:, 1:] + np.repeat(steps, window)
        rows, columns = self._image.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        self._flat = np.where(inside, row * columns + column, -1)
        source = np.flatnonzero(inside)
        target = self._flat.ravel()[source]
        order = np.argsort(target, kind="stable")
        self._lit, first, count = np.unique(target[order], return_index=True, return_counts=True)
        self._slots = int(count.max(initial=1))
        table = np.full((len(self._lit), self._slots), inside.size)
        slot = np.arange(len(order)) - np.repeat(first, count)
        table[np.repeat(np.arange(len(count)), count), slot] = source[order]
        self._table = owner._index(table.ravel().astype(np.uint32))
        self._used = owner._index(np.array([inside.size], dtype=np.uint32))
        self._column, self._row = (
            owner._float(one.ravel().astype(np.float64)) for one in (column, row)
        )
        self._set_data()

    def _set_data(self) -> None:
        """Take the data of lit pixels, and the constant cost of all others."""
        image, weight = (one.ravel().astype(np.float64) for one in (self._image, self._weight))
        dark = np.ones(image.size, dtype=np.bool_)
        dark[self._lit] = False
        self.dark = float(0.5 * np.sum((weight * image**2)[dark]))
        self._data, self._trust = (self._owner._float(one[self._lit]) for one in (image, weight))

    def cost(self, place: list[Any], log: Any) -> Any:
        """Compute half the weighted sum of squared residuals, of positions and light."""
        off = self._sum_up(self._images(place, log)) - self._data
        return 0.5 * self._owner._dr.sum(self._trust * off * off)

    def render(self, place: list[Any], log: Any) -> F64:
        """Render the image (row, column)."""
        image = np.zeros(self._image.size)
        image[self._lit] = self._sum_up(self._images(place, log)).numpy()
        return image.reshape(self._image.shape)

    def slopes(self, position_mm: F64, log: F64) -> tuple[F64, F64]:
        """Compute derivatives of each particle's image by its position and light.

        Returns (n, window pixel, 4), and the weights (n, window pixel) of the pixels.
        """
        dr, found = self._owner._dr, []
        for axis in range(4):
            *place, light = self._owner._leaves(np.column_stack([position_mm, log]))
            leaf = (*place, light)[axis]
            dr.enable_grad(leaf)
            image = self._images(place, light)
            dr.forward(leaf)
            found.append(dr.grad(image).numpy().reshape(len(log), -1))
        weight = np.append(self._weight.ravel(), 0.0)[self._flat]
        return np.stack(found, axis=2), weight

    def _images(self, place: list[Any], log: Any) -> Any:
        """Render each particle's own image: arrays (n window pixels,), particle by particle."""
        dr, spread = self._owner._dr, self._owner.spread
        column, row = self.camera.project(*place)
        across, down = (
            middle + sum(each * one for each, one in zip(slopes, place, strict=True))
            for middle, *slopes in self._widths
        )
        light = self._typical * dr.exp(log)
        column, row, across, down, light = spread([column, row, across, down, light])
        light *= self._shares(self._column - column, across)
        return light * self._shares(self._row - row, down)

    def _shares(self, offset: Any, width: Any) -> Any:
        """Integrate Gaussians over pixels at an offset from their centres."""
        erf, scale = self._owner._dr.erf, self._owner._dr.rcp(width * math.sqrt(2.0))
        return 0.5 * (erf((offset + 0.5) * scale) - erf((offset - 0.5) * scale))

    def _sum_up(self, images: Any) -> Any:
        """Add up the images of all particles in the lit pixels."""
        dr, owner = self._owner._dr, self._owner
        each = dr.gather(
            owner._float,
            images,
            self._table,
            active=self._table < self._used,
            mode=dr.ReduceMode.NoConflicts,
        )
        return dr.block_sum(each, self._slots)
