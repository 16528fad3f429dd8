"""An episode of the licence test: a policy drives in a scenario among a crowd, and is measured.

A crowd is each behaviour alone, all of them, or clones. With one seed everybody departs at the same
time for the same goal in every crowd; only who drives how differs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.ndimage import convolve1d

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from behaviors.profiles import Profile
from experiments.drive.policies import POLICIES, get_policy
from experiments.what_if.outcomes import RULES
from scenarios.environments import ENVIRONMENTS
from scenarios.environments.environment import Ego, TrafficEnv
from sim.episode.annotate import incidents
from sim.frames import EventKind, Frame, Tracks
from sim.highway.ego import Observation, distance_left_m, is_off_road
from sim.road import Road
from sim.safety import ConflictKind
from sim.scenario import AgentSpec

STANDARD: Final = Profile(
    speed_factor=1.0, time_headway_s=1.5, min_gap_m=2.0, max_accel_mps2=1.4,
    comfort_decel_mps2=2.0, politeness=0.2, lane_change_gain=1.0, lane_change_patience_s=0.0,
    lane_change_assertiveness=1.0, gap_acceptance_s=1.0, crossing_gap_s=10.0,
    yield_probability=1.0, red_run_probability=0.0, stop_roll_probability=0.0, yellow_run_s=0.0,
    insistence=0.0, startup_delay_s=0.0, cut_in_rate_per_min=0.0, stop_rate_per_min=0.0,
    wrong_way_rate_per_min=0.0,
)  # fmt: skip
"""The driver of homogeneous traffic: IDM's and MOBIL's usual numbers (Kesting, Treiber and Helbing
2010, Phil. Trans. R. Soc. A 368, table 1), who breaks no rule."""


def standard(agent: AgentSpec) -> AgentSpec:
    """The agent as a clone of the `STANDARD` driver; a pedestrian as it is."""
    if agent.profile is None:
        return agent
    return dataclasses.replace(agent, behavior=None, profile=STANDARD)


HOMOGENEOUS, MIXED = "homogeneous", "mixed"

CROWDS: Final[dict[str, dict[str, Any]]] = {
    **{str(b): {"mix": {str(b): 1.0}} for b in BEHAVIORS},
    MIXED: {},
    "recorded": {"population": "us101"},
    HOMOGENEOUS: {},
}
"""What crowds change in an environment's configuration: the behaviours alone, all of them in equal
shares, the same with numbers drawn from a recorded population, and clones (`standard`)."""


def crowd_of(name: str, own: Sequence[str] = ()) -> dict[str, Any]:
    """The crowd of a name: of `CROWDS`, a behaviour of one's own, or a mix."""
    if "=" in name:
        return {"mix": name}
    return lookup({**CROWDS, **{one: {"mix": {one: 1.0}} for one in own}}, name, "crowd")


FORWARD_MPS2: Final = (-4.05, 2.40)
"""Comfortable braking and acceleration, m/s2 (nuPlan's bounds, from human drivers: Karnchanachari
et al. 2024, ICRA)."""

SIDEWAYS_MPS2: Final = 4.89
"""Comfortable sideways acceleration, m/s2 (the same)."""

BEHIND: Final = (ConflictKind.FOLLOWING, ConflictKind.MERGING)
"""The conflicts in which one of the two is ahead of the other."""

WEIGHTS: Final[dict[str, float]] = {"progress": 5.0, "calm": 5.0, "lawful": 4.0, "comfort": 2.0}
"""Weights of the score: nuPlan's of progress, time to collision, speed limit and comfort. Rules
broken stand for the limit here."""

METRICS: Final = (
    "score", "collisions", "collisions_caused", "near_misses", "near_misses_ahead",
    "near_misses_behind", "near_misses_crossing", "rules_broken", "off_road",
    "uncomfortable_share", "rms_jerk_mps3", "progress", "arrived", "minutes",
)  # fmt: skip
"""Measures of an episode; all are counts or shares but for the jerk and the minutes.

Near misses are with somebody whom the vehicle follows ("ahead"), who follows it ("behind"), or who
comes from the side ("crossing").
"""

ROADS: Final[dict[str, dict[str, Any]]] = {
    row["scenario_name"]: row
    for row in (
        {**row, "scenario_name": "city"} if name == "graphrqi/OwnRoad-v0" else row
        for name, row in ENVIRONMENTS.items()
    )
}
"""Arguments of `TrafficEnv` for each scenario."""


class _Among(TrafficEnv):
    """The environment of a scenario, whose other drivers may be clones; it keeps every frame."""

    def __init__(self, scenario: str, config: Mapping[str, Any], clones: bool, looks: bool) -> None:
        self._clones, self._looks = clones, looks
        self.on_frame: Callable[[Frame], object] | None = None
        self.frames: list[Frame] = []
        self.truth: Mapping[int, int] = {}
        super().__init__(config, **ROADS[scenario])

    @property
    def ego_id(self) -> int:
        """Agent id of the vehicle that is driven."""
        return self.egos[0].id

    def draw_agents(self, seed: int) -> tuple[AgentSpec, ...]:
        """Everybody but the ego vehicle: the crowd."""
        agents = super().draw_agents(seed)
        agents = tuple(standard(agent) for agent in agents) if self._clones else agents
        self.truth = {a.id: a.behavior.base.code for a in agents if a.behavior is not None}
        self.frames = []
        return agents

    def advance(self) -> None:
        """Move everybody for one simulation step, keep the frame and show it to the policy."""
        known = len(self.events)
        super().advance()
        self.frames.append(self.road.frame(tuple(self.events[known:])))
        if self.on_frame is not None:
            self.on_frame(self.frames[-1])

    def watch(self) -> None:
        """Do nothing: near misses are counted afterwards, in what was driven."""

    def observe(self, ego: Ego) -> Observation:
        """The policy's observation; nothing for one that does not look."""
        return super().observe(ego) if self._looks else {}


def drive(
    scenario: str, crowd: str, policy: str, seed: int, config: Mapping[str, Any]
) -> dict[str, float]:
    """The `METRICS` of an episode; with one seed, traffic departs alike in all crowds.

    The scenario is a key of `ROADS`; crowd and policy are as `crowd_of` and `get_policy` take them.
    The seed is the traffic's, and the configuration the environment's.
    """
    make, changes = get_policy(policy)
    others = crowd_of(crowd, [*(config.get("behaviors") or ())])
    looks = policy not in POLICIES  # ours see frames
    env = _Among(
        scenario, {"seed": seed, **others, **config, **changes}, crowd == HOMOGENEOUS, looks
    )
    act = make(env)
    observation, _ = env.reset(seed=seed)
    begun = len(env.frames)
    left_m, limit = env.egos[0].distance_left_m, float(env.vehicle.lane.speed_limit)
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


def _events(driven: Tracks, road: Road, ego_id: int) -> dict[str, float]:
    """Collisions, near misses and rules broken of the ego vehicle."""
    found = incidents(driven, road) if driven.time_s.size > 1 else ()
    mine = [event for event in found if ego_id in (event.agent, event.other)]
    near = [event for event in mine if event.kind is EventKind.NEAR_MISS]
    collisions = [event for event in mine if event.kind is EventKind.COLLISION]
    return {
        "collisions": len(collisions),
        "collisions_caused": sum(event.agent == ego_id for event in collisions),
        "near_misses": len(near),
        "near_misses_ahead": sum(e.rule in BEHIND and e.agent == ego_id for e in near),
        "near_misses_behind": sum(e.rule in BEHIND and e.agent != ego_id for e in near),
        "near_misses_crossing": sum(event.rule not in BEHIND for event in near),
        "rules_broken": sum(e.kind in RULES and e.agent == ego_id for e in mine),
    }


def _comfort(driven: Tracks, ego_id: int) -> dict[str, float]:
    """How much of the time the ride is uncomfortable, and the root mean square of the jerk."""
    row = int(np.searchsorted(driven.ids, ego_id))
    seen = driven.valid[row]
    speed, heading = driven.speed[row, seen], np.unwrap(driven.heading[row, seen])
    if speed.size < 4:
        return {"uncomfortable_share": 0.0, "rms_jerk_mps3": 0.0}
    mean = np.full(3, 1 / 3)  # of neighbours, so that a single step's jump is no acceleration
    forward = convolve1d(np.diff(speed), mean, mode="nearest") / driven.step_s
    sideways = speed[1:] * convolve1d(np.diff(heading), mean, mode="nearest") / driven.step_s
    bad = (forward < FORWARD_MPS2[0]) | (forward > FORWARD_MPS2[1])
    bad |= np.abs(sideways) > SIDEWAYS_MPS2
    jerk = np.diff(forward) / driven.step_s
    return {
        "uncomfortable_share": float(bad.mean()), "rms_jerk_mps3": float(np.sqrt((jerk**2).mean()))
    }  # fmt: skip


def score(figures: Mapping[str, float]) -> float:
    """One number for an episode, 0 to 1, in the manner of nuPlan's closed-loop score.

    A collision that the vehicle caused, or leaving the road, makes it 0. Otherwise it is the mean
    of progress, having no near miss, breaking no rule, and comfort, by `WEIGHTS`.
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
