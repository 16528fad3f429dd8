"""Distributions of what a driver does, built up frame by frame.

A `Block` watches one quantity under one condition (the time headway while following, say) and
spreads each moment's duration over the two nodes of its scale that the value lies between. Sums of
such moments are additive: the sum over any stretch of time is the difference of two running sums,
a stretch may be as long as a driver's life at no further cost, and missing frames are simply not
counted. What is told of such a distribution are its quantiles and its mean, and how long it was
watched for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEVELS: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles told of each distribution (our choice: middle, quarters, nearly the ends)."""

LEAST_S: Final = 1e-6
"""Time below which a block counts as never seen, s: what rounding leaves of a difference of sums
(our choice)."""

UNKNOWN: Final = 1.0
"""How far below its scale an unseen block's numbers lie (our choice: trees can split it off)."""


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
    from graphrqi.features.statistics_kernel import spread_on_nodes

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
        blocks: whose nodes the columns are; columns beyond theirs are not looked at.

    Returns:
        (n, 7 B) block by block the quantiles ``LEVELS`` and the mean of its distribution, and
        log(1 + its total in tenths of a second). The weight of a node lies evenly half-way to its
        neighbours. Of a block that never counted, quantiles and mean are ``UNKNOWN`` below its
        lowest node.

    Examples:
        >>> b = Block("gap", (0.0, 1.0))
        >>> describe(np.array([[3.0, 1.0], [0.0, 0.0]]), (b,)).round(2)
        array([[ 0.03,  0.17,  0.33,  0.5 ,  0.9 ,  0.25,  3.71],
               [-1.  , -1.  , -1.  , -1.  , -1.  , -1.  ,  0.  ]])
    """
    from graphrqi.features.statistics_kernel import summarise

    nodes, starts = _scale(blocks)
    out = np.empty((len(sums), len(blocks) * (len(LEVELS) + 2)))
    summarise(np.ascontiguousarray(sums), nodes, starts, np.array(LEVELS), LEAST_S, UNKNOWN, out)
    return out


def describe_names(blocks: tuple[Block, ...]) -> tuple[str, ...]:
    """The columns of `describe`, named."""
    parts = (*(f"{100 * level:g}%" for level in LEVELS), "mean", "evidence")
    return tuple(f"{block.name}:{part}" for block in blocks for part in parts)
