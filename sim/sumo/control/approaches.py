"""Approaches: the signals, stop lines and crossings at the end of an edge, for each next edge."""

from __future__ import annotations

from dataclasses import dataclass

from sim.road import Connection, Road


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


def approaches(road: Road) -> dict[tuple[str, str], Approach]:
    """The approaches of a road, by edge and next edge."""
    lanes = {lane.id: lane for lane in road.lanes}
    links: dict[tuple[str, str], list[Connection]] = {}
    for link in road.connections:
        edges = (lanes[link.from_lane].edge, lanes[link.to_lane].edge)
        links.setdefault(edges, []).append(link)
    return {
        edges: Approach(
            lanes=frozenset(lanes[link.from_lane].index for link in ways),
            signal=any(link.signal >= 0 for link in ways),
            stop=any(link.must_stop for link in ways),
            crossings=frozenset(
                crossing.id
                for crossing in road.crossings
                if set(edges) & set(crossing.edges)
                and any(road.green_together(link.signal, crossing.signal) for link in ways)
            ),
            on_red=frozenset(c.id for c in road.crossings if set(edges) & set(c.edges)),
        )
        for edges, ways in links.items()
    }


def drivable(road: Road) -> frozenset[tuple[str, int]]:
    """Edge and index of every lane on which vehicles may drive."""
    return frozenset((lane.edge, lane.index) for lane in road.lanes if not lane.walking)
