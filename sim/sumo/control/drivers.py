"""What the controllers of drivers have in common: the drivers, and which of them are present."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from behaviors.profiles import Profile
from sim.scenario import AgentSpec


@dataclass(slots=True)
class Driver:
    """A driver whom a controller steers.

    Attributes:
        agent: the driver's drawn numbers.
        stream: number of the driver's random stream for this controller.
        rng: that stream.
    """

    agent: AgentSpec
    stream: int
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        """Begin the random stream."""
        self.rng = np.random.default_rng((self.agent.seed, self.stream))

    @property
    def profile(self) -> Profile:
        """The driver's profile."""
        assert self.agent.profile is not None
        return self.agent.profile


@dataclass(slots=True)
class RouteDriver(Driver):
    """A driver whose conduct is decided anew on every edge of its route.

    Attributes:
        edge: the last edge on which something was decided.
        next_check_s: when to look at the driver again, s.
        following: by edge, the one that follows.
    """

    edge: str = ""
    next_check_s: float = 0.0
    following: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        """Read the route."""
        Driver.__post_init__(self)
        self.following = dict(itertools.pairwise(self.agent.route))


@dataclass(slots=True)
class RandomTimeDriver(Driver):
    """A driver who acts at random times, with exponential pauses between them.

    Attributes:
        rate_per_min: how often, per minute.
        next_s: when the driver next wants to act, s.
    """

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


class Controller(Generic[D]):
    """Steers some drivers of a running simulation.

    Args:
        sumo: libsumo's C module.
        drivers: those that it steers.

    Attributes:
        _present: name and driver of those that are on the road, in SUMO's order.
    """

    def __init__(self, sumo: Any, drivers: Iterable[D]) -> None:
        self._sumo = sumo
        self._drivers = {str(driver.agent.id): driver for driver in drivers}
        self._present: list[tuple[str, D]] = []

    def set_vehicles(self, vehicles: Sequence[str]) -> None:
        """Take the names of the vehicles on the road, whenever they change."""
        self._present = [(name, self._drivers[name]) for name in vehicles if name in self._drivers]

    def replace(self, name: str, fresh: Controller[D], time_s: float) -> None:
        """Take over what another controller of the same kind does with one driver.

        The caller sets the vehicle's speed and modes back to SUMO's own, so that nothing that this
        controller has begun with the driver goes on.

        Args:
            name: the vehicle.
            fresh: a controller that was made for agents among whom this driver has changed.
            time_s: simulated time, s; a driver who acts at random times pauses from now on.
        """
        self._drivers.pop(name, None)
        driver = fresh._drivers.get(name)
        if driver is None:
            return
        if isinstance(driver, RandomTimeDriver):
            driver.pause_from(time_s)
        self._drivers[name] = driver
