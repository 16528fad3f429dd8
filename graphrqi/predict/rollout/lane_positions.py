"""Positions in lane coordinates, compiled: along paths, on lanes beside, and back to metres."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

CHANGE_S = 3.0
"""Duration of a lane change, s (3 to 6 s are observed)."""


@in_place()
def turn_to_lane_beside(
    side: int, other_ways: bool, on_path: Any, lane: Any, path: Any, offset: Any,
    lateral_speed: Any, there: Any, beside: Any, lane_spacing: Any, by_turn: Any, path_turn: Any,
) -> None:  # fmt: skip
    """Turn everyone to the lane beside, where there is one.

    Args:
        side: 0: to the left, 1: to the right.
        other_ways: whether a lane counts that leads elsewhere than the path does.
        on_path: (n,) who is on a path.
        lane: (n,) lane of each driver, -1 off the road; this and the next three are changed where
            there is such a lane.
        path: (n,) path of each.
        offset: (n,) distance to the left of the lane's centre, m.
        lateral_speed: (n,) m/s.
        there: (n,) receives whether there is one; must be false before.
        beside: (2, L) and the next three: columns of `graphrqi.predict.scene.paths.PathTable`.
        lane_spacing: (2, L) m.
        by_turn: (L, D).
        path_turn: (Q,).
    """
    sign = 1.0 - 2.0 * side
    _, turns = by_turn.shape
    for i in range(lane.size):
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
        lane[i], path[i] = to, onward
        offset[i], lateral_speed[i] = offset[i] - wide, wide / CHANGE_S


def along_path(
    path: IntArray, x: FloatArray, path_lane: IntArray, path_start: FloatArray
) -> tuple[IntArray, FloatArray]:
    """(n, H) lanes and distances along them, m, of distances x (n, H) along paths (n,)."""
    lane, s = np.empty(x.shape, np.int64), np.empty(x.shape)
    _find_along_path(path, x, path_lane, path_start, lane, s)
    return lane, s


@in_place(reordered=True)
def _find_along_path(path: Any, x: Any, path_lane: Any, path_start: Any, lane: Any, s: Any) -> None:
    n, steps = x.shape
    _, most = path_lane.shape
    for i in range(n):
        q, k = path[i], 0
        for h in range(steps):
            while k + 1 < most and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x[i, h]:
                k += 1
            lane[i, h], s[i, h] = path_lane[q, k], x[i, h] - path_start[q, k]


def positions(
    lane: IntArray, s: FloatArray, offset: FloatArray, segment_start: FloatArray,
    segment_direction: FloatArray, segment_at: FloatArray, segment_first: IntArray,
    segment_last: IntArray,
) -> FloatArray:  # fmt: skip
    """(n, H, 2) positions of (n, H) distances along lanes and to the left of their centres, m."""
    out = np.empty((*s.shape, 2))
    _find_positions(
        lane, s, offset, segment_start, segment_direction, segment_at, segment_first, segment_last,
        out,
    )  # fmt: skip
    return out


@in_place(reordered=True)
def _find_positions(
    lane: Any, s: Any, offset: Any, segment_start: Any, segment_direction: Any, segment_at: Any,
    segment_first: Any, segment_last: Any, out: Any,
) -> None:  # fmt: skip
    n, steps = s.shape
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


def in_own_frame(
    xy: FloatArray, now: FloatArray, heading: FloatArray, speed: FloatArray, on_path: BoolArray,
    every: int, step_s: float,
) -> FloatArray:  # fmt: skip
    """(n, J, 2) every so many of positions (n, H, 2), ahead and to the left of each driver, m.

    Drivers on no path go straight on.
    """
    n, steps, _ = xy.shape
    out = np.empty((n, steps // every, 2))
    _find_in_own_frame(xy, now, heading, speed, on_path, every, step_s, out)
    return out


@in_place(reordered=True)
def _find_in_own_frame(
    xy: Any, now: Any, heading: Any, speed: Any, on_path: Any, every: int, step_s: float, out: Any
) -> None:
    n, knots, _ = out.shape
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for j in range(knots):
            h = (j + 1) * every - 1
            if on_path[i]:
                dx, dy = xy[i, h, 0] - now[i, 0], xy[i, h, 1] - now[i, 1]
                out[i, j, 0], out[i, j, 1] = dx * cos + dy * sin, dy * cos - dx * sin
            else:
                out[i, j, 0], out[i, j, 1] = speed[i] * (h + 1) * step_s, 0.0
