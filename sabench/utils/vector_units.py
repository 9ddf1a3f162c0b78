"""LLVM code written by hand: kernels' operations on vectors of a fixed length.

Compilers unroll loops of a few steps, and then have no loop left to put on vector units. What is
written as operations on vectors takes a seventh to a half of the time, in the same order on every
machine, whatever the width of its vector units. docs/developing/vector-units.md says how to read
and debug it. There are four parts: the operations, products of matrices, profiles of Gaussians, and
windows of images.
"""

import functools
import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.polynomial import chebyshev

from sabench.utils.compiled import numba

LANES = 8  # pixels of a row, in kernels that take several simultaneously


class Vectors:
    """Code for operations on vectors of one length and kind of numbers."""

    def __init__(self, builder: Any, kind: Any, length: int) -> None:
        """Write code with a builder, for vectors of so many floats or doubles."""
        self.builder, self.length = builder, length
        self.bytes = 4 if isinstance(kind, ir.FloatType) else 8
        self.type = ir.VectorType(kind, length)
        self.plus, self.minus, self.times = builder.fadd, builder.fsub, builder.fmul
        self.zero = self.constant(0.0)

    def constant(self, value: float) -> Any:
        """Return a vector of one number."""
        return ir.Constant(self.type, [value] * self.length)

    def splat(self, value: Any) -> Any:
        """Return a vector of one value."""
        first = self.builder.insert_element(self.zero, value, ir.Constant(cgutils.int32_t, 0))
        return self.builder.shuffle_vector(first, first, self._mask([0] * self.length))

    def load(self, pointer: Any) -> Any:
        """Load numbers that lie one after the other."""
        value = self.builder.load(self._place(pointer))
        value.align = self.bytes
        return value

    def store(self, value: Any, pointer: Any) -> None:
        """Store numbers one after the other."""
        self.builder.store(value, self._place(pointer)).align = self.bytes

    def store_as(self, value: Any, pointer: Any, kind: Any) -> None:
        """Store doubles one after the other as numbers of another kind."""
        if isinstance(kind, ir.FloatType):
            value = self.builder.fptrunc(value, ir.VectorType(kind, self.length))
        place = self.builder.bitcast(pointer, value.type.as_pointer())
        self.builder.store(value, place).align = 4

    def positive(self, values: Any) -> Any:
        """Return values, or 0 where they are less."""
        return self.where(self.above_zero(values), values)

    def where(self, marked: Any, values: Any) -> Any:
        """Return values, or 0 where they are not marked."""
        return self.builder.select(marked, values, self.zero)

    def magnitude(self, values: Any) -> Any:
        """Return absolute values."""
        return self.builder.select(self.above_zero(values), values, self.minus(self.zero, values))

    def fused(self, left: Any, right: Any, third: Any) -> Any:
        """Return left times right, plus the third, rounded once."""
        kind = ir.FunctionType(self.type, [self.type] * 3)
        name = f"llvm.fma.v{self.length}f{8 * self.bytes}"
        fma = cgutils.get_or_insert_function(self.builder.module, kind, name)
        return self.builder.call(fma, [left, right, third])

    def polynomial(self, coefficients: Sequence[float], values: Any) -> Any:
        """Return polynomials of values, with coefficients from the constant one on."""
        total = self.constant(coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            total = self.fused(total, values, self.constant(coefficient))
        return total

    def clip(self, values: Any, least: float, most: float) -> Any:
        """Return values, not below one number and not above another."""
        low, high = self.constant(least), self.constant(most)
        values = self.builder.select(self.builder.fcmp_ordered(">", values, low), values, low)
        return self.builder.select(self.builder.fcmp_ordered("<", values, high), values, high)

    def numbers(self) -> Any:
        """Return 0, 1, 2, ..."""
        return ir.Constant(self.type, [float(n) for n in range(self.length)])

    def lane(self, values: Any, number: int) -> Any:
        """Return one value of a vector."""
        return self.builder.extract_element(values, ir.Constant(cgutils.int32_t, number))

    def moved(self, values: Any, end: Any) -> Any:
        """Return values of the next lanes; the last lane gets another value."""
        mask = self._mask([*range(1, self.length), self.length])
        return self.builder.shuffle_vector(values, self.splat(end), mask)

    def above_zero(self, values: Any) -> Any:
        """Mark values above 0."""
        return self.builder.fcmp_ordered(">", values, self.zero)

    def total(self, vector: Any) -> Any:
        """Sum up a vector, one half to the other at each step."""
        width = self.length
        while width > 1:
            width //= 2
            low, high = (
                self.builder.shuffle_vector(vector, vector, self._mask(range(first, first + width)))
                for first in (0, width)
            )
            vector = self.plus(low, high)
        return self.lane(vector, 0)

    def _place(self, pointer: Any) -> Any:
        return self.builder.bitcast(pointer, self.type.as_pointer())

    @staticmethod
    def _mask(places: Sequence[int]) -> Any:
        return ir.Constant(ir.VectorType(cgutils.int32_t, len(places)), list(places))


@intrinsic
def add_product(
    context: Any, out: Any, n: Any, left: Any, i: Any, right: Any, j: Any
) -> tuple[Any, Any]:
    """Add a product of matrices (4, 4): left[i] @ right[j] to out[n].

    The arrays (., 4, 4) are C-contiguous, of doubles.
    """
    signature = types.void(out, types.intp, left, types.intp, right, types.intp)

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        do, zero = Vectors(builder, ir.DoubleType(), 4), context.get_constant(types.intp, 0)

        def row(k: int, index: int) -> Any:
            kind, array = signature.args[k], values[k]
            struct = context.make_array(kind)(context, builder, array)
            place = [values[k + 1], context.get_constant(types.intp, index), zero]
            return cgutils.get_item_pointer(context, builder, kind, struct, place)

        factors = [do.load(row(4, b)) for b in range(4)]
        for a in range(4):
            place, first = row(0, a), row(2, a)
            total = do.load(place)
            for b, factor in enumerate(factors):
                step = builder.gep(first, [context.get_constant(types.intp, b)])
                total = do.plus(total, do.times(do.splat(builder.load(step)), factor))
            do.store(total, place)
        return context.get_dummy_value()

    return signature, code


# Profiles of Gaussians averaged over pixels. Half the error function is t P(t^2), and exp(-t^2) is
# Q(t^2), with polynomials that interpolate at Chebyshev's nodes. They need neither tables nor
# powers, which vector units are slow at, and each step is rounded once: numbers are the same on
# every machine.
_END = 4.2  # of the error function's argument: half of it is within 2e-9 of 1/2 there
_TERMS, _DENSITY_TERMS = 18, 20  # of P and Q, which are exact to 3e-9


def _polynomial(value: Callable[[float], float], terms: int) -> list[float]:
    """Fit a polynomial of 2 (t / _END)^2 - 1 to a function of t."""

    def at(places: Any) -> Any:
        return [value(_END * math.sqrt((place + 1.0) / 2.0)) for place in places]

    return [float(c) for c in chebyshev.cheb2poly(chebyshev.chebinterpolate(at, terms - 1))]


_HALF_ERF = _polynomial(lambda t: 0.5 * math.erf(t) / t, _TERMS)
_DENSITY = _polynomial(lambda t: math.exp(-t * t), _DENSITY_TERMS)


@numba.njit(cache=True)
def whole_lanes(pixels: int) -> int:
    """Return the length of a profile of so many pixels, or of a few more."""
    return LANES * -(-pixels // LANES)


@intrinsic
def fill_edges(context: Any, shares: Any, start: Any, step: Any, pixels: Any) -> tuple[Any, Any]:
    """Fill in differences of half the error function between edges.

    `shares` (lane,) are at least as many as `whole_lanes` says, of floats or doubles. Of those, the
    ones after so many pixels become 0; edge n is at start + n step.
    """
    return _differences([shares])


@intrinsic
def fill_edges_and_slopes(
    context: Any, shares: Any, slopes: Any, start: Any, step: Any, pixels: Any
) -> tuple[Any, Any]:
    """Fill in `fill_edges` and their derivatives by minus the start, times the step."""
    return _differences([shares, slopes])


def _differences(arrays: Sequence[Any]) -> tuple[Any, Any]:
    """Return the signature and the code of a profile's differences."""
    signature = types.void(*arrays, types.float64, types.float64, types.intp)

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        do, scalar = (Vectors(builder, ir.DoubleType(), length) for length in (LANES, 1))
        start, step, pixels = values[len(arrays) :]
        kinds = signature.args[: len(arrays)]
        structs = [
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(kinds, values, strict=False)
        ]
        lanes = context.get_constant(types.intp, LANES)
        more = builder.add(pixels, context.get_constant(types.intp, LANES - 1))
        size = builder.mul(builder.sdiv(more, lanes), lanes)

        def edges(do: Vectors, first: Any) -> tuple[Any, Any]:
            away = do.plus(do.splat(builder.sitofp(first, ir.DoubleType())), do.numbers())
            return away, do.fused(away, do.splat(step), do.splat(start))

        last = _at_edges(scalar, edges(scalar, size)[1], step)
        ends = [cgutils.alloca_once_value(builder, scalar.lane(value, 0)) for value in last]
        width = do.splat(builder.sitofp(pixels, ir.DoubleType()))
        with cgutils.for_range(builder, builder.sdiv(size, lanes)) as loop:  # the last block first
            behind = builder.mul(
                builder.add(loop.index, context.get_constant(types.intp, 1)), lanes
            )
            first = builder.sub(size, behind)
            away, places = edges(do, first)
            at_edge, inside = _at_edges(do, places, step), do.above_zero(do.minus(width, away))
            for kind, struct, end, here in zip(kinds, structs, ends, at_edge, strict=False):
                change = do.where(inside, do.minus(do.moved(here, builder.load(end)), here))
                builder.store(do.lane(here, 0), end)
                place = cgutils.get_item_pointer(context, builder, kind, struct, [first])
                do.store_as(change, place, context.get_value_type(kind.dtype))
        return context.get_dummy_value()

    return signature, code


def _at_edges(do: Vectors, edges: Any, step: Any) -> list[Any]:
    """Return half the error function at edges, and minus their density times a step."""
    t = do.clip(edges, -_END, _END)
    place = do.fused(do.times(t, t), do.constant(2.0 / _END**2), do.constant(-1.0))
    density = do.times(do.splat(step), do.constant(-1.0 / math.sqrt(math.pi)))
    return [
        do.times(t, do.polynomial(_HALF_ERF, place)),
        do.times(density, do.polynomial(_DENSITY, place)),
    ]


@intrinsic
def add_products(
    context: Any,
    image: Any,
    top: Any,
    left: Any,
    down: Any,
    across: Any,
    terms: Any,
    rows: Any,
    lanes: Any,
) -> tuple[Any, Any]:
    """Add a sum of outer products to an image, from a row and a column on.

    Factors (term, pixel) are doubles; those across are a multiple of `LANES`, which the image has
    room for.
    """
    signature = types.void(image, types.intp, types.intp, down, across, *[types.intp] * 3)

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        do = Vectors(builder, ir.DoubleType(), LANES)
        top, left, terms, rows, lanes = (values[k] for k in (1, 2, 5, 6, 7))
        arrays = {k: (signature.args[k], values[k]) for k in (0, 3, 4)}

        def at(k: int, *place: Any) -> Any:
            kind, array = arrays[k]
            struct = context.make_array(kind)(context, builder, array)
            return cgutils.get_item_pointer(context, builder, kind, struct, place)

        width = context.get_constant(types.intp, LANES)
        with (
            cgutils.for_range(builder, builder.udiv(lanes, width)) as block,
            cgutils.for_range(builder, rows) as row,
        ):
            first = builder.mul(block.index, width)
            place = at(0, builder.add(top, row.index), builder.add(left, first))
            total = cgutils.alloca_once_value(builder, do.load(place))
            with cgutils.for_range(builder, terms) as term:
                share = do.splat(builder.load(at(3, term.index, row.index)))
                light = do.load(at(4, term.index, first))
                builder.store(do.fused(share, light, builder.load(total)), total)
            do.store(builder.load(total), place)
        return context.get_dummy_value()

    return signature, code


# Sums over windows of images, eight pixels at a time. The arrays are those of `ImageModel` and
# `Room` (image_model.py), all cameras'. A window is that of camera c, from a row and a column on,
# with so many rows.


class Profile(IntEnum):
    """Profiles of an image along columns and rows, for light 1, and derivatives.

    Derivatives are those by the centre. Plain images have OWN and SLOPE alone; the others are as
    `image_model` fills them in. The products of FLAT_X and the next three with OWN_Y and the next
    three are the image.
    """

    FLAT_X, OWN_X, SLOPE_X, CURVE_X, THIRD_X, FLAT_SLOPE_X, CURVE_SLOPE_Y = range(7)
    SLOPE_Y, OWN_Y, WHOLE_Y, TILT_Y, CURVE_Y, WHOLE_SLOPE_Y, TILT_SLOPE_Y = range(7, 14)


Pairs = Sequence[tuple[int, int]]

# of profiles that multiply to an image, and its derivatives by the centre's column and row
PLAIN, PLAIN_BY_X, PLAIN_BY_Y = (
    ((Profile.OWN_X, Profile.OWN_Y),),
    ((Profile.SLOPE_X, Profile.OWN_Y),),
    ((Profile.OWN_X, Profile.SLOPE_Y),),
)
SHAPED = (
    (Profile.FLAT_X, Profile.OWN_Y),
    (Profile.OWN_X, Profile.WHOLE_Y),
    (Profile.SLOPE_X, Profile.TILT_Y),
    (Profile.CURVE_X, Profile.CURVE_Y),
)
SHAPED_BY_X = (
    (Profile.SLOPE_X, Profile.WHOLE_Y),
    (Profile.CURVE_X, Profile.TILT_Y),
    (Profile.THIRD_X, Profile.CURVE_Y),
    (Profile.FLAT_SLOPE_X, Profile.OWN_Y),
)
SHAPED_BY_Y = (
    (Profile.OWN_X, Profile.WHOLE_SLOPE_Y),
    (Profile.SLOPE_X, Profile.TILT_SLOPE_Y),
    (Profile.CURVE_X, Profile.CURVE_SLOPE_Y),
    (Profile.FLAT_X, Profile.SLOPE_Y),
)


class _Row(NamedTuple):
    """Vectors of a window's row, with profiles across and down it."""

    left: Any
    weight: Any
    light: Any
    profiles: dict[int, Any]

    def product(self, do: Vectors, pairs: Pairs) -> Any:
        """Return the sum of products of profiles across and down."""
        terms = [do.times(self.profiles[across], self.profiles[down]) for across, down in pairs]
        return functools.reduce(do.plus, terms)


def _match(do: Vectors, row: _Row, image: Pairs) -> list[Any]:
    """Return the terms of `match_window`, and of `match_shaped`."""
    pixel = row.product(do, image)
    counts = _counting(do, row.weight, do.minus(row.left, do.times(row.light, pixel)))
    each = do.times(counts, pixel)
    spared = _spared(do, row.weight, counts, row.left)
    return [do.times(each, row.left), do.times(each, pixel), spared]


def _sum(do: Vectors, row: _Row, image: Pairs, by_x: Pairs, by_y: Pairs) -> list[Any]:
    """Return the terms of `sum_window`, and of `sum_shaped`."""
    pixel, along_x, along_y = (row.product(do, pairs) for pairs in (image, by_x, by_y))
    left, counts = row.left, _counting(do, row.weight, row.left)
    share, slope_x, slope_y = (do.times(counts, factor) for factor in (pixel, along_x, along_y))
    products = (
        (share, pixel),
        (share, left),
        (slope_x, along_x),
        (slope_x, along_y),
        (slope_y, along_y),
        (slope_x, left),
        (slope_y, left),
    )
    shown = do.plus(left, do.times(row.light, pixel))
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
