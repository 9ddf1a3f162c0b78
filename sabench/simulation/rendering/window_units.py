"""Windows of an image, eight pixels at a time."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from sabench.utils.vector_units import LANES, Vectors


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
