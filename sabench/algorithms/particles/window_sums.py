"""Sums over a window of an image, eight pixels at a time.

A compiler that is left alone unrolls the short rows of a window, and puts none of them on vector
units. The arrays are those of `image_model.ImageModel` and `image_model.Room`, all cameras'. A
window is that of camera c, from a row and a column on, with so many rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from sabench.utils.vector_units import LANES, Vectors

# Profiles of an image along columns and rows, and their first and second derivatives by the centre;
# those that tilted images alone have are times t, t^2 / 2 and, for the slope along rows, t, with
# the covariance t of columns and rows.
OWN_X, SLOPE_X, CURVE_X, OWN_Y, TILT_Y, TILT_CURVE_Y, SLOPE_Y, TILT_SLOPE_Y = range(8)
PROFILES = 8


class _Row(NamedTuple):
    """Vectors of a window's row, with profiles across and down it."""

    left: Any
    weight: Any
    light: Any
    across: Sequence[Any]
    down: Sequence[Any]


def _product(do: Vectors, across: Sequence[Any], down: Sequence[Any]) -> Any:
    """Return the sum of products of profiles across and down."""
    total = do.times(across[0], down[0])
    for one, other in zip(across[1:], down[1:], strict=True):
        total = do.plus(total, do.times(one, other))
    return total


def _match(do: Vectors, row: _Row) -> list[Any]:
    """Return the terms of `match_window`, and of `match_tilted`."""
    own = _product(do, row.across, row.down)
    counts = _counting(do, row.weight, do.minus(row.left, do.times(row.light, own)))
    each = do.times(counts, own)
    spared = _spared(do, row.weight, counts, row.left)
    return [do.times(each, row.left), do.times(each, own), spared]


def _sum(do: Vectors, row: _Row) -> list[Any]:
    """Return the terms of `sum_window`."""
    (x, by_x), (y, by_y) = row.across, row.down
    return _products(do, row, do.times(x, y), do.times(by_x, y), do.times(x, by_y))


def _sum_tilted(do: Vectors, row: _Row) -> list[Any]:
    """Return the terms of `sum_tilted`."""
    (x, by_x, _), (y, by_y, *tilted, slope_y) = row.across, row.down
    own = _product(do, row.across, [y, *tilted])
    along_x = _product(do, row.across[1:], [y, tilted[0]])
    along_y = _product(do, [x, by_x], [by_y, slope_y])
    return _products(do, row, own, along_x, along_y)


def _products(do: Vectors, row: _Row, own: Any, along_x: Any, along_y: Any) -> list[Any]:
    """Return the terms of `sum_window` for an image and its derivatives."""
    left, counts = row.left, _counting(do, row.weight, row.left)
    share, slope_x, slope_y = (do.times(counts, one) for one in (own, along_x, along_y))
    products = (
        (share, own),
        (share, left),
        (slope_x, along_x),
        (slope_x, along_y),
        (slope_y, along_y),
        (slope_x, left),
        (slope_y, left),
    )
    shown = do.plus(left, do.times(row.light, own))
    return [*(do.times(*pair) for pair in products), _spared(do, row.weight, counts, shown)]


def _counting(do: Vectors, weight: Any, left: Any) -> Any:
    """Return the weights of pixels as `image_model.counting` does."""
    asked = do.above_zero(left)
    return do.builder.select(asked, do.magnitude(weight), do.positive(weight))


def _spared(do: Vectors, weight: Any, counts: Any, light: Any) -> Any:
    """Return what light saves in saturated pixels that have enough."""
    shown = do.positive(light)
    unasked = do.times(do.constant(0.5), do.minus(do.magnitude(weight), counts))
    return do.times(unasked, do.times(shown, shown))


def _sums(
    terms: Callable[[Vectors, _Row], list[Any]],
    count: int,
    arrays: tuple[Any, Any, Any],
    across: Sequence[int],
    down: Sequence[int],
) -> tuple[Any, Any]:
    """Return the signature and the code of sums of terms over a window.

    Of the profiles, those that the terms ask for are read across and down.
    """
    signature = types.UniTuple(types.float32, count)(
        *arrays, types.intp, types.intp, types.intp, types.intp, types.float32
    )

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        do = Vectors(builder, ir.FloatType(), LANES)
        camera, top, start, rows, light = values[len(arrays) :]
        kinds = signature.args[: len(arrays)]
        structs = [
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(kinds, values, strict=False)
        ]

        def number(value: int) -> Any:
            return context.get_constant(types.intp, value)

        element = number(do.bytes)

        def at(array: int, *place: Any) -> Any:
            each = kinds[array], structs[array], [camera, *place]
            return cgutils.get_item_pointer(context, builder, *each)

        def after(pointer: Any, step: Any, stride: Any) -> Any:
            return builder.gep(pointer, [builder.mul(step, stride)])

        width = builder.extract_value(structs[2].shape, 2)
        strides = [
            builder.sdiv(builder.extract_value(struct.strides, 1), element)
            for struct in structs[:2]
        ]
        totals = [cgutils.alloca_once_value(builder, do.zero) for _ in range(count)]
        everywhere = do.splat(light)
        with cgutils.for_range(builder, builder.sdiv(width, number(LANES))) as block:
            first = builder.mul(block.index, number(LANES))
            corners = [at(k, top, builder.add(start, first)) for k in range(2)]
            along = [do.load(at(2, number(kind), first)) for kind in across]
            ends = [at(2, number(kind), number(0)) for kind in down]
            with cgutils.for_range(builder, rows) as step:
                left, weight = (
                    do.load(after(corner, step.index, stride))
                    for corner, stride in zip(corners, strides, strict=True)
                )
                shares = [do.splat(builder.load(after(end, step.index, number(1)))) for end in ends]
                row = _Row(left, weight, everywhere, along, shares)
                for total, term in zip(totals, terms(do, row), strict=True):
                    builder.store(do.plus(builder.load(total), term), total)
        sums = [do.total(builder.load(total)) for total in totals]
        return context.make_tuple(builder, signature.return_type, sums)

    return signature, code


def _kernel(
    terms: Callable[[Vectors, _Row], list[Any]],
    count: int,
    across: Sequence[int],
    down: Sequence[int],
) -> Any:
    """Make a kernel that sums up so many terms, of these profiles across and down."""

    @intrinsic
    def add_up(
        context: Any,
        left: Any,
        weight: Any,
        profiles: Any,
        c: Any,
        row: Any,
        column: Any,
        rows: Any,
        light: Any,
    ) -> tuple[Any, Any]:
        return _sums(terms, count, (left, weight, profiles), across, down)

    return add_up


# Sums of weights times an image times what is left, and times the image itself. Saturated pixels
# that have enough with this light count in the third sum.
match_window = _kernel(_match, 3, [OWN_X], [OWN_Y])
match_tilted = _kernel(_match, 3, [OWN_X, SLOPE_X, CURVE_X], [OWN_Y, TILT_Y, TILT_CURVE_Y])
# What `image_model.sum_up` fills in of a camera, in its order.
sum_window = _kernel(_sum, 8, [OWN_X, SLOPE_X], [OWN_Y, SLOPE_Y])
sum_tilted = _kernel(
    _sum_tilted,
    8,
    [OWN_X, SLOPE_X, CURVE_X],
    [OWN_Y, SLOPE_Y, TILT_Y, TILT_CURVE_Y, TILT_SLOPE_Y],
)
