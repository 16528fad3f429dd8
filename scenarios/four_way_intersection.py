"""Four-way intersections with sidewalks and crossings on every arm, under any control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from behaviors.labels import Behavior
from behaviors.profiles import DEFAULT_SPREAD
from scenarios.demand import parse_flow, parse_kinds, parse_mix
from scenarios.networks.build import net_of
from scenarios.networks.geometry import ARM_M, ARMS, LIMIT_MPS, FourWayGeometry
from sim.frames import AgentKind
from sim.road.net import read_road
from sim.scenario import DEFAULT_JAYWALK_SHARE, Scenario, Stream

SIGNALISED_FLOWS: Final[dict[str, float]] = {"light": 600.0, "medium": 1200.0, "dense": 1800.0}
"""Vehicles per hour over all arms of each named flow, with signals and 2 lanes (our choice: free,
interacting, near capacity)."""

OTHER_FLOWS: Final[dict[str, float]] = {"light": 250.0, "medium": 500.0, "dense": 750.0}
"""The same without signals and with 1 lane."""

TURNS: Final[dict[int, float]] = {1: 0.2, 2: 0.6, 3: 0.2}
"""Share of vehicles that leave by the arm that many places clockwise round from theirs: left,
straight, right (our choice)."""

PEDESTRIANS_PER_H: Final = 240.0
"""Pedestrians per hour over all arms (our choice)."""


def four_way_intersection(
    *,
    flow: str | float = "medium",
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None = None,
    kinds: str | Mapping[AgentKind, float] | Mapping[str, float] | None = None,
    spread: float = DEFAULT_SPREAD,
    duration_s: float = 300.0,
    step_s: float = 0.1,
    pedestrians_per_h: float = PEDESTRIANS_PER_H,
    jaywalk_share: float = DEFAULT_JAYWALK_SHARE,
    control: str = "traffic_light",
    lanes: int | None = None,
    arm_m: float = ARM_M,
    limit_mps: float = LIMIT_MPS,
) -> Scenario:
    """Four arms of 250 m, 50 km/h; by default fixed-time signals of 60 s and 2 lanes each way.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all arms.
        mix: share of each behaviour, as a mapping or ``"impatient=.2,..."``; None for equal.
        kinds: share of each kind of vehicle, as a mapping or ``"car=.9,truck=.1"``; None for cars.
        spread: how much drivers of one behaviour differ.
        duration_s: s.
        step_s: time between frames, s.
        pedestrians_per_h: pedestrians per hour over all arms.
        jaywalk_share: share of pedestrians who cross on red and anywhere.
        control: ``traffic_light``, ``priority`` (of the east-west road), ``allway_stop`` or
            ``right_before_left``.
        lanes: lanes per direction, 1 to 5; by default 2 with signals and 1 without.
        arm_m: length of each arm, m.
        limit_mps: speed limit, m/s.

    Returns:
        The scenario. Roads whose net is not shipped are built with netconvert.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> len(four_way_intersection().road.signal_groups)
        4
        >>> four_way_intersection(control="priority").road.signal_groups
        ()
    """
    signalised = control == "traffic_light"
    geometry = FourWayGeometry(
        control=control,
        lanes=(2 if signalised else 1) if lanes is None else lanes,
        arm_m=arm_m,
        limit_mps=limit_mps,
    )
    vehicles = parse_flow(flow, SIGNALISED_FLOWS if signalised else OTHER_FLOWS) / len(ARMS)
    walkers = parse_flow(pedestrians_per_h, {}, "pedestrians_per_h") / (len(ARMS) * len(TURNS))
    arms = list(ARMS)
    streams = []
    for i, arm in enumerate(arms):
        for places, share in TURNS.items():
            to = arms[(i - places) % len(arms)]
            streams.append(Stream((f"{arm}_in", f"{to}_out"), vehicles * share))
            streams.append(Stream((f"{arm}_in", f"{to}_out"), walkers, walking=True))
    return Scenario(
        name="four_way_intersection",
        road=read_road(net_of(geometry), "four_way_intersection"),
        streams=tuple(streams),
        mix=parse_mix(mix),
        spread=spread,
        duration_s=duration_s,
        step_s=step_s,
        kinds=parse_kinds(kinds),
        jaywalk_share=jaywalk_share,
    )


if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("four_way_intersection"))
