"""Episodes of the licence test: policies drive in a scenario among a crowd, and are measured.

All policies begin at the same moment of the same traffic, which is driven until then only once.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from behaviors.populations import read_population
from experiments.benches.drive.crowds import CROWDS, Crowd
from experiments.benches.drive.policies import BLIND, get_policy
from scenarios.environments.environment import TrafficEnv
from scenarios.environments.four_way_intersection import FourWayIntersectionEnv
from scenarios.environments.roads import (
    AllWayStopEnv,
    MotorwayEnv,
    MotorwayRampsEnv,
    OwnRoadEnv,
    PriorityIntersectionEnv,
    RightBeforeLeftEnv,
    RoundaboutEnv,
    TwoWayRoadEnv,
)
from scenarios.environments.straight_road import StraightRoadEnv
from sim.episode.incidents import incidents
from sim.episode.rows import TrajectoryRows
from sim.files import write_whole
from sim.frames import EventKind, FloatArray, Frame, Tracks
from sim.highway.demand import Demand
from sim.highway.ego import Observation, distance_left_m, is_off_road
from sim.highway.engine import read_frame
from sim.highway.lanes import LaneIndex
from sim.highway.traffic import TrafficRoad
from sim.scenario import AgentSpec

FORWARD_MPS2: Final = (-4.05, 2.40)
"""Comfortable braking and acceleration, m/s2 (nuPlan's bounds, from human drivers: Karnchanachari
et al. 2024, ICRA)."""

SIDEWAYS_MPS2: Final = 4.89
"""Comfortable sideways acceleration, m/s2 (the same)."""

RULES: Final = (
    EventKind.RED_RUN, EventKind.STOP_ROLLED, EventKind.NOT_YIELDED, EventKind.WRONG_WAY,
)  # fmt: skip
"""What counts as a rule broken."""

WEIGHTS: Final[dict[str, float]] = {"progress": 5.0, "calm": 5.0, "lawful": 4.0, "comfort": 2.0}
"""What the score weighs (nuPlan's weights of progress, time to collision, speed limit and comfort;
here rules broken stand for the limit)."""

METRICS: Final = (
    "score", "collisions", "collisions_caused", "near_misses", "rules_broken", "off_road",
    "uncomfortable_share", "rms_jerk_mps3", "progress", "arrived", "minutes",
)  # fmt: skip
"""What is measured of an episode; all are counts or shares but for the jerk and the minutes."""


class _CityEnv(OwnRoadEnv):
    """Drive through a grid of streets, along a route of the traffic's."""

    scenario_name = "city"


ROADS: Final[dict[str, type[TrafficEnv]]] = {
    made.scenario_name: made
    for made in (
        StraightRoadEnv, TwoWayRoadEnv, FourWayIntersectionEnv, PriorityIntersectionEnv,
        AllWayStopEnv, RightBeforeLeftEnv, MotorwayEnv, MotorwayRampsEnv, RoundaboutEnv, _CityEnv,
    )
}  # fmt: skip
"""The environment of each scenario."""


OWN: Final = ("action", "policy_frequency", "observation", "observed")
"""What a policy may change in the configuration and still begin from the traffic of the others."""


@dataclass(frozen=True, slots=True)
class _Start:
    """The traffic at the moment at which the ego vehicle enters.

    Attributes:
        config: of the environment, but for `OWN`.
        road: with everybody on it.
        demand: those still to come.
        room: the lane that the ego vehicle enters, its room, m, and the next one's speed, m/s.
        frames: everything until then.
    """

    config: dict[str, Any]
    road: TrafficRoad
    demand: Demand
    room: tuple[LaneIndex, float, float]
    frames: tuple[Frame, ...]


def _among(base: type[TrafficEnv], crowd: Crowd) -> type[TrafficEnv]:
    """The environment whose other drivers are a crowd, and which keeps every frame.

    Its first episode drives the traffic until the ego vehicle enters; all others of the same
    configuration go on from a copy.
    """

    class Among(base):  # type: ignore[misc, valid-type]
        """The environment with a crowd."""

        start: ClassVar[_Start | None] = None
        looks: bool = True
        on_frame: Callable[[Frame], object] | None = None
        frames: list[Frame]
        truth: Mapping[int, int]
        road: TrafficRoad
        _demand: Demand

        def _draw_agents(self, seed: int) -> tuple[AgentSpec, ...]:
            agents = tuple(crowd.changed(agent) for agent in super()._draw_agents(seed))
            self.truth = {a.id: a.behavior.code for a in agents if a.behavior is not None}
            self.frames = []
            return agents

        @property
        def ego_id(self) -> int:
            """Agent id of the vehicle that is driven."""
            return int(self._ego_id)

        def _warm_up(
            self, agents: tuple[AgentSpec, ...], seed: int, lanes: list[LaneIndex]
        ) -> tuple[LaneIndex, float, float]:
            room: tuple[LaneIndex, float, float]
            start, same = type(self).start, {**self.config, "traffic": seed}
            for key in OWN:
                same.pop(key)
            if self._classify is not None or start is None or start.config != same:
                room = super()._warm_up(agents, seed, lanes)
                if self._classify is None:  # else it has to see the traffic itself
                    road = self.road.copied()
                    demand = self._demand.copied(road)
                    type(self).start = _Start(same, road, demand, room, tuple(self.frames))
                return room
            self.road = start.road.copied()
            self._demand = start.demand.copied(self.road)
            for frame in start.frames:
                self._show(frame)
            return start.room

        def _advance(self) -> None:
            known = len(self._events)
            super()._advance()
            self._show(read_frame(self.road, tuple(self._events[known:])))

        def _watch(self) -> None:
            """Do nothing: near misses are counted afterwards, in what was driven."""

        def _observe(self) -> Observation:
            return super()._observe() if self.looks else {}

        def _show(self, frame: Frame) -> None:
            """Keep a frame, and show it to the policy."""
            self.frames.append(frame)
            if self.on_frame is not None:
                self.on_frame(frame)

    return Among


@dataclass(frozen=True, slots=True)
class Driven:
    """What became of the policies in one scenario, crowd and seed.

    Attributes:
        figures: the `METRICS` of each policy, in their order.
        minutes: how many of the policies' minutes were driven just now, not kept from before.
        core_s: processor time since this process's last episodes, or since it began: all that it
            took to drive these, with starting and compiling.
    """

    figures: list[dict[str, float]]
    minutes: float
    core_s: float


_spent_s = [0.0]  # of this process's processor time, when its last episodes ended


def drive(
    scenario: str, crowd: str, policies: Sequence[str], seed: int, config: Mapping[str, Any],
    kept: str | None = None,
) -> Driven:  # fmt: skip
    """Drive one episode with each policy, unless its figures are kept already.

    Args:
        scenario: a key of `ROADS`.
        crowd: a key of `CROWDS`.
        policies: as in `get_policy`.
        seed: of the traffic.
        config: of the environment.
        kept: folder with the figures of episodes that were driven before; None for none.

    Raises:
        InputError: if a policy or a part of the configuration is not usable.
    """
    of = dict(config)
    population = CROWDS[crowd].population
    if population is not None:  # another file of that name is another crowd
        of["population"] = read_population(population).sha256
    made = _among(ROADS[scenario], CROWDS[crowd])
    every, minutes = [], 0.0
    for policy in policies:
        path = None
        if kept is not None:
            name = policy.replace(":", "--").replace("/", "--")
            path = Path(kept) / scenario / crowd / name / f"{seed}.json"
        figures = None if path is None else _kept(path, of)
        if figures is None:
            figures = _drive(made, CROWDS[crowd], policy, seed, config)
            minutes += figures["minutes"]
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                content = {"config": of, "figures": figures}
                write_whole(path, json.dumps(content, indent=1, sort_keys=True).encode() + b"\n")
        every.append(figures)
    before, _spent_s[0] = _spent_s[0], time.process_time()
    return Driven(every, minutes, _spent_s[0] - before)


def _kept(path: Path, config: Mapping[str, Any]) -> dict[str, float] | None:
    """The figures in a file; None if there are none, or of another configuration."""
    try:
        content = json.loads(path.read_bytes())
        if content["config"] != json.loads(json.dumps(dict(config))):
            return None
        return {metric: float(content["figures"][metric]) for metric in METRICS}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _drive(
    made: type[TrafficEnv], crowd: Crowd, policy: str, seed: int, config: Mapping[str, Any]
) -> dict[str, float]:
    make, changes = get_policy(policy)
    drawn = {"seed": seed, "mix": crowd.mix, "population": crowd.population}
    env: Any = made(config={**drawn, **config, **changes})
    env.looks = policy not in BLIND
    act = make(env)
    observation, _ = env.reset(seed=seed)
    begun = len(env.frames)
    left_m, limit = env._distance_left, float(env.vehicle.lane.speed_limit)
    ended = cut = False
    while not (ended or cut):
        observation, _, ended, cut, info = env.step(act(observation))
    driven = Tracks.from_frames(env.frames[begun:])
    gone_m = left_m - min(distance_left_m(env.road, env.vehicle), left_m)
    reachable_m = min(left_m, limit * float(env.config["duration_s"]))
    found = {
        "off_road": float(is_off_road(env.road, env.vehicle) and not info["arrived"]),
        "progress": 1.0 if info["arrived"] else float(np.clip(gone_m / reachable_m, 0.0, 1.0)),
        "arrived": float(info["arrived"]),
        "minutes": float(info["time_s"]) / 60.0,
        **_events(driven, env.scenario.road, env.ego_id),
        **_comfort(driven, env.ego_id),
    }
    env.close()
    return {"score": score(found), **found}


def _events(driven: Tracks, road: Any, ego_id: int) -> dict[str, float]:
    """Collisions, near misses and rules broken of the ego vehicle."""
    if driven.time_s.size < 2:
        return dict.fromkeys(("collisions", "collisions_caused", "near_misses", "rules_broken"), 0)
    found = incidents(TrajectoryRows.of(driven), road)
    mine = [event for event in found if ego_id in (event.agent, event.other)]
    collisions = [event for event in mine if event.kind is EventKind.COLLISION]
    return {
        "collisions": float(len(collisions)),
        "collisions_caused": float(sum(event.agent == ego_id for event in collisions)),
        "near_misses": float(sum(event.kind is EventKind.NEAR_MISS for event in mine)),
        "rules_broken": float(sum(e.kind in RULES and e.agent == ego_id for e in mine)),
    }


def _comfort(driven: Tracks, ego_id: int) -> dict[str, float]:
    """How much of the time the ride is uncomfortable, and the root mean square of the jerk."""
    row = int(np.searchsorted(driven.ids, ego_id))
    seen = driven.valid[row]
    speed, heading = driven.speed[row, seen], np.unwrap(driven.heading[row, seen])
    if speed.size < 4:
        return {"uncomfortable_share": 0.0, "rms_jerk_mps3": 0.0}
    forward = _smooth(np.diff(speed)) / driven.step_s
    sideways = speed[1:] * _smooth(np.diff(heading)) / driven.step_s
    bad = (forward < FORWARD_MPS2[0]) | (forward > FORWARD_MPS2[1])
    bad |= np.abs(sideways) > SIDEWAYS_MPS2
    jerk = np.diff(forward) / driven.step_s
    return {
        "uncomfortable_share": float(bad.mean()),
        "rms_jerk_mps3": math.sqrt(float((jerk**2).mean())),
    }


def _smooth(values: FloatArray) -> FloatArray:
    """The mean of three neighbours, so that a single step's jump is no acceleration."""
    return np.convolve(np.pad(values, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")


def score(figures: Mapping[str, float]) -> float:
    """One number for an episode, 0 to 1, in the manner of nuPlan's closed-loop score.

    A collision that the vehicle caused, or leaving the road, makes it 0. Otherwise it is the mean
    of progress, having no near miss, breaking no rule, and comfort, by `WEIGHTS`.

    Examples:
        >>> calm = {"collisions_caused": 0, "off_road": 0, "progress": 1.0, "near_misses": 0,
        ...         "rules_broken": 0, "uncomfortable_share": 0.0}
        >>> score(calm), score({**calm, "near_misses": 2}), score({**calm, "collisions_caused": 1})
        (1.0, 0.6875, 0.0)
    """
    if figures["collisions_caused"] or figures["off_road"]:
        return 0.0
    parts = {
        "progress": figures["progress"],
        "calm": float(not figures["near_misses"]),
        "lawful": float(not figures["rules_broken"]),
        "comfort": 1.0 - figures["uncomfortable_share"],
    }
    return sum(WEIGHTS[name] * part for name, part in parts.items()) / sum(WEIGHTS.values())
