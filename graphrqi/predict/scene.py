"""The present as a predictor needs it: drivers on their paths, gates and pedestrians foreseen.

A `Scene` is made once per instant and shared by all predictors, so that they differ only in what
they do with it.
"""

from __future__ import annotations

import dataclasses
import warnings
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
from sim.observables import along, observe
from sim.road import Road

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

STEP_S: Final = 0.1
"""Time between predicted places, s: the simulators' usual step."""

ACCELERATION_WINDOW_S: Final = 0.5
"""Over which a driver's present acceleration is taken (our choice: shorter is noise)."""

OFFSET_DECAY_S: Final = 1.0
"""In which a driver off its lane's centre returns to 1/e of it (our choice)."""

PAST_EVERY_S: Final = 1.0
"""How far apart the past is looked at to learn a driver's wishes, s (our choice)."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""Driving freely: this far behind the leader in time and from anything ahead in space, and with
so little acceleration (our choice; HCM calls a headway over 3 to 4 s free)."""

OPEN, CLOSING, CLOSED = 0, 1, 2
"""States of a gate: pass, stop if that is comfortable, stop."""

PEDESTRIAN_REACH_S: Final = 2.0
"""A pedestrian who will be in a lane within this time already blocks it (our choice; calibrated
gaps at zebras are 2 to 4 s)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One instant, ready to be driven on; rows are the agents of the history.

    Attributes:
        history: what was seen; its last column is the present.
        road: where.
        steps: how many steps of `STEP_S` are predicted.
        on_path: (n,) whether the agent drives along a lane.
        lane: (n,) lane of each, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        accel: (n,) present acceleration, m/s2.
        path: (n,) most likely path of each agent, row of the road's `PathTable`.
        closed: (R, steps + 1) state of every gate at each step to come.
        free_factor: (n,) speed over limit when last seen driving steadily with nothing ahead; NaN
            if never.
        least_factor: (n,) largest speed over limit seen: nobody drives faster than it wants to.
    """

    history: Tracks
    road: Road
    steps: int
    on_path: BoolArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray
    accel: FloatArray
    path: IntArray
    closed: NDArray[np.int8]
    free_factor: FloatArray
    least_factor: FloatArray

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

    def straight_on(self) -> FloatArray:
        """(n, H, 2) everyone at constant velocity, m."""
        facing = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)
        travelled = self.speed[:, None] * self.time_s[None]
        return np.asarray(self.xy[:, None] + travelled[..., None] * facing[:, None])

    def predicted(self, xy: FloatArray, probability: FloatArray | None = None) -> Prediction:
        """A `Prediction` of these agents; ``xy`` (n, H, 2) for one future or (n, K, H, 2)."""
        futures = xy[:, None] if xy.ndim == 3 else xy
        if probability is None:
            probability = np.full(futures.shape[:2], 1.0 / futures.shape[1])
        return Prediction(self.ids, self.time_s, futures, probability)

    def with_path(self, path: IntArray) -> Scene:
        """The same scene with other paths taken."""
        return dataclasses.replace(self, path=path)


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
    if not np.isfinite(horizon_s) or horizon_s < STEP_S:
        raise InputError(f"horizon_s: found {horizon_s}, expected seconds >= {STEP_S}")
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
    if drives.any():
        found = road.project(xy[drives], heading[drives])
        place, facing = graph.position(found.lane, found.s, found.offset)
        near = np.abs(found.offset) <= graph.width[found.lane] / 2 + 1.0  # a metre: our choice
        near &= np.hypot(*(xy[drives] - place).T) < 2.0  # beyond a lane's end: our choice
        near &= np.cos(heading[drives] - facing) > 0.5  # not across or against: our choice
        lane[drives] = np.where(near, found.lane, -1)
        s[drives], offset[drives] = found.s, found.offset
    on_path = lane >= 0
    free, least = _wishes(history, road)
    return Scene(
        history=history,
        road=road,
        steps=steps,
        on_path=on_path,
        lane=lane,
        s=s,
        offset=offset,
        accel=_acceleration(history),
        path=_likely_path(paths, lane),
        closed=_gates(history, road, graph, steps),
        free_factor=free,
        least_factor=least,
    )


def _acceleration(history: Tracks) -> FloatArray:
    """(n,) present acceleration from the last half second seen, m/s2; 0 where unknown."""
    age = history.time_s[-1] - history.time_s
    recent = history.valid & (age <= ACCELERATION_WINDOW_S + 1e-6)[None]
    first = recent.argmax(axis=1)
    row = np.arange(history.ids.size)
    span = age[first]
    change = history.speed[:, -1] - history.speed[row, first]
    return np.asarray(np.divide(change, span, out=np.zeros(row.size), where=span > 1e-6))


def _wishes(history: Tracks, road: Road) -> tuple[FloatArray, FloatArray]:
    """(n,) speed over limit when free and steady, NaN if never so, and (n,) the largest seen."""
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows never free are NaN, as documented
        wished = np.nanmean(np.where(free, ratio, np.nan), axis=1)
        least = np.nanmax(ratio, axis=1)
    return wished, np.nan_to_num(least, nan=0.0)


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


def _likely_path(paths: PathTable, lane: IntArray) -> IntArray:
    best = np.zeros(paths.first.size, dtype=np.int64)
    for i, (first, count) in enumerate(zip(paths.first, paths.count, strict=True)):
        if count:
            best[i] = first + int(paths.probability[first : first + count].argmax())
    return np.where(lane >= 0, best[np.maximum(lane, 0)], 0)


def _gates(history: Tracks, road: Road, graph: LaneGraph, steps: int) -> NDArray[np.int8]:
    """(R, steps + 1) states of signals and crossings to come."""
    signals = _signals_ahead(history, road, steps)
    crossings = _crossings_ahead(history, road, graph, steps)
    return np.concatenate([signals, crossings]) if signals.size or crossings.size else np.zeros(
        (1, steps + 1), dtype=np.int8
    )  # fmt: skip


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
