"""What can be seen of the traffic from positions, headings and speeds on a known road.

Who is on which lane, who follows whom and how closely, what limit holds, which signal, stop line
or crossing lies ahead and whether someone walks there. One function serves a single frame and a
whole recording: every instant is worked on at once.

Leaders are looked for along the lane and onward over the junctions. Where a lane goes on in
several ways the straightest one is followed, because a frame does not say where a driver wants to
go; gaps are bumper to bumper. Vehicles on a junction's other paths are not leaders.

References:
    Surrogate safety measures: Hayward (1972), "Near miss determination through use of a scale of
    danger" (time to collision).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim import lane_search
from sim.frames import PEDESTRIAN, BoolArray, CodeArray, FloatArray, Frame, IntArray, Signal, Tracks
from sim.lane_graph import LaneGraph, project
from sim.road import Road

LOOK_AHEAD_M: Final = 200.0
"""Leaders, signals and crossings farther than this are not seen (our choice: 14 s at 14 m/s)."""

MAX_LANES_AHEAD: Final = 8
"""How many lanes onward are searched at most: junction paths are short (our choice)."""

MIN_SPEED_MPS: Final = 0.1
"""Below this a headway in seconds means nothing; it is infinite (our choice)."""

CROSSING_MARGIN_M: Final = 2.0
"""A pedestrian this close beside a crossing or its end counts as near it (our choice: one stride
and the width of the kerb)."""


@dataclass(frozen=True, slots=True)
class Observables:
    """What is seen of each agent; all arrays share the shape of the agents' speeds.

    For a `Frame` that shape is (n,), for `Tracks` (N, T). Distances are +inf and indices -1 where
    there is nothing; for pedestrians and unseen agents everything is.

    Attributes:
        on_road: whether the agent drives on a lane (its centre within the lane's width).
        lane: index into ``Road.lanes``.
        s: distance along the lane, m.
        offset: signed distance to the left of the lane's centre line, m.
        lane_heading: heading relative to the lane's, rad in (-pi, pi]; near pi: the wrong way.
        limit: speed limit, m/s.
        leader: row of the vehicle ahead.
        gap: bumper to bumper to the leader, m; negative when boxes overlap.
        closing: own speed minus the leader's, m/s; 0 without leader.
        headway: gap over own speed, s.
        time_to_collision: gap over closing speed, s; +inf when not closing.
        follower: row of the nearest vehicle that has this one as its leader.
        stop_distance: front bumper to the next junction entry, m; negative when inside one.
        signal: code into ``SIGNALS`` of the signal there; ``OFF`` if none.
        crossing: the next crossing on the way, index into ``Road.crossings``.
        crossing_distance: front bumper to the near edge of it, m.
        crossing_occupied: whether a pedestrian is on that crossing.
        crossing_waiting: whether one stands within reach of either end of it.
    """

    on_road: BoolArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray
    lane_heading: FloatArray
    limit: FloatArray
    leader: IntArray
    gap: FloatArray
    closing: FloatArray
    headway: FloatArray
    time_to_collision: FloatArray
    follower: IntArray
    stop_distance: FloatArray
    signal: CodeArray
    crossing: IntArray
    crossing_distance: FloatArray
    crossing_occupied: BoolArray
    crossing_waiting: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class LaneTraffic:
    """Vehicles sorted along their lanes, at one or many instants, ready to be searched.

    Attributes:
        graph: the lanes.
        key: (m,) instant times number of lanes plus lane, of the sorted vehicles.
        s: (m,) their distance along the lane, m.
        row: (m,) their row among those given.
    """

    graph: LaneGraph
    key: IntArray
    s: FloatArray
    row: IntArray

    @classmethod
    def of(cls, graph: LaneGraph, instant: IntArray, lane: IntArray, s: FloatArray) -> LaneTraffic:
        """Sort vehicles; those with lane -1 are left out."""
        keep = np.flatnonzero(lane >= 0)
        key = instant[keep] * graph.length.size + lane[keep]
        order = np.lexsort((s[keep], key))
        return cls(graph, key[order], s[keep][order], keep[order])

    def ahead(
        self, instant: IntArray, lane: IntArray, s: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """The first vehicle strictly ahead of each place, along the lane and straight on.

        Args:
            instant: (q,) instant of each question.
            lane: (q,) lane asked about, -1 for none.
            s: (q,) distance along it, m.

        Returns:
            (q,) row of the vehicle or -1, and (q,) distance between centres, m, or +inf.
        """
        return self._chain(instant, lane, s, forward=True)

    def behind(
        self, instant: IntArray, lane: IntArray, s: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """The last vehicle strictly behind each place; see `ahead`."""
        return self._chain(instant, lane, s, forward=False)

    def _chain(
        self, instant: IntArray, lane: IntArray, s: FloatArray, *, forward: bool
    ) -> tuple[IntArray, FloatArray]:
        onward = self.graph.ahead if forward else self.graph.behind
        return lane_search.nearest(
            self.key, self.s, self.row, self.graph.length, onward, instant, lane,
            s.astype(np.float64), forward, MAX_LANES_AHEAD, LOOK_AHEAD_M,
        )  # fmt: skip


def observe(traffic: Frame | Tracks, road: Road) -> Observables:
    """Everything `Observables` lists, for one frame or a whole recording.

    Args:
        traffic: a frame, or tracks (a history or an episode).
        road: where it happens.

    Returns:
        Arrays of shape (n,) for a frame, (N, T) for tracks; rows as in ``traffic``.

    Examples:
        >>> from pathlib import Path
        >>> from sim.road import Lane
        >>> lane = Lane("a", "e", 0, np.array([[0.0, 0.0], [100.0, 0.0]]), 3.2, 10.0)
        >>> road = Road("line", (lane,), (), (), (), Path("none"))
        >>> frame = Frame(
        ...     time_s=0.0, ids=[0, 1], xy=[[10.0, 0.0], [34.0, 0.0]], heading=[0.0, 0.0],
        ...     speed=[10.0, 5.0], length=[4.0, 4.0], width=[2.0, 2.0], kind=[0, 0])
        >>> seen = observe(frame, road)
        >>> seen.leader.tolist(), seen.gap.tolist(), seen.time_to_collision[0].item()
        ([1, -1], [20.0, inf], 4.0)
    """
    if isinstance(traffic, Frame):
        n = len(traffic)
        every = np.arange(n)
        return _observe(
            road,
            agent=every,
            instant=np.zeros(n, np.int64),
            shape=(n,),
            flat=every,
            xy=traffic.xy,
            heading=traffic.heading,
            speed=traffic.speed,
            length=traffic.length,
            kind=traffic.kind,
            signals=traffic.signals[:, None],
        )
    agent, instant = np.nonzero(traffic.valid)
    return _observe(
        road,
        agent=agent,
        instant=instant,
        shape=traffic.valid.shape,
        flat=agent * traffic.time_s.size + instant,
        xy=traffic.xy[agent, instant],
        heading=traffic.heading[agent, instant],
        speed=traffic.speed[agent, instant],
        length=traffic.length[agent],
        kind=traffic.kind[agent],
        signals=traffic.signals,
    )


def crossing_people(
    road: Road, instant: IntArray, xy: FloatArray, instants: int
) -> tuple[BoolArray, BoolArray]:
    """On which crossings someone walks, and beside which someone stands.

    Args:
        road: where it happens.
        instant: (p,) instant of each pedestrian seen.
        xy: (p, 2) where, m.
        instants: how many instants there are.

    Returns:
        (C, instants) occupied, and (C, instants) someone within `CROSSING_MARGIN_M` of an end.
    """
    occupied = np.zeros((len(road.crossings), instants), dtype=bool)
    waiting = np.zeros_like(occupied)
    for c, crossing in enumerate(road.crossings):
        u, across, total = along(crossing.centerline, xy)
        beside = np.abs(across) <= crossing.width_m / 2 + CROSSING_MARGIN_M
        on = beside & (u > 0) & (u < total)
        near = beside & ~on & (u > -CROSSING_MARGIN_M) & (u < total + CROSSING_MARGIN_M)
        occupied[c, instant[on]] = True
        waiting[c, instant[near]] = True
    return occupied, waiting


def along(line: FloatArray, xy: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Places in the coordinates of a line that goes on straight at both ends.

    Args:
        line: (P, 2) points, m.
        xy: (n, 2) places, m.

    Returns:
        (n,) distance along it, m (negative before it, above its length after it), (n,) distance to
        its left, m, and its length, m.

    Examples:
        >>> u, left, total = along(np.array([[0.0, 0.0], [0.0, 8.0]]), np.array([[1.0, 9.0]]))
        >>> u.tolist(), left.tolist(), total
        ([9.0], [-1.0], 8.0)
    """
    step = np.diff(line, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    begin = np.cumsum(size) - size
    unit = step / size[:, None]
    relative = xy[:, None, :] - line[None, :-1]
    forward = (relative * unit[None]).sum(axis=2)
    low = np.where(np.arange(size.size) == 0, -np.inf, 0.0)
    high = np.where(np.arange(size.size) == size.size - 1, np.inf, size)
    clipped = np.clip(forward, low[None], high[None])
    left = unit[None, :, 0] * relative[..., 1] - unit[None, :, 1] * relative[..., 0]
    best = np.argmin(np.hypot(left, forward - clipped), axis=1)
    row = np.arange(len(xy))
    return begin[best] + clipped[row, best], left[row, best], float(size.sum())


def _observe(
    road: Road,
    *,
    agent: IntArray,
    instant: IntArray,
    shape: tuple[int, ...],
    flat: IntArray,
    xy: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    kind: CodeArray,
    signals: CodeArray,
) -> Observables:
    graph = LaneGraph.of(road)
    m = agent.size
    instants = int(signals.shape[1])
    walking = kind == PEDESTRIAN
    place = project(road, xy, heading)
    xy_of_place, facing = graph.position(place.lane, place.s, place.offset)
    lane_heading = np.pi - (np.pi - (heading - facing)) % (2 * np.pi)
    inside = np.abs(place.offset) <= graph.width[place.lane] / 2 + 0.5  # half a metre: our choice
    on_road = ~walking & inside & (np.hypot(*(xy - xy_of_place).T) < 5.0)
    lane = np.where(on_road, place.lane, -1)
    forward = on_road & (np.abs(lane_heading) < np.pi / 2)

    traffic = LaneTraffic.of(graph, instant, lane, place.s)
    leader, distance = traffic.ahead(instant, np.where(forward, lane, -1), place.s)
    has = leader >= 0
    gap = np.full(m, np.inf)
    closing = np.zeros(m)
    gap[has] = distance[has] - (length[has] + length[leader[has]]) / 2
    closing[has] = speed[has] - speed[leader[has]]
    headway = np.full(m, np.inf)
    np.divide(gap, speed, out=headway, where=has & (speed > MIN_SPEED_MPS))
    collision = np.full(m, np.inf)
    np.divide(np.maximum(gap, 0.0), closing, out=collision, where=has & (closing > 1e-6))

    follower = np.full(m, -1)
    followed = np.flatnonzero(has)
    followed = followed[np.argsort(-gap[followed], kind="stable")]  # the nearest is written last
    follower[leader[followed]] = followed

    signal = np.full(m, Signal.OFF.code, dtype=np.int8)
    stop_distance, group, crossing, crossing_distance = lane_search.stops_ahead(
        np.where(forward, lane, -1), place.s + length / 2, graph.length, graph.ahead,
        graph.internal, graph.signal, graph.cross_lane, graph.cross_id, graph.cross_s,
        graph.cross_exit_s, MAX_LANES_AHEAD, LOOK_AHEAD_M,
    )  # fmt: skip
    lit = np.flatnonzero((group >= 0) & (group < signals.shape[0]))
    signal[lit] = signals[group[lit], instant[lit]]

    occupied, waiting = crossing_people(road, instant[walking], xy[walking], instants)
    meets = crossing >= 0
    is_occupied, is_waiting = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
    is_occupied[meets] = occupied[crossing[meets], instant[meets]]
    is_waiting[meets] = waiting[crossing[meets], instant[meets]]

    def spread(values: NDArray[np.generic], empty: float | bool) -> NDArray[np.generic]:
        out = np.full(int(np.prod(shape)), empty, dtype=values.dtype)
        out[flat] = values
        return out.reshape(shape)

    def floats(values: FloatArray, empty: float = np.inf) -> FloatArray:
        return np.asarray(spread(values, empty), dtype=np.float64)

    def rows(values: IntArray) -> IntArray:
        named = np.where(values >= 0, agent[np.maximum(values, 0)], -1)
        return np.asarray(spread(named, -1), dtype=np.int64)

    def flags(values: BoolArray) -> BoolArray:
        return np.asarray(spread(values, False), dtype=np.bool_)

    seen = on_road
    return Observables(
        on_road=flags(on_road),
        lane=np.asarray(spread(lane, -1), dtype=np.int64),
        s=floats(np.where(seen, place.s, np.nan), np.nan),
        offset=floats(np.where(seen, place.offset, np.nan), np.nan),
        lane_heading=floats(np.where(seen, lane_heading, np.nan), np.nan),
        limit=floats(np.where(seen, graph.limit[place.lane], np.nan), np.nan),
        leader=rows(leader),
        gap=floats(gap),
        closing=floats(closing, 0.0),
        headway=floats(headway),
        time_to_collision=floats(collision),
        follower=rows(follower),
        stop_distance=floats(stop_distance),
        signal=np.asarray(spread(signal, Signal.OFF.code), dtype=np.int8),
        crossing=np.asarray(spread(crossing, -1), dtype=np.int64),
        crossing_distance=floats(crossing_distance),
        crossing_occupied=flags(is_occupied),
        crossing_waiting=flags(is_waiting),
    )
