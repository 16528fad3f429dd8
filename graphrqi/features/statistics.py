"""Distributions of what a driver does, built up frame by frame.

A `Block` is the histogram of one quantity under one condition (the time headway while following,
say). Each moment's duration is shared between the two nodes of the block's scale that the value
lies between. Histograms are additive. The histogram of any period is the difference of two running
sums, at a cost that does not grow with its length. Missing frames do not count. Features of a block
are quantiles, the mean, and the time it was observed for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray

LEVELS: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of each distribution that become features."""

LEAST_S: Final = 1e-6
"""Time below which a block counts as unobserved, s; differences of sums leave rounding errors."""

UNKNOWN: Final = 1.0
"""Distance of an unobserved block's features below its scale, so that trees can split it off."""


@dataclass(frozen=True, slots=True, eq=False)  # hashed by identity, in every frame
class Block:
    """Histogram of one quantity under one condition.

    Attributes:
        name: of the quantity and its condition.
        nodes: the scale, ascending; values beyond an end count at that end.
    """

    name: str
    nodes: tuple[float, ...]


def spread(
    values: FloatArray,
    counts: BoolArray,
    blocks: tuple[Block, ...],
    step_s: float,
    rows: IntArray,
    sums: FloatArray,
) -> None:
    """Add a moment's duration to the nodes of every block whose condition holds.

    Values and conditions are (B, n), one row per block. Agents' durations are in ``rows`` (n,) of
    ``sums`` (m, S), on the blocks' nodes.
    """
    from graphrqi.features.kernels import spread_on_nodes

    nodes, _, starts = _scale(blocks)
    counts = np.ascontiguousarray(counts & ~np.isnan(values))  # other layouts compile once more
    spread_on_nodes(np.ascontiguousarray(values), counts, nodes, starts, step_s, rows, sums)


@cache
def _scale(blocks: tuple[Block, ...]) -> tuple[FloatArray, FloatArray, IntArray]:
    """The nodes of all blocks, their limits (see `summarise`), and where each block's nodes begin.

    The last number of the third array is where the last block's nodes end.
    """
    scales = [np.asarray(b.nodes) for b in blocks]
    limits = [np.concatenate([s[:1], 0.5 * (s[:-1] + s[1:]), s[-1:]]) for s in scales]
    starts = np.cumsum([0, *(s.size for s in scales)])
    return np.concatenate(scales), np.concatenate(limits), starts


def describe(sums: FloatArray, blocks: tuple[Block, ...]) -> FloatArray:
    """(n, 7 B) features of durations (n, S) on the nodes of all blocks, s.

    They are block by block the quantiles ``LEVELS`` and the mean of its distribution, and log(1 +
    its total in tenths of a second). The weight of a node is spread evenly half-way to its
    neighbours. Quantiles and mean of an unobserved block are ``UNKNOWN`` below its lowest node.
    """
    from graphrqi.features.kernels import summarise

    nodes, limits, starts = _scale(blocks)
    out = np.empty((len(sums), len(blocks) * (len(LEVELS) + 2)))
    summarise(
        np.ascontiguousarray(sums), nodes, limits, starts, np.array(LEVELS), LEAST_S, UNKNOWN,
        np.empty(nodes.size), out,
    )  # fmt: skip
    return out


def describe_names(blocks: tuple[Block, ...]) -> tuple[str, ...]:
    """The columns of `describe`, named."""
    parts = (*(f"{100 * level:g}%" for level in LEVELS), "mean", "evidence")
    return tuple(f"{block.name}:{part}" for block in blocks for part in parts)
