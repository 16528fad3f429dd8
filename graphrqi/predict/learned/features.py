"""What the learned predictors are given about each driver, as numbers.

The sources are those of the rollouts: the driver's own past, its lane and limit, leaders and
followers on its lane and beside it, signals, crossings and yielding places ahead. Whatever depends
on behaviours (beliefs, rollouts with their parameters) is kept apart, so that a predictor can do
without it.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene.paths import limits
from graphrqi.predict.scene.scene import Scene
from graphrqi.predict.scene.stop_constraints import STOP, STOP_IF_COMFORTABLE
from sim.compiled import in_place
from sim.road.lane_graph import DIRECTIONS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FAR_M = 100.0
"""Distances are cut off here and divided by it."""

PAST_S: Final = tuple(0.5 * i for i in range(1, 10))
"""Ages of the moments of the own past that are described, s."""

AHEAD_S: Final = (0.0, 1.0, 2.0, 3.0, 5.0)
"""Times at which the states of the stop constraints ahead are described, s."""

STOPS: Final = 3
"""Stop constraints ahead that are described."""

NEIGHBORS: Final = 7
"""Neighbours that are described: leader, its leader, follower, and those ahead and behind on the
left and on the right."""

PER_NEIGHBOR: Final = 4
"""Numbers per neighbour: present, nearness, relative speed and acceleration."""

STATE: Final = 13
"""Numbers of the own state."""

PAST: Final = slice(STATE, STATE + 3 * len(PAST_S))
AROUND: Final = slice(PAST.stop, PAST.stop + NEIGHBORS * PER_NEIGHBOR)
"""Places of the own past and of the neighbours among the features."""

FEATURES: Final = AROUND.stop + STOPS * (1 + 2 * len(AHEAD_S)) + 2 + len(DIRECTIONS)
"""Number of features."""


PAST_END, AROUND_END = PAST.stop, AROUND.stop


def features(scene: Scene) -> FloatArray:
    """(n, FEATURES) everything that is known of each driver but its behaviour.

    In this order: speed, acceleration, limit, place on the lane, lanes beside, wished speeds seen
    so far; at each time of `PAST_S` whether it was seen, speed then less now, turned since; the
    neighbours; nearness and coming states of the next stop constraints on the path; nearness and
    size of the next lower limit, and which way the path turns.
    """
    history, graph = scene.history, scene.graph
    when = history.time_s[-1] - np.array(PAST_S)
    columns = np.searchsorted(history.time_s, when - 1e-6)
    columns[history.time_s[0] > when + 1e-6] = -1
    shown = np.minimum(np.round(np.array(AHEAD_S) / STEP_S).astype(np.int64), scene.steps)
    valid, speed, heading = (
        np.ascontiguousarray(x) for x in (history.valid, history.speed, history.heading)
    )
    now, length = speed[:, -1].copy(), history.length.copy()
    states, paths = scene.states, scene.paths
    out = np.zeros((scene.ids.size, FEATURES))
    _describe_own_states(
        now, length, scene.on_path, scene.lane, scene.s, scene.offset, scene.lateral_speed,
        scene.accel, (states.free_factor, states.least_factor, states.on_lane),
        (graph.left, graph.right, graph.internal, graph.length, limits(graph)), out,
    )  # fmt: skip
    _describe_past(valid, speed, heading, columns, out)
    _describe_neighbors(
        now, length, scene.accel, states.leader, states.gap, states.follower, states.adjacent,
        states.adjacent_gap, np.empty(NEIGHBORS, np.int64), np.empty(NEIGHBORS), out,
    )  # fmt: skip
    _describe_paths(
        scene.on_path, scene.s, length, scene.path, scene.stop_state, shown, paths.stop_x,
        paths.stop_row, paths.turn, paths.start, paths.limit, out,
    )  # fmt: skip
    return out


@in_place()
def _describe_own_states(
    speed: Any, length: Any, on_path: Any, lane: Any, s: Any, offset: Any, lateral_speed: Any,
    accel: Any, seen: Any, road: Any, out: Any,
) -> None:  # fmt: skip
    """Write the first `STATE` features."""
    free, least, on_lane = seen
    left, right, internal, lane_length, limits = road
    for i in range(lane.size):
        on, v = max(lane[i], 0), speed[i]
        limit = limits[on] if on_path[i] else 0.0
        out[i, 0], out[i, 1], out[i, 2] = v / 10.0, accel[i] / 3.0, limit / 20.0
        out[i, 3], out[i, 4] = v / max(limit, 1.0), offset[i] / 3.0
        out[i, 5], out[i, 6] = lateral_speed[i], length[i] / 10.0
        if on_path[i]:
            out[i, 7], out[i, 8], out[i, 9] = 1.0, left[on] >= 0, right[on] >= 0
        if math.isfinite(free[i]):
            out[i, 10] = free[i]
        out[i, 11] = least[i]
        if on_lane[i] < 0 or not internal[on]:
            out[i, 12] = min(max(lane_length[on] - s[i], 0.0), FAR_M) / FAR_M


@in_place()
def _describe_past(valid: Any, speed: Any, heading: Any, columns: Any, out: Any) -> None:
    """Write the features of the own past."""
    n, moments = speed.shape
    last = moments - 1
    for i in range(n):
        c = STATE
        for k in range(columns.size):
            t = columns[k]
            if t >= 0 and valid[i, t]:
                out[i, c] = 1.0
                out[i, c + 1] = (speed[i, t] - speed[i, last]) / 5.0
                out[i, c + 2] = math.sin(heading[i, last] - heading[i, t])
            c += 3


@in_place()
def _describe_neighbors(
    speed: Any, length: Any, accel: Any, leader: Any, gap: Any, follower: Any, adjacent: Any,
    adjacent_gap: Any, who: Any, far: Any, out: Any,
) -> None:  # fmt: skip
    """Write the features of the neighbours."""
    for i in range(leader.size):
        who[0], far[0] = leader[i], gap[i]
        who[1] = who[2] = -1
        if leader[i] >= 0 and leader[leader[i]] >= 0:
            who[1] = leader[leader[i]]
            far[1] = gap[i] + gap[leader[i]] + length[leader[i]]
        if follower[i] >= 0:
            who[2], far[2] = follower[i], gap[follower[i]]
        for k in range(4):
            who[3 + k], far[3 + k] = adjacent[i, k], adjacent_gap[i, k]
        c = PAST_END
        for k in range(NEIGHBORS):
            other = who[k]
            if other >= 0:
                out[i, c], out[i, c + 1] = 1.0, 1.0 - min(max(far[k], -5.0), FAR_M) / FAR_M
                out[i, c + 2] = (speed[other] - speed[i]) / 10.0
                out[i, c + 3] = accel[other] / 3.0
            c += PER_NEIGHBOR


@in_place()
def _describe_paths(
    on_path: Any, s: Any, length: Any, path_of: Any, stop_state: Any, shown: Any, stop_x: Any,
    stop_row: Any, turn: Any, start: Any, limit: Any, out: Any,
) -> None:  # fmt: skip
    """Write the next stop constraints, the next lower limit, and which way the path turns."""
    (_, stops), (_, lanes) = stop_x.shape, start.shape
    for i in range(s.size):
        if not on_path[i]:
            continue
        path, front, found, c = path_of[i], s[i] + length[i] / 2, 0, AROUND_END
        for g in range(stops):
            room = stop_x[path, g] - front
            if room <= -1.0:
                continue
            if room >= FAR_M or found == STOPS:
                break
            out[i, c + found] = 1.0 - max(room, 0.0) / FAR_M
            for a in range(shown.size):
                state = stop_state[stop_row[path, g], shown[a]]
                first = c + STOPS * (1 + 2 * a) + found
                out[i, first] = state == STOP
                out[i, first + STOPS] = state == STOP_IF_COMFORTABLE
            found += 1
        c += STOPS * (1 + 2 * shown.size)
        for k in range(lanes):
            if limit[path, k] < limit[path, 0] - 0.1 and math.isfinite(start[path, k]):
                out[i, c] = 1.0 - min(max(start[path, k] - s[i], 0.0), FAR_M) / FAR_M
                out[i, c + 1] = limit[path, k] / 20.0
                break
        out[i, c + 2 + turn[path]] = 1.0
