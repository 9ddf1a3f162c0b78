"""Sums over a window of an image, eight pixels at a time.

A compiler that is left alone unrolls the short rows of a window, and puts none of them on vector
units. The arrays are those of `image_model.ImageModel` and `image_model.Room`, all cameras'. A
window is that of camera c, from a row and a column on, with so many rows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from sabench.utils.vector_units import LANES, Vectors

# Profiles of an image along columns and rows, for light 1, and their derivatives by the centre.
# Plain images have OWN and SLOPE alone; the others are as `image_model` fills them in.
FLAT_X, OWN_X, SLOPE_X, CURVE_X, THIRD_X, FLAT_SLOPE_X, CURVE_SLOPE_Y, SLOPE_Y = range(8)
OWN_Y, WHOLE_Y, TILT_Y, CURVE_Y, WHOLE_SLOPE_Y, TILT_SLOPE_Y = range(8, 14)
PROFILES = 14

Pairs = Sequence[tuple[int, int]]

# of profiles whose products make up an image, and its derivatives by the centre's column and row
PLAIN, PLAIN_BY_X, PLAIN_BY_Y = ((OWN_X, OWN_Y),), ((SLOPE_X, OWN_Y),), ((OWN_X, SLOPE_Y),)
SHAPED = ((FLAT_X, OWN_Y), (OWN_X, WHOLE_Y), (SLOPE_X, TILT_Y), (CURVE_X, CURVE_Y))
SHAPED_BY_X = ((SLOPE_X, WHOLE_Y), (CURVE_X, TILT_Y), (THIRD_X, CURVE_Y), (FLAT_SLOPE_X, OWN_Y))
SHAPED_BY_Y = (
    (OWN_X, WHOLE_SLOPE_Y),
    (SLOPE_X, TILT_SLOPE_Y),
    (CURVE_X, CURVE_SLOPE_Y),
    (FLAT_X, SLOPE_Y),
)


class _Row(NamedTuple):
    """Vectors of a window's row, with profiles across and down it."""

    left: Any
    weight: Any
    light: Any
    profiles: dict[int, Any]

    def product(self, do: Vectors, pairs: Pairs) -> Any:
        """Return the sum of products of profiles across and down."""
        terms = [do.times(self.profiles[one], self.profiles[other]) for one, other in pairs]
        return functools.reduce(do.plus, terms)


def _match(do: Vectors, row: _Row, image: Pairs) -> list[Any]:
    """Return the terms of `match_window`, and of `match_shaped`."""
    own = row.product(do, image)
    counts = _counting(do, row.weight, do.minus(row.left, do.times(row.light, own)))
    each = do.times(counts, own)
    spared = _spared(do, row.weight, counts, row.left)
    return [do.times(each, row.left), do.times(each, own), spared]


def _sum(do: Vectors, row: _Row, image: Pairs, by_x: Pairs, by_y: Pairs) -> list[Any]:
    """Return the terms of `sum_window`, and of `sum_shaped`."""
    own, along_x, along_y = (row.product(do, pairs) for pairs in (image, by_x, by_y))
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


class _Places:
    """Places of elements of arrays, all cameras', for one camera."""

    def __init__(
        self, context: Any, builder: Any, kinds: Sequence[Any], values: Sequence[Any], camera: Any
    ) -> None:
        """Keep what makes pointers."""
        self._context, self._builder, self._kinds = context, builder, kinds
        self._camera = camera
        self.structs = [
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(kinds, values, strict=True)
        ]

    def __call__(self, array: int, *place: Any) -> Any:
        """Return a pointer to an element of one of the arrays."""
        each = self._kinds[array], self.structs[array], [self._camera, *place]
        return cgutils.get_item_pointer(self._context, self._builder, *each)


def _sums(
    terms: Callable[[Vectors, _Row], list[Any]],
    count: int,
    arrays: tuple[Any, Any, Any],
    pairs: set[tuple[int, int]],
) -> tuple[Any, Any]:
    """Return the signature and the code of sums of terms over a window.

    Of the profiles, those of some pairs are read across and down.
    """
    across, down = (sorted(set(kinds)) for kinds in zip(*pairs, strict=True))
    signature = types.UniTuple(types.float32, count)(
        *arrays, types.intp, types.intp, types.intp, types.intp, types.float32
    )

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        do = Vectors(builder, ir.FloatType(), LANES)
        camera, top, start, rows, light = values[len(arrays) :]
        at = _Places(context, builder, signature.args[: len(arrays)], values[: len(arrays)], camera)

        def number(value: int) -> Any:
            return context.get_constant(types.intp, value)

        def after(pointer: Any, step: Any, stride: Any) -> Any:
            return builder.gep(pointer, [builder.mul(step, stride)])

        width = builder.extract_value(at.structs[2].shape, 2)
        strides = [
            builder.sdiv(builder.extract_value(struct.strides, 1), number(do.bytes))
            for struct in at.structs[:2]
        ]
        totals = [cgutils.alloca_once_value(builder, do.zero) for _ in range(count)]
        everywhere = do.splat(light)
        with cgutils.for_range(builder, builder.sdiv(width, number(LANES))) as block:
            first = builder.mul(block.index, number(LANES))
            corners = [at(k, top, builder.add(start, first)) for k in range(2)]
            along = {kind: do.load(at(2, number(kind), first)) for kind in across}
            ends = {kind: at(2, number(kind), number(0)) for kind in down}
            with cgutils.for_range(builder, rows) as step:
                left, weight = (
                    do.load(after(corner, step.index, stride))
                    for corner, stride in zip(corners, strides, strict=True)
                )
                shares = {
                    kind: do.splat(builder.load(after(end, step.index, number(1))))
                    for kind, end in ends.items()
                }
                row = _Row(left, weight, everywhere, along | shares)
                for total, term in zip(totals, terms(do, row), strict=True):
                    builder.store(do.plus(builder.load(total), term), total)
        sums = [do.total(builder.load(total)) for total in totals]
        return context.make_tuple(builder, signature.return_type, sums)

    return signature, code


def _kernel(terms: Callable[..., list[Any]], count: int, *images: Pairs) -> Any:
    """Make a kernel that sums up so many terms of an image, or also its derivatives."""
    pairs = {pair for image in images for pair in image}

    def of_images(do: Vectors, row: _Row) -> list[Any]:
        return terms(do, row, *images)

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
        return _sums(of_images, count, (left, weight, profiles), pairs)

    return add_up


# Sums of weights times an image times what is left, and times the image itself. Saturated pixels
# that have enough with this light count in the third sum.
match_window = _kernel(_match, 3, PLAIN)
match_shaped = _kernel(_match, 3, SHAPED)
# What `image_model.sum_up` fills in of a camera, in its order.
sum_window = _kernel(_sum, 8, PLAIN, PLAIN_BY_X, PLAIN_BY_Y)
sum_shaped = _kernel(_sum, 8, SHAPED, SHAPED_BY_X, SHAPED_BY_Y)
