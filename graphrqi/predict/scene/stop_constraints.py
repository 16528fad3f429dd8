"""Where vehicles may have to stop, and whether they must in the next seconds.

A stop constraint stands before a signal, before a pedestrian crossing and where a movement must
yield. Signals follow their programme where it explains the signals seen; pedestrians are assumed to
walk on at their present velocity, and vehicles with priority to keep their speed.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene.paths import PathTable
from sim.compiled import compiled
from sim.frames import PEDESTRIAN, Signal, Tracks
from sim.road import Road, lane_search
from sim.road.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
StateArray = NDArray[np.int8]

PROCEED, STOP_IF_COMFORTABLE, STOP, PREPARE_TO_STOP = 0, 1, 2, 3
"""States of a stop constraint. `PREPARE_TO_STOP`: approach at a speed from which one can stop,
until one is near enough to see that nobody comes."""

YIELD_WITHIN_M: Final = 80.0
"""Vehicles farther away are not yielded to (our choice: 6 s at 14 m/s)."""

YIELD_BEFORE_S: Final = 2.5
"""A driver that must yield waits for vehicles that arrive within this time (our choice; critical
gaps at junctions are 4 to 6 s for the average driver (HCM), and these drivers' are 0.1 to 2.5
s)."""

PEDESTRIAN_REACH_S = 2.0
"""A pedestrian who reaches a lane within this time blocks it already (our choice; calibrated gaps
at zebras are 2 to 4 s)."""

PROGRAMME_FRAMES: Final = 50
"""Frames over which a signal programme is compared with the signals seen (our choice)."""


def stop_states(
    history: Tracks, road: Road, paths: PathTable, lane: IntArray, s: FloatArray, path: IntArray,
    steps: int,
) -> StateArray:  # fmt: skip
    """The state of every stop constraint now and at each coming step.

    Args:
        history: tracks whose last column is the present.
        road: where it happens.
        paths: its paths.
        lane: (n,) lane of each agent, -1 off the road.
        s: (n,) distance along it, m.
        path: (n,) path that each takes.
        steps: how many steps of `STEP_S` are foreseen.

    Returns:
        (R, steps + 1) states of signals, of crossings and of yielding places, in this order.
    """
    graph = LaneGraph.of(road)
    signals = _signals_ahead(history, road, steps)
    crossings = _crossings_ahead(history, road, graph, steps)
    yields = _yields_ahead(history, paths, lane, s, path, signals, graph.signal)
    nothing = np.zeros((1, steps + 1), dtype=np.int8)  # constraint tables are padded with row 0
    whole = np.concatenate([signals, crossings, yields])
    return whole if whole.size else nothing


def _signals_ahead(history: Tracks, road: Road, steps: int) -> StateArray:
    """States of each signal group: by its programme if that explains the past, else as now."""
    groups = len(road.signal_groups)
    known = history.signals.shape[0]
    state = np.full((groups, steps + 1), Signal.OFF.code, dtype=np.int8)
    shown = min(groups, known)
    state[:shown] = history.signals[:shown, -1:]
    past = slice(max(0, history.time_s.size - PROGRAMME_FRAMES), None)
    for plan in road.signal_plans:
        rows = np.array(plan.groups, dtype=np.int64)
        if not rows.size or rows.max() >= known:
            continue
        seen = history.signals[rows, past]
        # a frame shows the signals of its own time or, in some sources, of one step before
        agrees = {
            lag: (seen == np.array([plan.state_at(float(t) - lag) for t in history.time_s[past]]).T)
            for lag in (0.0, STEP_S)
        }
        lag = max(agrees, key=lambda lag: agrees[lag].mean())
        if agrees[lag].mean() < 0.9:
            continue  # the signals follow another programme or another clock
        now = float(history.time_s[-1]) - lag
        state[rows] = np.array([plan.state_at(now + h * STEP_S) for h in range(steps + 1)]).T
    # red, yellow, green, off
    of_signal = np.array([STOP, STOP_IF_COMFORTABLE, PROCEED, PROCEED], dtype=np.int8)
    return of_signal[state]


def _crossings_ahead(history: Tracks, road: Road, graph: LaneGraph, steps: int) -> StateArray:
    """States of each place where a lane meets a crossing: blocked while someone walks there."""
    state = np.zeros((graph.cross_lane.size, steps + 1), dtype=np.int8)
    walking = np.flatnonzero(history.kind == PEDESTRIAN)
    if not walking.size or not graph.cross_lane.size:
        return state
    half = graph.width[graph.cross_lane] / 2
    xy, heading = history.xy[walking, -1], history.heading[walking, -1]
    speed = history.speed[walking, -1]
    for c, crossing in enumerate(road.crossings):
        rows = np.flatnonzero(graph.cross_id == c)
        _block_crossing(
            crossing.centerline, crossing.width_m, xy, heading, speed, rows, graph.cross_u[rows],
            half[rows], state,
        )  # fmt: skip
    return state


@compiled
def _block_crossing(
    line: Any, width: float, xy: Any, heading: Any, speed: Any, rows: Any, centre: Any, half: Any,
    state: Any,
) -> None:  # fmt: skip
    """Block the lanes of one crossing while pedestrians are in them or about to be.

    Pedestrians walk on at their present velocity. One blocks a lane while within its width, or
    walking towards it and at most `PEDESTRIAN_REACH_S` away.

    Args:
        line: (P, 2) the crossing's centre line, m.
        width: its width, m.
        xy: (p, 2) pedestrians, m.
        heading: (p,) rad.
        speed: (p,) m/s.
        rows: (z,) rows of ``state`` that belong to it.
        centre: (z,) where along the crossing each lane has its centre, m.
        half: (z,) half of the lane's width, m.
        state: (Z, H + 1) receives `STOP` where a lane is blocked.
    """
    for p in range(len(xy)):
        x, y = xy[p, 0], xy[p, 1]
        u, across, total = lane_search.along_at(line, x, y)
        if not (abs(across) <= width / 2 + 1.0 and -0.5 < u < total + 0.5):
            continue
        ahead, _, _ = lane_search.along_at(line, x + math.cos(heading[p]), y + math.sin(heading[p]))
        pace = (ahead - u) * speed[p]
        way = np.sign(pace)
        for h in range(state.shape[1]):
            at = u + pace * (h * STEP_S)
            if not -0.5 < at < total + 0.5:
                continue
            for z in range(rows.size):
                left = (centre[z] - at) * way
                coming = left > 0 and left - half[z] <= abs(pace) * PEDESTRIAN_REACH_S
                if coming or abs(centre[z] - at) <= half[z]:
                    state[rows[z], h] = STOP


def _yields_ahead(
    history: Tracks, paths: PathTable, lane: IntArray, s: FloatArray, path: IntArray,
    signals: StateArray, entry_signal: IntArray,
) -> StateArray:  # fmt: skip
    """States of each yielding place: blocked while a vehicle with priority comes.

    Vehicles with priority keep their speed and take the given paths.
    """
    places, steps = paths.yield_entry.size, signals.shape[1] - 1
    first = np.where(paths.yield_entry, PREPARE_TO_STOP, PROCEED).astype(np.int8)[:, None]
    state = np.repeat(first, steps + 1, axis=1)
    time_s = np.arange(steps + 1) * STEP_S
    rows = np.flatnonzero(lane >= 0)
    if not rows.size or not places:
        return state
    chain, start = paths.lane[path[rows]], paths.start[path[rows]]
    speed, length = history.speed[rows, -1], history.length[rows]
    for place, foe, at in zip(paths.foe_place, paths.foe_lane, paths.foe_s, strict=True):
        meets = chain == foe
        who = np.flatnonzero(meets.any(axis=1))
        if not who.size:
            continue
        where = meets[who].argmax(axis=1)
        far = start[who, where] + at - s[rows[who]]
        pace, size = np.maximum(speed[who], 0.5), length[who]
        near = (far > -size) & (far < YIELD_WITHIN_M) & (speed[who] > 0.5)
        arrive, leave = far / pace, (far + size) / pace
        if entry_signal[foe] >= 0:
            soon = np.clip(np.round(arrive / STEP_S).astype(np.int64), 0, steps)
            near &= ~((signals[entry_signal[foe], soon] == STOP) & (where > 0))
        busy = (arrive[:, None] - YIELD_BEFORE_S <= time_s) & (time_s <= leave[:, None])
        state[place] = np.where((busy & near[:, None]).any(axis=0), STOP, state[place])
    return state
