"""Where vehicles may have to stop, and whether they must in the next seconds.

A stop constraint stands before a signal, before a pedestrian crossing and where a movement must
yield. Signals follow their programme where it explains the signals seen; pedestrians are assumed to
walk on at their present velocity, and vehicles with priority to keep their speed.
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray, IntArray
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene.paths import PathTable
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road, SignalPlan, lane_search
from sim.road.cells import boxes_of, members
from sim.road.lane_graph import LaneGraph

StateArray = NDArray[np.int8]

PROCEED, STOP_IF_COMFORTABLE, STOP, PREPARE_TO_STOP = 0, 1, 2, 3
"""States of a stop constraint. `PREPARE_TO_STOP`: approach at a speed from which the driver can
stop, until it sees that no vehicle comes."""

YIELD_WITHIN_M = 80.0
"""Vehicles farther away are not yielded to (6 s at 14 m/s)."""

YIELD_BEFORE_S = 2.5
"""A driver that must yield waits for vehicles that arrive within this time, s (the simulated
drivers' largest critical gap)."""

YIELD_TO_MPS = 0.5
"""Slower vehicles are not yielded to (they stand)."""

PEDESTRIAN_REACH_S = 2.0
"""A pedestrian who reaches a lane within this time blocks it already (calibrated gaps at zebras are
2 to 4 s)."""

PROGRAMME_FRAMES: Final = 50
"""Frames over which a signal programme is compared with the signals seen."""

AGREEMENT = 0.9
"""A signal programme is believed if it explains this share of what was seen."""

OF_SIGNAL: Final = np.array([STOP, STOP_IF_COMFORTABLE, PROCEED, PROCEED], dtype=np.int8)
"""State of a stop constraint by the signal's code: red, yellow, green, off."""

BESIDE_CROSSING_M, BEYOND_CROSSING_M = 1.0, 0.5
"""A pedestrian this far beside a crossing, or beyond its end, still walks on it."""


def stop_states(
    history: Tracks, paths: PathTable, lane: IntArray, s: FloatArray, path: IntArray, steps: int
) -> StateArray:
    """(R, steps + 1) states of signals, crossings and yielding places, now and at each step.

    Lanes (n,), distances along them, m, and paths are the agents'; a lane is -1 off the road.
    Signals that no driver can reach stay as they are now.
    """
    road, graph = paths.road, LaneGraph.of(paths.road)
    groups, crossed = paths.kinds.tolist()
    entry = paths.priority.entry
    # constraint tables are padded with row 0, which there must be
    state = np.zeros((max(crossed + entry.size, 1), steps + 1), dtype=np.int8)
    if groups:
        _follow_programs(history, paths, lane, state[:groups])
    if crossed > groups:
        _block_crossings(history, road, graph, state[groups:crossed])
    if entry.size:
        state[crossed:][entry] = PREPARE_TO_STOP
        _block_yielding(history, lane, s, path, paths, state[:groups], state[crossed:])
    return state


def _follow_programs(history: Tracks, paths: PathTable, lane: IntArray, state: StateArray) -> None:
    """Write the states of the signal groups: by their programmes if these explain the past."""
    shown = min(len(state), history.signals.shape[0])
    state[:shown] = OF_SIGNAL[history.signals[:shown, -1:]]
    rows = paths.options_of(np.unique(lane[lane >= 0]))[1]
    ahead = paths.stop_row[rows][np.isfinite(paths.stop_x[rows])]
    met = set(ahead[ahead < shown].tolist())
    time_s = history.time_s[-PROGRAMME_FRAMES:]
    coming = time_s[-1] + np.arange(state.shape[1]) * STEP_S
    for plan in paths.road.signal_plans:
        groups = list(plan.groups)
        if met.isdisjoint(groups) or max(groups) >= shown:
            continue
        seen = history.signals[groups, -PROGRAMME_FRAMES:]
        agree = {lag: (_shown(plan, time_s - lag) == seen).mean() for lag in (0.0, STEP_S)}
        late = max(agree, key=agree.__getitem__)
        if agree[late] >= AGREEMENT:  # else they follow another programme or another clock
            state[groups] = OF_SIGNAL[_shown(plan, coming - late)]


def _shown(plan: SignalPlan, time_s: FloatArray) -> StateArray:
    """(groups, T) codes into ``SIGNALS`` at several times, as `SignalPlan.state_at` finds them."""
    ends = np.cumsum(plan.duration_s)
    phase = np.searchsorted(ends - 1e-9, (time_s - plan.offset_s) % ends[-1], side="right")
    states: StateArray = np.array(plan.states, dtype=np.int8)
    return np.asarray(states[phase % ends.size].T)


@functools.lru_cache(maxsize=32)
def _crossing_boxes(road: Road) -> FloatArray:
    """(C, 4) the boxes in which pedestrians may be on each crossing."""
    boxes = boxes_of([crossing.centerline for crossing in road.crossings], BEYOND_CROSSING_M)
    width = np.array([crossing.width_m for crossing in road.crossings])
    return boxes + (width[:, None] / 2 + BESIDE_CROSSING_M) * [-1.0, -1.0, 1.0, 1.0]


def _block_crossings(history: Tracks, road: Road, graph: LaneGraph, state: StateArray) -> None:
    """Block the lanes of crossings while pedestrians are in them or about to be."""
    walking = np.flatnonzero(history.kind == PEDESTRIAN)
    if not walking.size:
        return
    places, heading = history.xy[walking, -1], history.heading[walking, -1]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    boxes = _crossing_boxes(road)
    near = (places[:, None] >= boxes[:, :2]) & (places[:, None] <= boxes[:, 2:])
    near = near.all(axis=2)
    for c in np.flatnonzero(near.any(axis=0)).tolist():
        who, line = near[:, c], np.array(road.crossings[c].centerline)
        u, across, total = lane_search.along(line, places[who])
        ahead, _, _ = lane_search.along(line, places[who] + facing[who])
        pace = ((ahead - u) * history.speed[walking[who], -1])[:, None]
        at = u[:, None] + pace * np.arange(state.shape[1]) * STEP_S
        beside = np.abs(across) <= road.crossings[c].width_m / 2 + BESIDE_CROSSING_M
        beside &= (u > -BEYOND_CROSSING_M) & (u < total + BEYOND_CROSSING_M)
        on = beside[:, None] & (at > -BEYOND_CROSSING_M) & (at < total + BEYOND_CROSSING_M)
        for z in np.flatnonzero(graph.cross_id == c).tolist():
            half, left = graph.width[graph.cross_lane[z]] / 2, graph.cross_u[z] - at
            left = left * np.where(pace < 0.0, -1.0, 1.0)
            coming = (left > 0.0) & (left - half <= np.abs(pace) * PEDESTRIAN_REACH_S)
            coming &= pace != 0.0
            state[z, (on & (coming | (np.abs(left) <= half))).any(axis=0)] = STOP


def _block_yielding(
    history: Tracks, lane: IntArray, s: FloatArray, path: IntArray, paths: PathTable,
    signals: StateArray, state: StateArray,
) -> None:  # fmt: skip
    """Block yielding places while a vehicle with priority comes."""
    priority, graph = paths.priority, LaneGraph.of(paths.road)
    comes = np.flatnonzero((lane >= 0) & (history.speed[:, -1] > YIELD_TO_MPS))
    lanes, until = paths.lane[path[comes]], paths.start[path[comes]] - s[comes, None]
    row, place = np.nonzero((lanes >= 0) & (until < YIELD_WITHIN_M))
    on = lanes[row, place]
    _, once = np.unique(row * graph.length.size + on, return_index=True)  # the first time counts
    row, place, on = row[once], place[once], on[once]
    first = priority.foe_first
    which, foe = members(first[on], first[on + 1] - first[on])
    row, place, on = row[which], place[which], on[which]
    far, length = until[row, place] + priority.foe_s[foe], history.length[comes[row]]
    speed = history.speed[comes[row], -1]
    arrive, leave = far / speed, (far + length) / speed
    blocks = (far > -length) & (far < YIELD_WITHIN_M)
    if len(signals):
        soon = np.clip(np.rint(arrive / STEP_S).astype(np.int64), 0, signals.shape[1] - 1)
        red = signals[graph.signal[on], soon] == STOP
        blocks &= ~(red & (graph.signal[on] >= 0) & (place > 0))
    time_s = np.arange(state.shape[1]) * STEP_S
    waits = (arrive[:, None] - YIELD_BEFORE_S <= time_s) & (time_s <= leave[:, None])
    pair, step = np.nonzero(waits & blocks[:, None])
    state[priority.foe_place[foe[pair]], step] = STOP
