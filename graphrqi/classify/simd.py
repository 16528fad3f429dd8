"""SIMD operations on bit masks: one mask of reachable leaves for each of 64 samples, in registers.

These functions are a few machine instructions each, on four registers of 512 bits or eight of 256.
They can be called from compiled functions only.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

WIDTH = 64
"""Samples that are processed together."""
_UINT32 = ir.IntType(32)
_INDEX = ir.IntType(64)
_VECTOR = ir.VectorType(_UINT32, WIDTH)
_NUMBERS = ir.VectorType(ir.FloatType(), WIDTH)
_make_array: Any = make_array
_insert_function: Any = cgutils.get_or_insert_function


class Masks(types.Type):
    """Type of 64 masks of 32 bits in registers."""

    def __init__(self) -> None:
        """Name the type."""
        super().__init__(name="Masks")


TYPE = Masks()


@register_model(Masks)
class _MasksModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend_type: Any) -> None:
        super().__init__(manager, frontend_type, _VECTOR)  # type: ignore[no-untyped-call]


def _instruction(typing: Any) -> Any:
    return intrinsic(typing)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, to: Any) -> Any:
    data = _make_array(kind)(context, builder, array).data
    return builder.bitcast(data, to.as_pointer())


def _spread(builder: Any, value: Any, vector: Any) -> Any:
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INDEX(0))
    zeros = ir.Constant(ir.VectorType(_UINT32, WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


@_instruction
def all_bits(_context: Any) -> Any:
    """Return masks of which every bit is set."""

    def generate(_target: Any, _builder: Any, _signature: Any, _values: list[Any]) -> Any:
        return ir.Constant(_VECTOR, [0xFFFFFFFF] * WIDTH)

    return TYPE(), generate


@_instruction
def keep_where_above(_context: Any, x: Any, a: Any, row: Any, limit: Any, kept: Any) -> Any:
    """Intersect the masks x with ``kept`` where the numbers in row ``row`` of a exceed ``limit``.

    ``a`` is (n, 64) float32, ``row`` >= 0, ``limit`` float32, ``kept`` uint32.
    """
    if a != types.Array(types.float32, 2, "C") or not isinstance(row, types.Integer):
        return None
    if x != TYPE or limit != types.float32 or kept != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        kinds = signature.args
        rows = _pointer(context, builder, kinds[1], values[1], _NUMBERS)
        index = context.cast(builder, values[2], kinds[2], types.int64)
        numbers = builder.load(builder.gep(rows, [index]), align=4)
        above = builder.fcmp_ordered(">", numbers, _spread(builder, values[3], _NUMBERS))
        left = builder.and_(values[0], _spread(builder, values[4], _VECTOR))
        return builder.select(above, left, values[0])

    return TYPE(x, a, row, limit, kept), generate


@_instruction
def first_bits(_context: Any, x: Any, out: Any) -> Any:
    """Write the index of the lowest set bit of each mask, none of which is 0, to (64,) uint32."""
    if x != TYPE or out != types.Array(types.uint32, 1, "C"):
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR, ir.IntType(1)])
        count = _insert_function(builder.module, kind, f"llvm.cttz.v{WIDTH}i32")
        places = builder.call(count, [values[0], ir.Constant(ir.IntType(1), 1)])
        pointer = _pointer(context, builder, signature.args[1], values[1], _VECTOR)
        builder.store(places, pointer, align=4)
        return context.get_dummy_value()

    return types.void(x, out), generate
