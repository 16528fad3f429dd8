"""Another route for a driver whose lane does not lead where it wants to go."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sim.highway.tables import LaneTables

Stretch = tuple[str, str]


def find_way(tables: LaneTables, lane: int, goal: Stretch) -> tuple[Stretch, ...] | None:
    """The shortest way from a lane to a stretch, or else to the nearest where the road ends.

    Args:
        tables: of the road.
        lane: where it begins; other lanes of its stretch are not used, nor is the stretch again.
        goal: where it is to lead.

    Returns:
        The stretches after that of ``lane``; None if the lane leads nowhere. On a road that never
        ends it is the way to the farthest stretch.
    """
    net, names = tables.net, list(tables.stretches)
    lanes, n = net.lanes, len(names)
    begin = np.repeat(np.arange(lanes.size), lanes["way_end"] - lanes["way"])
    one, other, here = lanes["stretch"][begin], net.ways["stretch"], int(lanes["stretch"][lane])
    length = np.ones(n)
    length[lanes["stretch"][::-1]] = lanes["length"][::-1]  # of each one's first lane
    used = (other != here) & ((one != here) | (begin == lane))
    pairs = np.unique(np.stack([one[used], other[used]], axis=1), axis=0)
    graph = coo_array((length[pairs[:, 1]], (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    away, before = dijkstra(graph, indices=[here], return_predecessors=True)
    away[0, here] = np.inf
    reached = np.isfinite(away[0])
    if not reached.any():
        return None
    ends = reached & ~np.isin(np.arange(n), one)
    end = tables.stretch(goal)
    if end >= n or not reached[end]:
        away[0, ~(ends if ends.any() else reached)] = np.nan
        end = int(np.nanargmin(away[0]) if ends.any() else np.nanargmax(away[0]))
    way = []
    while end != here:
        way.append(names[end])
        end = int(before[0, end])
    return tuple(way[::-1])
