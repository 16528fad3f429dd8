"""What is wrong with a road: each defect with its place, what was found and what was expected."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from scenarios.own.demand import SLOWEST_MPS, EdgeGraph
from sim.frames import Signal
from sim.road import Lane, Road

SAME_POINT_M: Final = 1e-3
"""Points of a line nearer to each other than this coincide, m (a millimetre)."""

LIMITS_MPS: Final = (1.0, 70.0)
"""Least and greatest speed limit that is believed, m/s (walking pace and 250 km/h)."""

WIDTHS_M: Final = (1.5, 12.0)
"""Least and greatest width of a lane for cars that is believed, m."""

SHORTEST_M: Final = 1.0
"""Lanes shorter than this are named, m (no car fits between their ends)."""

KINK_DEG: Final = 100.0
"""A line that turns by more than this at one point doubles back."""

APART_M: Final = 15.0
"""The ends of lanes that a way joins without a path between them are at most this far apart, m (a
large junction)."""

LONGEST_RED_S: Final = 300.0
"""Signals that let nobody go for longer than this are named, s (twice the longest usual round)."""

SAME_LINE_M: Final = 0.3
"""Lanes of one length whose ends are this near to each other lie on each other, m."""


@dataclass(frozen=True, slots=True)
class Defect:
    """Something wrong with a map.

    Attributes:
        kind: what kind of defect it is, in words.
        place: lane, edge, signal group or element.
        found: what was found there, and what was expected.
    """

    kind: str
    place: str
    found: str


def defects_of(road: Road) -> list[Defect]:
    """Everything wrong with a road, in the order of its lanes.

    Args:
        road: any.

    Returns:
        One entry for each defect and place.

    Examples:
        >>> from scenarios import get_scenario
        >>> defects_of(get_scenario("roundabout")().road)
        []
    """
    found = [defect for lane in road.lanes for defect in _of_lane(lane)]
    found += _coinciding_lanes(road)
    found += _of_connections(road)
    found += _of_signals(road)
    found += _of_reach(road)
    return found


def _of_lane(lane: Lane) -> Iterator[Defect]:
    line, place = lane.centerline, f"lane {lane.id}"
    step = np.diff(line, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    same = int((size < SAME_POINT_M).sum())
    if same and not lane.internal:  # paths between lanes that touch have no length
        yield Defect("coinciding points", place, f"found {same} of {len(line)}, expected none")
    if lane.walking or not lane.cars:
        return
    limit = lane.speed_limit_mps
    least, most = LIMITS_MPS
    if math.isfinite(limit) and not least <= limit <= most:
        expected = f"expected {least:g} to {most:g}"
        yield Defect("absurd limit", place, f"found {limit:g} m/s, {expected}")
    if not WIDTHS_M[0] <= lane.width_m <= WIDTHS_M[1]:
        expected = f"expected {WIDTHS_M[0]:g} to {WIDTHS_M[1]:g}"
        yield Defect("absurd width", place, f"found {lane.width_m:.2f} m, {expected}")
    if lane.internal:
        return
    if size.sum() < SHORTEST_M:
        expected = f"expected {SHORTEST_M:g} or more"
        yield Defect("short lane", place, f"found {size.sum():.2f} m, {expected}")
    heading = np.arctan2(step[:, 1], step[:, 0])[size >= SAME_POINT_M]
    turn = np.abs((np.diff(heading) + math.pi) % (2 * math.pi) - math.pi)
    if turn.size and np.degrees(turn.max()) > KINK_DEG:
        found = f"found a turn by {np.degrees(turn.max()):.0f} degrees at one point"
        yield Defect("kinked lane", place, f"{found}, expected at most {KINK_DEG:g}")


def _coinciding_lanes(road: Road) -> Iterator[Defect]:
    """Lanes for cars that lie on each other, of one direction or of opposite ones."""
    places: dict[tuple[int, ...], list[Lane]] = {}
    for lane in road.lanes:
        if not lane.cars or lane.walking or lane.internal:
            continue
        ends = lane.centerline[[0, -1]]
        for begin, what, said in (
            (ends, "coinciding lanes", ""),
            (ends[::-1], "oncoming lane on the same line", " and oncoming"),
        ):
            for other in places.get(_rounded(begin), []):
                if (
                    np.abs(begin - other.centerline[[0, -1]]).max() < SAME_LINE_M
                    and abs(lane.length_m - other.length_m) < SAME_LINE_M
                ):
                    found = f"found lane {other.id} on the same line{said}"
                    yield Defect(what, f"lane {lane.id}", found)
                    break
        places.setdefault(_rounded(ends), []).append(lane)


def _rounded(points: np.ndarray) -> tuple[int, ...]:
    """Points to the metre."""
    return tuple(np.round(points).astype(int).ravel().tolist())


def _of_connections(road: Road) -> Iterator[Defect]:
    """Ways whose lanes do not meet."""
    index = road.lane_index
    for link in road.connections:
        names = (link.from_lane, *link.via, link.to_lane)
        if not all(name in index for name in names):
            missing = next(name for name in names if name not in index)
            yield Defect("missing lane", f"way from lane {link.from_lane}", f"found no {missing}")
            continue
        for one, then in itertools.pairwise(names):
            end = road.lanes[index[one]].centerline[-1]
            begin = road.lanes[index[then]].centerline[0]
            apart_m = math.dist(end, begin)
            if apart_m > (APART_M if not link.via else 1.0 + SAME_LINE_M):
                yield Defect(
                    "gap", f"way from lane {one}", f"found lane {then} {apart_m:.1f} m from its end"
                )
                break


def _of_signals(road: Road) -> Iterator[Defect]:
    """Signal groups that never let anybody go, or keep everybody waiting for very long."""
    lets_go = {Signal.GREEN.code, Signal.OFF.code}
    for plan in road.signal_plans:
        for k, group in enumerate(plan.groups):
            place = f"signals {road.signal_groups[group]}"
            goes = [state[k] in lets_go for state in plan.states]
            phases = list(zip(goes, plan.duration_s, strict=True))
            if not any(go and duration > 0 for go, duration in phases):
                yield Defect("dead signal", place, "found no green, expected some")
                continue
            longest_s = waited_s = 0.0
            for go, duration in phases * 2:  # a wait may go on into the next round
                waited_s = 0.0 if go and duration > 0 else waited_s + duration
                longest_s = max(longest_s, waited_s)
            if longest_s > LONGEST_RED_S:
                found = f"found no green for {longest_s:g} s, expected at most {LONGEST_RED_S:g}"
                yield Defect("slow signal", place, found)


def _of_reach(road: Road) -> Iterator[Defect]:
    """Lanes that nobody can come to or leave."""
    graph = EdgeGraph(road)
    usable = set(graph.lanes)
    for lane in road.lanes:
        slow = lane.speed_limit_mps < SLOWEST_MPS
        if lane.cars and not lane.walking and not lane.internal and slow:
            yield Defect("unreachable lane", f"lane {lane.id}", "found a limit too low to drive")
    if not usable:
        return
    backward: dict[str, list[str]] = {edge: [] for edge in graph.lanes}
    for edge, ways in graph.onward.items():
        for then in ways:
            backward[then].append(edge)
    if graph.entries:
        reached = _reached(graph.entries, graph.onward)
        for edge in sorted(usable - reached):
            yield Defect("unreachable lane", f"edge {edge}", "found no way to it from any entry")
    if graph.exits:
        leaving = _reached(graph.exits, backward)
        for edge in sorted(usable - leaving):
            yield Defect("trap", f"edge {edge}", "found no way from it out of the road")
    joined = set(itertools.chain(*graph.links))
    if joined:
        for edge in sorted(usable - joined):
            yield Defect("lonely edge", f"edge {edge}", "found no way to or from another edge")


def _reached(begin: Collection[str], onward: dict[str, list[str]]) -> set[str]:
    """Everything that can be reached from some edges, these included."""
    found, queue = set(begin), list(begin)
    while queue:
        for then in onward[queue.pop()]:
            if then not in found:
                found.add(then)
                queue.append(then)
    return found
