"""Searches for agents that share a position within a few seconds, as driven and as predicted.

Two searches cover a whole episode: for bodies that enter another's driven area, and for areas
ahead that overlap. Their cost grows with the bodies near each other, not with the number of pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from behaviors.row_index import RowIndex
from sim.compiled import in_place
from sim.frames import BREAK_S, BREAK_STEPS, BoolArray, FloatArray, IntArray, Tracks
from sim.geometry import Outlines
from sim.road.cells import Cells, cells_of
from sim.safety.measures import Bodies
from sim.safety.rectangles import SLABS, least_shift, on_axes, reaches

SAME_WAY_RAD: Final = math.radians(30.0)
"""Bodies whose headings differ by less go the same way (SSAM: rear-end conflicts are below it)."""

SAME_WAY_COSINE: Final = math.cos(SAME_WAY_RAD)

CELL_M: Final = 5.0
"""Width of the cells in which driven areas are looked for (a car's length)."""

ROUNDING_M: Final = 1e-6
"""Boxes around motions are this much larger, m."""

TURN_WINDOW_S: Final = 0.5
"""How fast a body turns is measured from this long before to this long after, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """State of m rows, by agent and then by time.

    A piece is the straight motion from one row to the next; it takes no time before a break.
    """

    index: RowIndex
    bodies: Bodies
    time_s: FloatArray
    turning: FloatArray  # rad/s
    walking: BoolArray  # pedestrians
    piece_s: FloatArray
    piece_mps: FloatArray  # (m, 2)
    piece_heading: FloatArray  # halfway

    @classmethod
    def of(cls, tracks: Tracks) -> Driven:
        """State of the rows of tracks."""
        agent, time_s = tracks.index.agent, tracks.time_s[tracks.index.step]
        usual_s = float(np.median(np.diff(tracks.time_s))) if tracks.time_s.size > 1 else 1.0
        begins = tracks.index.begins.copy()
        begins[1:] |= np.diff(time_s) > max(BREAK_S, BREAK_STEPS * usual_s)
        run, here = np.cumsum(begins), np.arange(begins.size)
        first, last = np.searchsorted(run, run), np.searchsorted(run, run, side="right") - 1
        after, before = np.minimum(here + 1, last), np.maximum(here - 1, first)
        wide = max(1, round(TURN_WINDOW_S / usual_s))
        late, early = np.minimum(here + wide, last), np.maximum(here - wide, first)
        piece_s, heading, speed = time_s[after] - time_s, tracks.row_heading, tracks.row_speed
        faster = _rate(speed[after] - speed[before], time_s[after] - time_s[before])
        length, width = tracks.length[agent], tracks.width[agent]
        return cls(
            index=tracks.index,
            bodies=Bodies(tracks.row_xy, heading, speed, faster, length, width),
            time_s=time_s,
            turning=_rate(wrapped(heading[late] - heading[early]), time_s[late] - time_s[early]),
            walking=tracks.walking,
            piece_s=piece_s,
            piece_mps=_rate(tracks.row_xy[after] - tracks.row_xy, piece_s[:, None]),
            piece_heading=heading + 0.5 * wrapped(heading[after] - heading),
        )

    def outlines(self, heading: FloatArray) -> Outlines:
        """The outlines of the rows, with these headings."""
        return Outlines.of(self.bodies.xy, heading, self.bodies.length, self.bodies.width)


class Shared(NamedTuple):
    """Moments at which a body comes to a place where another one has been."""

    later: IntArray  # row of the body that comes, whose piece it is then in
    earlier: IntArray  # row of the one that has been there
    gap_s: FloatArray  # how long after; 0 where they touch
    time_s: FloatArray  # when it comes


def shared_places(driven: Driven, within_s: float) -> Shared:
    """Find bodies that come where another one has been, at most ``within_s`` after.

    Each piece is compared with the others' of the last seconds, and for each other body the least
    time counts. Among bodies that went the same way only the last counts, which is the leader.
    """
    rows, _ = driven.index.by_time
    outlines = driven.outlines(driven.piece_heading)
    pieces = _pieces(driven, outlines, driven.piece_mps, driven.piece_s)[rows]
    cells = cells_of(pieces[:, 10:], np.arange(rows.size), CELL_M)
    size = 4 * rows.size
    while True:
        pairs, times = np.empty((size, 2), np.int64), np.empty((size, 2))
        size = _find_shared(
            pieces, driven.index.agent[rows], driven.walking[rows], cells, cells.first.copy(),
            within_s, within_s + pieces[:, 9].max(initial=0.0),
            np.full((driven.index.agents, 4), np.inf), np.empty((SLABS, 3)), pairs, times,
        )  # fmt: skip
        if size <= len(pairs):
            return Shared(*rows[pairs[:size].T], *times[:size].T)


@in_place()
def _find_shared(
    pieces: FloatArray, agent: IntArray, walking: BoolArray, cells: Cells, upto: IntArray,
    within_s: float, longest_s: float, best: FloatArray, slab: FloatArray, pairs: IntArray,
    times: FloatArray,
) -> Any:  # fmt: skip
    """Find the moments of `Shared`; returns how many, of which those that fit are set.

    A piece is x, y, heading as a vector, velocity, half sizes, time, duration, and the box around
    it. ``upto`` are the cells' items that have been looked at. ``best`` holds each agent's least
    time and its piece. Pieces are compared in the first cell that both touch.
    """
    found = 0
    for i in range(len(pieces)):
        seen, same_way_s, me = 0, np.inf, pieces[i]
        first_column, first_row = _cell(me[10], me[11], cells)
        last_column, last_row = _cell(me[12], me[13], cells)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                cell = row * cells.columns + column
                at = upto[cell]
                upto[cell] += 1
                while at > cells.first[cell]:
                    at -= 1
                    j = cells.items[at]
                    one, other = agent[j], pieces[j]
                    since_s = me[8] - other[8]
                    if since_s > longest_s:
                        break
                    if one == agent[i] or since_s - other[9] >= min(best[one, 0], within_s):
                        continue
                    if _apart(me, other) or (walking[i] and walking[j]):
                        continue
                    its_column, its_row = _cell(other[10], other[11], cells)
                    if column > max(first_column, its_column) or row > max(first_row, its_row):
                        continue
                    low, high, at_s = _shift_of(other, me, slab)
                    low, high = low + since_s, high + since_s
                    gap_s = max(low, -high, 0.0)
                    if low > high or gap_s > within_s or gap_s >= best[one, 0]:
                        continue
                    if best[one, 0] == np.inf:
                        best[seen, 3] = one
                        seen += 1
                    best[one, 0], best[one, 1] = gap_s, other[8] + at_s + gap_s
                    best[one, 2] = j if high >= 0.0 else -j - 1  # the other one comes later
        for k in range(seen):
            one = int(best[k, 3])
            j = int(best[one, 2])
            if _same_way(me, pieces[j if j >= 0 else -j - 1]):
                same_way_s = min(same_way_s, best[one, 0])
        for k in range(seen):
            one = int(best[k, 3])
            j = int(best[one, 2])
            later, earlier = (i, j) if j >= 0 else (-j - 1, i)
            if best[one, 0] <= same_way_s or not _same_way(pieces[later], pieces[earlier]):
                if found < len(pairs):
                    pairs[found, 0], pairs[found, 1] = later, earlier
                    times[found, 0], times[found, 1] = best[one, 0], best[one, 1]
                found += 1
            best[one, 0] = np.inf
    return found


@in_place(inner=True)
def _cell(x: Any, y: Any, cells: Any) -> Any:
    """Column and row of the cell of a place."""
    return int((x - cells.x0) / cells.size), int((y - cells.y0) / cells.size)


@in_place(inner=True)
def _apart(one: Any, other: Any) -> Any:
    """Whether the boxes around two pieces do not touch."""
    aside = other[11] > one[13] or other[13] < one[11]
    return aside or other[10] > one[12] or other[12] < one[10]


@in_place(inner=True)
def _same_way(one: Any, other: Any) -> Any:
    return one[2] * other[2] + one[3] * other[3] > SAME_WAY_COSINE


@in_place(inner=True)
def _shift_of(piece: Any, other: Any, slab: Any) -> Any:
    """`least_shift` of two pieces, from the beginning of each."""
    ahead, ahead_2 = (piece[2], piece[3]), (other[2], other[3])
    place = on_axes(other[0] - piece[0], other[1] - piece[1], ahead, ahead_2)
    reach = reaches(ahead, (piece[6], piece[7]), ahead_2, (other[6], other[7]))
    rate = on_axes(piece[4], piece[5], ahead, ahead_2)
    rate_2 = on_axes(other[4], other[5], ahead, ahead_2)
    return least_shift(place, rate, rate_2, reach, piece[9], other[9], slab)


def areas_ahead(driven: Driven, within_s: float) -> IntArray:
    """(k, 2) rows of one time whose areas ahead overlap, pedestrians with each other aside.

    An area ahead is what a body sweeps in ``within_s`` at constant velocity. Bodies that go the
    same way count on a collision course only.
    """
    outlines = driven.outlines(driven.bodies.heading)
    velocity = driven.bodies.speed[:, None] * outlines.forward
    pieces = _pieces(driven, outlines, velocity, np.full(driven.time_s.size, within_s))
    rows = np.lexsort((pieces[:, 10], driven.index.step))
    size = 4 * rows.size
    while True:
        pairs = np.empty((size, 2), np.int64)
        size = _find_ahead(pieces[rows], driven.walking[rows], np.empty((SLABS, 3)), pairs)
        if size <= len(pairs):
            return rows[pairs[:size]]


@in_place()
def _find_ahead(pieces: FloatArray, walking: BoolArray, slab: FloatArray, pairs: IntArray) -> Any:
    """Find the pairs of `areas_ahead`, as `_find_shared` does; pieces are by time, then by x."""
    found = 0
    for i in range(len(pieces)):
        me = pieces[i]
        for j in range(i + 1, len(pieces)):
            other = pieces[j]
            if other[8] != me[8] or other[10] > me[12]:
                break
            if _apart(me, other) or (walking[i] and walking[j]):
                continue
            low, high, _ = _shift_of(me, other, slab)
            if low > high or (_same_way(me, other) and not low <= 0.0 <= high):
                continue
            if found < len(pairs):
                pairs[found, 0], pairs[found, 1] = i, j
            found += 1
    return found


def _pieces(
    driven: Driven, outlines: Outlines, velocity: FloatArray, duration_s: FloatArray
) -> FloatArray:
    """(m, 14) straight motions from each row on, as `_find_shared` takes them."""
    xy, ahead, half = outlines
    ends = xy + velocity * duration_s[:, None]
    reach = np.abs(ahead) * half[:, :1] + np.abs(ahead[:, ::-1]) * half[:, 1:] + ROUNDING_M
    box = np.minimum(xy, ends) - reach, np.maximum(xy, ends) + reach
    times = np.stack([driven.time_s, duration_s], axis=1)
    return np.concatenate([xy, ahead, velocity, half, times, *box], axis=1)


def _rate(change: FloatArray, over_s: FloatArray) -> FloatArray:
    """Change over time; 0 where no time passes."""
    return np.divide(change, over_s, out=np.zeros_like(change), where=over_s > 0.0)


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-pi, pi), rad."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
