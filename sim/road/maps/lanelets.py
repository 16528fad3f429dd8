"""Shared part of the recordings' maps: lanelets become a road's lanes and the paths between them.

Argoverse 2 calls them lane segments, CommonRoad and Lanelet2 lanelets: pieces of lane with a
beginning and an end, neighbours and successors.

References:
    Bender, Ziegler, Stiller (2014), Lanelets: efficient map representation for autonomous driving,
    IEEE IV.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.geometry import distances_along, meeting, pieces_of, points_at
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan
from sim.road.cells import boxes_of, near_pairs

MAX_COORDINATE_M: Final = 1e9
"""Largest absolute coordinate (beyond any UTM coordinate)."""

MAX_LENGTH_M: Final = 1e7
"""Longest that all lanes and crossings of a map may be together, m (a city's streets are some
thousand km): what is drawn of them stays small."""

STRAIGHT_RAD, BACK_RAD = math.pi / 4, 0.85 * math.pi
"""A way that turns by less than the first goes straight, by more than the second goes back (about
as SUMO's netconvert has it)."""

COMPARED_POINTS: Final = 24
"""Points of each line that are compared to find junctions (2 m apart on a turn)."""

END_M: Final = 1.0
"""Lines that meet this close to an end of one of them follow each other, m."""

CELL_M: Final = 30.0
"""Width of the cells in which lines that meet are searched, m."""

CROSSING_RAD: Final = math.radians(12.0)
"""Centre lines that meet at a larger angle cross, so that their lanes are part of a junction (lanes
of one carriageway that part or join stay below)."""


@dataclass(frozen=True, slots=True, eq=False)
class Lanelet:
    """A piece of lane, as maps of recordings give it.

    Attributes:
        id: its number in the map.
        centerline: (P, 2) points in driving direction, m.
        width_m: m.
        successors: ids of those that can follow.
        internal: whether it crosses a junction.
        left: id of the neighbour on the left, of the same direction; None without one.
        right: likewise on the right.
        use: permitted traffic; there are no lane changes between lanelets of different use.
        limit_mps: speed limit, m/s; NaN where unknown.
        walking: whether it is for pedestrians only.
        cars: whether cars may drive on it.
        signal: signal group that controls it, or leaving it, -1 if none.
        must_yield: whether others have priority over those who are on it, or leave it.
        must_stop: whether a stop sign stands at its end.
        yields_to: ids of lanelets whose traffic has priority over them.
    """

    id: int
    centerline: FloatArray
    width_m: float
    successors: tuple[int, ...]
    internal: bool
    left: int | None = None
    right: int | None = None
    use: str = ""
    limit_mps: float = math.nan
    walking: bool = False
    cars: bool = True
    signal: int = -1
    must_yield: bool = False
    must_stop: bool = False
    yields_to: tuple[int, ...] = ()


def check_lines(path: Path, lines: Sequence[FloatArray]) -> None:
    """Refuse a map with lines of one point, or beyond any place.

    Raises:
        InputError: naming the file.
    """
    if any(len(line) < 2 for line in lines):
        raise InputError(f"{path}: found a line of one point, expected 2 or more")
    if not all((np.abs(line) <= MAX_COORDINATE_M).all() for line in lines):
        raise InputError(f"{path}: found a point beyond {MAX_COORDINATE_M:g} m, expected metres")
    length_m = sum(float(distances_along(line)[-1]) for line in lines)
    if not 0 < length_m <= MAX_LENGTH_M:
        raise InputError(
            f"{path}: found {length_m:.3g} m of lanes, expected up to {MAX_LENGTH_M:g}"
        )


def between(left: FloatArray, right: FloatArray) -> tuple[FloatArray, float]:
    """Centre line and mean width of a lane from its borders.

    Args:
        left: (P, 2) left border in driving direction, m.
        right: (Q, 2) right border, m; matched point by point where P = Q, else by the share of its
            length.

    Returns:
        (max(P, Q), 2) the centre line, m, read-only, and the width, m.
    """
    if len(left) != len(right):
        shares = [_shares(line) for line in (left, right)]
        every = shares[0] if len(left) > len(right) else shares[1]
        left, right = (
            np.stack([np.interp(every, share, line[:, axis]) for axis in (0, 1)], axis=1)
            for line, share in zip((left, right), shares, strict=True)
        )
    middle = frozen((left + right) / 2)
    step = np.diff(middle, axis=0)
    # across the lane: a border's points need not lie opposite each other
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1)
    size = np.hypot(normal[:, 0], normal[:, 1])
    apart = (left - right)[:-1] + (left - right)[1:]
    across = np.abs(np.sum(apart * normal, axis=1)) / 2
    total = float(np.sum(size**2))
    width = float(np.sum(across * size)) / total if total > 0 else 0.0
    return middle, width


def _shares(line: FloatArray) -> FloatArray:
    """(P,) how much of a line's length comes before each of its points."""
    along = distances_along(line)
    return along / along[-1] if along[-1] > 0 else np.linspace(0.0, 1.0, len(line))


def road_of_lanelets(
    path: Path,
    name: str | None,
    lanelets: Mapping[int, Lanelet],
    crossings: Sequence[Crossing],
    priority: bool = False,
    signal_groups: tuple[str, ...] = (),
    signal_plans: tuple[SignalPlan, ...] = (),
    left_hand: bool = False,
    broken: Sequence[str] = (),
) -> Road:
    """A road of lanelets.

    Args:
        path: the map.
        name: what to call the road; None for the file's name without its ending.
        lanelets: by id.
        crossings: of the map.
        priority: whether the map says who yields to whom.
        signal_groups: the names of the lights.
        signal_plans: their programmes, if they are known.
        left_hand: whether traffic drives on the left.
        broken: why lanelets are left out, a sentence for each.

    Raises:
        InputError: if no lanelet is for cars, or a line is broken.
    """
    if broken and len(broken) > len(lanelets):
        raise InputError(broken[0])
    if not any(one.cars and not one.walking for one in lanelets.values()):
        raise InputError(f"{path}: found no lanelet for cars, expected at least one")
    lines = [one.centerline for one in lanelets.values()]
    check_lines(path, lines + [crossing.centerline for crossing in crossings])
    limits = any(math.isfinite(one.limit_mps) for one in lanelets.values())
    return Road(
        name=name if name is not None else path.name.split(".")[0],
        lanes=tuple(lanes_of(lanelets, left_hand)),
        connections=tuple(connections_of(lanelets)),
        crossings=tuple(crossings),
        signal_groups=signal_groups,
        source=path,
        signal_plans=signal_plans,
        knows=MapKnowledge(limits=limits, signals=bool(signal_groups), priority=priority),
        left_hand=left_hand,
        doubts=(f"{len(broken)} lanelets are left out, first {broken[0]}",) if broken else (),
    )


def lanes_of(lanelets: Mapping[int, Lanelet], left_hand: bool = False) -> Iterator[Lane]:
    """Every lanelet as a lane; those side by side in one direction share an edge.

    Lanelets of another use (bicycles, buses) are edges of their own, without lane changes from
    others.

    Args:
        lanelets: by id, in order of the ids.
        left_hand: whether lanes are counted from the left.

    Yields:
        A lane per lanelet, in that order, its id in digits.
    """
    right: dict[int, int] = {}
    for i, one in lanelets.items():
        outer = one.left if left_hand else one.right
        beside = None if outer is None else lanelets.get(outer)
        if (
            beside is not None
            and (beside.right if left_hand else beside.left) == i
            and beside.use == one.use
            and beside.internal == one.internal
            and _chord(one) @ _chord(beside) >= 0
        ):
            right[i] = beside.id
    junction = _junctions(lanelets)
    for i, one in lanelets.items():
        first, index = i, 0
        while first in right and right[first] != i:
            first, index = right[first], index + 1
        yield Lane(
            id=str(i),
            edge=f":{junction[i]}_{first}" if one.internal else str(first),
            index=index,
            centerline=one.centerline,
            width_m=one.width_m,
            speed_limit_mps=one.limit_mps,
            walking=one.walking,
            internal=one.internal,
            cars=one.cars,
        )


def _chord(lanelet: Lanelet) -> FloatArray:
    return np.asarray(lanelet.centerline[-1] - lanelet.centerline[0])


def _junctions(lanelets: Mapping[int, Lanelet]) -> dict[int, int]:
    """The number of the junction that each lanelet is in: those that part, join or follow."""
    inside = [i for i, one in lanelets.items() if one.internal]
    place = {i: k for k, i in enumerate(inside)}
    pairs: list[tuple[int, int]] = []
    into: dict[int, int] = {}
    for i, one in lanelets.items():
        ways = [place[j] for j in one.successors if j in place]
        pairs += pairwise(ways)
        if i in place:
            pairs += [(place[i], j) for j in ways]
            for j in one.successors:
                pairs.append((into.setdefault(j, place[i]), place[i]))
    one_end, other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    shape = (len(inside), len(inside))
    joined = coo_array((np.ones(one_end.size), (one_end, other)), shape=shape)
    _, number = connected_components(joined)
    return {i: int(number[k]) for i, k in place.items()}


def connections_of(lanelets: Mapping[int, Lanelet]) -> list[Connection]:
    """Every way from a lane over a junction to the next, and what of such a way the map shows.

    Args:
        lanelets: by id.

    Returns:
        The ways that vehicles have, in order of their lanes' numbers.
    """
    driven = {i: one for i, one in lanelets.items() if not one.walking}
    following = {i: [j for j in s.successors if j in driven] for i, s in driven.items()}
    entered = {j for ways in following.values() for j in ways}
    inside = {i for i, one in driven.items() if one.internal}
    found: list[list[int]] = []
    for begin in driven:
        if begin in inside and begin in entered:
            continue
        chains = [[begin, j] for j in following[begin]]
        while chains:
            chain = chains.pop()
            onward = [j for j in following[chain[-1]] if j not in chain]
            if chain[-1] in inside and onward:
                chains += [[*chain, j] for j in onward]
            else:
                found.append(chain)
    found.sort(key=lambda c: (c[0], [*c[1:-1], c[-1]]))
    ways = [_connection(chain, driven) for chain in found]
    return _with_priority(ways, found, driven)


def _with_priority(
    ways: list[Connection], chains: list[list[int]], lanelets: Mapping[int, Lanelet]
) -> list[Connection]:
    """The ways, each with those that have priority over it."""
    passing: dict[int, list[int]] = {}
    for index, chain in enumerate(chains):
        for i in chain[:-1] if len(chain) > 2 else chain:
            passing.setdefault(i, []).append(index)
    told = []
    for index, (way, chain) in enumerate(zip(ways, chains, strict=True)):
        others = {j for i in chain[:-1] for j in lanelets[i].yields_to}
        over = {k for j in others for k in passing.get(j, ())} - {index}
        told.append(dataclasses.replace(way, yields_to=tuple(sorted(over))) if over else way)
    return told


def _connection(chain: list[int], lanelets: Mapping[int, Lanelet]) -> Connection:
    first = lanelets[chain[0]]
    before = pieces_of(first.centerline).direction[-1:]
    after = pieces_of(lanelets[chain[-1]].centerline).direction[:1]
    turned = 0.0
    if before.size and after.size:
        (bx, by), (ax, ay) = before[0], after[0]
        turned = math.atan2(bx * ay - by * ax, bx * ax + by * ay)
    if abs(turned) <= STRAIGHT_RAD:
        direction = "straight"
    elif abs(turned) >= BACK_RAD:
        direction = "turnaround"
    else:
        direction = "left" if turned > 0 else "right"
    names = [str(i) for i in chain]
    held = chain if lanelets[chain[-1]].internal else chain[:-1]
    return Connection(
        names[0], names[-1], tuple(names[1:-1]), direction,
        signal=next((s for i in held if (s := lanelets[i].signal) >= 0), -1),
        must_yield=any(lanelets[i].must_yield for i in held),
        must_stop=any(lanelets[i].must_stop for i in held),
    )  # fmt: skip


def with_junctions(lanelets: Mapping[int, Lanelet]) -> dict[int, Lanelet]:
    """Junction lanelets of a map without that information, from their lines.

    A lanelet is part of a junction if its centre line crosses another at more than `CROSSING_RAD`.
    It is also part of one if it parts from, or joins, such a lanelet.

    Args:
        lanelets: by id.

    Returns:
        The same lanelets, ``internal`` set.
    """
    driven = [one for one in lanelets.values() if not one.walking]
    inside = _crossing_ids(driven)
    before: dict[int, list[int]] = {}
    for one in driven:
        for j in one.successors:
            before.setdefault(j, []).append(one.id)
    beside = [one.successors for one in driven if len(one.successors) > 1]
    beside += [tuple(ways) for ways in before.values() if len(ways) > 1]
    known = {one.id for one in driven}
    # the way straight on belongs to a junction like the turns that part from it or join it
    for ways in beside:
        if inside.intersection(ways):
            inside.update(known.intersection(ways))
    return {i: dataclasses.replace(one, internal=i in inside) for i, one in lanelets.items()}


def _crossing_ids(lanelets: list[Lanelet]) -> set[int]:
    """Ids of the lanelets whose centre line crosses another's at an angle, not at their ends."""
    lines = [_thinned(one.centerline) for one in lanelets]
    boxes = boxes_of(lines, 0.0)
    inside = set[int]()
    for i, j in near_pairs(boxes, boxes, CELL_M).tolist():
        found = meeting(lines[i], lines[j]) if i < j else None
        if found is None or found.sine <= math.sin(CROSSING_RAD):
            continue
        point = points_at(lines[i], np.array([found.along]))
        corners = np.stack([lines[i][0], lines[i][-1], lines[j][0], lines[j][-1]])
        if np.hypot(*(corners - point).T).min() > END_M:
            inside |= {lanelets[i].id, lanelets[j].id}
    return inside


def _thinned(line: FloatArray) -> FloatArray:
    """A line with at most some `COMPARED_POINTS` of its points, both ends among them."""
    step = max(len(line) // COMPARED_POINTS, 1)
    return line if step == 1 else np.concatenate([line[:-1:step], line[-1:]])
