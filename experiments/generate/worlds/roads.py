"""The roads of worlds, and the traffic that wants to pass them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.elementwise import log_uniform
from behaviors.errors import InputError
from experiments.generate.worlds.written_nets import limited_net, ramp_net, straight_net
from scenarios.four_way_intersection import TURNS
from scenarios.networks.geometries import ARMS, TWO_WAY_LENGTH_M
from sim.scenario import RouteFlow

FAMILIES: Final = {"straight": 0.45, "junction": 0.25, "ramp": 0.2, "two-way": 0.1}
"""Chance of each family of roads."""

JUNCTIONS: Final[dict[str, dict[int, str]]] = {
    "traffic_light": {1: "four_way_1", 2: "four_way_intersection", 3: "four_way_3"},
    "priority": {1: "four_way_priority", 2: "four_way_priority_2"},
    "right_before_left": {1: "four_way_right_before_left", 2: "four_way_right_before_left_2"},
    "allway_stop": {1: "four_way_allway_stop"},
}
"""The shipped net of each control of a junction, by lanes in each direction."""

MOST_PRESENT: Final = 60.0
"""Largest number of vehicles on the road at once, about, by which flows are bounded: more take time
and show nothing new."""

RAMP_SHARE: Final = (0.1, 0.35)
"""Share of the traffic that uses each ramp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldRoad:
    """A road and the demand on it.

    Attributes:
        family: straight, junction, ramp or two-way.
        control: priority at a junction; "" without one.
        lanes: in each direction.
        limit_mps: speed limit, m/s.
        length_m: of the road, of a junction from end to end, m.
        flow: vehicles per hour over all entries.
        pedestrians_per_h: per hour.
        ramp_share: share of the traffic that enters, and that leaves, by a ramp.
    """

    family: str
    control: str = ""
    lanes: int
    limit_mps: float
    length_m: float
    flow: float
    pedestrians_per_h: float = 0.0
    ramp_share: float = 0.0

    def net(self) -> str:
        """The text of the SUMO net.

        Raises:
            InputError: if no such family or control exists.
        """
        if self.family == "straight":
            return straight_net(self.lanes, self.limit_mps, self.length_m)
        if self.family == "ramp":
            return ramp_net(self.lanes, self.limit_mps, self.length_m)
        if self.family == "two-way" and self.lanes in (1, 2):
            return limited_net(f"two_way_{self.lanes}_plain", self.limit_mps)
        if self.family == "junction" and self.lanes in JUNCTIONS.get(self.control, {}):
            return limited_net(JUNCTIONS[self.control][self.lanes], self.limit_mps)
        raise InputError(
            f"road: found {self.family} {self.control} with {self.lanes} lanes, expected one of "
            f"{', '.join(FAMILIES)}, a junction with one of {', '.join(JUNCTIONS)} and few lanes"
        )

    def flows(self) -> tuple[RouteFlow, ...]:
        """The demand along each route."""
        if self.family == "straight":
            return (RouteFlow(("road",), self.flow),)
        if self.family == "two-way":
            return tuple(
                RouteFlow((f"{way}_in", f"{way}_out"), self.flow / 2) for way in ("east", "west")
            )
        if self.family == "ramp":
            aside = self.flow * self.ramp_share
            return (
                RouteFlow(("before", "between", "after"), self.flow - 2 * aside),
                RouteFlow(("on", "between", "after"), aside),
                RouteFlow(("before", "between", "off"), aside),
            )
        arms, found = list(ARMS), []
        for i, arm in enumerate(arms):
            for places, share in TURNS.items():
                route = (f"{arm}_in", f"{arms[(i - places) % len(arms)]}_out")
                found.append(RouteFlow(route, self.flow / len(arms) * share))
                walkers = self.pedestrians_per_h / (len(arms) * len(TURNS))
                found.append(RouteFlow(route, walkers, walking=True))
        return tuple(found)


def draw_road(rng: np.random.Generator) -> WorldRoad:
    """Draw a road of 20 to 130 km/h with one to five lanes, and light to dense traffic on it."""
    family = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    level = float(rng.uniform(0.0, 1.0))
    if family == "junction":
        control = str(rng.choice(list(JUNCTIONS)))
        signals = control == "traffic_light"
        lanes = int(rng.choice(list(JUNCTIONS[control])))
        limit = float(rng.uniform(20.0, 70.0)) / 3.6
        return WorldRoad(
            family=family,
            control=control,
            lanes=lanes,
            limit_mps=round(limit, 2),
            length_m=500.0,
            flow=round((200.0 + 700.0 * level) * lanes if signals else 200.0 + 550.0 * level),
            pedestrians_per_h=float(rng.choice((0.0, 0.0, 120.0, 300.0))),
        )
    if family == "two-way":
        lanes = int(rng.integers(1, 3))
        return WorldRoad(
            family=family,
            lanes=lanes,
            limit_mps=round(float(rng.uniform(30.0, 100.0)) / 3.6, 2),
            length_m=TWO_WAY_LENGTH_M,
            flow=round((250.0 + 800.0 * level) * lanes),
        )
    ramp = family == "ramp"
    limit = float(rng.uniform(60.0 if ramp else 20.0, 130.0)) / 3.6
    lanes = int(rng.integers(1, 5 if ramp else 6))
    seconds = log_uniform(rng, 25.0, 80.0)
    length = min(max(limit * seconds, 900.0 if ramp else 250.0), 2500.0)
    flow = (250.0 + 1550.0 * level) * lanes
    present = flow / 3600.0 * length / (0.85 * limit)
    return WorldRoad(
        family=family,
        lanes=lanes,
        limit_mps=round(limit, 2),
        length_m=round(length),
        flow=round(flow * min(1.0, MOST_PRESENT / present)),
        ramp_share=round(float(rng.uniform(*RAMP_SHARE)), 3) if ramp else 0.0,
    )
