"""A road's lanes as arrays that kernels read, and the places of points along them.

Every lane has a number, its position in `HighwayNetwork.lanes`; -1 stands for none. Lists that
belong to a lane, such as its `conflicts`, run from ``lane.conflict`` to ``lane.conflict_end``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.road.cells import Cells

IntArray = NDArray[np.int64]
Records = NDArray[Any]

BLEND_M: Final = 2.0
"""The heading turns from one piece's to the next's within this distance of the corner (half a
wheelbase)."""

STRETCH_MARGIN_M: Final = 1.0
"""A vehicle this far beyond a lane's edge is still on it (highway-env's)."""

PATH_MARGIN_M: Final = 0.5
"""The same on junction paths, which lie close together."""

BEHIND_M: Final = 40.0
"""A vehicle this far before the beginning of a lane, and in line with it, is on it already."""

LONGEST_M: Final = 40.0
"""Length up to which a vehicle beyond the end of a lane is still on it with its rear, m (twice a
lorry's)."""


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
"""Where a junction path runs too close to another one: from where to where on either, m.

``yields`` is 1 if its traffic gives way to the other's, -1 if the other's does, else 0.
"""

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


def listed(of: Records, name: str, lists: Sequence[Any], kind: np.dtype[Any]) -> Records:
    """All lists behind one another, and in each row of ``of`` where its own begins and ends."""
    ends = np.cumsum([len(each) for each in lists], dtype=np.int64)
    of[name + "_end"] = ends
    of[name][1:] = ends[:-1]
    return np.concatenate([np.zeros(0, kind), *(np.asarray(each, kind) for each in lists)])


# Places along lanes ---------------------------------------------------------------------------


@in_place(inner=True)
def project(x: float, y: float, k: int, net: Net) -> tuple[float, float, int]:
    """Distance along a lane of a point, how far to the right it is, m, and the piece there."""
    return project_on(x, y, net.lanes[k].piece, net.lanes[k].piece_end, net.pieces)


@in_place()
def project_on(
    x: float, y: float, first: int, end: int, pieces: Records
) -> tuple[float, float, int]:
    """The same on the line of the pieces from ``first`` to before ``end``."""
    best, s, lateral, found = np.inf, 0.0, 0.0, first
    for g in range(first, end):
        piece = pieces[g]
        dx, dy = x - piece.x, y - piece.y
        along, across = dx * piece.dx + dy * piece.dy, dy * piece.dx - dx * piece.dy
        clipped, side = along, across
        if along < 0.0 and g > first:
            clipped = 0.0
            side = piece.outside if piece.outside != 0.0 else across
        elif along > piece.size and g + 1 < end:
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


@in_place()
def closest_lane(x: float, y: float, heading: float, net: Net) -> int:
    """The lane closest to a place by highway-env's measure; ``heading`` is NaN if it is unknown."""
    best, found = np.inf, 0
    for k in range(net.lanes.size):
        s, lateral, _ = project(x, y, k, net)
        away = abs(lateral) + max(s - net.lanes[k].length, 0.0) + max(-s, 0.0)
        if not math.isnan(heading):
            off = heading - heading_at(s, k, net)
            away += abs((off + math.pi) % (2.0 * math.pi) - math.pi)
        if away < best:
            best, found = away, k
    return found
