"""The compiled evaluation of decision trees, sample by sample or for 64 samples in SIMD registers.

The SIMD operations work on masks: one mask of reachable leaves for each of 64 samples. They are a
few machine instructions each, on four registers of 512 bits or eight of 256, and can be called from
compiled functions only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

from sim.compiled import in_place

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


@in_place()
def sum_of_leaves(
    features: NDArray[np.float32],
    root: NDArray[np.uint32],
    depth: NDArray[np.uint32],
    column: NDArray[np.uint32],
    feature: NDArray[np.uint16],
    threshold: NDArray[np.float32],
    child: NDArray[np.uint32],
    value: NDArray[np.float32],
    node: NDArray[np.uint32],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into; see `graphrqi.classify.ensembles.trees.Trees`.

    Every sample takes as many steps in a tree as the tree is deep (a leaf leads to itself), and a
    batch of samples takes each step together: there are no branches to predict, and the steps of
    different samples overlap. Unsigned indices need no check for negative ones. This is six times
    as fast as one sample after another.

    Args:
        features: (n, F).
        root: (B,).
        depth: (B,).
        column: (B,).
        feature: (N,).
        threshold: (N,).
        child: (N,).
        value: (N, W).
        node: (WIDTH,) room to work in.
        out: (n, C) receives the sums; must be zero before.
    """
    for begin in range(0, features.shape[0], WIDTH):
        count = min(WIDTH, features.shape[0] - begin)
        for b in range(root.size):
            for j in range(count):
                node[j] = root[b]
            for _ in range(depth[b]):
                for j in range(count):
                    k = node[j]
                    above = features[np.uint32(begin + j), feature[k]] > threshold[k]
                    node[j] = child[k] + np.uint32(above)
            for j in range(count):
                for w in range(value.shape[1]):
                    out[np.uint32(begin + j), column[b] + np.uint32(w)] += value[node[j], w]


@in_place()
def sum_of_first_leaves(
    features: NDArray[np.float32],
    first: NDArray[np.uint64],
    feature: NDArray[np.uint64],
    threshold: NDArray[np.float32],
    keep: NDArray[np.uint32],
    leaf: NDArray[np.float64],
    column: NDArray[np.uint64],
    place: NDArray[np.uint32],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into.

    See `graphrqi.classify.ensembles.trees.QuickScorer`.

    Args:
        features: (K * F, 64) of K batches of 64 samples, feature by feature.
        first: (B + 1,).
        feature: (I,).
        threshold: (I,).
        keep: (I,).
        leaf: (B, 32).
        column: (B,).
        place: (WIDTH,) room to work in.
        out: (K, C, 64) receives the sums; must be zero before.
    """
    batch = np.uint64(len(features) // max(len(out), 1))
    for k in range(np.uint64(len(out))):
        for b in range(np.uint64(first.size - 1)):
            reachable = all_bits()
            for i in range(first[b], first[b + np.uint64(1)]):
                row = k * batch + feature[i]
                reachable = keep_where_above(reachable, features, row, threshold[i], keep[i])
            first_bits(reachable, place)
            values, total = leaf[b], out[k, column[b]]
            for j in range(WIDTH):
                total[j] += values[place[j]]
