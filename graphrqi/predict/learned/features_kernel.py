"""The compiled loop behind `graphrqi.predict.learned.features`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphrqi.predict.scene.stop_constraints import CLOSED, CLOSING
from sim.compiled import compiled, inner

FAR_M = 100.0
"""Distances are cut off here and divided by it (our choice)."""


@inner
def _near(gap: float) -> float:
    return 1.0 - min(max(gap, -5.0), FAR_M) / FAR_M


@compiled
def describe(
    valid: Any, speed: Any, heading: Any, length: Any, past: Any, on_path: Any, lane: Any, s: Any,
    offset: Any, sideways: Any, accel: Any, free: Any, least: Any, place: Any, leader: Any,
    gap: Any, follower: Any, beside: Any, beside_gap: Any, path: Any, closed: Any, shown: Any,
    gates: int, gate_x: Any, gate_row: Any, path_limit: Any, path_start: Any, path_turn: Any,
    lane_limit: Any, lane_length: Any, internal: Any, left: Any, right: Any, out: Any,
) -> None:  # fmt: skip
    """Write the features of every agent.

    Args:
        valid: (n, T) whether each is seen.
        speed: (n, T) m/s.
        heading: (n, T) rad.
        length: (n,) m.
        past: (P,) columns of the past looked at, -1: before the history begins.
        on_path: (n,) as in `graphrqi.predict.scene.scene.Scene`, like those to ``sideways``.
        lane: (n,).
        s: (n,) m.
        offset: (n,) m.
        sideways: (n,) m/s.
        accel: (n,) as in `graphrqi.predict.scene.sight.Sight`, like those to ``beside_gap``.
        free: (n,).
        least: (n,).
        place: (n,).
        leader: (n,).
        gap: (n,) m.
        follower: (n,).
        beside: (n, 4).
        beside_gap: (n, 4) m.
        path: (n,) path of each.
        closed: (R, steps + 1) states of the gates.
        shown: (A,) which columns of them are told.
        gates: how many of the next ones.
        gate_x: (Q, G) as in `graphrqi.predict.scene.paths.PathTable`, like those to ``path_turn``.
        gate_row: (Q, G).
        path_limit: (Q, P) m/s.
        path_start: (Q, P) m.
        path_turn: (Q,).
        lane_limit: (L,) m/s; this and the rest as in `sim.road.lane_graph.LaneGraph`.
        lane_length: (L,) m.
        internal: (L,).
        left: (L,).
        right: (L,).
        out: (n, F) receives them; must be zero before.
    """
    now = speed.shape[1] - 1
    who, far = np.empty(7, np.int64), np.empty(7)
    for i in range(on_path.size):
        on, v = max(lane[i], 0), speed[i, now]
        limit = lane_limit[on] if on_path[i] else 0.0
        out[i, 0], out[i, 1], out[i, 2] = v / 10.0, accel[i] / 3.0, limit / 20.0
        out[i, 3], out[i, 4] = v / max(limit, 1.0), offset[i] / 3.0
        out[i, 5], out[i, 6] = sideways[i], length[i] / 10.0
        if on_path[i]:
            out[i, 7], out[i, 8], out[i, 9] = 1.0, left[on] >= 0, right[on] >= 0
        if math.isfinite(free[i]):
            out[i, 10] = free[i]
        out[i, 11] = least[i]
        if place[i] < 0 or not internal[on]:
            out[i, 12] = min(max(lane_length[on] - s[i], 0.0), FAR_M) / FAR_M
        c = 13
        for k in range(past.size):
            if past[k] >= 0 and valid[i, past[k]]:
                out[i, c] = 1.0
                out[i, c + 1] = (speed[i, past[k]] - v) / 5.0
                out[i, c + 2] = math.sin(heading[i, now] - heading[i, past[k]])
            c += 3

        who[0], far[0] = leader[i], gap[i]
        who[1] = who[2] = -1
        if leader[i] >= 0 and leader[leader[i]] >= 0:
            who[1] = leader[leader[i]]
            far[1] = gap[i] + gap[leader[i]] + length[leader[i]]
        if follower[i] >= 0:
            who[2], far[2] = follower[i], gap[follower[i]]
        for k in range(4):
            who[3 + k], far[3 + k] = beside[i, k], beside_gap[i, k]
        for k in range(7):
            other = who[k]
            if other >= 0:
                out[i, c], out[i, c + 1] = 1.0, _near(far[k])
                out[i, c + 2] = (speed[other, now] - v) / 10.0
                out[i, c + 3] = accel[other] / 3.0
            c += 4

        if on_path[i]:
            front, told = s[i] + length[i] / 2, 0
            for g in range(gate_x.shape[1]):
                room = gate_x[path[i], g] - front
                if room <= -1.0:
                    continue
                if room >= FAR_M or told == gates:
                    break
                out[i, c + told] = 1.0 - max(room, 0.0) / FAR_M
                for a in range(shown.size):
                    state = closed[gate_row[path[i], g], shown[a]]
                    first = c + gates * (1 + 2 * a) + told
                    out[i, first] = state == CLOSED
                    out[i, first + gates] = state == CLOSING
                told += 1
        c += gates * (1 + 2 * shown.size)
        if on_path[i]:
            for j in range(path_start.shape[1]):
                if path_limit[path[i], j] < path_limit[path[i], 0] - 0.1 and math.isfinite(
                    path_start[path[i], j]
                ):
                    room = path_start[path[i], j] - s[i]
                    out[i, c] = 1.0 - min(max(room, 0.0), FAR_M) / FAR_M
                    out[i, c + 1] = path_limit[path[i], j] / 20.0
                    break
            out[i, c + 2 + path_turn[path[i]]] = 1.0
