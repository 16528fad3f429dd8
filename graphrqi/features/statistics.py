"""Distributions of what a driver does, built up frame by frame.

A `Block` watches one quantity under one condition (the time headway while following, say) and
spreads each moment's duration over the two nodes of its scale that the value lies between. Sums of
such moments are additive: the sum over any stretch of time is the difference of two running sums,
a stretch may be as long as a driver's life at no further cost, and missing frames are simply not
counted. Dividing by the block's total time gives a distribution; the total says how much it is
worth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Block:
    """One quantity under one condition.

    Attributes:
        name: what is watched.
        nodes: the scale, ascending; values beyond an end count at that end.
    """

    name: str
    nodes: tuple[float, ...]


def spread(
    values: FloatArray, counts: BoolArray, blocks: tuple[Block, ...], out: FloatArray
) -> None:
    """Write each value's weights on the nodes of its block.

    Args:
        values: (B, n) one row per block; NaN where unknown.
        counts: (B, n) whether the block's condition holds.
        blocks: B of them.
        out: (n, S) receives the weights, the blocks' nodes side by side; must be zero before.

    Examples:
        >>> out = np.zeros((1, 2))
        >>> spread(np.array([[0.25]]), np.array([[True]]), (Block("gap", (0.0, 1.0)),), out)
        >>> out
        array([[0.75, 0.25]])
    """
    from graphrqi.features.spread_kernel import spread_on_nodes

    nodes, starts = _scale(blocks)
    spread_on_nodes(values, counts & ~np.isnan(values), nodes, starts, out)


@cache
def _scale(blocks: tuple[Block, ...]) -> tuple[FloatArray, NDArray[np.int64]]:
    """All nodes side by side, and where each block's begin (and the last's end)."""
    nodes = np.concatenate([np.asarray(b.nodes) for b in blocks])
    return nodes, np.cumsum([0, *(len(b.nodes) for b in blocks)])


def describe(sums: FloatArray, blocks: tuple[Block, ...]) -> FloatArray:
    """Turn sums of moments into features.

    Args:
        sums: (n, S) durations on the nodes of all blocks, side by side, s.
        blocks: whose nodes the columns are.

    Returns:
        (n, S + 2 B) the square roots of all blocks' distributions (all zero where one never
        counted; the root evens out rare and common values), then their means, then log(1 + their
        totals in tenths of a second).

    Examples:
        >>> b = Block("gap", (0.0, 1.0))
        >>> describe(np.array([[3.0, 1.0]]), (b,)).round(2)
        array([[0.87, 0.5 , 0.25, 3.71]])
    """
    nodes, starts = _scale(blocks)
    part = np.maximum(sums, 0.0)
    total = np.add.reduceat(part, starts[:-1], axis=1)
    share = part / np.repeat(np.where(total > 1e-9, total, 1.0), np.diff(starts), axis=1)
    mean = np.add.reduceat(share * nodes, starts[:-1], axis=1)
    return np.concatenate([np.sqrt(share), mean, np.log1p(10.0 * total)], axis=1)


def describe_names(blocks: tuple[Block, ...]) -> tuple[str, ...]:
    """The columns of `describe`, named."""
    return (
        *(f"{block.name}~{node:g}" for block in blocks for node in block.nodes),
        *(f"{block.name}:mean" for block in blocks),
        *(f"{block.name}:evidence" for block in blocks),
    )
