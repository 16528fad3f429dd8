"""The compiled loops behind `graphrqi.features.statistics`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def spread_on_nodes(
    values: NDArray[np.float64],
    counts: NDArray[np.bool_],
    nodes: NDArray[np.float64],
    starts: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Spread each counted value over the two nodes of its block that it lies between.

    Args:
        values: (B, n).
        counts: (B, n).
        nodes: (S,) ascending within each block.
        starts: (B + 1,) where each block's nodes begin.
        out: (n, S) receives the weights.
    """
    for b in range(values.shape[0]):
        first, last = starts[b], starts[b + 1] - 1
        for i in range(values.shape[1]):
            if not counts[b, i]:
                continue
            value = values[b, i]
            if value <= nodes[first]:
                out[i, first] = 1.0
            elif value >= nodes[last]:
                out[i, last] = 1.0
            else:
                upper = first + 1
                while nodes[upper] < value:
                    upper += 1
                share = (value - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
                out[i, upper - 1] = 1.0 - share
                out[i, upper] = share


@compiled
def summarise(
    sums: NDArray[np.float64],
    nodes: NDArray[np.float64],
    starts: NDArray[np.int64],
    levels: NDArray[np.float64],
    least: float,
    unknown: float,
    out: NDArray[np.float64],
) -> None:
    """Quantiles, mean and evidence of each block.

    Args:
        sums: (n, S) durations on the nodes, s; S may be larger than there are nodes.
        nodes: (S,) ascending within each block.
        starts: (B + 1,) where each block's nodes begin.
        levels: (Q,) of the quantiles, ascending.
        least: total below which a block counts as unseen, s.
        unknown: what quantiles and mean of an unseen block lie below the lowest node.
        out: (n, B (Q + 2)) receives block by block the quantiles, the mean, the evidence.
    """
    quantiles = levels.size
    for i in range(sums.shape[0]):
        column = 0
        for b in range(starts.size - 1):
            first, end = starts[b], starts[b + 1]
            total, moment = 0.0, 0.0
            for k in range(first, end):
                weight = max(sums[i, k], 0.0)
                total += weight
                moment += weight * nodes[k]
            out[i, column + quantiles + 1] = math.log1p(10.0 * total)
            if total < least:
                out[i, column : column + quantiles + 1] = nodes[first] - unknown
                column += quantiles + 2
                continue
            out[i, column + quantiles] = moment / total
            q, below = 0, 0.0
            for k in range(first, end):
                weight = sums[i, k]
                if not weight > 0.0 or below + weight < levels[q] * total:
                    below += max(weight, 0.0)
                    continue
                low = nodes[k] if k == first else 0.5 * (nodes[k - 1] + nodes[k])
                high = nodes[k] if k == end - 1 else 0.5 * (nodes[k] + nodes[k + 1])
                while q < quantiles and below + weight >= levels[q] * total:
                    share = (levels[q] * total - below) / weight
                    out[i, column + q] = low + share * (high - low)
                    q += 1
                if q == quantiles:
                    break
                below += weight
            while q < quantiles:  # rounding: the last share of the total
                out[i, column + q] = nodes[end - 1]
                q += 1
            column += quantiles + 2


@compiled
def accumulate(
    sums: NDArray[np.float64],
    rows: NDArray[np.int64],
    moment: NDArray[np.float64],
    step_s: float,
) -> None:
    """Add weights that held for a time to running sums; most weights are zero.

    Args:
        sums: (m, S) of all agents.
        rows: (n,) where each agent's sums are.
        moment: (n, S).
        step_s: s.
    """
    for i in range(rows.size):
        row = rows[i]
        for k in range(moment.shape[1]):
            if moment[i, k] != 0.0:
                sums[row, k] += moment[i, k] * step_s
