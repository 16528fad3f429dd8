"""The paths along a map's lanes that agents of a recording may follow, as the network sees them.

An agent may be on every lane whose centre line lies within `LANE_REACH_M` of it and leads within
60 degrees of its own direction of travel. Lines go on straight beyond the ends of their lanes. An
agent's paths are all ways that lead on from there. Paths that stay within `APART_M` of each other
for as far as the agent goes are one. The `MOST` that fit best are kept.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.networks import TIME_S
from graphrqi.predict.recorded.features import scale_of
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.scene.paths import REACH_M, PathTable
from sim.frames import PEDESTRIAN, Tracks
from sim.geometry import to_own_frame
from sim.road import Road
from sim.road.cells import Cells, cells_of, members
from sim.road.lane_graph import DIRECTIONS, LaneGraph

LANE_REACH_M: Final = 5.0
"""Agents may be on lanes this near, m (maps and positions may be off by a metre or two, and the
lane beside is a path, too)."""

SAME_WAY: Final = 0.5
"""Least cosine between an agent's direction and its lane's (60 degrees)."""

APART_M: Final = 1.2
"""Paths nearer to each other than this are one, m (a third of a lane's width)."""

LONGEST: Final = 4
"""Longest paths, in units of `REACH_M` (5 s at 120 m/s; recordings with wrong clocks show any
speed)."""

MOST: Final = 6
"""Paths per agent at most."""

CONSIDERED: Final = 24
"""Paths per agent that are compared with each other, those that fit best."""

POINTS: Final = 25
"""Points along each path within the first `HORIZON_S`, evenly spaced from beside the agent on."""

HORIZON_S: Final = 5.0
"""How far ahead the networks were trained, and paths are described to them, s."""

LONGER, FURTHER_M = 1.6, 20.0
"""Paths reach this many times as far as the base goes, and by so much farther, m (3 m/s2 beyond the
base are 38 m)."""

KNOTS_S: Final = (1.0, 2.0, 3.0, 4.0, 5.0)
"""A path is described by where the base would be along it at these times, s."""

LOOKED_AT: Final = 12
"""Nearest agents that may be the leader on a path."""

ON_PATH_M: Final = 1.75
"""A vehicle whose centre is this near to a path is on it, m (half a lane's width)."""

CELL_M: Final = 20.0
"""Width of the cells in which lanes are looked for, m."""

PATH_FEATURES: Final = 42
"""How many numbers describe a path."""

_AT: Final = np.searchsorted(TIME_S, np.asarray(KNOTS_S) - 1e-9)


class LanesAhead(NamedTuple):
    """Paths of n agents along lanes.

    Attributes:
        exists: (n, MOST) which there are, those that fit best first.
        points: (n, MOST, G, 2) places along each in the agent's own frame, from beside it on, m.
        spacing_m: (n,) distance between them along the path, m.
        offset_m: (n, MOST) how far the agent is to the left of each lane's line, m.
        features: (n, MOST, PATH_FEATURES) what the network is told; 0 where there is none.
    """

    exists: BoolArray
    points: FloatArray
    spacing_m: FloatArray
    offset_m: FloatArray
    features: FloatArray

    @classmethod
    def none(cls, n: int, points: int = POINTS) -> LanesAhead:
        """No path for any of n agents."""
        return cls(
            np.zeros((n, MOST), bool), np.zeros((n, MOST, points, 2)), np.ones(n),
            np.zeros((n, MOST)), np.zeros((n, MOST, PATH_FEATURES)),
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Sequence[LanesAhead]) -> LanesAhead:
        """The agents of all parts, one part after the other."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def of(self, which: NDArray[Any]) -> LanesAhead:
        """Some of the agents."""
        return LanesAhead._make(column[which] for column in self)

    def in_single_precision(self) -> LanesAhead:
        """The same in half the memory."""
        single = (column.astype(np.float32) for column in self[1:])
        return LanesAhead._make([self.exists, *single])


class _Candidates(NamedTuple):
    """Agents on paths, m of them.

    Attributes:
        agent: (m,) row of the agent.
        path: (m,) row of the road's `PathTable`.
        s: (m,) distance of the place beside the agent along the path, m.
        offset: (m,) how far the agent is to the left of it, m.
        turned: (m,) the agent's direction relative to the path's, rad.
    """

    agent: IntArray
    path: IntArray
    s: FloatArray
    offset: FloatArray
    turned: FloatArray

    def of(self, which: IntArray) -> _Candidates:
        """Some of them."""
        return _Candidates._make(column[which] for column in self)


class _Steady(NamedTuple):
    """What the base says of all agents.

    Attributes:
        xy: (n, KNOTS, 2) where they come, in their own frames, m.
        gone: (n, 5) how far each has gone along its way at `KNOTS_S`, m.
        reach: (n,) how far paths are followed within `HORIZON_S`, m.
    """

    xy: FloatArray
    gone: FloatArray
    reach: FloatArray


@functools.lru_cache(maxsize=32)
def _lane_pieces(graph: LaneGraph) -> tuple[Cells, IntArray, FloatArray]:
    """The straight pieces of vehicles' lanes by cells, the lane of each, and its length, m."""
    count = graph.segment_last - graph.segment_first + 1
    lane, begin = np.repeat(np.arange(count.size), count), graph.segment_start
    end = np.append(graph.segment_at[1:], 0.0)
    end[graph.segment_last] = graph.length
    length = end - graph.segment_at
    stop = begin + length[:, None] * graph.segment_direction
    boxes = np.concatenate(
        [np.minimum(begin, stop) - LANE_REACH_M, np.maximum(begin, stop) + LANE_REACH_M], axis=1
    )
    drives = np.flatnonzero(graph.drivable[lane])
    return cells_of(boxes[drives], drives, CELL_M), lane, length


def lanes_ahead(
    history: Tracks, motion: Motion, road: Road, horizon_s: float = HORIZON_S
) -> LanesAhead:
    """The paths that every agent may follow; pedestrians have none.

    Places along the paths are given for as far ahead as ``horizon_s``.
    """
    stretches = max(1, math.ceil(horizon_s / HORIZON_S - 1e-9))
    found = LanesAhead.none(history.ids.size, 1 + stretches * (POINTS - 1))
    base = fading(motion, TIME_S)
    gone = along_way(base)
    steady = _Steady(base, gone[:, _AT], LONGER * gone[:, -1] + FURTHER_M)
    spacing = steady.reach / (POINTS - 1)
    found.spacing_m[:] = spacing
    graph = LaneGraph.of(road)
    near, lane = _near_lanes(graph, motion, history.kind != PEDESTRIAN)
    if not lane.size:
        return found
    farthest = stretches * float(steady.reach[near.agent].max())
    table = PathTable.of(road, REACH_M * max(1, math.ceil(min(farthest / REACH_M, LONGEST))))
    table.cover(lane)
    all_ = _paths_of(table, near, lane, near.s + stretches * steady.reach[near.agent])
    steady_at = _places(graph, table, all_.path, all_.s[:, None] + steady.gone[all_.agent])
    own = _own_frame(motion, all_.agent, steady_at)
    from_base = np.linalg.norm(own - base[all_.agent][:, _AT], axis=-1).mean(axis=1)
    cost = np.abs(all_.offset) + 2.0 * np.abs(all_.turned) + from_base
    kept, row, slot = _distinct(all_.agent, own, cost, history.ids.size)
    one = all_.of(kept)
    grid = one.s[:, None] + spacing[one.agent][:, None] * np.arange(found.points.shape[2])
    points = _own_frame(motion, one.agent, _places(graph, table, one.path, grid))
    found.exists[row, slot], found.points[row, slot] = True, points
    found.offset_m[row, slot] = one.offset
    columns = [
        *_fit_columns(one, cost[kept], slot, found.exists),
        *_lane_columns(one, steady, motion, graph, table),
        *_shape_columns(one, steady, motion, own[kept], points[:, :POINTS]),
        *_leader_columns(history, motion, one, points[:, :POINTS], spacing[one.agent]),
    ]
    found.features[row, slot] = np.stack(columns, axis=1)
    return found


def along_way(xy: FloatArray) -> FloatArray:
    """(n, H) how far agents have gone along their ways (n, H, 2), which begin at the origin, m."""
    before = np.concatenate([np.zeros_like(xy[:, :1]), xy[:, :-1]], axis=1)
    return np.asarray(np.cumsum(np.linalg.norm(xy - before, axis=-1), axis=1))


def _near_lanes(
    graph: LaneGraph, motion: Motion, drives: BoolArray
) -> tuple[_Candidates, IntArray]:
    """Agents beside lanes, without a path yet, and the lane of each."""
    cells, lane_of, length_of = _lane_pieces(graph)
    column = np.floor((motion.xy[:, 0] - cells.x0) / cells.size)
    line = np.floor((motion.xy[:, 1] - cells.y0) / cells.size)
    inside = drives & (column >= 0) & (column < cells.columns) & (line >= 0) & (line < cells.rows)
    who = np.flatnonzero(inside)
    cell = (line[who] * cells.columns + column[who]).astype(np.int64)
    which, at = members(cells.first[cell], cells.first[cell + 1] - cells.first[cell])
    agent, piece = who[which], cells.items[at].astype(np.int64)
    length, lane = length_of[piece], lane_of[piece]
    apart = motion.xy[agent] - graph.segment_start[piece]
    ahead = graph.segment_direction[piece]
    beyond = (apart * ahead).sum(axis=1)
    away = np.linalg.norm(apart - np.clip(beyond, 0.0, length)[:, None] * ahead, axis=1)
    least = np.where(piece == graph.segment_first[lane], -LANE_REACH_M, 0.0)
    more = np.where(piece == graph.segment_last[lane], LANE_REACH_M, 0.0)
    along = np.clip(beyond, least, length + more)
    left = ahead[:, 0] * apart[:, 1] - ahead[:, 1] * apart[:, 0]
    turned = np.angle(np.exp(1j * (motion.heading[agent] - graph.segment_heading[piece])))
    fits = np.flatnonzero((away < LANE_REACH_M) & (np.cos(turned) > SAME_WAY))
    lane = lane[fits]
    order = np.lexsort((away[fits], lane, agent[fits]))
    fits, lane = fits[order], lane[order]
    nearest = np.ones(fits.size, bool)
    nearest[1:] = (agent[fits[1:]] != agent[fits[:-1]]) | (lane[1:] != lane[:-1])
    fits, lane = fits[nearest], lane[nearest]
    return _Candidates(
        agent=agent[fits],
        path=np.full(fits.size, -1),
        s=graph.segment_at[piece[fits]] + along[fits],
        offset=left[fits],
        turned=turned[fits],
    ), lane


def _paths_of(table: PathTable, near: _Candidates, lane: IntArray, end: FloatArray) -> _Candidates:
    """Every path that leads on from each lane; those with the same lanes up to ``end`` m once."""
    which, path = table.options_of(lane)
    lanes = np.where(table.start[path] < end[which, None], table.lane[path], -1)
    _, first = np.unique(np.column_stack([which, lanes]), axis=0, return_index=True)
    return near.of(which[first])._replace(path=path[first])


def _places(graph: LaneGraph, table: PathTable, path: IntArray, s: FloatArray) -> FloatArray:
    """(m, H, 2) places at distances along paths, m; a path goes on straight after its end."""
    lane, at = table.along(path, s)
    return graph.position(lane.ravel(), at.ravel())[0].reshape(*s.shape, 2)


def _own_frame(motion: Motion, agent: IntArray, xy: FloatArray) -> FloatArray:
    """(m, H, 2) places in the frames of agents (m,), m."""
    return to_own_frame(xy, motion.xy[agent], motion.heading[agent])


def _distinct(
    agent: IntArray, own: FloatArray, cost: FloatArray, n: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Which paths are kept, the agent of each, and its slot."""
    order = np.lexsort((cost, agent))
    count = np.bincount(agent, minlength=n)
    rank = np.arange(order.size) - np.repeat(np.cumsum(count) - count, count)
    order, rank = order[rank < CONSIDERED], rank[rank < CONSIDERED]
    who = agent[order]
    places = np.full((n, CONSIDERED, *own.shape[1:]), np.inf)
    places[who, rank] = own[order]
    index = np.full((n, CONSIDERED), -1)
    index[who, rank] = order
    kept = index >= 0
    for k in range(1, CONSIDERED):
        rows = np.flatnonzero(kept[:, k])
        if not rows.size:
            break
        apart = np.linalg.norm(places[rows, :k] - places[rows, k, None], axis=-1).max(axis=-1)
        alike = ((apart < APART_M) & kept[rows, :k]).any(axis=1)
        kept[rows, k] = ~alike & (kept[rows, :k].sum(axis=1) < MOST)
    slot = np.cumsum(kept, axis=1) - 1
    row, at = np.nonzero(kept)
    return index[row, at], row, slot[row, at]


def _fit_columns(
    one: _Candidates, cost: FloatArray, slot: IntArray, exists: BoolArray
) -> list[FloatArray]:
    """How well each path fits, alone and beside the agent's others."""
    least, nearest = np.full(len(exists), np.inf), np.full(len(exists), np.inf)
    np.minimum.at(least, one.agent, cost)
    np.minimum.at(nearest, one.agent, np.abs(one.offset))
    return [
        np.ones(slot.size),
        one.offset / 2.0,
        np.abs(one.offset) / 2.0,
        (np.abs(one.offset) - nearest[one.agent]) / 2.0,
        np.sin(one.turned) * 3.0,
        np.sin(np.abs(one.turned)) * 3.0,
        np.minimum(cost, 30.0) / 10.0,
        np.minimum(cost - least[one.agent], 30.0) / 10.0,
        slot / 3.0,
        exists.sum(axis=1)[one.agent] / 3.0,
    ]


def _lane_columns(
    one: _Candidates, steady: _Steady, motion: Motion, graph: LaneGraph, table: PathTable
) -> list[FloatArray]:
    """Where the lanes end, where a junction begins, and which way the path turns."""
    lanes, begins = table.lane[one.path], table.start[one.path]
    known = lanes >= 0
    lengths = graph.length[np.maximum(lanes, 0)]
    last = (np.arange(one.path.size), known.sum(axis=1) - 1)
    end = begins[last] + lengths[last]
    crosses = known & graph.internal[np.maximum(lanes, 0)]
    comes = crosses & (begins + lengths > one.s[:, None])
    until = np.where(comes, begins - one.s[:, None], np.inf).min(axis=1)
    speed = np.maximum(motion.speed[one.agent], 2.0)
    turn = table.turn[one.path]
    return [
        np.minimum((end - one.s) / steady.reach[one.agent], 1.5),
        np.exp(-np.maximum(until, 0.0) / 20.0),
        (until <= 0.0).astype(np.float64),
        np.exp(-np.maximum(until, 0.0) / speed / 2.0),
        *((turn == code).astype(np.float64) for code in range(len(DIRECTIONS))),
        table.probability[one.path],
    ]


def _shape_columns(
    one: _Candidates, steady: _Steady, motion: Motion, own: FloatArray, points: FloatArray
) -> list[FloatArray]:
    """How the path bends, and how far from the base it leads."""
    speed, row = motion.speed[one.agent], np.arange(one.agent.size)
    spacing = steady.reach[one.agent] / (POINTS - 1)
    step = np.diff(points, axis=1)
    heading = np.arctan2(step[..., 1], step[..., 0])
    gone = np.maximum(steady.gone[one.agent], 1.0)
    at = np.clip((gone / spacing[:, None]).astype(np.int64), 0, POINTS - 2)
    aims = np.take_along_axis(heading, at, axis=1)
    bend = np.diff(np.unwrap(heading, axis=1), axis=1) / np.maximum(spacing, 0.2)[:, None]
    sharpest = np.abs(bend).argmax(axis=1)
    most = bend[row, sharpest]
    scale = scale_of(speed)[:, None, None] * np.asarray(KNOTS_S)[:, None] / 4.0
    aside = (own - steady.xy[one.agent][:, _AT]) / scale
    return [
        np.abs(most) * 10.0,
        most * 10.0,
        np.exp(-(sharpest + 1) * spacing / 20.0) * np.minimum(np.abs(most) * 10.0, 1.0),
        speed * np.sqrt(np.abs(most)),
        *aside[..., 0].T,
        *aside[..., 1].T,
        np.sin(aims[:, 1]),
        np.sin(aims[:, 3]),
        np.sin(aims[:, 4]),
        np.cos(aims[:, 4]),
    ]


def _leader_columns(
    history: Tracks, motion: Motion, one: _Candidates, points: FloatArray, spacing: FloatArray
) -> list[FloatArray]:
    """Whether somebody is ahead on the path, how far, and how fast the gap closes."""
    n, m = history.ids.size, one.agent.size
    if n < 2:
        return [np.zeros(m)] * 5
    nearest = np.asarray(cKDTree(motion.xy).query(motion.xy, k=min(LOOKED_AT + 1, n))[1])
    others = nearest[one.agent, 1:]
    place = _own_frame(motion, one.agent, motion.xy[others])
    apart = np.linalg.norm(place[:, :, None] - points[:, None], axis=-1)
    at = apart.argmin(axis=2)
    aside = np.take_along_axis(apart, at[..., None], axis=2)[..., 0]
    wide = np.hypot(ON_PATH_M, spacing[:, None] / 2)
    on = (aside < wide) & (at > 0) & (history.kind[others] != PEDESTRIAN)
    half = (history.length[one.agent][:, None] + history.length[others]) / 2
    gap = np.where(on, np.maximum(spacing[:, None] * at - half, 0.0), np.inf)
    row, first = np.arange(m), gap.argmin(axis=1)
    there = np.isfinite(gap[row, first])
    who, gap = others[row, first], np.where(there, gap[row, first], 0.0)
    same_way = np.cos(motion.heading[who] - motion.heading[one.agent])
    speed = motion.speed[one.agent]
    closing = speed - motion.speed[who] * np.where(same_way > 0.0, 1.0, same_way)
    columns = [
        np.ones(m),
        np.exp(-gap / 30.0),
        np.exp(-gap / np.maximum(speed, 2.0) / 2.0),
        closing / 5.0,
        np.clip(closing / (gap + 2.0), -1.5, 1.5),
    ]
    return [np.where(there, column, 0.0) for column in columns]
