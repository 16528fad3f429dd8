"""Where vehicles may have to stop, and whether they must in the next seconds.

A stop constraint stands before a signal, before a pedestrian crossing and where a movement must
yield. Signals follow their programme where it explains the signals seen; pedestrians are assumed to
walk on at their present velocity, and vehicles with priority to keep their speed.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene.paths import PathTable
from sim.compiled import in_place
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road, lane_coordinates
from sim.road.cells import Cells, boxes_of, cells_of
from sim.road.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
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

CROSSING_CELL_M: Final = 10.0
"""Width of the cells in which crossings are looked for, m (a crossing's length)."""

BESIDE_CROSSING_M, BEYOND_CROSSING_M = 1.0, 0.5
"""A pedestrian this far beside a crossing, or beyond its end, still walks on it."""


class SignalPrograms(NamedTuple):
    """The signal plans of a road as arrays that compiled functions read.

    Attributes:
        group_first: (P + 1,) where the groups of each plan begin in ``group``.
        group: the groups of all plans.
        phase_first: (P + 1,) where the phases of each plan begin in ``duration_s``.
        duration_s: of all phases, s.
        state_first: (P,) where the states of each plan begin in ``state``: phase by phase.
        state: codes into ``SIGNALS``.
        cycle_s: (P,) length of each programme, s.
        offset_s: (P,) s.
    """

    group_first: IntArray
    group: IntArray
    phase_first: IntArray
    duration_s: FloatArray
    state_first: IntArray
    state: StateArray
    cycle_s: FloatArray
    offset_s: FloatArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> SignalPrograms:
        """The programmes of a road, gathered once."""
        plans = road.signal_plans
        states = [np.array(plan.states, dtype=np.int8).ravel() for plan in plans]
        return SignalPrograms(
            group_first=_begins([len(plan.groups) for plan in plans]),
            group=np.array([g for plan in plans for g in plan.groups], dtype=np.int64),
            phase_first=_begins([len(plan.duration_s) for plan in plans]),
            duration_s=np.array([d for plan in plans for d in plan.duration_s], dtype=np.float64),
            state_first=_begins([each.size for each in states]),
            state=np.concatenate([np.empty(0, np.int8), *states]),
            cycle_s=np.array([sum(plan.duration_s) for plan in plans], dtype=np.float64),
            offset_s=np.array([plan.offset_s for plan in plans], dtype=np.float64),
        )


class CrossingArrays(NamedTuple):
    """The crossings of a road, and where lanes meet them, as arrays that compiled functions read.

    Attributes:
        point_first: (C + 1,) where the centre line of each begins in ``points``.
        points: (N, 2) centre lines, m.
        width: (C,) m.
        meet_first: (C + 1,) where the places at which lanes meet each begin in ``meet``.
        meet: places where lanes and crossings meet, rows of the `LaneGraph`'s.
        cells: the crossings by the places at which a pedestrian may be on them.
    """

    point_first: IntArray
    points: FloatArray
    width: FloatArray
    meet_first: IntArray
    meet: IntArray
    cells: Cells

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> CrossingArrays:
        """The crossings of a road, gathered once."""
        graph, lines = LaneGraph.of(road), [crossing.centerline for crossing in road.crossings]
        width = np.array([crossing.width_m for crossing in road.crossings], dtype=np.float64)
        boxes = boxes_of(lines, BEYOND_CROSSING_M)
        reach = width[:, None] / 2 + BESIDE_CROSSING_M
        boxes[:, :2] -= reach
        boxes[:, 2:] += reach
        meet = np.argsort(graph.cross_id, kind="stable")
        return CrossingArrays(
            point_first=_begins([len(line) for line in lines]),
            points=np.concatenate([np.empty((0, 2)), *lines]),
            width=width,
            meet_first=np.searchsorted(graph.cross_id[meet], np.arange(len(lines) + 1)),
            meet=meet,
            cells=cells_of(boxes, np.arange(len(lines)), CROSSING_CELL_M),
        )


def _begins(counts: list[int]) -> IntArray:
    """Where each of several lists begins when they follow each other, and the end."""
    return np.concatenate([[0], np.cumsum(np.array(counts, dtype=np.int64))]).astype(np.int64)


def stop_states(
    history: Tracks, road: Road, paths: PathTable, lane: IntArray, s: FloatArray, path: IntArray,
    steps: int,
) -> StateArray:  # fmt: skip
    """The state of every stop constraint now and at each coming step.

    Signals that no driver can reach stay as they are now.

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
    groups, crossed = paths.kinds.tolist()
    entry = paths.priority.entry
    # constraint tables are padded with row 0, which there must be
    state = np.zeros((max(crossed + entry.size, 1), steps + 1), dtype=np.int8)
    if groups:
        _signals_ahead(history, road, paths, lane, state[:groups])
    if crossed > groups:
        _crossings_ahead(history, road, graph, state[groups:crossed])
    if entry.size:
        state[crossed:][entry] = PREPARE_TO_STOP
        _block_yielding(
            history.speed[:, -1].copy(), history.length.copy(), lane, s, path, paths.columns,
            (paths.priority.foe_first, paths.priority.foe_place, paths.priority.foe_s),
            graph.signal, state[:groups], state[crossed:],
        )  # fmt: skip
    return state


def _signals_ahead(
    history: Tracks, road: Road, paths: PathTable, lane: IntArray, state: StateArray
) -> None:
    """Write the states of the signal groups: by their programmes if these explain the past."""
    groups = len(state)
    known = history.signals.shape[0]
    shown = min(groups, known)
    state[:shown] = OF_SIGNAL[history.signals[:shown, -1:]]
    if road.signal_plans and shown:
        programs = SignalPrograms.of(road)
        past = slice(max(0, history.time_s.size - PROGRAMME_FRAMES), None)
        _follow_programs(
            lane, paths.plans_near, np.ascontiguousarray(history.signals[:, past]),
            history.time_s[past].copy(), programs, OF_SIGNAL,
            np.zeros(programs.cycle_s.size, np.bool_), state,
        )  # fmt: skip


@in_place(inner=True)
def _phase(programs: Any, plan: Any, time_s: float) -> Any:
    """The phase of a plan at a time, as `sim.road.SignalPlan.state_at` finds it."""
    begin, end = programs.phase_first[plan], programs.phase_first[plan + 1]
    into = (time_s - programs.offset_s[plan]) % programs.cycle_s[plan]
    for phase in range(begin, end):
        into -= programs.duration_s[phase]
        if into < -1e-9:
            return phase - begin
    return 0


@in_place()
def _follow_programs(
    lane: Any, plans_near: Any, seen: Any, time_s: Any, programs: Any, of_signal: Any, done: Any,
    state: Any,
) -> None:  # fmt: skip
    """Let the signals near drivers follow their programmes where these explain the past."""
    frames = time_s.size
    for i in range(lane.size):
        if lane[i] < 0:
            continue
        for w in range(plans_near.shape[1]):
            plan = plans_near[lane[i], w]
            if plan < 0:
                break
            if done[plan]:
                continue
            done[plan] = True
            begin, end = programs.group_first[plan], programs.group_first[plan + 1]
            size, states = end - begin, programs.state_first[plan]
            known = size > 0
            for g in range(begin, end):
                known = known and programs.group[g] < seen.shape[0]
            if not known:
                continue
            best, late = -1, 0.0
            for lag in (0.0, STEP_S):
                agree = 0
                for t in range(frames):
                    at = states + _phase(programs, plan, time_s[t] - lag) * size - begin
                    for g in range(begin, end):
                        agree += seen[programs.group[g], t] == programs.state[at + g]
                if agree > best:
                    best, late = agree, lag
                if agree == frames * size:
                    break  # nothing explains more than everything
            if best / (frames * size) < AGREEMENT:
                continue  # the signals follow another programme or another clock
            now = time_s[frames - 1] - late
            for h in range(state.shape[1]):
                at = states + _phase(programs, plan, now + h * STEP_S) * size - begin
                for g in range(begin, end):
                    state[programs.group[g], h] = of_signal[programs.state[at + g]]


def _crossings_ahead(history: Tracks, road: Road, graph: LaneGraph, state: StateArray) -> None:
    """Block the places where lanes meet crossings on which somebody walks."""
    walking = np.flatnonzero(history.kind == PEDESTRIAN)
    if walking.size:
        _block_crossings(
            history.xy[walking, -1], history.heading[walking, -1], history.speed[walking, -1],
            CrossingArrays.of(road), graph.cross_u, graph.width[graph.cross_lane] / 2, state,
        )  # fmt: skip


@in_place()
def _block_crossings(
    xy: Any, heading: Any, speed: Any, crossings: Any, centre: Any, half: Any, state: Any
) -> None:
    """Block the lanes of crossings while pedestrians are in them or about to be."""
    point_first, points = crossings.point_first, crossings.points
    meet_first, meet = crossings.meet_first, crossings.meet
    x0, y0, size, columns, rows, first, items = crossings.cells
    for p in range(len(xy)):
        x, y = xy[p, 0], xy[p, 1]
        column, row = (x - x0) / size, (y - y0) / size
        if not (column >= 0.0 and column < columns and row >= 0.0 and row < rows):
            continue
        cell = int(row) * columns + int(column)
        for k in range(first[cell], first[cell + 1]):
            c = items[k]
            line = points[point_first[c] : point_first[c + 1]]
            u, across, total = lane_coordinates.along_at(line, x, y)
            beside = abs(across) <= crossings.width[c] / 2 + BESIDE_CROSSING_M
            if not (beside and -BEYOND_CROSSING_M < u < total + BEYOND_CROSSING_M):
                continue
            ahead, _, _ = lane_coordinates.along_at(
                line, x + math.cos(heading[p]), y + math.sin(heading[p])
            )
            pace = (ahead - u) * speed[p]
            way = np.sign(pace)
            for h in range(state.shape[1]):
                at = u + pace * (h * STEP_S)
                if not -BEYOND_CROSSING_M < at < total + BEYOND_CROSSING_M:
                    continue
                for m in range(meet_first[c], meet_first[c + 1]):
                    z = meet[m]
                    left = (centre[z] - at) * way
                    coming = left > 0 and left - half[z] <= abs(pace) * PEDESTRIAN_REACH_S
                    if coming or abs(centre[z] - at) <= half[z]:
                        state[z, h] = STOP


@in_place()
def _block_yielding(
    speed: Any, length: Any, lane: Any, s: Any, path: Any, paths: Any, foes: Any,
    entry_signal: Any, signals: Any, state: Any,
) -> None:  # fmt: skip
    """Block yielding places while a vehicle with priority comes."""
    foe_first, foe_place, foe_s = foes
    path_lane, path_start = paths.lane, paths.start
    last = state.shape[1] - 1
    for i in range(lane.size):
        if lane[i] < 0 or not speed[i] > YIELD_TO_MPS:
            continue
        q, pace = path[i], speed[i]
        for k in range(path_lane.shape[1]):
            on = path_lane[q, k]
            if on < 0 or path_start[q, k] - s[i] >= YIELD_WITHIN_M:
                break
            before = False  # of a lane that comes twice the first time counts
            for g in range(k):
                before = before or path_lane[q, g] == on
            if before:
                continue
            for f in range(foe_first[on], foe_first[on + 1]):
                far = path_start[q, k] + foe_s[f] - s[i]
                if not -length[i] < far < YIELD_WITHIN_M:
                    continue
                arrive, leave = far / pace, (far + length[i]) / pace
                if entry_signal[on] >= 0 and k > 0:
                    soon = min(max(int(np.rint(arrive / STEP_S)), 0), last)
                    if signals[entry_signal[on], soon] == STOP:
                        continue
                for h in range(last + 1):
                    if arrive - YIELD_BEFORE_S <= h * STEP_S <= leave:
                        state[foe_place[f], h] = STOP
