"""Searches for agents that share a position within a few seconds, as driven and as predicted.

Two searches cover a whole episode: for bodies that enter another's driven area, and for areas
ahead that overlap. Their cost grows with the bodies near each other, not with the number of pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from behaviors.row_index import RowIndex
from sim.compiled import in_place
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, IntArray, Tracks
from sim.geometry import Outlines
from sim.road.cells import cells_of
from sim.safety.kernels import SLABS, apart, least_shift, meeting, on_axes, reaches
from sim.safety.measures import Bodies

SAME_WAY_RAD: Final = math.radians(30.0)
"""Bodies whose headings differ by less go the same way (SSAM: rear-end conflicts are below it)."""

SAME_WAY_COSINE: Final = math.cos(SAME_WAY_RAD)

BLOCK_ROWS: Final = 100_000
"""Rows that are searched at once."""

CELL_M: Final = 5.0
"""Width of the cells in which driven areas are looked for (a car's length)."""

BREAK_S: Final = 1.0
"""Motion is unknown between frames farther apart than this and than three usual steps."""

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
        rows = tracks.rows
        agent, time_s = rows.index.agent, tracks.time_s[rows.index.step]
        usual_s = float(np.median(np.diff(tracks.time_s))) if tracks.time_s.size > 1 else 1.0
        begins = rows.index.begins.copy()
        begins[1:] |= np.diff(time_s) > max(BREAK_S, 3.0 * usual_s)
        run, here = np.cumsum(begins), np.arange(begins.size)
        first, last = np.searchsorted(run, run), np.searchsorted(run, run, side="right") - 1
        after, before = np.minimum(here + 1, last), np.maximum(here - 1, first)
        wide = max(1, round(TURN_WINDOW_S / usual_s))
        late, early = np.minimum(here + wide, last), np.maximum(here - wide, first)
        piece_s, heading, speed = time_s[after] - time_s, rows.heading, rows.speed
        faster = _rate(speed[after] - speed[before], time_s[after] - time_s[before])
        sizes = tracks.length[agent], tracks.width[agent]
        return cls(
            index=rows.index,
            bodies=Bodies(rows.xy, heading, speed, faster, *sizes),
            time_s=time_s,
            turning=_rate(wrapped(heading[late] - heading[early]), time_s[late] - time_s[early]),
            walking=(tracks.kind == PEDESTRIAN)[agent],
            piece_s=piece_s,
            piece_mps=_rate(rows.xy[after] - rows.xy, piece_s[:, None]),
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
    by_time, _ = driven.index.by_time
    time_s = driven.time_s[by_time]
    longest_s = within_s + float(driven.piece_s.max(initial=0.0))
    found = [Shared(*np.empty((2, 0), np.int64), *np.empty((2, 0)))]
    for begin in range(0, by_time.size, BLOCK_ROWS):
        since = int(np.searchsorted(time_s, time_s[begin] - longest_s))
        rows = by_time[since : begin + BLOCK_ROWS]
        found.append(_shared_in_block(driven, rows, begin - since, within_s, longest_s))
    return Shared(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _shared_in_block(
    driven: Driven, rows: IntArray, begin: int, within_s: float, longest_s: float
) -> Shared:
    """`shared_places` of the rows from ``begin`` on, with all of them as those before."""
    xy, ahead, half = driven.outlines(driven.piece_heading).rows(rows)
    way, piece_s = driven.piece_mps[rows], driven.piece_s[rows, None]
    ends = np.stack([xy, xy + way * piece_s])
    reach = np.abs(ahead) * half[:, :1] + np.abs(ahead[:, ::-1]) * half[:, 1:]
    boxes = np.concatenate([ends.min(axis=0) - reach, ends.max(axis=0) + reach], axis=1)
    cells = cells_of(boxes, np.arange(rows.size), CELL_M)
    corners = (boxes - np.tile([cells.x0, cells.y0], 2)) / cells.size
    pieces = np.concatenate([xy, ahead, way, half, driven.time_s[rows, None], piece_s], axis=1)
    size = 4 * rows.size
    while True:
        pairs, times = np.empty((size, 2), np.int64), np.empty((size, 2))
        best = np.full((driven.index.agents, 4), np.inf)
        size = _find_shared(
            pieces, driven.index.agent[rows], driven.walking[rows], corners.astype(np.int64),
            cells.columns, cells.first, cells.items, begin, within_s, longest_s, best,
            np.empty((SLABS, 3)), pairs, times,
        )  # fmt: skip
        if size <= len(pairs):
            return Shared(*rows[pairs[:size].T], *times[:size].T)


@in_place()
def _find_shared(
    pieces: FloatArray, agent: IntArray, walking: BoolArray, corners: IntArray, columns: int,
    first: IntArray, items: Any, begin: int, within_s: float, longest_s: float, best: FloatArray,
    slab: FloatArray, pairs: IntArray, times: FloatArray,
) -> Any:  # fmt: skip
    """Find the moments of `Shared`; returns how many, of which those that fit are set.

    A piece is x, y, heading as a vector, velocity, half sizes, time, duration. ``corners`` are the
    cells that it touches; ``best`` holds each agent's least time and its piece.
    """
    found = 0
    for i in range(begin, len(pieces)):
        seen, same_way_s = 0, np.inf
        for row in range(corners[i, 1], corners[i, 3] + 1):
            for cell in range(row * columns + corners[i, 0], row * columns + corners[i, 2] + 1):
                here = items[first[cell] : first[cell + 1]]
                for n in range(np.searchsorted(here, i) - 1, -1, -1):
                    j = here[n]
                    one, since_s = agent[j], pieces[i, 8] - pieces[j, 8]
                    if since_s > longest_s:
                        break
                    if one == agent[i] or (walking[i] and walking[j]):
                        continue
                    if since_s - pieces[j, 9] >= min(best[one, 0], within_s):
                        continue
                    low, high, at = _shift_of(pieces[j], pieces[i], slab)
                    low, high = low + since_s, high + since_s
                    gap_s = max(low, -high, 0.0)
                    if low > high or gap_s > within_s or gap_s >= best[one, 0]:
                        continue
                    if best[one, 0] == np.inf:
                        best[seen, 3] = one
                        seen += 1
                    best[one, 0], best[one, 1] = gap_s, pieces[j, 8] + at + gap_s
                    best[one, 2] = j if high >= 0.0 else -j - 1  # the other one comes later
        for k in range(seen):
            one = int(best[k, 3])
            j = int(best[one, 2])
            if _same_way(pieces[i], pieces[j if j >= 0 else -j - 1]):
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
def _same_way(one: Any, other: Any) -> Any:
    return one[2] * other[2] + one[3] * other[3] > SAME_WAY_COSINE


@in_place(inner=True)
def _shift_of(piece: Any, other: Any, slab: Any) -> Any:
    """`least_shift` of two pieces, from the beginning of each; cheap where they are apart."""
    ahead, ahead_2 = (piece[2], piece[3]), (other[2], other[3])
    place = on_axes(other[0] - piece[0], other[1] - piece[1], ahead, ahead_2)
    reach = reaches(ahead, (piece[6], piece[7]), ahead_2, (other[6], other[7]))
    rate = on_axes(piece[4], piece[5], ahead, ahead_2)
    rate_2 = on_axes(other[4], other[5], ahead, ahead_2)
    way = on_axes(piece[4] * piece[9], piece[5] * piece[9], ahead, ahead_2)
    way_2 = on_axes(other[4] * other[9], other[5] * other[9], ahead, ahead_2)
    if apart(place, reach, way, way_2):
        return np.inf, -np.inf, 0.0
    return least_shift(place, rate, rate_2, reach, piece[9], other[9], slab)


def areas_ahead(driven: Driven, within_s: float) -> IntArray:
    """(k, 2) rows of one time whose areas ahead overlap, pedestrians with each other aside.

    An area ahead is what a body sweeps in ``within_s`` at constant velocity. Bodies that go the
    same way count on a collision course only.
    """
    xy, ahead, half = driven.outlines(driven.bodies.heading)
    way = within_s * driven.bodies.speed[:, None] * ahead
    middle, reach = xy + 0.5 * way, np.hypot(*half.T) + 0.5 * np.hypot(*way.T)
    bodies = np.concatenate([xy, ahead, way, half], axis=1)
    order, begins = driven.index.by_time
    found = [np.empty((0, 2), np.int64)]
    for begin, end in pairwise(begins.tolist()):
        rows = order[begin:end]
        if rows.size > 1:
            tree = cKDTree(middle[rows])
            near = tree.query_pairs(2.0 * float(reach[rows].max()), output_type="ndarray")
            kept = np.empty(len(near), dtype=bool)
            _meet(bodies[rows], near, kept)
            pairs = rows[near[kept]]
            found.append(pairs[~driven.walking[pairs].all(axis=1)])
    return np.concatenate(found)


@in_place()
def _meet(bodies: FloatArray, pairs: IntArray, kept: BoolArray) -> None:
    """Select the pairs of `areas_ahead`; a body is x, y, heading, length, half sizes."""
    for n in range(len(pairs)):
        one, other = bodies[pairs[n, 0]], bodies[pairs[n, 1]]
        ahead, ahead_2 = (one[2], one[3]), (other[2], other[3])
        place = on_axes(other[0] - one[0], other[1] - one[1], ahead, ahead_2)
        reach = reaches(ahead, (one[6], one[7]), ahead_2, (other[6], other[7]))
        way, way_2 = (
            on_axes(one[4], one[5], ahead, ahead_2),
            on_axes(other[4], other[5], ahead, ahead_2),
        )
        kept[n] = not apart(place, reach, way, way_2)
        if kept[n] and _same_way(one, other):
            between = on_axes(other[4] - one[4], other[5] - one[5], ahead, ahead_2)
            kept[n] = meeting(place, between, reach) <= 1.0


def _rate(change: FloatArray, over_s: FloatArray) -> FloatArray:
    """Change over time; 0 where no time passes."""
    return np.divide(change, over_s, out=np.zeros_like(change), where=over_s > 0.0)


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-pi, pi), rad."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
