"""Signals, crossings and yielding places: whether each can be passed in the next seconds.

Signals follow their programme where that explains what was seen; pedestrians are taken to walk on
as they do, and those with priority to keep their speed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene import stop_constraints_kernel
from graphrqi.predict.scene.paths import PathTable
from sim.frames import PEDESTRIAN, Signal, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OPEN, CLOSING, CLOSED, LOOKING = 0, 1, 2, 3
"""States of a gate: pass; stop if that is comfortable; stop; approach ready to stop until one can
see that nobody comes."""

YIELD_WITHIN_M: Final = 80.0
"""Nobody farther away is yielded to (our choice: 6 s at 14 m/s)."""

YIELD_BEFORE_S: Final = 2.5
"""Who must yield waits for those who will be there within this time (our choice; critical gaps at
junctions are 4 to 6 s for the average driver (HCM), and these drivers' are 0.1 to 2.5 s)."""

PEDESTRIAN_REACH_S: Final = 2.0
"""A pedestrian who will be in a lane within this time already blocks it (our choice; calibrated
gaps at zebras are 2 to 4 s)."""


def _yields_ahead(
    paths: PathTable,
    lane: IntArray,
    s: FloatArray,
    path: IntArray,
    history: Tracks,
    signals: NDArray[np.int8],
    entry_signal: IntArray,
    steps: int,
) -> NDArray[np.int8]:
    """Gate states of each place where one yields: closed while someone with priority comes.

    Those with priority are taken to keep their speed and to go straight where they can.
    """
    gates = paths.yield_entry.size
    state = np.where(paths.yield_entry, LOOKING, OPEN).astype(np.int8)[:, None]
    closed = np.repeat(state, steps + 1, axis=1)
    time_s = np.arange(steps + 1) * STEP_S
    speed = history.speed[:, -1]
    rows = np.flatnonzero(lane >= 0)
    if not rows.size or not gates:
        return closed
    chain, start = paths.lane[path[rows]], paths.start[path[rows]]
    for gate, foe, at in zip(paths.foe_gate, paths.foe_lane, paths.foe_s, strict=True):
        meets = chain == foe
        who = np.flatnonzero(meets.any(axis=1))
        if not who.size:
            continue
        where = meets[who].argmax(axis=1)
        far = start[who, where] + at - s[rows[who]]
        pace, size = speed[rows[who]], history.length[rows[who]]
        near = (far > -size) & (far < YIELD_WITHIN_M) & (pace > 0.5)
        arrive = far / np.maximum(pace, 0.5)
        leave = (far + size) / np.maximum(pace, 0.5)
        if entry_signal[foe] >= 0:
            soon = np.clip(np.round(arrive / STEP_S).astype(np.int64), 0, steps)
            red = (signals[entry_signal[foe], soon] == CLOSED) & (where > 0)
            near &= ~red
        busy = (arrive[:, None] - YIELD_BEFORE_S <= time_s) & (time_s <= leave[:, None])
        closed[gate] = np.where((busy & near[:, None]).any(axis=0), CLOSED, closed[gate])
    return closed


def gates_to_come(
    history: Tracks, road: Road, graph: LaneGraph, paths: PathTable, lane: IntArray, s: FloatArray,
    path: IntArray, steps: int,
) -> NDArray[np.int8]:  # fmt: skip
    """(R, steps + 1) states to come of signals, of crossings and of yielding places."""
    signals = _signals_ahead(history, road, steps)
    crossings = _crossings_ahead(history, road, graph, steps)
    yields = _yields_ahead(paths, lane, s, path, history, signals, graph.signal, steps)
    nothing = np.zeros((1, steps + 1), dtype=np.int8)  # gate tables are padded with row 0
    whole = np.concatenate([signals, crossings, yields])
    return whole if whole.size else nothing


def _signals_ahead(history: Tracks, road: Road, steps: int) -> NDArray[np.int8]:
    """Gate states of each signal group: by its programme if that explains the past, else held."""
    groups = len(road.signal_groups)
    known = history.signals.shape[0]
    state = np.full((groups, steps + 1), Signal.OFF.code, dtype=np.int8)
    shown = min(groups, known)
    state[:shown] = history.signals[:shown, -1:]
    past = slice(max(0, history.time_s.size - 50), None)  # 50 frames tell a wrong clock: our choice
    for plan in road.signal_plans:
        rows = np.array(plan.groups, dtype=np.int64)
        if not rows.size or rows.max() >= known:
            continue
        seen = history.signals[rows, past]
        told = np.array([plan.state_at(float(t) - STEP_S) for t in history.time_s[past]]).T
        late = np.array([plan.state_at(float(t)) for t in history.time_s[past]]).T
        lag = 0.0 if (late == seen).mean() >= (told == seen).mean() else STEP_S
        if max((late == seen).mean(), (told == seen).mean()) < 0.9:
            continue  # the lights follow another programme or another clock
        now = float(history.time_s[-1]) - lag
        state[rows] = np.array([plan.state_at(now + h * STEP_S) for h in range(steps + 1)]).T
    gate = np.array([CLOSED, CLOSING, OPEN, OPEN], dtype=np.int8)  # red, yellow, green, off
    return gate[state]


def _crossings_ahead(history: Tracks, road: Road, graph: LaneGraph, steps: int) -> NDArray[np.int8]:
    """Gate states of each place where a lane meets a crossing: closed while someone walks there.

    Pedestrians are taken to walk on as they do. One blocks a lane while within reach of it or
    walking towards it and at most `PEDESTRIAN_REACH_S` away.
    """
    closed = np.zeros((graph.cross_lane.size, steps + 1), dtype=np.int8)
    walking = np.flatnonzero(history.kind == PEDESTRIAN)
    if not walking.size or not graph.cross_lane.size:
        return closed
    half = graph.width[graph.cross_lane] / 2
    xy, heading = history.xy[walking, -1], history.heading[walking, -1]
    speed = history.speed[walking, -1]
    for c, crossing in enumerate(road.crossings):
        gates = np.flatnonzero(graph.cross_id == c)
        stop_constraints_kernel.close_crossing(
            crossing.centerline, crossing.width_m, xy, heading, speed, gates, graph.cross_u[gates],
            half[gates], PEDESTRIAN_REACH_S, STEP_S, CLOSED, closed,
        )  # fmt: skip
    return closed
