"""Another route for a driver whose lane does not lead where it wants to go."""

from __future__ import annotations

import heapq
import math

from sim.highway.lanes import LaneIndex
from sim.highway.network import HighwayNetwork

Stretch = tuple[str, str]


def find_way(network: HighwayNetwork, lane: LaneIndex, goal: Stretch) -> tuple[Stretch, ...] | None:
    """The shortest way from a lane to a stretch, or else to any stretch where the road ends.

    Args:
        network: of the road.
        lane: where it begins; other lanes of its stretch are not used, nor is the stretch again.
        goal: where it is to lead.

    Returns:
        The stretches after that of ``lane``; None if the lane leads nowhere.
    """
    here = lane[:2]
    best: dict[Stretch, float] = {}
    before: dict[Stretch, Stretch] = {}
    queue: list[tuple[float, Stretch]] = []
    for then in network.ways_of_lane.get(lane, ()):
        if then != here:
            best[then] = network.lanes[(*then, 0)].length
            heapq.heappush(queue, (best[then], then))
    way_out: Stretch | None = None
    furthest: Stretch | None = None
    while queue:
        cost, stretch = heapq.heappop(queue)
        if cost > best[stretch]:
            continue
        furthest = stretch
        if stretch == goal:
            break
        onward = network.ways_of_stretch.get(stretch, ())
        if not onward and way_out is None:
            way_out = stretch
        for then in onward:
            new = cost + network.lanes[(*then, 0)].length
            if then != here and new < best.get(then, math.inf):
                best[then], before[then] = new, stretch
                heapq.heappush(queue, (new, then))
    end = goal if goal in best else way_out or furthest
    if end is None:
        return None
    way = [end]
    while way[-1] in before:
        way.append(before[way[-1]])
    return tuple(reversed(way))
