"""What the learned predictors know of each driver, as numbers.

The same sources as the rollouts use: the driver's own past, its lane and limit, leaders and
followers on its lane and beside it, signals, crossings and yielding places ahead. Whatever depends
on who drives how (beliefs, rollouts with their numbers) is kept apart, so that a predictor can do
without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.scene import CLOSED, CLOSING, Scene
from sim.observables import LaneTraffic

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PAST_S: Final = tuple(0.5 * i for i in range(1, 10))
"""How long ago the own past is looked at, s."""

AHEAD_S: Final = (0.0, 1.0, 2.0, 3.0, 5.0)
"""When the gates ahead are looked at, s."""

FAR_M: Final = 100.0
"""Distances are cut off here and divided by it (our choice)."""

GATES: Final = 3
"""How many gates ahead are looked at."""

NEIGHBORS: Final = 7
"""How many neighbours are looked at (`neighbors`)."""

PER_NEIGHBOR: Final = 4
"""Numbers per neighbour."""

STATE: Final = 13
"""Numbers of the own state."""

PAST: Final = slice(STATE, STATE + 3 * len(PAST_S))
AROUND: Final = slice(PAST.stop, PAST.stop + NEIGHBORS * PER_NEIGHBOR)
"""Where the own past and the neighbours stand among the features."""


@dataclass(frozen=True, slots=True)
class Neighbor:
    """Someone near each driver: bumper to bumper gap, relative speed and acceleration, or nobody.

    Attributes:
        row: (n,) who, -1 for nobody.
        gap: (n,) m, +inf for nobody.
    """

    row: IntArray
    gap: FloatArray

    def numbers(self, scene: Scene) -> FloatArray:
        """(n, 4) presence, nearness, relative speed over 10 m/s, acceleration over 3 m/s2."""
        here = self.row >= 0
        who = np.maximum(self.row, 0)
        speed = np.where(here, scene.speed[who] - scene.speed, 0.0)
        accel = np.where(here, scene.accel[who], 0.0)
        near = 1.0 - np.clip(self.gap, -5.0, FAR_M) / FAR_M
        return np.stack([here, np.where(here, near, 0.0), speed / 10.0, accel / 3.0], axis=1)


def neighbors(scene: Scene) -> list[Neighbor]:
    """Leader, its leader, follower, and those ahead and behind on the left and on the right."""
    seen, graph = scene.seen, scene.graph
    n = scene.ids.size
    nobody = np.full(n, -1)
    leader = seen.leader
    second = np.where(leader >= 0, leader[np.maximum(leader, 0)] if n else nobody, -1)
    length = scene.history.length
    second_gap = np.full(n, np.inf)
    has = second >= 0
    second_gap[has] = seen.gap[has] + seen.gap[leader[has]] + length[leader[has]]
    follower = seen.follower
    behind_gap = np.full(n, np.inf)
    behind_gap[follower >= 0] = seen.gap[follower[follower >= 0]]
    found = [
        Neighbor(leader, seen.gap),
        Neighbor(second, second_gap),
        Neighbor(follower, behind_gap),
    ]
    now = np.zeros(n, dtype=np.int64)
    lane = np.where(seen.on_road, seen.lane, -1)
    traffic = LaneTraffic.of(graph, now, lane, np.nan_to_num(seen.s))
    for beside in (graph.left, graph.right):
        other = np.where(lane >= 0, beside[np.maximum(lane, 0)], -1)
        for search in (traffic.ahead, traffic.behind):
            row, distance = search(now, other, np.nan_to_num(seen.s))
            gap = distance - (length + length[np.maximum(row, 0)]) / 2 if n else distance
            found.append(Neighbor(row, gap))
    return found


def own_past(scene: Scene) -> FloatArray:
    """(n, 3 P) at each time of `PAST_S`: seen or not, speed then less now, turned since, scaled."""
    history = scene.history
    parts = []
    for ago in PAST_S:
        column = int(np.searchsorted(history.time_s, history.time_s[-1] - ago - 1e-6))
        there = history.valid[:, column] & (history.time_s[0] <= history.time_s[-1] - ago + 1e-6)
        speed = np.where(there, history.speed[:, column] - scene.speed, 0.0)
        turned = np.where(there, np.sin(scene.heading - history.heading[:, column]), 0.0)
        parts += [there.astype(np.float64), speed / 5.0, turned]
    return np.stack(parts, axis=1)


def gates_ahead(scene: Scene) -> FloatArray:
    """(n, GATES (1 + 2 len(AHEAD_S))) nearness and states to come of the next gates on the path."""
    paths = scene.paths
    front = scene.s + scene.history.length / 2
    room = paths.gate_x[scene.path] - front[:, None]
    room = np.where(scene.on_path[:, None] & (room > -1.0), room, np.inf)
    order = np.argsort(room, axis=1, kind="stable")[:, :GATES]
    if order.shape[1] < GATES:
        order = np.pad(order, ((0, 0), (0, GATES - order.shape[1])))
    row = np.take_along_axis(paths.gate_row[scene.path], order, axis=1)
    room = np.take_along_axis(room, order, axis=1)
    room[:, paths.gate_x.shape[1] :] = np.inf
    near = room < FAR_M
    parts = [np.where(near, 1.0 - np.clip(room, 0.0, FAR_M) / FAR_M, 0.0)]
    for ahead in AHEAD_S:
        state = scene.closed[row, min(round(ahead / 0.1), scene.steps)]
        parts.append((near & (state == CLOSED)).astype(np.float64))
        parts.append((near & (state == CLOSING)).astype(np.float64))
    return np.concatenate(parts, axis=1)


def way_ahead(scene: Scene) -> FloatArray:
    """(n, 6) nearness and size of the next lower limit, and which way the path turns."""
    paths = scene.paths
    limit, start = paths.limit[scene.path], paths.start[scene.path]
    lower = (limit < limit[:, :1] - 0.1) & np.isfinite(start)
    first = lower.argmax(axis=1)
    row = np.arange(first.size)
    some = lower.any(axis=1) & scene.on_path
    room = np.where(some, start[row, first] - scene.s, np.inf)
    near = np.where(some, 1.0 - np.clip(room, 0.0, FAR_M) / FAR_M, 0.0)
    turn = np.eye(4)[paths.turn[scene.path]] * scene.on_path[:, None]
    low = np.where(some, limit[row, first] / 20.0, 0.0)
    return np.concatenate([near[:, None], low[:, None], turn], axis=1)


def own_state(scene: Scene) -> FloatArray:
    """(n, 13) speed, acceleration, limit, place on the lane, lanes beside, wishes seen so far."""
    graph = scene.graph
    seen = scene.seen
    lane = np.maximum(scene.lane, 0)
    limit = np.where(scene.on_path, graph.limit[lane], 0.0)
    free = np.isfinite(scene.free_factor)
    to_end = np.clip(graph.length[lane] - scene.s, 0.0, FAR_M) / FAR_M
    return np.stack(
        [
            scene.speed / 10.0,
            scene.accel / 3.0,
            limit / 20.0,
            scene.speed / np.maximum(limit, 1.0),
            scene.offset / 3.0,
            scene.sideways,
            scene.history.length / 10.0,
            scene.on_path,
            (graph.left[lane] >= 0) & scene.on_path,
            (graph.right[lane] >= 0) & scene.on_path,
            np.where(free, scene.free_factor, 0.0),
            scene.least_factor,
            np.where(seen.on_road & graph.internal[lane], 0.0, to_end),
        ],
        axis=1,
    ).astype(np.float64)


def features(scene: Scene) -> FloatArray:
    """(n, F) everything that can be known of each driver without knowing how it drives."""
    around = np.concatenate([x.numbers(scene) for x in neighbors(scene)], axis=1)
    return np.concatenate(
        [own_state(scene), own_past(scene), around, gates_ahead(scene), way_ahead(scene)], axis=1
    )
