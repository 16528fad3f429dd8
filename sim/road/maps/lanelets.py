"""Shared part of the recordings' maps: lanelets become a road's lanes and the paths between them.

Argoverse 2 calls them lane segments, CommonRoad and Lanelet2 lanelets: pieces of lane with a
beginning and an end, neighbours and successors.

References:
    Bender, Ziegler, Stiller (2014), Lanelets: efficient map representation for autonomous driving,
    IEEE IV.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.geometry import LEAST_PIECE_M, distances_along, meeting, pieces_of, points_at
from sim.input_files import broken_as_one_line
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan
from sim.road.cells import boxes_of, near_pairs
from sim.road.lane_graph import CELL_M

STRAIGHT_RAD, BACK_RAD = math.pi / 4, 0.85 * math.pi
"""A way that turns by less than the first goes straight, by more than the second goes back (about
as SUMO's netconvert has it)."""

COMPARED_POINTS: Final = 24
"""Points of each line that are compared to find junctions (2 m apart on a turn)."""

END_M: Final = 1.0
"""Lines that meet this close to an end of one of them follow each other, m."""

CROSSING_RAD: Final = math.radians(12.0)
"""Centre lines that meet at a larger angle cross, so that their lanes are part of a junction (lanes
of one carriageway that part or join stay below)."""


@dataclass(frozen=True, slots=True, eq=False)
class Lanelet:
    """A piece of lane, as maps of recordings give it.

    What `sim.road.Lane` has, too, means the same.

    Attributes:
        id: its number in the map.
        successors, predecessors: ids of those that can follow, and come before.
        left, right: id of the neighbour on either side, of the same direction; None without one.
        use: permitted traffic; there are no lane changes between lanelets of different use.
        limit_mps: speed limit, m/s; NaN where unknown.
        crossing: whether it is where pedestrians cross the road.
        signal: signal group that controls it, or leaving it, -1 if none.
        must_yield: whether others have priority over those who are on it, or leave it.
        must_stop: whether a stop sign stands at its end.
        yields_to: ids of lanelets whose traffic has priority over them.
    """

    id: int
    centerline: FloatArray
    width_m: float
    successors: tuple[int, ...] = ()
    predecessors: tuple[int, ...] = ()
    internal: bool = False
    left: int | None = None
    right: int | None = None
    use: str = ""
    limit_mps: float = math.nan
    walking: bool = False
    crossing: bool = False
    cars: bool = True
    signal: int = -1
    must_yield: bool = False
    must_stop: bool = False
    yields_to: tuple[int, ...] = ()


Lanelets = Mapping[int, Lanelet]


def between(left: FloatArray, right: FloatArray) -> tuple[FloatArray, float]:
    """The (max(P, Q), 2) centre line and the mean width of a lane, m.

    Its borders (P, 2) and (Q, 2), m, are matched point by point where P = Q, else by the share of
    their length.
    """
    if min(len(left), len(right)) < 2:
        raise InputError("found a border of less than 2 points, expected 2 or more")
    if len(left) != len(right):
        along = distances_along(left if len(left) > len(right) else right)
        shares = along / max(along[-1], LEAST_PIECE_M)
        left, right = (points_at(one, shares * distances_along(one)[-1]) for one in (left, right))
    middle = (left + right) / 2
    step = np.diff(middle, axis=0)
    # across the lane: a border's points need not lie opposite each other
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1)
    size = np.hypot(normal[:, 0], normal[:, 1])
    apart = (left - right)[:-1] + (left - right)[1:]
    across = np.abs(np.sum(apart * normal, axis=1)) / 2
    total = float(np.sum(size**2))
    return middle, float(np.sum(across * size)) / total if total > 0 else 0.0


def followers(road: Road) -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Ids of the lanes and paths before each lane of a road, and of those after it."""
    before, after = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    for link in road.connections:
        for one, two in pairwise((link.from_lane, *link.via, link.to_lane)):
            after[one].add(two)
            before[two].add(one)
    return before, after


def read_lanelets(
    path: Path, elements: Iterable[Element], read: Callable[[int, Element], Lanelet]
) -> tuple[dict[int, Lanelet], list[str]]:
    """The lanelets of XML elements in order of their ids, and why broken ones are left out."""
    found, broken = dict[int, Lanelet](), list[str]()
    numbered = [(int(element.attrib["id"]), element) for element in elements]
    for identity, element in sorted(numbered, key=lambda one: one[0]):
        try:
            with broken_as_one_line(path, f"lanelet {identity}"):
                one = read(identity, element)
                if one.limit_mps <= 0 or not np.isfinite(one.centerline).all():
                    raise InputError(f"lanelet {identity}: found a limit or a place of no road")
                found[identity] = one
        except InputError as error:
            broken.append(str(error))
    return found, broken


def road_of_lanelets(
    path: Path,
    name: str | None,
    lanelets: Lanelets,
    crossings: Sequence[Crossing] = (),
    *,
    find_junctions: bool = False,
    priority: bool = False,
    signal_groups: tuple[str, ...] = (),
    signal_plans: tuple[SignalPlan, ...] = (),
    left_hand: bool = False,
    broken: Sequence[str] = (),
) -> Road:
    """A road of the lanelets of a map, by id, and its crossings that are none.

    Junctions are found from the lines where the map has none and ``find_junctions`` is set.
    ``priority`` says whether the map knows who yields to whom, and ``broken`` why lanelets are
    left out.

    Raises:
        InputError: if no lanelet is for cars, or a line is broken.
    """
    walked = [one for one in lanelets.values() if one.crossing]
    lanelets = {i: one for i, one in lanelets.items() if not one.crossing}
    if len(broken) > len(lanelets):
        raise InputError(broken[0])
    if not any(one.cars and not one.walking for one in lanelets.values()):
        raise InputError(f"{path}: found no lanelet for cars, expected at least one")
    following = {i: dict.fromkeys(one.successors) for i, one in lanelets.items()}
    for i, one in lanelets.items():  # some only name those before them
        for before in one.predecessors:
            following.get(before, {})[i] = None
    lanelets = {i: replace(one, successors=tuple(following[i])) for i, one in lanelets.items()}
    if find_junctions and not any(one.internal for one in lanelets.values()):
        lanelets = _with_junctions(lanelets)
    limits = any(math.isfinite(one.limit_mps) for one in lanelets.values())
    walks = (Crossing(str(one.id), one.centerline, one.width_m, ()) for one in walked)
    road = Road(
        name=name if name is not None else path.name.split(".")[0],
        lanes=tuple(_lanes(lanelets, left_hand)),
        connections=tuple(_connections(lanelets)),
        crossings=tuple(
            replace(one, centerline=frozen(one.centerline)) for one in (*crossings, *walks)
        ),
        signal_groups=signal_groups,
        source=path,
        signal_plans=signal_plans,
        knows=MapKnowledge(limits=limits, signals=bool(signal_groups), priority=priority),
        left_hand=left_hand,
        doubts=(f"{len(broken)} lanelets are left out, first {broken[0]}",) if broken else (),
    )
    return road.checked()


def _lanes(lanelets: Lanelets, left_hand: bool) -> Iterator[Lane]:
    """Every lanelet as a lane; those side by side in one direction and of one use share an edge."""
    inward, outward = ("right", "left") if left_hand else ("left", "right")
    outer: dict[int, int] = {}
    for i, one in lanelets.items():
        beside = lanelets.get(getattr(one, outward))
        if (
            beside is not None
            and getattr(beside, inward) == i
            and (beside.use, beside.internal) == (one.use, one.internal)
            and _chord(one) @ _chord(beside) >= 0
        ):
            outer[i] = beside.id
    junction = _junctions(lanelets)
    for i, one in lanelets.items():
        first, index = i, 0
        while first in outer and outer[first] != i:
            first, index = outer[first], index + 1
        yield Lane(
            id=str(i),
            edge=f":{junction[i]}_{first}" if one.internal else str(first),
            index=index,
            centerline=frozen(one.centerline),
            width_m=one.width_m,
            speed_limit_mps=one.limit_mps,
            walking=one.walking,
            internal=one.internal,
            cars=one.cars,
        )


def _chord(lanelet: Lanelet) -> FloatArray:
    return np.asarray(lanelet.centerline[-1] - lanelet.centerline[0])


def _junctions(lanelets: Lanelets) -> dict[int, int]:
    """The number of the junction that each lanelet is in: those that part, join or follow."""
    place = {i: k for k, i in enumerate(i for i, one in lanelets.items() if one.internal)}
    pairs: list[tuple[int, int]] = []
    into: dict[int, int] = {}
    for i, one in lanelets.items():
        ways = [place[j] for j in one.successors if j in place]
        pairs += pairwise(ways)
        if i in place:
            pairs += [(place[i], j) for j in ways]
            pairs += [(into.setdefault(j, place[i]), place[i]) for j in one.successors]
    one_end, other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    shape = (len(place), len(place))
    _, number = connected_components(coo_array((np.ones(one_end.size), (one_end, other)), shape))
    return {i: int(number[k]) for i, k in place.items()}


def _connections(lanelets: Lanelets) -> list[Connection]:
    """Every way that vehicles have from a lane over a junction to the next, in order of ids."""
    driven = {i: one for i, one in lanelets.items() if not one.walking}
    following = {i: [j for j in one.successors if j in driven] for i, one in driven.items()}
    entered = {j for ways in following.values() for j in ways}
    chains: list[list[int]] = []
    for begin, one in driven.items():
        if one.internal and begin in entered:
            continue
        open_ends = [[begin, j] for j in following[begin]]
        while open_ends:
            chain = open_ends.pop()
            onward = [j for j in following[chain[-1]] if j not in chain]
            if driven[chain[-1]].internal and onward:
                open_ends += [[*chain, j] for j in onward]
            else:
                chains.append(chain)
    chains.sort(key=lambda c: (c[0], c[1:]))
    passing: dict[int, list[int]] = {}  # the ways over each lanelet
    for index, chain in enumerate(chains):
        for i in chain[:-1] if len(chain) > 2 else chain:
            passing.setdefault(i, []).append(index)
    found = []
    for index, chain in enumerate(chains):
        first = {j for i in chain[:-1] for j in driven[i].yields_to}
        over = {k for j in first for k in passing.get(j, ())} - {index}
        held = [driven[i] for i in (chain if driven[chain[-1]].internal else chain[:-1])]
        first_lane, *via, last_lane = (str(i) for i in chain)
        found.append(
            Connection(
                from_lane=first_lane,
                to_lane=last_lane,
                via=tuple(via),
                direction=_direction(driven[chain[0]], driven[chain[-1]]),
                signal=next((one.signal for one in held if one.signal >= 0), -1),
                must_yield=any(one.must_yield for one in held),
                must_stop=any(one.must_stop for one in held),
                yields_to=tuple(sorted(over)),
            )
        )
    return found


def _direction(first: Lanelet, last: Lanelet) -> str:
    """The direction of a way by the angle between the end of a lanelet and the start of another."""
    before = pieces_of(first.centerline).direction[-1:]
    after = pieces_of(last.centerline).direction[:1]
    turned = 0.0
    if before.size and after.size:
        (bx, by), (ax, ay) = before[0], after[0]
        turned = math.atan2(bx * ay - by * ax, bx * ax + by * ay)
    if abs(turned) <= STRAIGHT_RAD:
        return "straight"
    if abs(turned) >= BACK_RAD:
        return "turnaround"
    return "left" if turned > 0 else "right"


def _with_junctions(lanelets: Lanelets) -> dict[int, Lanelet]:
    """The lanelets of a map that does not mark its junctions, with ``internal`` set from the lines.

    A lanelet is part of a junction if its centre line crosses another at more than `CROSSING_RAD`,
    or if it parts from, or joins, such a lanelet.
    """
    driven = {i: one for i, one in lanelets.items() if not one.walking}
    ids = list(driven)
    # at most some points of each line, both ends among them
    lines = [
        np.concatenate([line[: -1 : max(len(line) // COMPARED_POINTS, 1)], line[-1:]])
        for line in (one.centerline for one in driven.values())
    ]
    boxes = boxes_of(lines, 0.0)
    inside = set[int]()
    for i, j in near_pairs(boxes, boxes, CELL_M).tolist():
        found = meeting(lines[i], lines[j]) if i < j else None
        if found is None or found.sine <= math.sin(CROSSING_RAD):
            continue
        point = points_at(lines[i], np.array([found.along]))
        ends = np.stack([lines[i][0], lines[i][-1], lines[j][0], lines[j][-1]])
        if np.hypot(*(ends - point).T).min() > END_M:
            inside |= {ids[i], ids[j]}
    before: dict[int, list[int]] = {}
    for i, one in driven.items():
        for j in one.successors:
            before.setdefault(j, []).append(i)
    # the way straight on belongs to a junction like the turns that part from it or join it
    for ways in (*(one.successors for one in driven.values()), *before.values()):
        if len(ways) > 1 and inside.intersection(ways):
            inside.update(driven.keys() & ways)
    return {i: replace(one, internal=i in inside) for i, one in lanelets.items()}
