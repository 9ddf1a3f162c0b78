"""Profiles of Gaussians averaged over pixels, eight pixels at a time.

Half the error function is t P(t^2), and exp(-t^2) is Q(t^2), with polynomials that interpolate at
Chebyshev's nodes. They need neither tables nor powers, which vector units are slow at, and each
step is rounded once: numbers are the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.polynomial import chebyshev

from sabench.utils.compiled import numba
from sabench.utils.vector_units import LANES, Vectors

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
        do, one = (Vectors(builder, ir.DoubleType(), length) for length in (LANES, 1))
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

        last = _at_edges(one, edges(one, size)[1], step)
        ends = [cgutils.alloca_once_value(builder, one.lane(value, 0)) for value in last]
        width = do.splat(builder.sitofp(pixels, ir.DoubleType()))
        with cgutils.for_range(builder, builder.sdiv(size, lanes)) as loop:  # the last block first
            behind = builder.mul(
                builder.add(loop.index, context.get_constant(types.intp, 1)), lanes
            )
            first = builder.sub(size, behind)
            away, places = edges(do, first)
            found, inside = _at_edges(do, places, step), do.above_zero(do.minus(width, away))
            for kind, struct, end, here in zip(kinds, structs, ends, found, strict=False):
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
