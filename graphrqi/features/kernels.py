"""The compiled loops of the features, loaded together on first use.

Callers allocate the outputs: an array made inside a kernel costs compile time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from sim.compiled import in_place

IndexArray = NDArray[np.int32]


@in_place()
def change_since(
    rows: IntArray,
    times: FloatArray,
    values: FloatArray,
    since_s: float,
    change: FloatArray,
    elapsed_s: FloatArray,
) -> None:
    """Difference of each agent's value now from its oldest known value since a time."""
    now = times.size - 1
    first = 0
    while first < now and times[first] < since_s:
        first += 1
    if first == now:
        return
    for i in range(rows.size):
        row, at = rows[i], first
        while at < now - 1 and np.isnan(values[row, at, 0]):
            at += 1
        if np.isnan(values[row, at, 0]):
            at = first
        change[i, 0] = values[row, now, 0] - values[row, at, 0]
        change[i, 1] = values[row, now, 1] - values[row, at, 1]
        elapsed_s[i] = times[now] - times[at]


@in_place()
def find_neighbors(
    indptr: IndexArray,
    indices: IndexArray,
    xy: FloatArray,
    velocity: FloatArray,
    direction: FloatArray,
    drives: BoolArray,
    limits_m: tuple[float, float, float, float],
    nearest: IntArray,
    out: FloatArray,
) -> None:
    """Distance and speed of the nearest ahead and behind, count beside, nearest pedestrian."""
    same_path_m, beside_m, abreast_m, pedestrian_m = limits_m
    for i in range(indptr.size - 1):
        if not drives[i]:
            continue
        east, north = direction[i, 0], direction[i, 1]
        for edge in range(indptr[i], indptr[i + 1]):
            j = indices[edge]
            if j == i:
                continue
            x, y = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            ahead = x * east + y * north
            aside = abs(east * y - north * x)
            if not drives[j]:
                near = aside < beside_m and ahead > 0.0 and ahead < pedestrian_m
                if near and not ahead >= out[i, 5]:
                    out[i, 5] = ahead
                continue
            if not east * direction[j, 0] + north * direction[j, 1] > 0.5:  # beyond 60 degrees
                continue
            if aside < same_path_m:
                side = 0 if ahead > 0.0 else 1
                distance = abs(ahead)
                if distance > 0.0 and not distance >= out[i, 2 * side]:
                    nearest[i, side] = j
                    out[i, 2 * side] = distance
                    out[i, 2 * side + 1] = velocity[j, 0] * east + velocity[j, 1] * north
            elif aside < beside_m and abs(ahead) < abreast_m:
                out[i, 4] += 1.0


@in_place()
def signal_differences(
    indptr: IndexArray,
    indices: IndexArray,
    values: FloatArray,
    counts: BoolArray,
    level: FloatArray,
    mean: FloatArray,
    out: FloatArray,
) -> None:
    """Difference of a signal from its neighbourhood; see `graphrqi.features.interaction`."""
    _, scales = out.shape
    for scale in range(scales):
        for i in range(level.size):
            total, weighted = 0.0, 0.0
            for e in range(indptr[i], indptr[i + 1]):
                j = indices[e]
                if j != i and counts[j]:
                    total -= values[e]
                    weighted -= values[e] * level[j]
            mean[i] = weighted / total if total > 0.0 else level[i]
            out[i, scale] = level[i] - mean[i] if total > 0.0 and counts[i] else np.nan
        for i in range(level.size):
            level[i] = mean[i]


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
def infer_law(
    sums: FloatArray, weight: float, prior: FloatArray, prior_target: FloatArray, out: FloatArray
) -> None:
    """Posterior means, deviations and residual; see `graphrqi.features.following_law.infer`."""
    for i in range(len(sums)):
        r, s, t = sums[i, 0], sums[i, 1], sums[i, 2]
        u, w, x = sums[i, 3], sums[i, 4], sums[i, 5]
        p, q, z = sums[i, 6], sums[i, 7], sums[i, 8]
        a, b, c = weight * r + prior[0], weight * s, weight * t
        d, e, f = weight * u + prior[1], weight * w, weight * x + prior[2]
        aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
        dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * aa + b * bb + c * cc
        aa, bb, cc = aa / determinant, bb / determinant, cc / determinant
        dd, ee, ff = dd / determinant, ee / determinant, ff / determinant
        g = weight * p + prior_target[0]
        h = weight * q + prior_target[1]
        k = weight * z + prior_target[2]
        first = aa * g + bb * h + cc * k
        second = bb * g + dd * h + ee * k
        third = cc * g + ee * h + ff * k
        square = (
            first * (r * first + s * second + t * third)
            + second * (s * first + u * second + w * third)
            + third * (t * first + w * second + x * third)
        )
        error = sums[i, 9] - 2.0 * (first * p + second * q + third * z) + square
        out[i, 0], out[i, 1], out[i, 2] = first, second, third
        # Differences of long sums may leave a variance a rounding error below zero.
        out[i, 3] = math.sqrt(max(aa, 0.0))
        out[i, 4] = math.sqrt(max(dd, 0.0))
        out[i, 5] = math.sqrt(max(ff, 0.0))
        out[i, 6] = math.sqrt(max(error, 0.0) / max(sums[i, 10], 1.0))


@in_place()
def speed_of_neighbors(
    indptr: IndexArray,
    indices: IndexArray,
    velocity: FloatArray,
    direction: FloatArray,
    drives: BoolArray,
    out: FloatArray,
) -> None:
    """Mean speed, along its own direction, of each driver's neighbours within 60 degrees of it."""
    for i in range(out.size):
        total, count = 0.0, 0
        east, north = direction[i, 0], direction[i, 1]
        for edge in range(indptr[i], indptr[i + 1]):
            j = indices[edge]
            if j == i or not drives[j]:
                continue
            if not east * direction[j, 0] + north * direction[j, 1] > 0.5:
                continue
            total += velocity[j, 0] * east + velocity[j, 1] * north
            count += 1
        out[i] = max(total / count, 0.5) if count else np.nan
