"""The compiled loops of the features, loaded together on first use.

Callers allocate the outputs: an array made inside a kernel costs compile time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
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
    """Difference of each agent's value now from its oldest known value since a time.

    Args:
        rows: (n,) the agents' rows in ``values``.
        times: (T,) ascending, s.
        values: (m, T, 2) of all agents; NaN where unknown.
        since_s: the oldest time used, s; the last time is never used.
        change: (n, 2) receives the differences; must be NaN before, which stays where no earlier
            value is known.
        elapsed_s: (n,) receives the time between the two values, s; must be 1 before, which stays
            where there is no earlier time.
    """
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
    """Find the nearest driver ahead and behind and the nearest pedestrian, and count those beside.

    Args:
        indptr: (n + 1,) where each vertex' edges begin.
        indices: (E,) other end of each edge; an edge from a vertex to itself does not count.
        xy: (n, 2) m.
        velocity: (n, 2) m/s.
        direction: (n, 2) unit vectors of travel; an agent whose direction is NaN has no neighbours.
        drives: (n,) whether each vertex drives.
        limits_m: sideways distance within which another is on the same path, sideways distance
            within which it is in the next lane, distance along the way within which it is beside,
            and distance ahead within which a pedestrian counts.
        nearest: (n, 2) receives the nearest ahead and behind; must be -1 before.
        out: (n, 6) receives distance and speed of the nearest ahead, distance and speed of the
            nearest behind, how many are beside, and the distance to the nearest pedestrian; must
            be NaN before, but 0 for the count.
    """
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
    """Difference of a signal from its neighbourhood; see `graphrqi.features.interaction`.

    Args:
        indptr: (n + 1,) row starts of the Laplacian.
        indices: (z,) its columns.
        values: (z,) its values.
        counts: (n,) vertices that count.
        level: (n,) the signal, 0 at vertices that do not count; overwritten.
        mean: (n,) working space.
        out: (n, scales) receives the differences; NaN where the vertex does not count or has no
            neighbour that does.
    """
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
    """Share a duration between the two nodes of its block that each counted value lies between.

    Args:
        values: (B, n).
        counts: (B, n).
        nodes: (S,) ascending within each block.
        starts: (B + 1,) where each block's nodes begin.
        step_s: the duration, s.
        rows: (n,) each agent's row in ``sums``.
        sums: (m, at least S) the durations are added to the nodes' columns.
    """
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
    """Quantiles, mean and evidence of each block.

    A quantile's node is found by counting all nodes of the block at which the total is still too
    small. A loop that ends at the node takes twice as long, because processors cannot foresee where
    it ends.

    Args:
        sums: (n, S) durations on the nodes, s; S may be larger than the number of nodes.
        nodes: (S,) ascending within each block.
        limits: (S + B,) between which each node's duration is spread: the lowest node of a block,
            half-way between its neighbours, and the highest.
        starts: (B + 1,) where each block's nodes begin.
        levels: (Q,) of the quantiles, above 0 and below 1.
        least: total below which a block counts as unobserved, s.
        unknown: distance of an unobserved block's quantiles and mean below its lowest node.
        below: (S,) room to work in.
        out: (n, at least B (Q + 2)) receives block by block the quantiles, the mean, the evidence.
    """
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
    """Posterior means, deviations and residual; see `graphrqi.features.following_law.infer`.

    The symmetric 3 x 3 matrices are inverted by cofactors.

    Args:
        sums: (n, 11) products.
        weight: one over the noise's variance.
        prior: (3,) one over the prior's variances.
        prior_target: (3,) the prior's means times ``prior``.
        out: (n, 7) receives the numbers.
    """
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
def fit_parabolas(trail: FloatArray, times: FloatArray, half_s: float, out: FloatArray) -> None:
    """Fit a parabola to each agent's positions about time zero, by least squares.

    An agent that is not seen before and after time zero gets NaN throughout; one that is not seen
    for ``half_s / 2`` on both sides gets a straight line and a NaN acceleration.

    Args:
        trail: (m, T, 2) positions, m; NaN where unknown.
        times: (T,) ascending, s.
        half_s: half the stretch, s.
        out: (m, 8) receives position (2), velocity (2), acceleration (2), the root mean square
            residual across the velocity, m (NaN without spare positions), and the number of
            positions.
    """
    for i in range(len(trail)):
        n = 0
        first = last = 0.0
        s1 = s2 = s3 = s4 = 0.0
        x0 = x1 = x2 = y0 = y1 = y2 = 0.0
        east = north = 0.0
        for k in range(times.size):
            if np.isnan(trail[i, k, 0]):
                continue
            t = times[k]
            if n == 0:
                first, east, north = t, trail[i, k, 0], trail[i, k, 1]
            last = t
            x, y = trail[i, k, 0] - east, trail[i, k, 1] - north
            n += 1
            s1 += t
            s2 += t * t
            s3 += t * t * t
            s4 += t * t * t * t
            x0, x1, x2 = x0 + x, x1 + t * x, x2 + t * t * x
            y0, y1, y2 = y0 + y, y1 + t * y, y2 + t * t * y
        for column in range(8):
            out[i, column] = np.nan
        out[i, 7] = n
        if n < 2 or first > 1e-6 or last < -1e-6 or last - first < 0.5 * half_s:
            continue
        curved = n >= 4 and -first >= 0.5 * half_s and last >= 0.5 * half_s
        ax = bx = cx = ay = by = cy = 0.0
        if curved:
            # Cofactors of the symmetric matrix of moments [[n, s1, s2], [s1, s2, s3], [s2, s3, s4]]
            aa, bb, cc = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
            dd, ee, ff = n * s4 - s2 * s2, s1 * s2 - n * s3, n * s2 - s1 * s1
            determinant = n * aa + s1 * bb + s2 * cc
            if not determinant > 1e-12:
                curved = False
            else:
                ax = (aa * x0 + bb * x1 + cc * x2) / determinant
                bx = (bb * x0 + dd * x1 + ee * x2) / determinant
                cx = (cc * x0 + ee * x1 + ff * x2) / determinant
                ay = (aa * y0 + bb * y1 + cc * y2) / determinant
                by = (bb * y0 + dd * y1 + ee * y2) / determinant
                cy = (cc * y0 + ee * y1 + ff * y2) / determinant
        if not curved:
            determinant = n * s2 - s1 * s1
            if not determinant > 1e-12:
                continue
            ax, bx = (s2 * x0 - s1 * x1) / determinant, (n * x1 - s1 * x0) / determinant
            ay, by = (s2 * y0 - s1 * y1) / determinant, (n * y1 - s1 * y0) / determinant
        out[i, 0], out[i, 1] = ax + east, ay + north
        out[i, 2], out[i, 3] = bx, by
        if not curved:
            continue
        out[i, 4], out[i, 5] = 2.0 * cx, 2.0 * cy
        speed = math.hypot(bx, by)
        if n < 5 or speed < 0.5:
            continue
        total = 0.0
        for k in range(times.size):
            if np.isnan(trail[i, k, 0]):
                continue
            t = times[k]
            x = trail[i, k, 0] - east - (ax + t * (bx + t * cx))
            y = trail[i, k, 1] - north - (ay + t * (by + t * cy))
            across = (bx * y - by * x) / speed
            total += across * across
        out[i, 6] = math.sqrt(total / (n - 3))


@in_place()
def speed_of_neighbors(
    indptr: IndexArray,
    indices: IndexArray,
    velocity: FloatArray,
    direction: FloatArray,
    drives: BoolArray,
    out: FloatArray,
) -> None:
    """Mean speed, along its own direction, of each driver's neighbours within 60 degrees of it.

    Args:
        indptr: (n + 1,) where each vertex' edges begin.
        indices: (E,) other end of each edge.
        velocity: (n, 2) m/s.
        direction: (n, 2) unit vectors of travel.
        drives: (n,) whether each vertex drives.
        out: (n,) receives the means, m/s; NaN without such a neighbour.
    """
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
