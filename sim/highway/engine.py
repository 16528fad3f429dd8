"""Runs a scenario in highway-env and yields `Frame`s.

References:
    Leurent (2018), An environment for autonomous driving decision-making (highway-env).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import Event, Frame
from sim.highway.demand import Demand
from sim.highway.network import HighwayNetwork, build_network
from sim.highway.state import RoadState, agent_of
from sim.highway.traffic import TrafficRoad
from sim.road import Road
from sim.scenario import AgentSpec, CarFollowing, Scenario

LONGEST_STEP_S: Final = 0.1
"""highway-env's own step is at most this long; frames further apart are made of several steps."""


@functools.lru_cache(maxsize=8)
def network_of(road: Road) -> HighwayNetwork:
    """The highway-env network of a road, built on first use and kept; nothing changes it."""
    return build_network(road)


def run(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in highway-env; drivers follow by IDM.

    Args:
        scenario: the road, the duration and the step.
        agents: who travels, as drawn by `sim.scenario.sample_agents`.
        seed: of the drivers' random numbers; the same seed gives the same frames to the bit.

    Yields:
        Frames from time ``step_s`` to ``duration_s``; without agents that found no room.

    Raises:
        InputError: if the agents, the seed or the road are not usable.
    """
    return _run(scenario, agents, seed, "IDM")


def run_krauss(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in highway-env; drivers follow by Krauss's law. See `run`.

    The drivers have the same profiles as in `run` and follow by another law, so that a model
    trained on both depends less on either law. Lane changes are weighed by IDM in both.
    """
    return _run(scenario, agents, seed, "Krauss")


def _run(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    law: CarFollowing,
) -> Iterator[Frame]:
    if not 0 <= seed < 2**31:
        raise InputError(f"seed: found {seed}, expected an integer from 0 to 2**31 - 1")
    if len({a.id for a in agents}) != len(agents):
        raise InputError("agents: found an id twice, expected unique ids")
    road = TrafficRoad(network_of(scenario.road))
    demand = Demand(road, agents, seed, law)
    return _frames(scenario, road, demand)


def _frames(scenario: Scenario, road: TrafficRoad, demand: Demand) -> Iterator[Frame]:
    steps = math.ceil(scenario.step_s / LONGEST_STEP_S - 1e-9)
    for index in range(1, scenario.steps + 1):
        for _ in range(steps):
            demand.enter()
            road.act()
            road.step(scenario.step_s / steps)
        road.time_s = index * scenario.step_s  # no rounding adds up
        yield read_frame(road)


def read_frame(road: RoadState, events: tuple[Event, ...] | None = None) -> Frame:
    """Everybody on the road now; highway-env has y to the right of x, frames have it to the left.

    Args:
        road: to read.
        events: what happened; by default the events since they were last taken.
    """
    everyone = sorted([*road.vehicles, *road.walkers], key=agent_of)
    n = len(everyone)
    xy = np.array([one.position for one in everyone], dtype=np.float64).reshape(n, 2)
    heading = -np.array([one.heading for one in everyone], dtype=np.float64)
    return Frame(
        time_s=road.time_s,
        ids=np.array([agent_of(one) for one in everyone], dtype=np.int64),
        xy=xy * np.array([1.0, -1.0]),
        heading=math.pi - np.mod(math.pi - heading, 2 * math.pi),
        speed=np.array([one.speed for one in everyone], dtype=np.float64),
        length=np.array([one.LENGTH for one in everyone], dtype=np.float64),
        width=np.array([one.WIDTH for one in everyone], dtype=np.float64),
        kind=np.array([_kind_code(one) for one in everyone], dtype=np.int8),
        signals=road.signals.copy(),
        events=road.take_events() if events is None else events,
    )


def _kind_code(one: object) -> int:
    kind = getattr(one, "kind", None)
    return 0 if kind is None else int(kind.code)
