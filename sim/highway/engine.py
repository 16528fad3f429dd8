"""Runs a scenario in highway-env and yields `Frame`s.

References:
    Leurent (2018), An environment for autonomous driving decision-making (highway-env).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import Event, Frame
from sim.highway.demand import Demand
from sim.highway.network import HighwayNetwork, build_network
from sim.highway.traffic import TrafficRoad
from sim.road import Road
from sim.scenario import AgentSpec, CarFollowing, Scenario

LONGEST_STEP_S: Final = 0.1
"""highway-env's own step is at most this long; frames further apart are made of several steps."""


@functools.lru_cache(maxsize=8)
def network_of(road: Road) -> HighwayNetwork:
    """The highway-env network of a road, built on first use and kept; nothing changes it."""
    if road.left_hand:
        raise InputError(f"road {road.name:.60}: found left-hand traffic, expected its mirror")
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
    left_hand = scenario.road.left_hand
    road = TrafficRoad(network_of(scenario.road.mirrored if left_hand else scenario.road))
    demand = Demand(road, agents, seed, law)
    frames = _frames(scenario, road, demand)
    return map(_mirrored, frames) if left_hand else frames


def _mirrored(frame: Frame) -> Frame:
    """A frame in a mirror along the x axis, as left-hand traffic is driven."""
    heading = np.where(frame.heading == np.pi, np.pi, -frame.heading)
    return dataclasses.replace(frame, xy=frame.xy * np.array([1.0, -1.0]), heading=heading)


def _frames(scenario: Scenario, road: TrafficRoad, demand: Demand) -> Iterator[Frame]:
    steps = math.ceil(scenario.step_s / LONGEST_STEP_S - 1e-9)
    for index in range(1, scenario.steps + 1):
        for _ in range(steps):
            demand.enter()
            road.advance(scenario.step_s / steps)
        road.time_s = index * scenario.step_s  # no rounding adds up
        yield read_frame(road)


def read_frame(road: TrafficRoad, events: tuple[Event, ...] | None = None) -> Frame:
    """Everybody on the road now.

    Args:
        road: to read.
        events: what happened; by default the events since they were last taken.
    """
    return road.frame(road.take_events() if events is None else events)
