"""Common part of the drivers' controllers: the drivers, and which of them are present."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeVar

import numpy as np

from behaviors.profiles import Profile
from sim.road import Road
from sim.scenario import AgentSpec

LANE_CHANGES: Final = 1621
"""SUMO's lane-change mode by default: changes for all of SUMO's reasons, and by command."""

NO_LANE_CHANGES: Final = 0
"""SUMO's lane-change mode: changes by command only."""

FORCED_LANE_CHANGES: Final = 256
"""SUMO's lane-change mode: changes by command only, refused only if vehicles would touch."""


def release(sumo: Any, name: str) -> None:
    """Let SUMO choose a vehicle's speed and lane again."""
    sumo.vehicle_setSpeed(name, -1.0)
    sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)


def drivable(road: Road) -> frozenset[tuple[str, int]]:
    """Edge and index of every lane on which vehicles may drive."""
    return frozenset((lane.edge, lane.index) for lane in road.lanes if not lane.walking)


@dataclass(slots=True)
class Driver:
    """A driver whom a controller steers.

    Attributes:
        agent: the driver's drawn numbers.
        stream: number of the driver's random stream for this controller.
        rng: that stream.
        following: by edge of its route, the one that follows.
    """

    agent: AgentSpec
    stream: int
    rng: np.random.Generator = field(init=False)
    following: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        """Begin the random stream and read the route."""
        self.rng = np.random.default_rng((self.agent.seed, self.stream))
        self.following = dict(itertools.pairwise(self.agent.route))

    @property
    def profile(self) -> Profile:
        """The driver's profile."""
        assert self.agent.profile is not None
        return self.agent.profile


@dataclass(slots=True)
class RouteDriver(Driver):
    """A driver that decides again on every edge, the last of them ``edge``, and looks at times."""

    edge: str = ""
    next_check_s: float = 0.0


@dataclass(slots=True)
class RandomTimeDriver(Driver):
    """A driver who acts so often per minute, next at ``next_s``, with exponential pauses."""

    rate_per_min: float
    next_s: float = field(init=False)

    def __post_init__(self) -> None:
        """Draw the first time."""
        Driver.__post_init__(self)
        self.pause_from(self.agent.depart_s)

    def pause_from(self, time_s: float) -> None:
        """Draw the next time to act, after a pause that begins at ``time_s``."""
        self.next_s = time_s + float(self.rng.exponential(60.0 / self.rate_per_min))


D = TypeVar("D", bound=Driver)


class Controller(ABC, Generic[D]):
    """Steers some drivers of a running simulation, given as libsumo's C module.

    Attributes:
        _lanes: the lanes for vehicles outside junctions, by id.
        _drivers: the drivers that it concerns, by name.
        _present: name and driver of those that are on the road, in SUMO's order.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._sumo = sumo
        self._lanes = {
            lane.id: lane for lane in road.lanes if not lane.internal and not lane.walking
        }
        self._drivers: dict[str, D] = {}
        self._present: list[tuple[str, D]] = []
        for agent in agents:
            self._take(agent)

    @abstractmethod
    def _driver(self, agent: AgentSpec, profile: Profile) -> D | None:
        """The controller's state of a driver; None for one without control."""

    def _take(self, agent: AgentSpec) -> D | None:
        """Begin with a driver, if it is of concern."""
        driver = None if agent.profile is None else self._driver(agent, agent.profile)
        if driver is not None:
            self._drivers[str(agent.id)] = driver
        return driver

    def set_vehicles(self, vehicles: Sequence[str]) -> None:
        """Take the names of the vehicles to steer, whenever they change."""
        self._present = [(name, self._drivers[name]) for name in vehicles if name in self._drivers]

    def change(self, agent: AgentSpec, time_s: float) -> None:
        """Begin again with a driver; one who acts at random times pauses from now on."""
        self._drivers.pop(str(agent.id), None)
        driver = self._take(agent)
        if isinstance(driver, RandomTimeDriver):
            driver.pause_from(time_s)
