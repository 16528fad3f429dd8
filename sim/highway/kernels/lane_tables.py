"""A road's lanes as arrays that kernels read, and places along them.

Every lane has a number, its position in `HighwayNetwork.lanes`; -1 stands for none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, StraightLane
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.lanes import BLEND_M, LaneIndex, PolylineLane
from sim.highway.network import HighwayNetwork, is_wrong_side

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NEARLY: Final = 1e-9
"""Distances nearer to each other than this, m, are compared in Python, whose `math.hypot` rounds
otherwise than that of kernels."""


ZERO: Final = np.zeros(2)


class Lanes(NamedTuple):
    """The lanes of a road; K lanes. Lists of each lane run from ``first[k]`` to ``first[k + 1]``.

    Attributes:
        length: (K,) m.
        limit: (K,) speed limit, m/s.
        connector: (K,) whether it crosses a junction.
        wrong: (K,) whether it runs over a lane of the opposite direction.
        must_yield: (K,) whether others have priority over those that enter it.
        must_stop: (K,) whether there is a stop sign before it.
        signal: (K,) signal group that guards its entry, -1 if none.
        exit: (K,) the lane on which a junction path ends.
        left: (K,) the lane to the left in the same stretch.
        right: (K,) the lane to the right.
        stretch: (K,) number of its stretch.
        way_first: (K + 1,) of the ways on from it.
        way_stretch: stretch that each leads to.
        way_path: junction path that leads there.
        conflict_first: (K + 1,) of its conflicts.
        conflict_lane: the other path of each.
        conflict_at: (C, 4) begin, end, begin and end on the other path, m.
        strip_first: (K + 1,) of the places where it runs over crossings.
        strip_crossing: which crossing.
        strip_at: (T, 2) near and far edge along the lane, m.
    """

    length: FloatArray
    limit: FloatArray
    connector: BoolArray
    wrong: BoolArray
    must_yield: BoolArray
    must_stop: BoolArray
    signal: IntArray
    exit: IntArray
    left: IntArray
    right: IntArray
    stretch: IntArray
    way_first: IntArray
    way_stretch: IntArray
    way_path: IntArray
    conflict_first: IntArray
    conflict_lane: IntArray
    conflict_at: FloatArray
    strip_first: IntArray
    strip_crossing: IntArray
    strip_at: FloatArray


class Lines(NamedTuple):
    """The centre lines of a road's lanes, with the numbers of highway-env's own lane objects.

    Attributes:
        straight: (K,) whether it is a straight lane.
        heading: (K,) of a straight lane, rad.
        start: (K, 2) where a straight lane begins, m.
        direction: (K, 2) its direction.
        aside: (K, 2) the direction to its right.
        first: (K + 1,) of the pieces of each polyline.
        piece_start: (P, 2) m.
        piece_direction: (P, 2).
        piece_size: (P,) m.
        piece_begin: (P,) distance along the lane, m.
        turn_first: (K + 1,) of the headings of each lane.
        turn_at: distances along the lane between which the heading is interpolated, m.
        turn_heading: rad.
    """

    straight: BoolArray
    heading: FloatArray
    start: FloatArray
    direction: FloatArray
    aside: FloatArray
    first: IntArray
    piece_start: FloatArray
    piece_direction: FloatArray
    piece_size: FloatArray
    piece_begin: FloatArray
    turn_first: IntArray
    turn_at: FloatArray
    turn_heading: FloatArray


class LaneTables:
    """A road's lanes as arrays, with the numbers of its lanes and stretches.

    Args:
        network: the road in highway-env's terms.
    """

    def __init__(self, network: HighwayNetwork) -> None:
        self.keys: list[LaneIndex] = list(network.lanes)
        self.number: dict[LaneIndex, int] = {key: k for k, key in enumerate(self.keys)}
        self.objects: list[AbstractLane] = list(network.lanes.values())
        self.stretches: dict[tuple[str, str], int] = {}
        self._ways: dict[tuple[tuple[str, str], ...], IntArray] = {}
        for key in self.keys:
            self.stretch(key[:2])
        self.lanes = self._lanes(network)
        self.lines = _lines(self.objects)
        self.has_paths: bool = bool((self.lanes.exit >= 0).any())

    def stretch(self, name: tuple[str, str]) -> int:
        """The number of a stretch; a new one for a stretch that the road does not have."""
        return self.stretches.setdefault(name, len(self.stretches))

    def way(self, stretches: tuple[tuple[str, str], ...]) -> IntArray:
        """The numbers of the stretches of a way; drivers share few ways."""
        if stretches not in self._ways:
            self._ways[stretches] = _integers([self.stretch(name) for name in stretches])
        return self._ways[stretches]

    def _lanes(self, network: HighwayNetwork) -> Lanes:
        info = [network.info[key] for key in self.keys]
        ways: list[list[tuple[int, int]]] = [[] for _ in self.keys]
        for (lane, then), path in network.onward.items():
            ways[self.number[lane]].append((self.stretch(then), self.number[path]))
        conflicts = [c for one in info for c in one.conflicts]
        strips = [strip for one in info for strip in one.strips]
        edges = [(c.begin_s, c.end_s, c.other_begin_s, c.other_end_s) for c in conflicts]
        return Lanes(
            length=_floats([lane.length for lane in self.objects]),
            limit=_floats([lane.speed_limit for lane in self.objects]),
            connector=np.array([one.connector for one in info], dtype=np.bool_),
            wrong=np.array([is_wrong_side(key) for key in self.keys], dtype=np.bool_),
            must_yield=np.array([one.must_yield for one in info], dtype=np.bool_),
            must_stop=np.array([one.must_stop for one in info], dtype=np.bool_),
            signal=_integers([one.signal for one in info]),
            exit=self._numbers([network.exit_of.get(key) for key in self.keys]),
            left=self._beside(network, -1),
            right=self._beside(network, 1),
            stretch=_integers([self.stretches[key[:2]] for key in self.keys]),
            way_first=_begins(ways),
            way_stretch=_integers([then for each in ways for then, _ in each]),
            way_path=_integers([path for each in ways for _, path in each]),
            conflict_first=_begins([one.conflicts for one in info]),
            conflict_lane=self._numbers([c.other for c in conflicts]),
            conflict_at=_floats(edges).reshape(-1, 4),
            strip_first=_begins([one.strips for one in info]),
            strip_crossing=_integers([strip.crossing for strip in strips]),
            strip_at=_floats([(strip.near_s, strip.far_s) for strip in strips]).reshape(-1, 2),
        )

    def _numbers(self, keys: Sequence[LaneIndex | None]) -> IntArray:
        return _integers([-1 if key is None else self.number[key] for key in keys])

    def _beside(self, network: HighwayNetwork, step: int) -> IntArray:
        """The lane to which each lane's drivers may change on one side."""
        return _integers(
            [
                -1
                if network.info[key].connector or is_wrong_side(key)
                else self.number.get((*key[:2], key[2] + step), -1)
                for key in self.keys
            ]
        )


def _lines(lanes: Sequence[AbstractLane]) -> Lines:
    straight = [type(lane) is StraightLane for lane in lanes]
    bent = [type(lane) is PolylineLane for lane in lanes]
    places = [(o.start, o.direction, o.direction_lateral) if ok else (ZERO, ZERO, ZERO)
              for o, ok in zip(lanes, straight, strict=True)]  # fmt: skip
    lines: list[Any] = [lane if ok else None for lane, ok in zip(lanes, bent, strict=True)]

    def pieces(name: str) -> list[Sequence[Any]]:
        return [() if lane is None else getattr(lane, name) for lane in lines]

    starts, directions = itertools.chain(*pieces("starts")), itertools.chain(*pieces("directions"))
    return Lines(
        straight=np.array(straight, dtype=np.bool_),
        heading=_floats(
            [lane.heading if ok else 0.0 for lane, ok in zip(lanes, straight, strict=True)]
        ),
        start=_floats([start for start, _, _ in places]),
        direction=_floats([direction for _, direction, _ in places]),
        aside=_floats([aside for _, _, aside in places]),
        first=_begins(pieces("sizes")),
        piece_start=_floats(list(starts)).reshape(-1, 2),
        piece_direction=_floats(list(directions)).reshape(-1, 2),
        piece_size=_floats(list(itertools.chain(*pieces("sizes")))),
        piece_begin=_floats(list(itertools.chain(*pieces("begins")))),
        turn_first=_begins(pieces("turn_at")),
        turn_at=_floats(list(itertools.chain(*pieces("turn_at")))),
        turn_heading=_floats(list(itertools.chain(*pieces("turn_heading")))),
    )


def _begins(lists: Sequence[Sequence[object]]) -> IntArray:
    """Where each list begins when they follow one another, and the end of the last."""
    return np.cumsum([0, *(len(each) for each in lists)], dtype=np.int64)


def _floats(values: Sequence[Any]) -> FloatArray:
    return np.array(values, dtype=np.float64)


def _integers(values: Sequence[int]) -> IntArray:
    return np.array(values, dtype=np.int64)


# Places along lanes ---------------------------------------------------------------------------


@in_place(inner=True)
def _interpolated(x: float, first: int, last: int, at: FloatArray, value: FloatArray) -> float:
    """`numpy.interp` for one place and the entries from ``first`` to ``last``, to the bit."""
    if x < at[first]:
        return float(value[first])
    if x > at[last]:
        return float(value[last])
    low, high = first, last  # the last entry not after x
    while low < high:
        middle = (low + high + 1) // 2
        if at[middle] <= x:
            low = middle
        else:
            high = middle - 1
    if low == last or at[low] == x:
        return float(value[low])
    slope = (value[low + 1] - value[low]) / (at[low + 1] - at[low])
    return float(slope * (x - at[low]) + value[low])


@in_place()
def _project_on_bends(
    xy: FloatArray, lane: IntArray, lines: Lines, found: FloatArray, doubtful: BoolArray
) -> None:
    """Fill the rows of those on lanes that are not straight.

    Args:
        xy: (n, 2) m.
        lane: (n,) the lane of each.
        lines: of the road.
        found: (n, 4) distance along and to the right, m, heading, rad, and curvature, rad/m; those
            on straight lanes get the heading and the curvature.
        doubtful: (n,) set where the kernel cannot give the distances to the bit.
    """
    for i in range(len(lane)):
        k = lane[i]
        if lines.straight[k]:
            found[i, 2], found[i, 3] = lines.heading[k], 0.0
            continue
        first, last = lines.first[k], lines.first[k + 1] - 1
        best, second, exact = np.inf, np.inf, False
        for g in range(first, last + 1):
            dx, dy = xy[i, 0] - lines.piece_start[g, 0], xy[i, 1] - lines.piece_start[g, 1]
            ahead, aside = lines.piece_direction[g, 0], lines.piece_direction[g, 1]
            along, across = dx * ahead + dy * aside, dy * ahead - dx * aside
            clipped = along
            if along < 0.0 and g > first:
                clipped = 0.0
            elif along > lines.piece_size[g] and g < last:
                clipped = lines.piece_size[g]
            distance = math.hypot(across, along - clipped)
            if distance < best:
                best, second, exact = distance, best, along == clipped
                found[i, 0] = lines.piece_begin[g] + clipped
                found[i, 1] = math.copysign(distance, across)
            elif distance < second:
                second = distance
        if not exact or second - best < NEARLY:
            doubtful[i] = True
            continue
        begin, end = lines.turn_first[k], lines.turn_first[k + 1] - 1
        at, value, s = lines.turn_at, lines.turn_heading, found[i, 0]
        found[i, 2] = _interpolated(s, begin, end, at, value)
        before = _interpolated(s - BLEND_M / 2, begin, end, at, value)
        after = _interpolated(s + BLEND_M / 2, begin, end, at, value)
        found[i, 3] = (after - before) / BLEND_M


def places_on_lanes(tables: LaneTables, xy: FloatArray, lane: IntArray) -> FloatArray:
    """Where everybody is on a lane, as highway-env's lane objects say, to the bit.

    Args:
        tables: of the road.
        xy: (n, 2) in highway-env's axes, m.
        lane: (n,) a lane for each.

    Returns:
        (n, 4) distance along the lane and to the right of it, m, the lane's heading there, rad,
        and its curvature, rad/m.
    """
    found, doubtful = np.empty((len(lane), 4)), np.zeros(len(lane), dtype=np.bool_)
    lines = tables.lines
    delta = xy - lines.start[lane]  # `vecdot` is the dot product that highway-env's lanes use
    found[:, 0] = np.vecdot(delta, lines.direction[lane])
    found[:, 1] = np.vecdot(delta, lines.aside[lane])
    _project_on_bends(xy, lane, lines, found, doubtful)
    for i in np.flatnonzero(doubtful).tolist():
        line = tables.objects[lane[i]]
        s, lateral = line.local_coordinates(xy[i])
        curvature = line.curvature_at(s) if isinstance(line, PolylineLane) else 0.0
        found[i] = s, lateral, line.heading_at(s), curvature
    return found
