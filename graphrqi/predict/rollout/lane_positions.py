"""Positions in lane coordinates, compiled: along paths, on lanes beside, and back to metres."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphrqi.predict.rollout.lane_changing import CHANGE_S
from sim.compiled import compiled, reordered


@compiled
def lane_beside(
    side: int, other_ways: bool, lane: Any, path: Any, on_path: Any, offset: Any,
    lateral_speed: Any, beside: Any, lane_spacing: Any, by_turn: Any, path_turn: Any,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Everyone on its way to the lane beside, where there is one.

    Args:
        side: 0: to the left, 1: to the right.
        other_ways: whether a lane counts that leads elsewhere than the path does.
        lane: (n,) lane of each driver, -1 off the road.
        path: (n,) path of each.
        on_path: (n,) who is on a path.
        offset: (n,) distance to the left of the lane's centre, m.
        lateral_speed: (n,) m/s.
        beside: (2, L) and the next three: columns of `graphrqi.predict.scene.paths.PathTable`.
        lane_spacing: (2, L) m.
        by_turn: (L, D).
        path_turn: (Q,).

    Returns:
        (n,) lanes, paths, offsets and lateral speeds then, unchanged where there is no such lane,
        and (n,) whether there is one.
    """
    new_lane, new_path = lane.copy(), path.copy()
    new_offset, new_speed = offset.copy(), lateral_speed.copy()
    there = np.empty(lane.size, np.bool_)
    sign = 1.0 - 2.0 * side
    _, turns = by_turn.shape
    for i in range(lane.size):
        there[i] = False
        if not on_path[i]:
            continue
        to = beside[side, lane[i]]
        if to < 0:
            continue
        onward = by_turn[to, path_turn[path[i]]]
        if onward < 0 and other_ways:
            for turn in range(turns):
                onward = max(onward, by_turn[to, turn])
        if onward < 0:
            continue
        there[i] = True
        wide = sign * lane_spacing[side, lane[i]]
        new_lane[i], new_path[i] = to, onward
        new_offset[i], new_speed[i] = offset[i] - wide, wide / CHANGE_S
    return new_lane, new_path, new_offset, new_speed, there


@reordered
def along_path(path: Any, x: Any, path_lane: Any, path_start: Any) -> tuple[Any, Any]:
    """(n, H) lanes and distances along them, m, of distances x (n, H) along paths (n,)."""
    n, steps = x.shape
    _, most = path_lane.shape
    lane, s = np.empty((n, steps), np.int64), np.empty((n, steps))
    for i in range(n):
        q, k = path[i], 0
        for h in range(steps):
            while k + 1 < most and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x[i, h]:
                k += 1
            lane[i, h], s[i, h] = path_lane[q, k], x[i, h] - path_start[q, k]
    return lane, s


@reordered
def positions(
    lane: Any, s: Any, offset: Any, segment_start: Any, segment_direction: Any, segment_at: Any,
    segment_first: Any, segment_last: Any,
) -> Any:  # fmt: skip
    """(n, H, 2) positions of (n, H) distances along lanes and to the left of their centres, m."""
    n, steps = s.shape
    out = np.empty((n, steps, 2))
    for i in range(n):
        before, g = -1, 0
        for h in range(steps):
            here = lane[i, h]
            if here != before:
                before, g = here, segment_first[here]
            while g < segment_last[here] and segment_at[g + 1] <= s[i, h]:
                g += 1
            along = s[i, h] - segment_at[g]
            out[i, h, 0] = (
                segment_start[g, 0] + along * segment_direction[g, 0]
                - offset[i, h] * segment_direction[g, 1]
            )  # fmt: skip
            out[i, h, 1] = (
                segment_start[g, 1] + along * segment_direction[g, 1]
                + offset[i, h] * segment_direction[g, 0]
            )  # fmt: skip
    return out


@reordered
def in_own_frame(
    xy: Any, now: Any, heading: Any, speed: Any, on_path: Any, every: int, step_s: float
) -> Any:
    """(n, J, 2) every so many of positions (n, H, 2), ahead and to the left of each driver, m.

    Drivers on no path go straight on.
    """
    n, steps, _ = xy.shape
    knots = steps // every
    out = np.empty((n, knots, 2))
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for j in range(knots):
            h = (j + 1) * every - 1
            if on_path[i]:
                dx, dy = xy[i, h, 0] - now[i, 0], xy[i, h, 1] - now[i, 1]
                out[i, j, 0], out[i, j, 1] = dx * cos + dy * sin, dy * cos - dx * sin
            else:
                out[i, j, 0], out[i, j, 1] = speed[i] * (h + 1) * step_s, 0.0
    return out
