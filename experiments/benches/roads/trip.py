"""Some vehicles on one map with one engine: who came in, who left, what went wrong on the way."""

from __future__ import annotations

import dataclasses
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from scenarios.networks.convert import KINDS, kind_of
from scenarios.own.demand import EdgeGraph
from scenarios.own.road import own_road
from scenarios.own.survey import survey
from sim.engines import get_engine
from sim.frames import EventKind, Frame
from sim.scenario import MAX_DURATION_S, AgentSpec, Scenario, sample_agents

DEMAND_S: Final = 30.0
"""The vehicles want to enter within this time, s (they meet one another)."""

LATEST_S: Final = 1500.0
"""A vehicle that is on the road after this time, and after `SLOW` times the travel time of the
longest route at the limits, counts as stuck, s (routes on maps of some kilometres take a third of
it)."""

SLOW: Final = 4.0
"""A route may take this many times its travel time at the limits (lights, jams, cautious drivers
and slow vehicles)."""

JUMP_MPS: Final = 80.0
"""A vehicle that moves faster than this between two frames has teleported, m/s (288 km/h)."""


@dataclass
class Trip:
    """What happened on a map with an engine; or what its survey said, with no engine.

    Attributes:
        map: the file's name.
        kind: what kind of map it is, in words.
        engine: a key of ``sim.engines.ENGINES``; "" for the survey.
        vehicles: how many were to enter.
        entered: how many did.
        stayed: ids of those on the road at the end.
        teleports: jumps between two frames.
        collisions: pairs that collided, each once.
        lasted_s: when the last one left, s; of the simulation.
        wall_s: how long it took.
        defects: what the survey found wrong, by kind and place.
        refused: why the map was refused, in one line; "" if it was not.
        crashed: the last lines of a traceback; "" if there was none.
    """

    map: str
    kind: str
    engine: str
    vehicles: int = 0
    entered: int = 0
    stayed: tuple[int, ...] = ()
    teleports: int = 0
    collisions: int = 0
    lasted_s: float = 0.0
    wall_s: float = 0.0
    defects: tuple[tuple[str, str], ...] = ()
    refused: str = ""
    crashed: str = ""
    _pairs: set[tuple[int, int]] = field(default_factory=set, repr=False)

    @property
    def waiting(self) -> int:
        """How many found no room to enter within a minute."""
        return self.vehicles - self.entered


def look(path: Path) -> Trip:
    """The survey of a map.

    Args:
        path: of the map.

    Returns:
        Its defects; or why it was refused.
    """
    begun = time.monotonic()
    trip = Trip(path.name, _kind(path), "")
    try:
        trip.defects = tuple(("warning", text) for text in survey(path).warnings)
    except InputError as error:
        trip.refused = str(error)
    except Exception:  # a bench counts what must not happen
        trip.crashed = _last_lines()
    trip.wall_s = time.monotonic() - begun
    return trip


def ride(path: Path, engine: str, vehicles: int, seed: int) -> Trip:
    """Some vehicles drive on a map until everybody has left.

    Args:
        path: of the map.
        engine: a key of ``sim.engines.ENGINES``.
        vehicles: how many.
        seed: of the drivers and the engine.

    Returns:
        What happened.
    """
    begun = time.monotonic()
    trip = Trip(path.name, _kind(path), engine)
    try:
        scenario = own_road(net=path, flow=vehicles * 3600.0 / DEMAND_S, duration_s=LATEST_S)
        agents = sample_agents(scenario, seed)[:vehicles]
        travel_s = EdgeGraph(scenario.road).travel_s
        longest_s = max((sum(travel_s[e] for e in a.route) for a in agents), default=0.0)
        latest_s = min(max(LATEST_S, SLOW * longest_s + DEMAND_S), MAX_DURATION_S)
        scenario = dataclasses.replace(scenario, duration_s=latest_s)
        trip.vehicles = len(agents)
        _drive(trip, scenario, agents, seed)
    except InputError as error:
        trip.refused = str(error)
    except Exception:  # a bench counts what must not happen
        trip.crashed = _last_lines()
    trip.wall_s = time.monotonic() - begun
    return trip


def _kind(path: Path) -> str:
    try:
        return KINDS[kind_of(path)]
    except InputError:
        return "none"


def _last_lines() -> str:
    return " | ".join(traceback.format_exc().strip().splitlines()[-3:])


def _drive(trip: Trip, scenario: Scenario, agents: tuple[AgentSpec, ...], seed: int) -> None:
    entered: set[int] = set()
    before: Frame | None = None
    last_depart_s = max((agent.depart_s for agent in agents), default=0.0)
    for frame in get_engine(trip.engine)(scenario, agents, seed):
        entered.update(frame.ids.tolist())
        trip.entered, trip.stayed = len(entered), tuple(frame.ids.tolist())
        trip.lasted_s = frame.time_s
        trip.teleports += _jumps(before, frame)
        for event in frame.events:
            if event.kind is EventKind.COLLISION and event.other is not None:
                trip._pairs.add((min(event.agent, event.other), max(event.agent, event.other)))
        trip.collisions = len(trip._pairs)
        before = frame
        here = not len(frame) and frame.time_s > last_depart_s
        if here and (trip.entered == trip.vehicles or frame.time_s > last_depart_s + 65.0):
            break


def _jumps(before: Frame | None, frame: Frame) -> int:
    """How many moved further between two frames than anybody can drive."""
    if before is None:
        return 0
    _, then, now = np.intersect1d(before.ids, frame.ids, assume_unique=True, return_indices=True)
    away = np.hypot(*(frame.xy[now] - before.xy[then]).T)
    return int((away > JUMP_MPS * (frame.time_s - before.time_s)).sum())


__all__ = ["DEMAND_S", "LATEST_S", "Trip", "look", "ride"]
