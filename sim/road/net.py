"""Reads a SUMO net into a `Road` with sumolib; no simulator is needed."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import Signal
from sim.input_files import broken_as_one_line, read_bytes, read_once
from sim.road import Connection, Crossing, Lane, Road, SignalPlan
from sim.road.maps.lanelets import check_lines
from sim.xml_tree import refuse_declarations

_DIRECTIONS: Final = {
    "s": "straight",
    "l": "left",
    "L": "left",
    "r": "right",
    "R": "right",
    "t": "turnaround",
    "T": "turnaround",
}
"""SUMO's link directions in words; partial turns count as turns."""

_STATES: Final = {
    "r": Signal.RED,
    "s": Signal.RED,
    "u": Signal.RED,
    "y": Signal.YELLOW,
    "Y": Signal.YELLOW,
    "g": Signal.GREEN,
    "G": Signal.GREEN,
    "o": Signal.OFF,
    "O": Signal.OFF,
}
"""SUMO's signal letters as states; red-yellow ("u") and green arrow ("s") still mean stop."""

YIELDING_STATES: Final = frozenset("msw=")
"""Link states of connections that do not have priority: minor, stop, all-way stop, equal."""

STOPPING_STATES: Final = frozenset("sw")
"""Link states of connections with a stop sign."""


HEAD_BYTES: Final = 65536
"""Beginning of a net in which its location stands."""

MAX_NET_BYTES: Final = 2**28
"""Largest net that is read, unpacked (256 MiB; a district of a city has some 20)."""

MAX_WIDTH_M: Final = 1000.0
"""Widest lane, m."""

_LEFT_HAND: Final = re.compile(rb"""<net\b[^>]*?\blefthand\s*=\s*["'](?:true|1)["']""")
_OFFSET: Final = re.compile(
    rb"""<location\b[^>]*?\bnetOffset\s*=\s*["']([-+.\deE]+),([-+.\deE]+)"""
)


def net_offset(path: Path) -> tuple[float, float]:
    """Offset that was added to the coordinates of a SUMO net, m; 0 by default.

    Args:
        path: a net, or any other map.
    """
    found = _OFFSET.search(read_bytes(path, MAX_NET_BYTES)[:HEAD_BYTES])
    try:
        return (float(found[1]), float(found[2])) if found else (0.0, 0.0)
    except ValueError:
        return 0.0, 0.0


def signal_code(letter: str) -> int:
    """The code into ``SIGNALS`` of one letter of a SUMO signal state.

    Examples:
        >>> signal_code("G"), signal_code("r")
        (2, 0)
    """
    return _STATES[letter].code


@read_once
def read_road(path: Path, name: str | None = None) -> Road:
    """Read a SUMO net.

    Args:
        path: a ``.net.xml`` file (or ``.net.xml.gz``).
        name: what to call the road; by default the file's name without its ending.

    Returns:
        Its lanes (junction paths and sidewalks too), connections, crossings and signals.

    Raises:
        InputError: if the file is missing or is not a SUMO net with at least one drivable lane.
    """
    with broken_as_one_line(path, "a SUMO net (.net.xml)"):
        data = read_bytes(path, MAX_NET_BYTES)
        refuse_declarations(path, data)
        road = _road(path, name)
        _check(road)
        left_hand = _LEFT_HAND.search(data[:HEAD_BYTES]) is not None
        return dataclasses.replace(road, left_hand=left_hand)


def _road(source: Path, name: str | None) -> Road:
    import sumolib

    net = sumolib.net.readNet(
        str(source),
        withInternal=True,
        withPedestrianConnections=True,
        withPrograms=True,
        lxml=False,  # sumolib's reader for lxml does not link crossings to the roads they cross
    )
    lanes = tuple(_lane(lane, edge) for edge in _edges(net) for lane in edge.getLanes())
    if not any(lane.cars for lane in lanes):
        raise InputError("found no drivable lane, expected at least one")
    plans, groups, group_of = _signals(net)
    return Road(
        name=name if name is not None else source.name.split(".")[0],
        lanes=lanes,
        connections=tuple(_connections(net, group_of)),
        crossings=tuple(_crossings(net, group_of)),
        signal_groups=groups,
        source=source.resolve(),
        signal_plans=plans,
    )


def _check(road: Road) -> None:
    """Refuse a net whose numbers or references make no road."""
    parts: tuple[Lane | Crossing, ...] = (*road.lanes, *road.crossings)
    check_lines(road.source, [part.centerline for part in parts])
    for part in parts:
        limit = getattr(part, "speed_limit_mps", 0.0)
        if not (0 < part.width_m <= MAX_WIDTH_M and 0 <= limit < np.inf):
            raise InputError(
                f"{part.id!r:.60}: found width {part.width_m} m and speed {limit} m/s, expected "
                f"up to {MAX_WIDTH_M:g} m and a limit"
            )
    if len(road.lane_index) < len(road.lanes):
        raise InputError("lanes: found an id twice, expected each once")
    named = {i for link in road.connections for i in (link.from_lane, *link.via, link.to_lane)}
    if not named <= road.lane_index.keys():
        raise InputError(f"connection: found lane {min(named - {*road.lane_index})!r:.60} nowhere")
    for plan in road.signal_plans:
        lasts = np.array(plan.duration_s)
        if not (np.isfinite([*lasts, plan.offset_s]).all() and (lasts >= 0).all() and lasts.sum()):
            raise InputError(f"signals {plan.id!r:.60}: found broken durations, expected seconds")


def _edges(net: Any) -> list[Any]:
    """Roads, sidewalks and junction paths, in the order of their ids."""
    kept = [e for e in net.getEdges() if e.getFunction() in ("", "internal")]
    return sorted(kept, key=lambda e: str(e.getID()))


def _points(lane: Any) -> np.ndarray:
    shape = np.array(lane.getShape(), dtype=np.float64)[:, :2]
    shape.flags.writeable = False
    return shape


def _lane(lane: Any, edge: Any) -> Lane:
    return Lane(
        id=str(lane.getID()),
        edge=str(edge.getID()),
        index=int(lane.getIndex()),
        centerline=_points(lane),
        width_m=float(lane.getWidth()),
        speed_limit_mps=float(lane.getSpeed()),
        walking=not lane.allows("passenger") and lane.allows("pedestrian"),
        internal=edge.getFunction() == "internal",
        opposite=str(lane.getNeigh() or ""),
        cars=bool(lane.allows("passenger")),
    )


def _signals(
    net: Any,
) -> tuple[tuple[SignalPlan, ...], tuple[str, ...], dict[tuple[str, int], int]]:
    """The signal plans, the names of all groups, and each link's group."""
    plans: list[SignalPlan] = []
    names: list[str] = []
    group_of: dict[tuple[str, int], int] = {}
    for lights in sorted(net.getTrafficLights(), key=lambda t: str(t.getID())):
        programs = lights.getPrograms()
        if not programs:
            continue
        program = list(programs.values())[-1]  # SUMO runs the one that it loads last
        phases = program.getPhases()
        codes = np.array([[signal_code(c) for c in phase.state] for phase in phases])
        columns: dict[tuple[int, ...], int] = {}
        firsts: list[int] = []
        for link in range(codes.shape[1]):
            key = tuple(int(c) for c in codes[:, link])
            if key not in columns:
                columns[key] = len(names)
                names.append(f"{lights.getID()}/{len(columns) - 1}")
                firsts.append(link)
            group_of[str(lights.getID()), link] = columns[key]
        plans.append(
            SignalPlan(
                id=str(lights.getID()),
                groups=tuple(columns.values()),
                links=tuple(firsts),
                duration_s=tuple(float(phase.duration) for phase in phases),
                states=tuple(tuple(int(c) for c in row) for row in codes[:, firsts]),
                offset_s=float(program.getOffset()),
            )
        )
    return tuple(plans), tuple(names), group_of


def _lights(link: Any) -> tuple[str, int]:
    """The traffic lights that control a link, and its index there."""
    return str(link.getTLSID()), int(link.getTLLinkIndex())


def _connections(net: Any, group_of: dict[tuple[str, int], int]) -> list[Connection]:
    links = [
        link
        for edge in sorted(net.getEdges(withInternal=False), key=lambda e: str(e.getID()))
        for lane in edge.getLanes()
        if lane.allows("passenger")
        for link in lane.getOutgoing()
        if not link.getTo().getFunction()
    ]
    group = [group_of.get(_lights(link), -1) for link in links]
    rivals: dict[tuple[int, int], list[int]] = {}  # let go together at one junction
    for i, link in enumerate(links):
        rivals.setdefault((id(link.getJunction()), group[i]), []).append(i)
    contested = [links[some[0]].getJunction() for some in rivals.values() if len(some) > 1]
    number = _numbers_in_junctions(contested)
    place = [number.get(id(link), -1) for link in links]
    found = []
    for i, link in enumerate(links):
        prohibits = link.getJunction()._prohibits
        stronger = tuple(
            other
            for other in rivals[id(link.getJunction()), group[i]]
            if other != i
            and place[i] >= 0
            and place[other] >= 0
            and place[i] in prohibits  # unregulated junctions have no rules
            and prohibits[place[i]][-(place[other] + 1)] == "1"
        )
        via = []
        at = link.getViaLaneID()
        while at:
            if str(at) in via:
                raise InputError(f"lane {str(at)!r:.60}: found a way that leads back to it")
            via.append(str(at))
            at = net.getLane(at).getOutgoing()[0].getViaLaneID()
        found.append(
            Connection(
                from_lane=str(link.getFromLane().getID()),
                to_lane=str(link.getToLane().getID()),
                via=tuple(via),
                direction=_DIRECTIONS[link.getDirection()],
                signal=group[i],
                must_yield=bool(stronger),
                must_stop=str(link.getState()) in STOPPING_STATES,
                yields_to=stronger,
            )
        )
    return found


def _numbers_in_junctions(junctions: Sequence[Any]) -> dict[int, int]:
    """The number of each link among those of its junction, by the link's Python id."""
    places: dict[int, int] = {}
    for junction in {id(junction): junction for junction in junctions}.values():
        incoming = {str(edge.getID()): edge for edge in junction.getIncoming()}
        count = 0
        for lane_id in junction._incLanes:
            name, underscore, index = lane_id.rpartition("_")
            if not (underscore and name):
                continue
            for link in incoming[name].getLane(int(index)).getOutgoing():
                begin = link.getFromLane().getEdge().getFunction()
                end = link.getToLane().getEdge().getFunction()
                if end == "walkingarea" or (begin == "walkingarea" and end != "crossing"):
                    continue
                places.setdefault(id(link), count)
                count += 1
    return places


def _crossings(net: Any, group_of: dict[tuple[str, int], int]) -> list[Crossing]:
    found = []
    edges = [e for e in net.getEdges() if e.getFunction() == "crossing"]
    for edge in sorted(edges, key=lambda e: str(e.getID())):
        crossed = tuple(str(e.getID()) for e in edge.getCrossingEdges())
        if not crossed:
            raise InputError(
                f"crossing {str(edge.getID())!r:.60}: found no road that it crosses, "
                "expected at least one"
            )
        lane = edge.getLanes()[0]
        links = [link for group in edge.getIncoming().values() for link in group]
        signal, priority = -1, True
        for link in links:
            signal = max(signal, group_of.get(_lights(link), -1))
            priority = priority and link.getState() not in YIELDING_STATES
        found.append(
            Crossing(
                id=str(edge.getID()),
                centerline=_points(lane),
                width_m=float(lane.getWidth()),
                edges=crossed,
                signal=signal,
                priority=priority,
            )
        )
    return found
