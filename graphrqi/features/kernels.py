"""The compiled loops of the distributions, loaded on first use.

Callers allocate the outputs: an array made inside a kernel costs compile time.
"""

from __future__ import annotations

import math

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from sim.compiled import in_place


@in_place()
def find_around(
    row: IntArray,
    other: IntArray,
    xy: FloatArray,
    direction: FloatArray,
    drives: BoolArray,
    bounds: tuple[float, float, float, float, float],
    nearest: IntArray,
    distance: FloatArray,
    beside: FloatArray,
) -> None:
    """Find each driver's leader, follower and pedestrian ahead among its neighbours.

    ``row`` and ``other`` (m,) are joined vertices. ``nearest`` (3, n), -1 before, receives the
    nearest of each kind, and ``distance`` (3, n), infinite before, how far. ``beside`` (n,) counts
    the drivers in the next lanes. ``bounds`` are those of `graphrqi.features.interaction`.
    """
    same_path_m, beside_m, abreast_m, same_way, pedestrian_m = bounds
    for e in range(row.size):
        i, j = row[e], other[e]
        if not drives[i]:
            continue
        east, north = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
        ahead = east * direction[i, 0] + north * direction[i, 1]
        aside = abs(direction[i, 0] * north - direction[i, 1] * east)
        if not aside < beside_m:  # nor where a direction is unknown
            continue
        if drives[j]:
            alike = direction[j, 0] * direction[i, 0] + direction[j, 1] * direction[i, 1]
            if not alike > same_way:
                continue
            if aside >= same_path_m:
                beside[i] += abs(ahead) < abreast_m
                continue
            kind = 0 if ahead > 0.0 else 1
        else:
            kind = 2
            if not 0.0 < ahead < pedestrian_m:
                continue
        if 0.0 < abs(ahead) < distance[kind, i]:
            nearest[kind, i], distance[kind, i] = j, abs(ahead)


@in_place()
def spread_on_nodes(
    values: FloatArray,
    counts: BoolArray,
    nodes: FloatArray,
    starts: IntArray,
    step_s: float,
    rows: IntArray,
    sums: FloatArray,
) -> None:
    """Share a duration between the two nodes of its block that each counted value lies between."""
    for i in range(rows.size):
        row = rows[i]
        for b in range(len(values)):
            if not counts[b, i]:
                continue
            value, first, last = values[b, i], starts[b], starts[b + 1] - 1
            if value <= nodes[first]:
                sums[row, first] += step_s
            elif value >= nodes[last]:
                sums[row, last] += step_s
            else:
                upper = first + 1
                while nodes[upper] < value:
                    upper += 1
                share = (value - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
                sums[row, upper - 1] += (1.0 - share) * step_s
                sums[row, upper] += share * step_s


@in_place()
def summarise(
    sums: FloatArray,
    nodes: FloatArray,
    limits: FloatArray,
    starts: IntArray,
    levels: FloatArray,
    least: float,
    unknown: float,
    below: FloatArray,
    out: FloatArray,
) -> None:
    """Quantiles, mean and evidence of each block."""
    quantiles = levels.size
    for i in range(len(sums)):
        column = 0
        for b in range(starts.size - 1):
            first, size = starts[b], starts[b + 1] - starts[b]
            total, moment = 0.0, 0.0
            for k in range(size):
                weight = max(sums[i, first + k], 0.0)
                below[k] = total
                total += weight
                moment += weight * nodes[first + k]
            out[i, column + quantiles + 1] = math.log1p(10.0 * total)
            if total < least:
                for q in range(quantiles + 1):
                    out[i, column + q] = nodes[first] - unknown
                column += quantiles + 2
                continue
            out[i, column + quantiles] = moment / total
            for q in range(quantiles):
                target = levels[q] * total
                at = -1
                for k in range(size):
                    at += below[k] < target
                low, high = limits[first + b + at], limits[first + b + at + 1]
                share = (target - below[at]) / sums[i, first + at]
                out[i, column + q] = low + share * (high - low)
            column += quantiles + 2


@in_place()
def change_within(
    values: FloatArray,
    rows: IntArray,
    times: FloatArray,
    first: int,
    out: FloatArray,
    elapsed: FloatArray,
) -> None:
    """Difference of each row's last values (m, T, 2) from its oldest known ones, and its time.

    Times before ``first`` do not count. Where only the last time is left, nothing is known.
    """
    last = times.size - 1
    for i in range(rows.size):
        row, at = rows[i], first
        while at < last and math.isnan(values[row, at, 0]):
            at += 1
        known = at < last
        for axis in range(2):
            out[i, axis] = values[row, last, axis] - values[row, at, axis] if known else math.nan
        elapsed[i, 0] = times[last] - times[at] if known else 1.0
