"""The present as a predictor needs it: drivers on their paths, and where they must stop.

A `Scene` is made once per instant and shared by all predictors, so that they differ only in what
they do with it. Lanes, leaders and stop lines are found by `sim.road.lane_search.perceive`, at the
present and at several moments of the past. The past ones give each driver's desired speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.prediction import STEP_S, Prediction, coming_times
from graphrqi.predict.scene.paths import PathTable, limits
from graphrqi.predict.scene.stop_constraints import stop_states
from sim.frames import KINDS, MAX_MAGNITUDE, MOVING, PEDESTRIAN, SIGNALS, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.lane_search import LaneView, adjacent_vehicles, perceive

PAST_EVERY_S: Final = 1.0
"""Time between the moments of the past from which wished speeds are estimated, s."""

RECENT_S = 0.5
"""Time over which the present acceleration and lateral speed are measured, s (shorter is noise)."""

NEAR_LANE_M = 1.0
"""A vehicle this far outside a lane still drives along it."""

BEYOND_M = 2.0
"""A vehicle this far beyond a lane's end still drives along it."""

CHANGING_MPS = 0.25
"""A vehicle with a higher lateral speed is changing lanes."""

CHANGING_FROM_M = 0.3
"""A vehicle this far on the other side of its lane's centre is returning to the centre instead."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""A driver drives freely with this headway, this distance to anything ahead and at most this
acceleration (HCM calls a headway over 3 to 4 s free)."""


class AgentStates(NamedTuple):
    """The agents of a history at its last moment; pedestrians are on no lane and have no leader.

    Attributes:
        lane: (n,) lane that each drives along or is changing to, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        lateral_speed: (n,) speed to the left over the last half second, m/s.
        accel: (n,) acceleration over the last half second, m/s2; 0 where unknown.
        free_factor: (n,) mean speed over limit while driving steadily with nothing ahead; NaN if
            that was never seen.
        least_factor: (n,) largest speed over limit seen: the driver wishes at least this.
        on_lane: (n,) lane that each is on, -1 off the road.
        limit: (n,) its speed limit, m/s; NaN off the road.
        leader: (n,) row of the vehicle ahead, -1 if none.
        gap: (n,) bumper to bumper to it, m; +inf if none.
        follower: (n,) row of the nearest vehicle that has this one as its leader, -1 if none.
        adjacent: (n, 4) rows of those ahead and behind on the lane to the left, and to the right.
        adjacent_gap: (n, 4) bumper to bumper to them, m.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray
    lateral_speed: FloatArray
    accel: FloatArray
    free_factor: FloatArray
    least_factor: FloatArray
    on_lane: IntArray
    limit: FloatArray
    leader: IntArray
    gap: FloatArray
    follower: IntArray
    adjacent: IntArray
    adjacent_gap: FloatArray


def agent_states(history: Tracks, road: Road) -> AgentStates:
    """The states of a history's agents, all of whom are seen in its last column."""
    graph = LaneGraph.of(road)
    ago = np.arange(0.0, np.ptp(history.time_s) + 1e-6, PAST_EVERY_S)[::-1]
    columns = np.searchsorted(history.time_s, history.time_s[-1] - ago - 1e-6)
    # copies: kernels are compiled again for strided or read-only arrays
    instant, agent = (x.copy() for x in np.nonzero(history.valid[:, columns].T))
    begins = np.searchsorted(instant, np.arange(columns.size + 1))
    column = columns[instant]
    past_xy, past_heading = history.xy[agent, column], history.heading[agent, column]
    past_length, drives = history.length[agent], (history.kind != PEDESTRIAN)[agent]
    found = graph.project(past_xy, past_heading)
    view = perceive(
        past_xy, past_heading, past_length, drives, found.lane, found.s, found.offset,
        np.arange(agent.size), begins, graph,
    )  # fmt: skip
    limit = limits(graph)
    free, least = _wished_speeds(history, columns, instant, agent, limit[found.lane], view)
    now = slice(begins[-2], None)  # the rows of the last column are the agents
    drives, on, offset = drives[now], found.lane[now], found.offset[now]
    first = _recent(history)
    span = history.time_s[-1] - history.time_s[first]
    along = graph.segment_direction[view.segment[now]]
    moved = past_xy[now] - history.xy[np.arange(first.size), first]
    sideways = moved[:, 1] * along[:, 0] - moved[:, 0] * along[:, 1]
    sideways = np.divide(sideways, span, out=np.zeros_like(span), where=drives & (span > 1e-6))
    outside = ~drives | (np.abs(offset) > graph.width[on] / 2 + NEAR_LANE_M)
    outside |= (view.missed[now] >= BEYOND_M) | (np.cos(view.lane_heading[now]) <= 0.5)
    lane, aside = np.where(outside, -1, on), offset
    for beside, sign in ((graph.left[on], 1.0), (graph.right[on], -1.0)):
        going = ~outside & (beside >= 0) & (sign * sideways > CHANGING_MPS)
        going &= sign * offset > -CHANGING_FROM_M
        if going.any():
            shift = sign * (graph.width[on] + graph.width[beside]) / 2
            lane, aside = np.where(going, beside, lane), np.where(going, offset - shift, aside)
    on_lane, leader, follower = view.lane[now], view.leader[now], view.follower[now]
    adjacent, adjacent_gap = adjacent_vehicles(on_lane, found.s[now], past_length[now], graph)
    return AgentStates(
        lane=lane,
        s=np.where(drives, found.s[now], 0.0),
        offset=np.where(drives, aside, 0.0),
        lateral_speed=sideways,
        accel=present_acceleration(history),
        free_factor=free,
        least_factor=least,
        on_lane=on_lane,
        limit=np.where(on_lane >= 0, limit[on], np.nan),
        leader=np.where(leader >= 0, leader - begins[-2], -1),
        gap=view.gap[now],
        follower=np.where(follower >= 0, follower - begins[-2], -1),
        adjacent=adjacent,
        adjacent_gap=adjacent_gap,
    )


def _recent(history: Tracks) -> IntArray:
    """(n,) the first column of the last `RECENT_S` in which each was seen."""
    begin = int(np.searchsorted(history.time_s, history.time_s[-1] - RECENT_S - 1e-6))
    return np.asarray(begin + history.valid[:, begin:].argmax(axis=1))


def present_acceleration(history: Tracks) -> FloatArray:
    """(n,) accelerations over the last `RECENT_S` of a history, m/s2; 0 where unknown."""
    first, row = _recent(history), np.arange(history.ids.size)
    span = history.time_s[-1] - history.time_s[first]
    gained = history.speed[:, -1] - history.speed[row, first]
    known = history.valid[:, -1] & (span > 1e-6)
    return np.asarray(np.divide(gained, span, out=np.zeros(row.size), where=known))


def _wished_speeds(
    history: Tracks, columns: IntArray, instant: IntArray, agent: IntArray, limit: FloatArray,
    view: LaneView,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(n,) mean speed over limit while driving freely, NaN if never seen, and (n,) the largest."""
    n, column, on = history.ids.size, columns[instant], view.lane >= 0
    before = columns[np.maximum(instant - 1, 0)]
    speed = history.speed[agent, column]
    ratio = speed / limit
    least = np.zeros(n)
    np.maximum.at(least, agent[on], ratio[on])
    seen = on & (column > before) & history.valid[agent, before]
    span = np.where(seen, history.time_s[column] - history.time_s[before], 1.0)
    change = (speed - history.speed[agent, before]) / span
    clear = np.maximum(FREE_HEADWAY_S * speed, FREE_GAP_M)
    room = np.minimum(view.gap / clear * FREE_GAP_M, view.stop_distance)
    room = np.minimum(room, view.crossing_distance)
    freely = seen & (room > FREE_GAP_M) & (np.abs(change) < STEADY_MPS2)
    total = np.bincount(agent[freely], ratio[freely], minlength=n)
    count = np.bincount(agent[freely], minlength=n)
    return np.divide(total, count, out=np.full(n, np.nan), where=count > 0), least


LEARNED_S: Final = 5.0
"""Horizon that the learned predictors are made for, s."""

LONGEST_S: Final = 30.0
"""Longest horizon answered, s (farther ahead no predictor is better than a guess)."""

BREAK_S: Final = 5.0
"""A time between two frames longer than this is a break (as long as the past that predictions are
made from)."""

RETURN_MPS: Final = 0.5
"""Least lateral speed at which a driver returns to its lane's centre."""


class Unmapped(NamedTuple):
    """One instant without a map: tracks that end at present, and how many steps are predicted."""

    history: Tracks
    steps: int


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """One instant, ready to be predicted; rows are the agents of the history.

    Attributes:
        history: past tracks; the last column is the present.
        road: where.
        graph: its lanes.
        paths: its paths.
        steps: how many steps of `STEP_S` are predicted.
        on_path: (n,) whether the agent drives along a lane.
        lane: (n,) lane of each, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        lateral_speed: (n,) speed to the left, m/s.
        accel: (n,) present acceleration, m/s2.
        path: (n,) most likely path of each agent, row of the road's `PathTable`.
        stop_state: (R, steps + 1) state of every stop constraint now and at each coming step.
        states: the agents' states, with their leaders and neighbours.
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
    lateral_speed: FloatArray
    accel: FloatArray
    path: IntArray
    stop_state: NDArray[np.int8]
    states: AgentStates

    def __repr__(self) -> str:
        """How many agents there are, when and where."""
        return (
            f"Scene({self.ids.size} agents, {int(self.on_path.sum())} of them on a path, at "
            f"{self.history.time_s[-1]:g} s on {self.road.name!r}, {self.steps} steps of "
            f"{STEP_S:g} s to predict)"
        )

    @property
    def ids(self) -> IntArray:
        """(n,) agent ids."""
        return self.history.ids

    @cached_property
    def xy(self) -> FloatArray:
        """(n, 2) present places, m."""
        return self.history.xy[:, -1].copy()

    @cached_property
    def speed(self) -> FloatArray:
        """(n,) present speeds, m/s."""
        return self.history.speed[:, -1].copy()

    @cached_property
    def heading(self) -> FloatArray:
        """(n,) present headings, rad."""
        return self.history.heading[:, -1].copy()

    @cached_property
    def time_s(self) -> FloatArray:
        """(H,) seconds from the present of each predicted place."""
        return coming_times(self.steps)

    def predicted(self, xy: FloatArray) -> Prediction:
        """A `Prediction` of these agents; ``xy`` (n, H, 2) for one future or (n, K, H, 2)."""
        futures = xy[:, None] if xy.ndim == 3 else xy
        probability = np.full(futures.shape[:2], 1.0 / futures.shape[1])
        return Prediction(self.ids, self.time_s, futures, probability)

    def replaced(self, **changed: IntArray | FloatArray) -> Scene:
        """The same scene with other paths, lanes, offsets or lateral speeds.

        Unlike `dataclasses.replace` it keeps the cached properties.
        """
        other = object.__new__(Scene)
        other.__dict__.update(self.__dict__, **changed)
        return other

    def with_path(self, path: IntArray) -> Scene:
        """The same scene with other paths taken."""
        return self.replaced(path=np.ascontiguousarray(path))


def check_horizon(horizon_s: float) -> None:
    """Refuse a horizon that is shorter than a step or longer than `LONGEST_S`."""
    number = isinstance(horizon_s, (int, float, np.number)) and not isinstance(horizon_s, bool)
    if not number or not STEP_S <= horizon_s <= LONGEST_S:
        raise InputError(
            f"horizon_s: found {horizon_s!r}, expected seconds from {STEP_S} to {LONGEST_S:g}"
        )


def check_history(history: Tracks) -> None:
    """Refuse a history that no predictor can read: numbers, codes, times or ids are wrong."""
    time_s = history.time_s
    if not (np.isfinite(time_s).all() and (np.diff(time_s) > 0.0).all()):
        raise InputError("history.time_s: found times that do not increase, expected seconds")
    if not (history.ids[1:] > history.ids[:-1]).all():
        raise InputError("history.ids: found ids that do not ascend, expected each once, in order")
    for name, codes, most in (("kind", history.kind, KINDS), ("signals", history.signals, SIGNALS)):
        if not ((codes >= 0) & (codes < len(most))).all():
            raise InputError(f"history.{name}: found other codes than 0 to {len(most) - 1}")
    for name in ("xy", "heading", "speed", "length", "width"):
        values = getattr(history, f"row_{name}" if name in MOVING else name)
        if np.abs(values).max(initial=0.0) <= MAX_MAGNITUDE:
            continue
        found = "a number that is not finite"
        if np.isfinite(values).all():
            found = f"a number beyond {MAX_MAGNITUDE:g}"
        raise InputError(f"history.{name}: found {found} where an agent was seen")


def since_break(history: Tracks) -> Tracks:
    """The part of a history after its last time without frames for more than `BREAK_S`."""
    breaks = np.flatnonzero(np.diff(history.time_s) > BREAK_S)
    if not breaks.size:
        return history
    since = slice(int(breaks[-1]) + 1, None)
    return history.part(np.arange(history.ids.size), since)


def present_agents(history: Tracks) -> Tracks:
    """The tracks of the agents that are seen in the last column; refuses a history without any."""
    if history.time_s.size == 0:
        raise InputError("history: found no frame, expected at least 1")
    if history.valid[:, -1].all():
        return history
    return history.window(history.time_s.size, history.time_s.size)


def make_scene(history: Tracks, road: Road, horizon_s: float = 5.0) -> Scene:
    """The scene at the end of a history, of the agents present now.

    Args:
        history: tracks whose last column is the present; agents seen there are kept.
        road: where it happens.
        horizon_s: how far ahead it is to be predicted, s.

    Raises:
        InputError: if the horizon is shorter than a step or the history is empty.
    """
    check_horizon(horizon_s)
    history = present_agents(since_break(history))
    steps = round(horizon_s / STEP_S)
    graph, paths = LaneGraph.of(road), PathTable.of(road)
    states = agent_states(history, road)
    lane = states.lane
    paths.cover(lane)
    path = np.where(lane >= 0, paths.likeliest[np.maximum(lane, 0)], 0)
    stops = stop_states(history, paths, lane, states.s, path, steps)
    moving = states.s, states.offset, states.lateral_speed, states.accel
    return Scene(history, road, graph, paths, steps, lane >= 0, lane, *moving, path, stops, states)
