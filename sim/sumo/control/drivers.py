"""Common part of the controllers: the road, the drivers, and which of them are present."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final, Generic, TypeVar

import numpy as np

from behaviors.profiles import Profile
from sim.road import Connection, Lane, Road
from sim.scenario import AgentSpec

LANE_CHANGES: Final = 1621
"""SUMO's lane-change mode by default: changes for all of SUMO's reasons, and by command."""

NO_LANE_CHANGES: Final = 0
"""SUMO's lane-change mode: changes by command only."""

FORCED_LANE_CHANGES: Final = 256
"""SUMO's lane-change mode: changes by command only, refused only if vehicles would touch."""

ORDINARY_SPEED_MODE: Final = 31
"""SUMO's default speed mode: safe speed, limits of the vehicle, right of way, red lights."""


def release(sumo: Any, name: str) -> None:
    """Let SUMO choose a vehicle's speed and lane again."""
    sumo.vehicle_setSpeed(name, -1.0)
    sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)


@dataclass(frozen=True, slots=True)
class Approach:
    """The junction at the end of an edge, for one next edge.

    Attributes:
        lanes: indices of the edge's lanes from which the next edge can be reached.
        signal: whether a signal controls it.
        stop: whether there is a stop sign.
        crossings: ids of the crossings on the way where pedestrians may walk at the same time.
        on_red: ids of all crossings on the way, which vehicles that run a red light may meet.
    """

    lanes: frozenset[int]
    signal: bool
    stop: bool
    crossings: frozenset[str]
    on_red: frozenset[str]


@dataclass(frozen=True)
class Streets:
    """What all controllers of a simulation look up.

    Attributes:
        sumo: libsumo's C module.
        road, agents: those of the episode.
        step_s, period_s: time between simulation steps, and between steps of a controller, s.
    """

    sumo: Any
    road: Road
    agents: Sequence[AgentSpec]
    step_s: float
    period_s: float

    @cached_property
    def lanes(self) -> dict[str, Lane]:
        """The lanes for vehicles outside junctions, by id."""
        return {one.id: one for one in self.road.lanes if not (one.internal or one.walking)}

    def beside(self, lane: Lane, side: int) -> Lane | None:
        """The lane to the left (1) or to the right (-1) of one, for vehicles too."""
        return self.lanes.get(f"{lane.edge}_{lane.index + side}")

    @cached_property
    def approaches(self) -> dict[tuple[str, str], Approach]:
        """The approaches of the road, by edge and next edge."""
        road = self.road
        lanes = {lane.id: lane for lane in road.lanes}
        links: dict[tuple[str, str], list[Connection]] = {}
        for link in road.connections:
            edges = (lanes[link.from_lane].edge, lanes[link.to_lane].edge)
            links.setdefault(edges, []).append(link)
        found = {}
        for edges, ways in links.items():
            crossed = [one for one in road.crossings if set(edges) & set(one.edges)]
            found[edges] = Approach(
                lanes=frozenset(lanes[link.from_lane].index for link in ways),
                signal=any(link.signal >= 0 for link in ways),
                stop=any(link.must_stop for link in ways),
                crossings=frozenset(
                    one.id
                    for one in crossed
                    if any(road.green_together(link.signal, one.signal) for link in ways)
                ),
                on_red=frozenset(one.id for one in crossed),
            )
        return found


@dataclass(slots=True)
class Driver:
    """A driver whom a controller steers.

    Attributes:
        stream: number of the random stream of the controller's drivers.
        agent: the driver's drawn numbers.
        rate_per_min: how often it acts; None for a driver who acts where it comes to a junction.
        name, profile: its name in SUMO, and how it drives.
        rng: its random stream.
        following: by edge of its route, the one that follows.
        next_s: when the controller looks at it again, s.
    """

    stream: ClassVar[int]
    agent: AgentSpec
    rate_per_min: float | None = None
    name: str = field(init=False)
    profile: Profile = field(init=False)
    rng: np.random.Generator = field(init=False)
    following: Mapping[str, str] = field(init=False)
    next_s: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        """Begin the random stream, read the route, and draw the first time."""
        assert self.agent.profile is not None
        self.name, self.profile = str(self.agent.id), self.agent.profile
        self.rng = np.random.default_rng((self.agent.seed, self.stream))
        self.following = dict(itertools.pairwise(self.agent.route))
        self.pause_from(self.agent.depart_s)

    def pause_from(self, time_s: float) -> None:
        """Draw the next time to act, after an exponential pause that begins at ``time_s``."""
        if self.rate_per_min is not None:
            self.next_s = time_s + float(self.rng.exponential(60.0 / self.rate_per_min))

    def draws(self, probability: float) -> bool:
        """Whether something of that probability happens."""
        return bool(self.rng.random() < probability)


D = TypeVar("D", bound=Driver)


class Controller(ABC, Generic[D]):
    """Steers some drivers of a running simulation.

    Attributes:
        _drivers: the drivers that it concerns, by name.
        _present: those of them that are on the road, in SUMO's order.
    """

    def __init__(self, streets: Streets) -> None:
        self._streets, self._sumo, self._lanes = streets, streets.sumo, streets.lanes
        self._drivers: dict[str, D] = {}
        self._present: list[D] = []
        for agent in streets.agents:
            self._begin_with(agent)

    @abstractmethod
    def _driver(self, agent: AgentSpec, profile: Profile) -> D | None:
        """The controller's state of a driver; None for one without control."""

    @abstractmethod
    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Act at a simulated time, s, given who is on the road."""

    def _begin_with(self, agent: AgentSpec) -> D | None:
        """Begin with a driver, if it is of concern."""
        driver = None if agent.profile is None else self._driver(agent, agent.profile)
        if driver is not None:
            self._drivers[driver.name] = driver
        return driver

    def set_vehicles(self, vehicles: Sequence[str]) -> None:
        """Take the names of the vehicles to steer, whenever they change."""
        self._present = [self._drivers[name] for name in vehicles if name in self._drivers]

    def change(self, agent: AgentSpec, time_s: float) -> None:
        """Begin again with a driver; one who acts at random times pauses from now on."""
        self._drivers.pop(str(agent.id), None)
        driver = self._begin_with(agent)
        if driver is not None:
            driver.pause_from(time_s)
