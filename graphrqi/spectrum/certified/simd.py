"""Eight numbers at a time: the arithmetic all kernels of the tracker are written in.

An (n, 8) array holds eight systems, or eight vectors, side by side. A row of it is a value of
type `Eight`, one 512-bit register or two of 256 bits, and these functions are single
machine instructions on it. They can be called from compiled functions only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.extending import intrinsic, models, register_model
from numba.core.imputils import impl_ret_borrowed
from numba.np.arrayobj import make_array

LANES = 8
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INDEX = ir.IntType(64)
_DOUBLE = types.float64
_make_array: Any = make_array
_borrowed: Any = impl_ret_borrowed
_insert_function: Any = cgutils.get_or_insert_function


class Eight(types.Type):
    """Type of eight doubles in a register."""

    def __init__(self) -> None:
        """Name the type."""
        super().__init__(name="Eight")


EIGHT = Eight()


@register_model(Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend_type: Any) -> None:
        super().__init__(manager, frontend_type, _VECTOR)  # type: ignore[no-untyped-call]


def _row(context: Any, builder: Any, array_type: Any, array: Any, row: Any, row_type: Any) -> Any:
    index = context.cast(builder, row, row_type, types.int64)
    data = _make_array(array_type)(context, builder, array).data
    start = builder.gep(data, [builder.mul(index, _INDEX(LANES))])
    return builder.bitcast(start, _VECTOR.as_pointer())


def _is_rows(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.ndim == 2 and kind.layout == "C"


def _spread(builder: Any, number: Any) -> Any:
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, _INDEX(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), zeros)


def _call(builder: Any, name: str, arguments: list[Any]) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
    function = _insert_function(builder.module, kind, f"llvm.{name}.v8f64")
    return builder.call(function, arguments)


def _instruction(typing: Callable[..., Any]) -> Any:
    return intrinsic(typing)


def _unary(text: str, emit: Callable[[Any, list[Any]], Any]) -> Any:
    def typing(_context: Any, x: Any) -> Any:
        return _signature((x,), emit)

    typing.__name__, typing.__doc__ = text.split("(")[0], text
    return _instruction(typing)


def _binary(text: str, emit: Callable[[Any, list[Any]], Any]) -> Any:
    def typing(_context: Any, x: Any, y: Any) -> Any:
        return _signature((x, y), emit)

    typing.__name__, typing.__doc__ = text.split("(")[0], text
    return _instruction(typing)


def _ternary(text: str, emit: Callable[[Any, list[Any]], Any]) -> Any:
    def typing(_context: Any, x: Any, y: Any, z: Any) -> Any:
        return _signature((x, y, z), emit)

    typing.__name__, typing.__doc__ = text.split("(")[0], text
    return _instruction(typing)


def _signature(arguments: tuple[Any, ...], emit: Callable[[Any, list[Any]], Any]) -> Any:
    if any(a != EIGHT for a in arguments):
        return None

    def generate(_target: Any, builder: Any, _signature: Any, values: list[Any]) -> Any:
        return emit(builder, values)

    return EIGHT(*arguments), generate


@_instruction
def load(_context: Any, a: Any, p: Any) -> Any:
    """Read row p >= 0 of an (n, 8) array a."""
    if not _is_rows(a) or not isinstance(p, types.Integer):
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        kinds = signature.args
        pointer = _row(context, builder, kinds[0], values[0], values[1], kinds[1])
        return builder.load(pointer, align=8)

    return EIGHT(a, p), generate


@_instruction
def store(_context: Any, a: Any, p: Any, x: Any) -> Any:
    """Write x to row p >= 0 of an (n, 8) array a."""
    if not _is_rows(a) or not isinstance(p, types.Integer) or x != EIGHT:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        kinds = signature.args
        pointer = _row(context, builder, kinds[0], values[0], values[1], kinds[1])
        builder.store(values[2], pointer, align=8)
        return context.get_dummy_value()

    return types.void(a, p, x), generate


@_instruction
def aligned(_context: Any, a: Any) -> Any:
    """Let an (n, 8) array begin at the next cache line; its last row is then not its own."""
    if not _is_rows(a):
        return None

    def generate(context: Any, builder: Any, signature: Any, values: list[Any]) -> Any:
        array = _make_array(signature.args[0])(context, builder, values[0])
        address = builder.add(builder.ptrtoint(array.data, _INDEX), _INDEX(63))
        address = builder.and_(address, _INDEX(-64))
        array.data = builder.inttoptr(address, array.data.type)
        return _borrowed(context, builder, signature.return_type, array._getvalue())

    return a(a), generate


@_instruction
def spread(_context: Any, v: Any) -> Any:
    """Repeat one number v eight times."""
    if v != _DOUBLE:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, values: list[Any]) -> Any:
        return _spread(builder, values[0])

    return EIGHT(v), generate


@_instruction
def plus(_context: Any, x: Any, v: Any, y: Any) -> Any:
    """Return x + v y for one number v."""
    if x != EIGHT or v != _DOUBLE or y != EIGHT:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, values: list[Any]) -> Any:
        return _call(builder, "fma", [_spread(builder, values[1]), values[2], values[0]])

    return EIGHT(x, v, y), generate


@_instruction
def any_below(_context: Any, x: Any, v: Any) -> Any:
    """Return whether one of the eight numbers x is below v in size."""
    if x != EIGHT or v != _DOUBLE:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, values: list[Any]) -> Any:
        size = _call(builder, "fabs", [values[0]])
        below = builder.fcmp_ordered("<", size, _spread(builder, values[1]))
        bits = builder.bitcast(below, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.IntType(LANES)(0))

    return types.boolean(x, v), generate


def _emit_sign(builder: Any, values: list[Any]) -> Any:
    zero = ir.Constant(_VECTOR, [0.0] * LANES)
    one = ir.Constant(_VECTOR, [1.0] * LANES)
    return builder.select(builder.fcmp_ordered(">", values[0], zero), one, zero)


def _emit_larger(builder: Any, values: list[Any]) -> Any:
    size = _call(builder, "fabs", [values[1]])
    return builder.select(builder.fcmp_ordered(">", size, values[0]), size, values[0])


def _emit_inverse(builder: Any, values: list[Any]) -> Any:
    return builder.fdiv(ir.Constant(_VECTOR, [1.0] * LANES), values[0])


def _emit_less(builder: Any, values: list[Any]) -> Any:
    return _call(builder, "fma", [builder.fneg(values[1]), values[2], values[0]])


def _emit_more(builder: Any, values: list[Any]) -> Any:
    return _call(builder, "fma", [values[1], values[2], values[0]])


times = _binary("times(x, y): x y.", lambda builder, v: builder.fmul(v[0], v[1]))
minus = _binary("minus(x, y): x - y.", lambda builder, v: builder.fsub(v[0], v[1]))
less = _ternary("less(x, y, z): x - y z.", _emit_less)
more = _ternary("more(x, y, z): x + y z.", _emit_more)
inverse = _unary("inverse(x): 1 / x.", _emit_inverse)
positive = _unary("positive(x): 1 where x > 0, else 0.", _emit_sign)
larger = _binary("larger(x, y): max(x, |y|).", _emit_larger)
