"""Images of particles that Dr.Jit renders and differentiates, and their cost.

Particles have a position and a light in every camera. Their images are Gaussians integrated over
pixels. The cost is minus the logarithm of the probability of images and lights, up to a constant:
that of `joint_fit`, but of all particles at a time and of cameras without polynomials.

Sums over particles run in a fixed order (a table holds the windows that cover each pixel), so that
the same positions have the same cost, bit for bit: sums by atomic additions have not.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sabench.plugins.solvers._inverse_rendering.projection import (
    DifferentiableCamera,
    aligned,
    constants,
)

from sabench.algorithms.particles.image_model import MOST_FLAT
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, F64, I64
from sabench.utils.backend import drjit

_REACH, _FLAT_REACH = 3.1, 4.2  # of a particle's image in widths, and of a flat one
_MARGIN_PX = 0.9  # that a particle may move before windows are laid out again
_SLOTS = 4  # of window pixels for a pixel: multiples of it, as each number has its own kernel


class ImageModel(NamedTuple):
    """Images, and what is known of particles' images before any particle is.

    Attributes
    ----------
    cameras : exact cameras.
    shifts : (camera, 2) shifts of their pixels as (column, row), px.
    images : (camera, row, column) less black.
    weight : the same shape, 1 / variance of a pixel; 0 where it is unknown.
    shapes : (camera, SHAPES, TERMS) of particle images, as those of `image_model.ImageModel`.
    typical : (camera,) a typical particle's light.
    precision : (camera, camera) inverse covariance of the logarithms of light over that.
    middle_mm, half_mm : (3,) centre and half edges of the box.
    """

    cameras: Sequence[Camera]
    shifts: F64
    images: F32
    weight: F32
    shapes: F64
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
        self._dr, _ = drjit()
        reach = _FLAT_REACH if model.shapes[:, 3, 0].any() else _REACH
        self._half = math.ceil(reach * float(model.shapes[:, :2, 0].max()) + _MARGIN_PX)
        self._model, self._precision = model, constants(model.precision)
        cameras = range(len(model.cameras))
        self._views = [_View(model, camera, 2 * self._half + 1) for camera in cameras]

    def lay_out(self, position_mm: F64) -> None:
        """Lay out windows around positions (n, 3)."""
        for view, pixel in zip(self._views, self._project(position_mm), strict=True):
            view.lay_out(np.rint(pixel).astype(np.int64) - self._half)

    def farthest_px(self, position_mm: F64) -> float:
        """Measure how far positions (n, 3) are from the middles of their windows."""
        return max(
            float(np.abs(pixel - self._half - view.corner).max(initial=0.0))
            for view, pixel in zip(self._views, self._project(position_mm), strict=True)
        )

    def _project(self, position_mm: F64) -> list[F64]:
        """Project positions (n, 3) to the pixels (n, 2) of each camera."""
        place = _load(position_mm)
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
        place, logs = _load(position_mm), _load(logarithms)
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
        place, logs = _load(position_mm), _load(logarithms)
        return np.stack(
            [view.render(place, own) for view, own in zip(self._views, logs, strict=True)]
        )

    def _prior(self, logs: list[Any]) -> Any:
        """Compute the cost of lights: that of a normal distribution."""
        pulls = [_weighted(row, logs) for row in self._precision]
        return 0.5 * self._dr.sum(_weighted(logs, pulls))


def _load(columns: F64) -> list[Any]:
    """Copy the columns of an array (n, k) to k Dr.Jit arrays."""
    return [_array(column) for column in columns.T]


def _array(values: F64 | I64) -> Any:
    return drjit()[1].ad.Float64(aligned(np.asarray(values, dtype=np.float64).ravel()))


def _indices(values: I64) -> Any:
    return drjit()[1].ad.UInt32(aligned(values.ravel().astype(np.uint32)))


@functools.cache
def _repeat() -> Any:
    """Make the operation that repeats the values of arrays; its derivatives are sums.

    They are added up in a fixed order. Arrays share kernels.
    """
    dr, _ = drjit()

    class Repeat(dr.CustomOp):  # type: ignore[misc,name-defined]
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

    def __init__(self, model: ImageModel, camera: int, window: int) -> None:
        """Prepare one of a model's cameras; windows are so many pixels wide and high."""
        self._dr, self._window = drjit()[0], window
        exact = model.cameras[camera]
        self.camera = DifferentiableCamera(exact, model.shifts[camera])
        self._image, self._weight = model.images[camera], model.weight[camera]
        # of 1, x, y, z and z^2 in the box: in mm
        even, *slopes, bend = model.shapes[camera].T
        per_mm, bend = np.stack(slopes, axis=1) / model.half_mm, bend / model.half_mm[2] ** 2
        even = even - per_mm @ model.middle_mm + bend * model.middle_mm[2] ** 2
        per_mm[:, 2] -= 2.0 * bend * model.middle_mm[2]
        terms = np.column_stack([per_mm, bend, even])
        self._typical, self._shapes = constants([model.typical[camera], terms])
        self._plain = not model.shapes[camera, 2:, 0].any()

    def lay_out(self, corner: I64) -> None:
        """Lay out windows from corners (n, 2), (column, row) of their first pixels."""
        steps = np.arange(self._window)
        column = corner[:, :1] + np.tile(steps, self._window)
        row = corner[:, 1:] + np.repeat(steps, self._window)
        rows, columns = self._image.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        self._flat = np.where(inside, row * columns + column, -1)
        self.corner, self._column, self._row = corner, _array(column), _array(row)
        self._set_table()
        self._set_data()

    def _set_table(self) -> None:
        """List the window pixels that cover each lit pixel of the image (pixel, slot).

        A slot that is not used refers to a place behind all window pixels.
        """
        source = np.flatnonzero(self._flat >= 0)
        source = source[np.argsort(self._flat.ravel()[source], kind="stable")]
        target = self._flat.ravel()[source]
        self._lit = np.union1d(target, [0])  # one pixel at least: Dr.Jit has no empty arrays
        place = np.searchsorted(self._lit, target)
        slot = np.arange(len(target)) - np.searchsorted(target, target)
        self._slots = _SLOTS * (int(slot.max(initial=0)) // _SLOTS + 1)
        table = np.full((len(self._lit), self._slots), self._flat.size)
        table[place, slot] = source
        self._table, self._unused = _indices(table), _indices(np.array([self._flat.size]))

    def _set_data(self) -> None:
        """Take the data of lit pixels, and the constant cost of all others."""
        image, weight = (one.ravel().astype(np.float64) for one in (self._image, self._weight))
        dark = np.ones(image.size, dtype=np.bool_)
        dark[self._lit] = False
        self.dark = float(0.5 * np.sum((weight * image**2)[dark]))
        self._data, self._trust = _array(image[self._lit]), _array(weight[self._lit])

    def cost(self, place: list[Any], log: Any) -> Any:
        """Compute half the weighted sum of squared residuals, of positions and light."""
        off = self._sum_up(self._images(place, log)) - self._data
        return 0.5 * self._dr.sum(self._trust * off * off)

    def render(self, place: list[Any], log: Any) -> F64:
        """Render the image (row, column)."""
        image = np.zeros(self._image.size)
        image[self._lit] = self._sum_up(self._images(place, log)).numpy()
        return image.reshape(self._image.shape)

    def slopes(self, position_mm: F64, log: F64) -> tuple[F64, F64]:
        """Compute derivatives of each particle's image by its position and light.

        Returns (n, window pixel, 4), and the weights (n, window pixel) of the pixels.
        """
        dr, found = self._dr, []
        for axis in range(4):
            *place, light = _load(np.column_stack([position_mm, log]))
            leaf = (*place, light)[axis]
            dr.enable_grad(leaf)
            image = self._images(place, light)
            dr.forward(leaf)
            found.append(dr.grad(image).numpy().reshape(len(log), -1))
        weight = np.append(self._weight.ravel(), 0.0)[self._flat]
        return np.stack(found, axis=2), weight

    def _images(self, place: list[Any], log: Any) -> Any:
        """Render each particle's own image, window pixels (n k,) particle by particle."""
        powers = [*place, place[2] * place[2], 1.0]
        across, down, *shape = (_weighted(terms, powers) for terms in self._shapes)
        light = self._typical * self._dr.exp(log)
        spread = [*self.camera.project(*place), across, down, light]
        if not self._plain:
            spread += shape
        each = self._dr.custom(_repeat(), spread, self._window**2)
        column, row, across, down, light, *shape = each
        x, y = (self._column - column, across), (self._row - row, down)
        own = self._shares(*x) * self._shares(*y)
        return light * (own + self._more_than_plain(x, y, *shape) if shape else own)

    def _more_than_plain(self, x: Any, y: Any, tilt: Any, flat: Any) -> Any:
        """Compute what the image of a camera has beside a plain one, as in `image_model`."""
        (_, across), (_, down) = x, y
        flat = self._dr.clip(flat, 0.0, MOST_FLAT)
        by_x, by_xx, fourth_x = self._derivatives(*x)
        by_y, by_yy, fourth_y = self._derivatives(*y)
        bend = 0.5 * tilt * tilt - 2.0 * flat * across * across * down * down
        fourth = across**4 * fourth_x * self._shares(*y) + down**4 * fourth_y * self._shares(*x)
        return tilt * by_x * by_y + bend * by_xx * by_yy - flat * fourth

    def _shares(self, offset: Any, width: Any) -> Any:
        """Integrate Gaussians over pixels at an offset from their centres."""
        erf, scale = self._dr.erf, 1.0 / (width * math.sqrt(2.0))
        return 0.5 * (erf((offset + 0.5) * scale) - erf((offset - 0.5) * scale))

    def _derivatives(self, offset: Any, width: Any) -> list[Any]:
        """Compute the first, second and fourth derivative of `_shares` by the centres."""
        first, last = (offset - 0.5) / width, (offset + 0.5) / width
        before, after = (
            self._dr.exp(-0.5 * edge * edge) / math.sqrt(2.0 * math.pi) for edge in (first, last)
        )
        third = first * (first * first - 3.0) * before - last * (last * last - 3.0) * after
        return [
            (before - after) / width,
            (first * before - last * after) / width**2,
            third / width**4,
        ]

    def _sum_up(self, images: Any) -> Any:
        """Add up the images of all particles in the lit pixels."""
        used, mode = self._table < self._unused, self._dr.ReduceMode.NoConflicts
        each = self._dr.gather(type(images), images, self._table, active=used, mode=mode)
        return self._dr.block_sum(each, self._slots)


def _weighted(weights: Sequence[Any], values: Sequence[Any]) -> Any:
    """Add up values times their weights."""
    return sum(weight * value for weight, value in zip(weights, values, strict=True))
