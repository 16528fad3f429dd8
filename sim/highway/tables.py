"""A road's lanes as arrays that kernels read, and the places of points along them.

Every lane has a number, its position in `HighwayNetwork.lanes`; -1 stands for none. Lists that
belong to a lane, such as its `conflicts`, run from ``lane.conflict`` to ``lane.conflict_end``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.lanes import BLEND_M, LaneIndex, is_wrong_side
from sim.road.cells import Cells, boxes_of, cells_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[Any]

STRETCH_MARGIN_M: Final = 1.0
"""A vehicle this far beyond a lane's edge is still on it (highway-env's)."""

PATH_MARGIN_M: Final = 0.5
"""The same on junction paths, which lie close together."""

BEHIND_M: Final = 40.0
"""A vehicle this far before the beginning of a lane, and in line with it, is on it already."""

CELL_M: Final = 50.0
"""Width of the cells in which lanes are looked for, m (`BEHIND_M` and a lane)."""

LONGEST_M: Final = 40.0
"""Length up to which a vehicle beyond the end of a lane is still on it with its rear, m (twice a
lorry's)."""

TIGHT_M: Final = 5.0
"""A junction path of a smaller mean radius is tight, m (a car's turning circle)."""

ROUNDING_M: Final = 1e-3
"""Lanes are searched this much farther from vehicles than they can be, m."""


def record_type(**fields: str) -> np.dtype[Any]:
    """The type of a row with named fields, for arrays of rows that kernels read and write."""
    return np.dtype((np.record, np.dtype(list(fields.items()), align=True)))


LANE: Final = record_type(
    length="f8", limit="f8", width="f8", margin="f8", behind="f8",
    connector="?", wrong="?", must_yield="?", must_stop="?", tight="?",
    signal="i8", entry="i8", exit="i8", left="i8", right="i8", stretch="i8",
    opposite="i8", own="i8",
    piece="i8", piece_end="i8", turn="i8", turn_end="i8", way="i8", way_end="i8",
    conflict="i8", conflict_end="i8", strip="i8", strip_end="i8",
)  # fmt: skip
"""A lane.

``margin``: how far aside a vehicle is still on it, m; ``behind``: how far before it, m;
``connector``: whether it crosses a junction; ``wrong``: whether it runs over a lane of the opposite
direction; ``tight``: whether it turns too sharply for the middle of a car to keep to it;
``signal``: the group that guards its entry; ``entry`` and ``exit``: the lanes on which
a junction path begins and ends; ``left`` and ``right``: lanes that drivers may change to;
``opposite``: the lane over the one of the opposite direction beside it; ``own``: the lane beside
such a lane.
"""

PIECE: Final = record_type(
    x="f8", y="f8", dx="f8", dy="f8", size="f8", begin="f8", outside="f8", outside_end="f8"
)
"""A straight piece of a lane: beginning and direction, m; how long it is and where it begins along
the lane, m; the side of a sharp corner at its beginning and at its end that is outside, or 0."""

TURN: Final = record_type(at="f8", heading="f8")
"""A lane's heading, rad, at a distance along it, m; between two of them it is interpolated."""

WAY: Final = record_type(stretch="i8", path="i8")
"""A stretch to which a lane leads, and the junction path that leads there."""

CONFLICT: Final = record_type(
    other="i8", begin="f8", end="f8", other_begin="f8", other_end="f8", yields="i8"
)
"""Where a junction path runs too close to another one; see `sim.highway.conflicts.Conflict`."""

STRIP: Final = record_type(crossing="i8", spot="i8", near="f8", far="f8", u="f8")
"""Where a lane runs over a crossing, and which spot of the crossing that is."""

CROSSING: Final = record_type(signal="i8", priority="?", spot="i8", spot_end="i8")
"""A crossing: its signal group, and whether drivers have to let pedestrians cross."""

SPOT: Final = record_type(u="f8", half="f8")
"""Where lanes run over a crossing: middle and half width, m along the crossing."""


class Net(NamedTuple):
    """The arrays of a road; each is named after its type, and ``cells`` holds the lanes by place.

    Attributes:
        has_paths: whether any lane is a junction path.
        has_wrong: whether any lane runs over one of the opposite direction.
    """

    lanes: Records
    pieces: Records
    turns: Records
    ways: Records
    conflicts: Records
    strips: Records
    crossings: Records
    spots: Records
    cells: Cells
    has_paths: bool
    has_wrong: bool


class LaneTables:
    """A road's lanes as arrays, with the numbers of its lanes and stretches.

    Args:
        network: the road in highway-env's terms, a `HighwayNetwork`.
    """

    def __init__(self, network: Any) -> None:
        self.network = network
        self.keys: list[LaneIndex] = list(network.lanes)
        self.number: dict[LaneIndex, int] = {key: k for k, key in enumerate(self.keys)}
        self.stretches: dict[tuple[str, str], int] = {}
        for key in self.keys:
            self.stretch(key[:2])

    def stretch(self, name: tuple[str, str]) -> int:
        """The number of a stretch; a new one for a stretch that the road does not have."""
        return self.stretches.setdefault(name, len(self.stretches))

    @cached_property
    def net(self) -> Net:
        """The arrays."""
        network, n = self.network, len(self.keys)
        info = [network.info[key] for key in self.keys]
        objects = list(network.lanes.values())
        lanes = np.zeros(n, LANE)
        lanes["length"] = [lane.length for lane in objects]
        lanes["limit"] = [lane.speed_limit for lane in objects]
        lanes["width"] = [lane.width for lane in objects]
        for name in ("connector", "must_yield", "must_stop", "signal"):
            lanes[name] = [getattr(one, name) for one in info]
        lanes["tight"] = [lane.length < TIGHT_M * abs(lane.turned) for lane in objects]
        lanes["wrong"] = [is_wrong_side(key) for key in self.keys]
        margin = np.where(lanes["connector"], PATH_MARGIN_M, STRETCH_MARGIN_M)
        lanes["margin"] = lanes["width"] / 2 + margin
        lanes["behind"] = np.where(lanes["connector"], 0.0, BEHIND_M)
        lanes["entry"] = self._numbers({path: lane for (lane, _), path in network.onward.items()})
        lanes["exit"] = self._numbers(network.exit_of)
        lanes["left"], lanes["right"] = self._beside(-1), self._beside(1)
        lanes["stretch"] = [self.stretches[key[:2]] for key in self.keys]
        lanes["opposite"] = self._numbers(network.wrong_side)
        lanes["own"] = self._numbers(
            {key: (key[0][1:], key[1][1:], 0) for key in self.keys if is_wrong_side(key)}
        )
        ways: list[list[tuple[int, int]]] = [[] for _ in self.keys]
        for (lane, then), path in network.onward.items():
            ways[self.number[lane]].append((self.stretch(then), self.number[path]))
        crossings, spots = self._crossings()
        strips = [
            [
                (z.crossing, _spot(crossings[z.crossing], spots, z.u), z.near_s, z.far_s, z.u)
                for z in one.strips
            ]
            for one in info
        ]
        conflicts = [[(self.number[c.other], *c[1:]) for c in one.conflicts] for one in info]
        turns = [_rows(lane.turn_at, lane.turn_heading) for lane in objects]
        pieces = [
            _rows(
                *lane.points[:-1].T, *lane.directions.T, lane.sizes, lane.begins,
                lane.outsides[:-1], lane.outsides[1:],
            )
            for lane in objects
        ]  # fmt: skip
        return Net(
            lanes=lanes,
            pieces=listed(lanes, "piece", pieces, PIECE),
            turns=listed(lanes, "turn", turns, TURN),
            ways=listed(lanes, "way", ways, WAY),
            conflicts=listed(lanes, "conflict", conflicts, CONFLICT),
            strips=listed(lanes, "strip", strips, STRIP),
            crossings=crossings,
            spots=spots,
            cells=_cells([lane.points for lane in objects], lanes),
            has_paths=bool((lanes["exit"] >= 0).any()),
            has_wrong=bool(network.wrong_side),
        )

    def _numbers(self, found: Mapping[LaneIndex, LaneIndex]) -> list[int]:
        """The number of the lane that is given for each lane."""
        return [self.number[found[key]] if key in found else -1 for key in self.keys]

    def _beside(self, step: int) -> IntArray:
        """The lane to which each lane's drivers may change on one side."""
        info, number = self.network.info, self.number
        beside = [number.get((*key[:2], key[2] + step), -1) for key in self.keys]
        fixed = [info[key].connector or is_wrong_side(key) for key in self.keys]
        return np.asarray(np.where(fixed, -1, beside), np.int64)

    def _crossings(self) -> tuple[Records, Records]:
        """The crossings, and where lanes run over each of them."""
        network = self.network
        found: list[list[tuple[float, float]]] = [[] for _ in network.road.crossings]
        for key, info in network.info.items():
            for strip in info.strips:
                places = found[strip.crossing]
                if all(abs(u - strip.u) >= 0.5 for u, _ in places):
                    places.append((strip.u, network.lanes[key].width / 2))
        crossings = np.zeros(len(found), CROSSING)
        crossings["signal"] = [one.signal for one in network.road.crossings]
        crossings["priority"] = [one.priority for one in network.road.crossings]
        return crossings, listed(crossings, "spot", [sorted(places) for places in found], SPOT)


def listed(
    of: Records, name: str, lists: Sequence[Sequence[tuple[Any, ...]]], kind: np.dtype[Any]
) -> Records:
    """All lists behind one another, and in each row of ``of`` where its own begins and ends."""
    ends = np.cumsum([len(each) for each in lists], dtype=np.int64)
    of[name + "_end"] = ends
    of[name][1:] = ends[:-1]
    rows = np.zeros(int(ends[-1]) if len(ends) else 0, kind)
    rows[:] = [row for each in lists for row in each]
    return rows


def _spot(crossing: Any, spots: Records, u: float) -> int:
    """Which spot of a crossing lies at a distance along it."""
    near = np.abs(spots["u"][crossing.spot : crossing.spot_end] - u) < 0.5
    return int(crossing.spot + np.argmax(near))


def _rows(*columns: FloatArray) -> list[tuple[float, ...]]:
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _cells(lines: Sequence[FloatArray], lanes: Records) -> Cells:
    """The lanes by the places at which a vehicle may be on them."""
    reached = []
    for line, behind in zip(lines, lanes["behind"], strict=True):
        first, last = line[1] - line[0], line[-1] - line[-2]
        back = line[0] - behind * first / np.hypot(*first)
        reached.append(
            np.concatenate([line, [back, line[-1] + LONGEST_M / 2 * last / np.hypot(*last)]])
        )
    boxes = boxes_of(reached, ROUNDING_M)
    boxes[:, :2] -= lanes["margin"][:, None]
    boxes[:, 2:] += lanes["margin"][:, None]
    return cells_of(boxes, np.arange(len(lines)), CELL_M)


# Places along lanes ---------------------------------------------------------------------------


@in_place(inner=True)
def project(x: float, y: float, k: int, net: Net) -> tuple[float, float, int]:
    """The place on a lane nearest to a point.

    Returns:
        Its distance along the lane, m, how far to the right of it the point is, m, and the piece.
    """
    lane, pieces = net.lanes[k], net.pieces
    best, s, lateral, found = np.inf, 0.0, 0.0, lane.piece
    for g in range(lane.piece, lane.piece_end):
        piece = pieces[g]
        dx, dy = x - piece.x, y - piece.y
        along, across = dx * piece.dx + dy * piece.dy, dy * piece.dx - dx * piece.dy
        clipped, side = along, across
        if along < 0.0 and g > lane.piece:
            clipped = 0.0
            side = piece.outside if piece.outside != 0.0 else across
        elif along > piece.size and g + 1 < lane.piece_end:
            clipped = piece.size
            side = piece.outside_end if piece.outside_end != 0.0 else across
        beyond = along - clipped
        if max(abs(across), abs(beyond)) >= best:
            continue  # the distance is no less than either
        distance = math.hypot(across, beyond) if beyond != 0.0 else abs(across)
        if distance < best:
            best, s, lateral, found = distance, piece.begin + clipped, side, g
    return s, math.copysign(best, lateral), found


@in_place(inner=True)
def heading_at(s: float, k: int, net: Net) -> float:
    """A lane's heading at a distance along it, rad."""
    turns, low, last = net.turns, net.lanes[k].turn, net.lanes[k].turn_end - 1
    if s < turns[low].at:
        return float(turns[low].heading)
    high = last
    while low < high:  # to the last entry not after s
        middle = (low + high + 1) // 2
        if turns[middle].at <= s:
            low = middle
        else:
            high = middle - 1
    one = turns[low]
    if low == last or one.at == s:
        return float(one.heading)
    then = turns[low + 1]
    slope = (then.heading - one.heading) / (then.at - one.at)
    return float(slope * (s - one.at) + one.heading)


@in_place(inner=True)
def curvature_at(s: float, k: int, net: Net) -> float:
    """How fast a lane's heading turns around a place, rad/m."""
    after, before = heading_at(s + BLEND_M / 2, k, net), heading_at(s - BLEND_M / 2, k, net)
    return (after - before) / BLEND_M
