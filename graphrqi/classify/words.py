"""Sixty-four words at a time: the leaves still in reach of as many samples, kept in registers.

These functions are a few machine instructions each, on four registers of 512 bits or eight of 256.
They can be called from compiled functions only.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

WORDS = 64
_WORD = ir.IntType(32)
_INDEX = ir.IntType(64)
_VECTOR = ir.VectorType(_WORD, WORDS)
_NUMBERS = ir.VectorType(ir.FloatType(), WORDS)
_make_array: Any = make_array


class Words(types.Type):
    """Type of 64 words of 32 bits in registers."""

    def __init__(self) -> None:
        """Name the type."""
        super().__init__(name="Words")


TYPE = Words()


@register_model(Words)
class _WordsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend_type: Any) -> None:
        super().__init__(manager, frontend_type, _VECTOR)  # type: ignore[no-untyped-call]


def _instruction(typing: Any) -> Any:
    return intrinsic(typing)


def _is_rows(kind: Any, number: Any, dimensions: int) -> bool:
    return (
        isinstance(kind, types.Array)
        and (kind.dtype, kind.ndim, kind.layout) == (number, dimensions, "C")
    )  # fmt: skip


def _spread(builder: Any, value: Any, vector: Any) -> Any:
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INDEX(0))
    zeros = ir.Constant(ir.VectorType(_WORD, WORDS), [0] * WORDS)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


@_instruction
def all_bits(_context: Any) -> Any:
    """Return words of which every bit is set."""

    def generate(_target: Any, _builder: Any, _signature: Any, _values: list[Any]) -> Any:
        return ir.Constant(_VECTOR, [0xFFFFFFFF] * WORDS)

    return TYPE(), generate


@_instruction
def keep_where_above(_context: Any, x: Any, a: Any, start: Any, limit: Any, kept: Any) -> Any:
    """Clear the bits of x that are not in ``kept`` where the numbers a[start:] are above a limit.

    ``a`` is (n,) float32, ``limit`` float32, ``kept`` uint32, start >= 0.
    """
    if not _is_rows(a, types.float32, 1) or not isinstance(start, types.Integer):
        return None
    if x != TYPE or limit != types.float32 or kept != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        kinds = signature.args
        data = _make_array(kinds[1])(context, builder, values[1]).data
        index = context.cast(builder, values[2], kinds[2], types.int64)
        pointer = builder.bitcast(builder.gep(data, [index]), _NUMBERS.as_pointer())
        numbers = builder.load(pointer, align=4)
        above = builder.fcmp_ordered(">", numbers, _spread(builder, values[3], _NUMBERS))
        left = builder.and_(values[0], _spread(builder, values[4], _VECTOR))
        return builder.select(above, left, values[0])

    return TYPE(x, a, start, limit, kept), generate


@_instruction
def first_bits(_context: Any, x: Any, spell: Any, out: Any) -> Any:
    """Write the upper five bits of ``spell`` times the lowest bit of each word.

    ``spell`` is uint32, ``out`` (64,) uint32.
    """
    if x != TYPE or spell != types.uint32 or not _is_rows(out, types.uint32, 1):
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        lowest = builder.and_(values[0], builder.neg(values[0]))
        product = builder.mul(lowest, _spread(builder, values[1], _VECTOR))
        bits = builder.lshr(product, ir.Constant(_VECTOR, [27] * WORDS))
        data = _make_array(signature.args[2])(context, builder, values[2]).data
        builder.store(bits, builder.bitcast(data, _VECTOR.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(x, spell, out), generate
