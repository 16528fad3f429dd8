"""The present as a predictor needs it: drivers on their paths, and where they must stop.

A `Scene` is made once per instant and shared by all predictors, so that they differ only in what
they do with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.scene.agent_states import AgentStates, agent_states
from graphrqi.predict.scene.paths import PathTable
from graphrqi.predict.scene.stop_constraints import stop_states
from sim.frames import KINDS, MAX_MAGNITUDE, SIGNALS, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph

LEARNED_S: Final = 5.0
"""Horizon that the learned predictors are made for, s."""

LONGEST_S: Final = 30.0
"""Longest horizon answered, s (farther ahead no predictor is better than a guess)."""

BREAK_S: Final = 5.0
"""A time between two frames longer than this is a break (as long as the past that predictions are
made from)."""

RETURN_MPS: Final = 0.5
"""Least lateral speed at which a driver returns to its lane's centre."""


@dataclass(frozen=True, slots=True, eq=False)
class Unmapped:
    """One instant without a map.

    Attributes:
        history: past tracks; the last column is the present.
        steps: how many steps of `STEP_S` are predicted.
        road: None.
    """

    history: Tracks
    steps: int
    road: None = None

    @classmethod
    def of(cls, history: Tracks, horizon_s: float) -> Unmapped:
        """The end of a history, with the agents seen there; refuses one without any frame."""
        if history.time_s.size == 0:
            raise InputError("history: found no frame, expected at least 1")
        return cls(_present_agents(history), round(horizon_s / STEP_S))


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
        return np.arange(1, self.steps + 1, dtype=np.float64) * STEP_S

    def offsets(self) -> FloatArray:
        """(n, H) distance to the left of the lane: drivers move to its centre and stay, m."""
        speed = np.maximum(np.abs(self.lateral_speed), RETURN_MPS)
        left = np.maximum(np.abs(self.offset)[:, None] - speed[:, None] * self.time_s[None], 0.0)
        return np.asarray(np.sign(self.offset)[:, None] * left)

    def straight_on(self, who: BoolArray, time_s: FloatArray) -> FloatArray:
        """(m, H, 2) some agents at constant velocity at times (H,), m."""
        heading = self.heading[who]
        facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        distance = self.speed[who, None] * time_s
        return np.asarray(self.xy[who, None] + distance[..., None] * facing[:, None])

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
    """Refuse a history that no predictor can read.

    Args:
        history: tracks.

    Raises:
        InputError: if times or ids do not increase, a code is none, or a number is not finite or
            beyond `MAX_MAGNITUDE` where an agent was seen.
    """
    time_s = history.time_s
    if not (np.isfinite(time_s).all() and (np.diff(time_s) > 0.0).all()):
        raise InputError("history.time_s: found times that do not increase, expected seconds")
    if not (history.ids[1:] > history.ids[:-1]).all():
        raise InputError("history.ids: found ids that do not ascend, expected each once, in order")
    for name, codes, most in (("kind", history.kind, KINDS), ("signals", history.signals, SIGNALS)):
        if not ((codes >= 0) & (codes < len(most))).all():
            raise InputError(f"history.{name}: found other codes than 0 to {len(most) - 1}")
    for name in ("xy", "heading", "speed", "length", "width"):
        values = getattr(history, name)
        seen = values if values.ndim == 1 else values[history.valid]
        if not np.isfinite(seen).all():
            raise InputError(
                f"history.{name}: found a number that is not finite where an agent was seen"
            )
        if not np.abs(seen).max(initial=0.0) <= MAX_MAGNITUDE:
            raise InputError(
                f"history.{name}: found a number beyond {MAX_MAGNITUDE:g} where an agent was seen"
            )


def since_break(history: Tracks) -> Tracks:
    """The part of a history after its last break: earlier frames say nothing about the present.

    Args:
        history: tracks whose last column is the present.

    Returns:
        The same where no two frames are more than `BREAK_S` apart.
    """
    breaks = np.flatnonzero(np.diff(history.time_s) > BREAK_S)
    if not breaks.size:
        return history
    since = slice(int(breaks[-1]) + 1, None)
    return history.part(np.arange(history.ids.size), since)


def _present_agents(history: Tracks) -> Tracks:
    """The tracks of the agents that are seen in the last column."""
    if history.valid[:, -1].all():
        return history
    return history.window(history.time_s.size, history.time_s.size)


def make_scene(history: Tracks, road: Road, horizon_s: float = 5.0) -> Scene:
    """The scene at the end of a history.

    Args:
        history: tracks whose last column is the present; agents seen there are kept.
        road: where it happens.
        horizon_s: how far ahead it is to be predicted, s.

    Returns:
        The scene of the agents present now.

    Raises:
        InputError: if the horizon is shorter than a step or the history is empty.
    """
    check_horizon(horizon_s)
    if history.time_s.size == 0:
        raise InputError("history: found no frame, expected at least 1")
    history = _present_agents(since_break(history))
    steps = round(horizon_s / STEP_S)
    graph, paths = LaneGraph.of(road), PathTable.of(road)
    states = agent_states(history, road)
    lane = states.lane
    paths.cover(lane)
    path = np.where(lane >= 0, paths.likeliest[np.maximum(lane, 0)], 0)
    stops = stop_states(history, road, paths, lane, states.s, path, steps)
    moving = states.s, states.offset, states.lateral_speed, states.accel
    return Scene(history, road, graph, paths, steps, lane >= 0, lane, *moving, path, stops, states)
