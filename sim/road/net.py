"""Reads a SUMO net into a `Road` with sumolib; no simulator is needed."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray, Signal
from sim.input_files import broken_as_one_line, read_bytes, read_once, refuse_declarations
from sim.road import Connection, Crossing, Lane, Road, SignalPlan

_DIRECTIONS: Final = {
    "s": "straight", "l": "left", "L": "left", "r": "right", "R": "right", "t": "turnaround",
    "T": "turnaround",
}  # fmt: skip
"""SUMO's link directions in words; partial turns count as turns."""

_STATES: Final = {
    **dict.fromkeys("rsu", Signal.RED), **dict.fromkeys("yY", Signal.YELLOW),
    **dict.fromkeys("gG", Signal.GREEN), **dict.fromkeys("oO", Signal.OFF),
}  # fmt: skip
"""SUMO's signal letters as states; red-yellow ("u") and green arrow ("s") still mean stop."""

HEAD_BYTES: Final = 65536
"""Beginning of a net in which its location stands."""

MAX_NET_BYTES: Final = 2**28
"""Largest net that is read, unpacked (256 MiB; a district of a city has some 20)."""

_LEFT_HAND: Final = re.compile(rb"""<net\b[^>]*?\blefthand\s*=\s*["'](?:true|1)["']""")
_OFFSET: Final = re.compile(
    rb"""<location\b[^>]*?\bnetOffset\s*=\s*["']([-+.\deE]+),([-+.\deE]+)"""
)


def net_offset(path: Path) -> tuple[float, float]:
    """Offset that was added to the coordinates of a SUMO net, m; 0 for other maps."""
    found = _OFFSET.search(read_bytes(path, MAX_NET_BYTES)[:HEAD_BYTES])
    try:
        return (float(found[1]), float(found[2])) if found else (0.0, 0.0)
    except ValueError:
        return 0.0, 0.0


def signal_code(letter: str) -> int:
    """The code into ``SIGNALS`` of one letter of a SUMO signal state."""
    return _STATES[letter].code


@read_once
def read_road(path: Path, name: str | None = None) -> Road:
    """Read a SUMO net, with its junction paths, sidewalks, connections, crossings and signals.

    Args:
        path: a ``.net.xml`` file (or ``.net.xml.gz``).
        name: what to call the road; by default the file's name without its ending.

    Raises:
        InputError: if the file is missing or is not a SUMO net with at least one drivable lane.
    """
    import sumolib

    with broken_as_one_line(path, "a SUMO net (.net.xml)"):
        data = read_bytes(path, MAX_NET_BYTES)
        refuse_declarations(path, data)
        net = sumolib.net.readNet(
            str(path),
            withInternal=True,
            withPedestrianConnections=True,
            withPrograms=True,
            lxml=False,  # sumolib's reader for lxml does not link crossings to the roads they cross
        )
        edges = [edge for edge in _by_id(net.getEdges()) if edge.getFunction() in ("", "internal")]
        lanes = tuple(_lane(lane, edge) for edge in edges for lane in edge.getLanes())
        if not any(lane.cars for lane in lanes):
            raise InputError("found no drivable lane, expected at least one")
        plans, groups, group_of = _signals(net)
        road = Road(
            name=name if name is not None else path.name.split(".")[0],
            lanes=lanes,
            connections=tuple(_connections(net, group_of)),
            crossings=tuple(_crossings(net, group_of)),
            signal_groups=groups,
            source=path.resolve(),
            signal_plans=plans,
            left_hand=_LEFT_HAND.search(data[:HEAD_BYTES]) is not None,
        )
        return road.checked()


def _by_id(parts: Iterable[Any]) -> list[Any]:
    """Parts of a net in the order of their ids."""
    return sorted(parts, key=lambda part: str(part.getID()))


def _points(lane: Any) -> FloatArray:
    return frozen(np.array(lane.getShape(), dtype=np.float64)[:, :2])


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


GroupOf = dict[tuple[str, int], int]
"""The signal group of each link, by its traffic lights' id and its index there."""


def _signals(net: Any) -> tuple[tuple[SignalPlan, ...], tuple[str, ...], GroupOf]:
    """The signal plans, the names of all groups, and each link's group."""
    plans: list[SignalPlan] = []
    names: list[str] = []
    group_of: GroupOf = {}
    for lights in _by_id(net.getTrafficLights()):
        programs = lights.getPrograms()
        if not programs:
            continue
        program = list(programs.values())[-1]  # SUMO runs the one that it loads last
        phases = program.getPhases()
        codes, id = np.array([[*map(signal_code, phase.state)] for phase in phases]), lights.getID()
        columns: dict[tuple[int, ...], int] = {}
        firsts: list[int] = []
        for link, column in enumerate(map(tuple, codes.T.tolist())):
            if column not in columns:
                columns[column] = len(names)
                names.append(f"{id}/{len(columns) - 1}")
                firsts.append(link)
            group_of[str(id), link] = columns[column]
        plans.append(
            SignalPlan(
                id=str(id),
                groups=tuple(columns.values()),
                links=tuple(firsts),
                duration_s=tuple(float(phase.duration) for phase in phases),
                states=tuple(map(tuple, codes[:, firsts].tolist())),
                offset_s=float(program.getOffset()),
            )
        )
    return tuple(plans), tuple(names), group_of


def _group(link: Any, group_of: GroupOf) -> int:
    """The signal group that controls a link, -1 if none."""
    return group_of.get((str(link.getTLSID()), int(link.getTLLinkIndex())), -1)


def _connections(net: Any, group_of: GroupOf) -> list[Connection]:
    links = [
        link
        for edge in _by_id(net.getEdges(withInternal=False))
        for lane in edge.getLanes()
        if lane.allows("passenger")
        for link in lane.getOutgoing()
        if not link.getTo().getFunction()
    ]
    group = [_group(link, group_of) for link in links]
    rivals: dict[tuple[int, int], list[int]] = {}  # let go together at one junction
    for i, link in enumerate(links):
        rivals.setdefault((id(link.getJunction()), group[i]), []).append(i)
    # the number of each link in its junction's table of priorities
    place = [link.getJunction().getLinkIndex(link) for link in links]
    found = []
    for i, link in enumerate(links):
        # unregulated junctions have no rules
        rules = link.getJunction()._prohibits.get(place[i], "")
        stronger = tuple(
            other
            for other in rivals[id(link.getJunction()), group[i]]
            if rules and other != i and place[other] >= 0 and rules[-(place[other] + 1)] == "1"
        )
        via: list[str] = []
        at = link.getViaLaneID()
        while at:
            if str(at) in via:
                raise InputError(
                    f"lane {str(at)!r:.60}: found a way that leads back to it, "
                    "expected one out of the junction"
                )
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
                must_stop=str(link.getState()) in {"s", "w"},  # stop, all-way stop
                yields_to=stronger,
            )
        )
    return found


def _crossings(net: Any, group_of: GroupOf) -> list[Crossing]:
    found = []
    for edge in _by_id(edge for edge in net.getEdges() if edge.getFunction() == "crossing"):
        crossed = tuple(str(e.getID()) for e in edge.getCrossingEdges())
        if not crossed:
            raise InputError(
                f"crossing {str(edge.getID())!r:.60}: found no road that it crosses, "
                "expected at least one"
            )
        lane = edge.getLanes()[0]
        links = [link for group in edge.getIncoming().values() for link in group]
        found.append(
            Crossing(
                id=str(edge.getID()),
                centerline=_points(lane),
                width_m=float(lane.getWidth()),
                edges=crossed,
                signal=max((_group(link, group_of) for link in links), default=-1),
                priority=all(link.getState() not in {*"msw="} for link in links),  # minor, equal
            )
        )
    return found
