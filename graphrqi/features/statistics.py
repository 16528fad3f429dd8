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

    def spread(self, values: FloatArray, counts: BoolArray, out: FloatArray) -> None:
        """Write each value's weights on the nodes.

        Args:
            values: (n,) of the quantity; NaN where unknown.
            counts: (n,) whether the condition holds.
            out: (n, len(nodes)) receives the weights, zero elsewhere before the call.
        """
        rows = np.flatnonzero(counts & ~np.isnan(values))
        if rows.size == 0:
            return
        nodes = np.asarray(self.nodes)
        inside = np.clip(values[rows], nodes[0], nodes[-1])
        upper = np.clip(np.searchsorted(nodes, inside), 1, nodes.size - 1)
        share = (inside - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
        out[rows, upper - 1] = 1.0 - share
        out[rows, upper] = share


def describe(sums: FloatArray, blocks: tuple[Block, ...]) -> FloatArray:
    """Turn sums of moments into features.

    Args:
        sums: (n, S) durations on the nodes of all blocks, side by side, s.
        blocks: whose nodes the columns are.

    Returns:
        (n, S + 2 B) for each block the square roots of its distribution (all zero where it never
        counted; the root evens out rare and common values), its mean, and log(1 + its total in
        tenths of a second).

    Example:
        >>> b = Block("gap", (0.0, 1.0))
        >>> describe(np.array([[3.0, 1.0]]), (b,)).round(2)
        array([[0.87, 0.5 , 0.25, 3.71]])
    """
    columns: list[FloatArray] = []
    at = 0
    for block in blocks:
        width = len(block.nodes)
        part = np.maximum(sums[:, at : at + width], 0.0)
        at += width
        total = part.sum(axis=1, keepdims=True)
        share = part / np.where(total > 1e-9, total, 1.0)
        columns += [np.sqrt(share), share @ np.asarray(block.nodes)[:, None], np.log1p(10 * total)]
    return np.concatenate(columns, axis=1)


def describe_names(blocks: tuple[Block, ...]) -> tuple[str, ...]:
    """The columns of `describe`, named."""
    names: list[str] = []
    for block in blocks:
        names += [f"{block.name}~{node:g}" for node in block.nodes]
        names += [f"{block.name}:mean", f"{block.name}:evidence"]
    return tuple(names)
