"""Kernels' operations on vectors of a fixed length.

Compilers unroll loops of a few steps, and then have no loop left to put on vector units. What is
written as operations on vectors takes a quarter to a half of the time, in the same order on every
machine, whatever the width of its vector units.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8  # pixels of a row, in kernels that take several at once
_INT = ir.IntType(32)


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
        one = self.builder.insert_element(self.zero, value, ir.Constant(_INT, 0))
        return self.builder.shuffle_vector(one, one, self._mask([0] * self.length))

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
        return self.builder.extract_element(values, ir.Constant(_INT, number))

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
        return ir.Constant(ir.VectorType(_INT, len(places)), list(places))


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
