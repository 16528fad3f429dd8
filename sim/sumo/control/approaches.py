"""What lies ahead at the end of an edge: signals, stop lines, crossings, lanes that lead on."""

from __future__ import annotations

from dataclasses import dataclass

from sim.road import Road


@dataclass(frozen=True, slots=True)
class Approach:
    """The junction at the end of an edge, for one way on.

    Attributes:
        lanes: indices of the edge's lanes from which the way on can be driven.
        signal: whether a signal controls it.
        stop: whether there is a stop sign.
        crossings: ids of the crossings that it leads over.
    """

    lanes: frozenset[int]
    signal: bool
    stop: bool
    crossings: frozenset[str]


def approaches(road: Road) -> dict[tuple[str, str], Approach]:
    """The approach of every edge and the edge that may follow it."""
    lanes = {lane.id: lane for lane in road.lanes}
    links: dict[tuple[str, str], list[tuple[int, bool, bool]]] = {}
    for link in road.connections:
        begin, end = lanes[link.from_lane], lanes[link.to_lane]
        way = (begin.index, link.signal >= 0, link.must_stop)
        links.setdefault((begin.edge, end.edge), []).append(way)
    return {
        edges: Approach(
            lanes=frozenset(index for index, _, _ in ways),
            signal=any(signal for _, signal, _ in ways),
            stop=any(stop for _, _, stop in ways),
            crossings=frozenset(c.id for c in road.crossings if set(edges) & set(c.edges)),
        )
        for edges, ways in links.items()
    }
