"""The compiled loop that describes drivers in numbers, loaded on first use."""

from __future__ import annotations

import math
from typing import Any

from graphrqi.predict.scene.stop_constraints import STOP, STOP_IF_COMFORTABLE
from sim.compiled import in_place

FAR_M = 100.0
"""Distances are cut off here and divided by it."""


@in_place()
def describe(
    past: Any, place: Any, wishes: Any, around: Any, lanes: Any, paths: Any, stop_state: Any,
    columns: Any, stops: int, out: Any,
) -> None:  # fmt: skip
    """Describe each driver; see `graphrqi.predict.learned.inputs.features_of`.

    Tuples hold columns of the history at its present and past moments, and of the scene, its agent
    states, its lane graph and its paths. ``stop_state`` (R, A) has the moments that are shown, of
    at most ``stops`` constraints. ``columns`` are the first ones of the past, of the neighbours and
    of the stop constraints in ``out`` (n, FEATURES), which must be zero.
    """
    first, second, third = columns
    for i in range(len(out)):
        _describe_own(i, past, place, wishes, lanes, first, out)
        _describe_neighbors(i, past, place, around, second, out)
        _describe_way(i, past, place, paths, stop_state, third, stops, out)


@in_place(inner=True)
def _describe_own(
    i: int, past: Any, place: Any, wishes: Any, lanes: Any, first: int, out: Any
) -> None:  # fmt: skip
    """Write the driver's own state and past."""
    seen, speed, heading, length = past
    on_path, lane, s, offset, lateral_speed, accel = place
    free, least, on_lane = wishes
    left, right, internal, lane_length, limits = lanes
    on, now = max(lane[i], 0), speed[i, 0]
    limit = limits[on] if on_path[i] else 0.0
    out[i, 0], out[i, 1], out[i, 2] = now / 10.0, accel[i] / 3.0, limit / 20.0
    out[i, 3], out[i, 4] = now / max(limit, 1.0), offset[i] / 3.0
    out[i, 5], out[i, 6], out[i, 7] = lateral_speed[i], length[i] / 10.0, on_path[i]
    out[i, 8], out[i, 9] = on_path[i] and left[on] >= 0, on_path[i] and right[on] >= 0
    out[i, 10] = free[i] if math.isfinite(free[i]) else 0.0
    out[i, 11] = least[i]
    if on_lane[i] < 0 or not internal[on]:
        out[i, 12] = min(max(lane_length[on] - s[i], 0.0), FAR_M) / FAR_M
    for k in range(1, seen.shape[1]):
        if seen[i, k]:
            c = first + 3 * (k - 1)
            out[i, c], out[i, c + 1] = 1.0, (speed[i, k] - now) / 5.0
            out[i, c + 2] = math.sin(heading[i, 0] - heading[i, k])


@in_place(inner=True)
def _describe_neighbors(i: int, past: Any, place: Any, around: Any, c: int, out: Any) -> None:
    """Write the leader, its leader, the follower and those on the lanes beside."""
    leader, gap, follower, adjacent, adjacent_gap = around
    _, speed, _, length = past
    _, _, _, _, _, accel = place
    for k in range(3 + adjacent.shape[1]):
        who, far = leader[i], gap[i]
        if k == 1:
            second = leader[who] if who >= 0 else -1
            far, who = gap[i] + gap[who] + length[who], second
        elif k == 2:
            who = follower[i]
            far = gap[who]
        elif k > 2:
            who, far = adjacent[i, k - 3], adjacent_gap[i, k - 3]
        if who >= 0:
            out[i, c], out[i, c + 1] = 1.0, 1.0 - min(max(far, -5.0), FAR_M) / FAR_M
            out[i, c + 2] = (speed[who, 0] - speed[i, 0]) / 10.0
            out[i, c + 3] = accel[who] / 3.0
        c += 4


@in_place(inner=True)
def _describe_way(
    i: int, past: Any, place: Any, paths: Any, stop_state: Any, first: int, stops: int, out: Any
) -> None:
    """Write the next stop constraints, the next lower limit and where the path turns."""
    _, _, _, length = past
    on_path, _, s, _, _, _ = place
    path, limit, start, turn, stop_x, stop_row = paths
    if not on_path[i]:
        return
    q, found = path[i], 0
    shown, front = stop_state.shape[1], s[i] + length[i] / 2.0
    for k in range(stop_x.shape[1]):
        room = stop_x[q, k] - front
        if not -1.0 < room < FAR_M or found == stops:
            continue
        c = first + found
        out[i, c] = 1.0 - max(room, 0.0) / FAR_M
        for a in range(shown):
            state = stop_state[stop_row[q, k], a]
            out[i, c + stops * (1 + 2 * a)] = state == STOP
            out[i, c + stops * (2 + 2 * a)] = state == STOP_IF_COMFORTABLE
        found += 1
    c = first + stops * (1 + 2 * shown)
    for k in range(limit.shape[1]):
        if limit[q, k] < limit[q, 0] - 0.1 and math.isfinite(start[q, k]):
            out[i, c] = 1.0 - min(max(start[q, k] - s[i], 0.0), FAR_M) / FAR_M
            out[i, c + 1] = limit[q, k] / 20.0
            break
    out[i, c + 2 + turn[q]] = 1.0
