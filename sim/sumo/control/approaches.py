"""What lies ahead at the end of an edge: signals, stop lines, crossings, lanes that lead on."""

from __future__ import annotations

from dataclasses import dataclass

from sim.road import Connection, Road


@dataclass(frozen=True, slots=True)
class Approach:
    """The junction at the end of an edge, for one way on.

    Attributes:
        lanes: indices of the edge's lanes from which the way on can be driven.
        signal: whether a signal controls it.
        stop: whether there is a stop sign.
        crossings: ids of the crossings that it leads over while people may walk there.
        on_red: ids of those that it leads over on red, too.
    """

    lanes: frozenset[int]
    signal: bool
    stop: bool
    crossings: frozenset[str]
    on_red: frozenset[str]


def approaches(road: Road) -> dict[tuple[str, str], Approach]:
    """The approach of every edge and the edge that may follow it."""
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
