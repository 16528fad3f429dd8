"""The present as a predictor needs it: drivers on their paths, gates and pedestrians foreseen.

A `Scene` is made once per instant and shared by all predictors, so that they differ only in what
they do with it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.paths import PathTable
from graphrqi.predict.prediction import Prediction
from sim.frames import PEDESTRIAN, Signal, Tracks
from sim.lane_graph import LaneGraph
from sim.observables import Observables, along, observe
from sim.road import Road

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

STEP_S: Final = 0.1
"""Time between predicted places, s: the simulators' usual step."""

LEARNED_S: Final = 5.0
"""Horizon that the learned predictors are made for, s."""

LONGEST_S: Final = 30.0
"""Longest horizon answered, s (our choice: beyond it nothing is known)."""

ACCELERATION_WINDOW_S: Final = 0.5
"""Over which a driver's present acceleration is taken (our choice: shorter is noise)."""

RETURN_MPS: Final = 0.5
"""Speed at which a driver off its lane's centre returns to it at least (our choice)."""

CHANGING_MPS: Final = 0.25
"""Faster sideways than this one is changing lanes (our choice; a change of 3.2 m takes 3 to 6 s,
and keeping a lane drifts at less than 0.2 m/s)."""

CHANGING_FROM_M: Final = 0.3
"""... unless still this far on the other side of the lane's centre (our choice)."""

PAST_EVERY_S: Final = 1.0
"""How far apart the past is looked at to learn a driver's wishes, s (our choice)."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""Driving freely: this far behind the leader in time and from anything ahead in space, and with
so little acceleration (our choice; HCM calls a headway over 3 to 4 s free)."""

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


@dataclass(frozen=True, eq=False)
class Scene:
    """One instant, ready to be driven on; rows are the agents of the history.

    Attributes:
        history: what was seen; its last column is the present.
        road: where.
        graph: its lanes.
        paths: its paths.
        steps: how many steps of `STEP_S` are predicted.
        on_path: (n,) whether the agent drives along a lane.
        lane: (n,) lane of each, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        sideways: (n,) speed to the left, m/s.
        accel: (n,) present acceleration, m/s2.
        path: (n,) most likely path of each agent, row of the road's `PathTable`.
        closed: (R, steps + 1) state of every gate at each step to come.
        free_factor: (n,) speed over limit when last seen driving steadily with nothing ahead; NaN
            if never.
        least_factor: (n,) largest speed over limit seen: nobody drives faster than it wants to.
        seen: what could be seen of the traffic at present, (n,) each.
    """

    history: Tracks
    road: Road
    graph: LaneGraph
    paths: PathTable
    steps: int
    on_path: BoolArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray
    sideways: FloatArray
    accel: FloatArray
    path: IntArray
    closed: NDArray[np.int8]
    free_factor: FloatArray
    least_factor: FloatArray
    seen: Observables

    @property
    def ids(self) -> IntArray:
        """(n,) agent ids."""
        return self.history.ids

    @property
    def xy(self) -> FloatArray:
        """(n, 2) present places, m."""
        return np.asarray(self.history.xy[:, -1], dtype=np.float64)

    @property
    def speed(self) -> FloatArray:
        """(n,) present speeds, m/s."""
        return np.asarray(self.history.speed[:, -1], dtype=np.float64)

    @property
    def heading(self) -> FloatArray:
        """(n,) present headings, rad."""
        return np.asarray(self.history.heading[:, -1], dtype=np.float64)

    @cached_property
    def time_s(self) -> FloatArray:
        """(H,) seconds from the present of each predicted place."""
        return np.arange(1, self.steps + 1, dtype=np.float64) * STEP_S

    def offsets(self) -> FloatArray:
        """(n, H) distance to the left of the lane: drivers move to its centre and stay, m."""
        pace = np.maximum(np.abs(self.sideways), RETURN_MPS)
        left = np.maximum(np.abs(self.offset)[:, None] - pace[:, None] * self.time_s[None], 0.0)
        return np.asarray(np.sign(self.offset)[:, None] * left)

    def straight_on(
        self, who: BoolArray | slice = slice(None), time_s: FloatArray | None = None
    ) -> FloatArray:
        """(n, H, 2) everyone, or some, at constant velocity, at the predicted or other times, m."""
        heading = self.heading[who]
        facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        travelled = self.speed[who, None] * (self.time_s if time_s is None else time_s)
        return np.asarray(self.xy[who, None] + travelled[..., None] * facing[:, None])

    def predicted(self, xy: FloatArray, probability: FloatArray | None = None) -> Prediction:
        """A `Prediction` of these agents; ``xy`` (n, H, 2) for one future or (n, K, H, 2)."""
        futures = xy[:, None] if xy.ndim == 3 else xy
        if probability is None:
            probability = np.full(futures.shape[:2], 1.0 / futures.shape[1])
        return Prediction(self.ids, self.time_s, futures, probability)

    def with_path(self, path: IntArray) -> Scene:
        """The same scene with other paths taken."""
        return dataclasses.replace(self, path=path)


def check_horizon(horizon_s: float) -> None:
    """Refuse a horizon that is shorter than a step or longer than `LONGEST_S`."""
    if not STEP_S <= horizon_s <= LONGEST_S:
        raise InputError(
            f"horizon_s: found {horizon_s}, expected seconds from {STEP_S} to {LONGEST_S:g}"
        )


def make_scene(history: Tracks, road: Road, horizon_s: float = 5.0) -> Scene:
    """Read the present from a history.

    Args:
        history: tracks whose last column is the present; agents seen there are kept.
        road: where it happens.
        horizon_s: how far ahead to look, s.

    Returns:
        The scene of the agents present now.

    Raises:
        InputError: if the horizon is shorter than a step or the history is empty.
    """
    check_horizon(horizon_s)
    if history.time_s.size == 0:
        raise InputError("history: found no frame, expected at least 1")
    if not history.valid[:, -1].all():
        history = history.window(history.time_s.size, history.time_s.size)
    steps = round(horizon_s / STEP_S)
    graph, paths = LaneGraph.of(road), PathTable.of(road)
    xy, heading = history.xy[:, -1], history.heading[:, -1]
    drives = history.kind != PEDESTRIAN
    n = history.ids.size
    lane, s, offset = np.full(n, -1), np.zeros(n), np.zeros(n)
    sideways = np.zeros(n)
    if drives.any():
        found = road.project(xy[drives], heading[drives])
        place, facing = graph.position(found.lane, found.s, found.offset)
        near = np.abs(found.offset) <= graph.width[found.lane] / 2 + 1.0  # a metre: our choice
        near &= np.hypot(*(xy[drives] - place).T) < 2.0  # beyond a lane's end: our choice
        near &= np.cos(heading[drives] - facing) > 0.5  # not across or against: our choice
        lane[drives] = np.where(near, found.lane, -1)
        s[drives], offset[drives] = found.s, found.offset
        sideways[drives] = _sideways(history, facing, drives)
        lane, offset = _changing(graph, lane, offset, sideways)
    on_path = lane >= 0
    free, least, seen = _wishes(history, road)
    path = np.where(on_path, paths.likeliest[np.maximum(lane, 0)], 0)
    return Scene(
        history=history,
        road=road,
        graph=graph,
        paths=paths,
        steps=steps,
        on_path=on_path,
        lane=lane,
        s=s,
        offset=offset,
        sideways=sideways,
        accel=_acceleration(history),
        path=path,
        closed=_gates(history, road, graph, paths, lane, s, path, steps),
        free_factor=free,
        least_factor=least,
        seen=seen,
    )


def _recent(history: Tracks) -> tuple[IntArray, FloatArray]:
    """(n,) column at which each agent's last half second seen begins, and (n,) its length, s."""
    age = history.time_s[-1] - history.time_s
    recent = history.valid & (age <= ACCELERATION_WINDOW_S + 1e-6)[None]
    first = recent.argmax(axis=1)
    return first, age[first]


def _acceleration(history: Tracks) -> FloatArray:
    """(n,) present acceleration from the last half second seen, m/s2; 0 where unknown."""
    first, span = _recent(history)
    row = np.arange(history.ids.size)
    change = history.speed[:, -1] - history.speed[row, first]
    return np.asarray(np.divide(change, span, out=np.zeros(row.size), where=span > 1e-6))


def _wishes(history: Tracks, road: Road) -> tuple[FloatArray, FloatArray, Observables]:
    """(n,) speed over limit when free and steady (NaN: never); (n,) the largest; the present."""
    every = max(1, round(PAST_EVERY_S / history.step_s)) if history.time_s.size > 1 else 1
    columns = np.arange(history.time_s.size - 1, -1, -every)[::-1]
    past = at_columns(history, columns)
    seen = observe(past, road)
    ratio = np.where(seen.on_road, past.speed / seen.limit, np.nan)
    change = np.full(ratio.shape, np.nan)
    change[:, 1:] = np.diff(past.speed, axis=1) / np.diff(past.time_s)
    free = (
        (seen.gap > np.maximum(FREE_HEADWAY_S * past.speed, FREE_GAP_M))
        & (np.minimum(seen.crossing_distance, seen.stop_distance) > FREE_GAP_M)
        & (np.abs(change) < STEADY_MPS2)
    )
    count = free.sum(axis=1)
    total = np.where(free, ratio, 0.0).sum(axis=1)
    wished = np.divide(total, count, out=np.full(count.size, np.nan), where=count > 0)
    least = np.where(np.isnan(ratio), 0.0, ratio).max(axis=1, initial=0.0)
    now = Observables(**{f.name: getattr(seen, f.name)[:, -1] for f in dataclasses.fields(seen)})
    return wished, least, now


def at_columns(tracks: Tracks, columns: IntArray) -> Tracks:
    """The same agents at some of the times only."""
    return dataclasses.replace(
        tracks,
        time_s=tracks.time_s[columns],
        xy=tracks.xy[:, columns],
        heading=tracks.heading[:, columns],
        speed=tracks.speed[:, columns],
        valid=tracks.valid[:, columns],
        signals=tracks.signals[:, columns],
    )


def _sideways(history: Tracks, facing: FloatArray, drives: BoolArray) -> FloatArray:
    """Speed to the left of the lane over the last half second seen, m/s; 0 where unknown."""
    first, span = _recent(history)
    row = np.flatnonzero(drives)
    moved = history.xy[row, -1] - history.xy[row, first[row]]
    left = moved[:, 1] * np.cos(facing) - moved[:, 0] * np.sin(facing)
    return np.asarray(np.divide(left, span[row], out=np.zeros(row.size), where=span[row] > 1e-6))


def _changing(
    graph: LaneGraph, lane: IntArray, offset: FloatArray, sideways: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Put drivers that move sideways out of their lane onto the lane that they move to."""
    changed, moved = lane.copy(), offset.copy()
    for beside, sign in ((graph.left, 1.0), (graph.right, -1.0)):
        to = np.where(lane >= 0, beside[lane], -1)
        going = (to >= 0) & (sign * sideways > CHANGING_MPS) & (sign * offset > -CHANGING_FROM_M)
        changed[going] = to[going]
        apart = (graph.width[lane[going]] + graph.width[to[going]]) / 2
        moved[going] = offset[going] - sign * apart
    return changed, moved


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


def _gates(
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
    time_s = np.arange(steps + 1) * STEP_S
    xy, heading = history.xy[walking, -1], history.heading[walking, -1]
    speed = history.speed[walking, -1]
    ahead_xy = xy + np.stack([np.cos(heading), np.sin(heading)], axis=1)
    for c, crossing in enumerate(road.crossings):
        u, across, total = along(crossing.centerline, xy)
        u_ahead, _, _ = along(crossing.centerline, ahead_xy)
        near = (np.abs(across) <= crossing.width_m / 2 + 1.0) & (u > -0.5) & (u < total + 0.5)
        if not near.any():
            continue
        u, pace = u[near], ((u_ahead - u) * speed)[near]
        at = u[:, None] + pace[:, None] * time_s[None]
        walks = (at > -0.5) & (at < total + 0.5)
        for z in np.flatnonzero(graph.cross_id == c):
            half = graph.width[graph.cross_lane[z]] / 2
            left = (graph.cross_u[z] - at) * np.sign(pace)[:, None]
            within = np.abs(graph.cross_u[z] - at) <= half
            coming = (left > 0) & (left - half <= np.abs(pace)[:, None] * PEDESTRIAN_REACH_S)
            closed[z] = np.where((walks & (within | coming)).any(axis=0), CLOSED, closed[z])
    return closed
