"""Observables of traffic, from positions, headings and speeds on a known road.

They give each agent's lane, leader and gap, limit, and the signal, stop line or crossing ahead
with its pedestrians. One function serves a single frame and the many instants of an episode. The
trait detectors read them together with the rules of the road.

Leaders are looked for along the lane and onward over the junctions. Where a lane branches the
straightest way is followed, because a frame does not give a driver's destination. Gaps are bumper
to bumper. Vehicles on a junction's other paths are not leaders.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from behaviors.traits import DetectorInputs
from sim.frames import (
    PEDESTRIAN,
    BoolArray,
    CodeArray,
    FloatArray,
    Frame,
    IntArray,
    Signal,
    Tracks,
    says_stop,
)
from sim.road import Road, lane_search
from sim.road.lane_graph import LaneGraph

CROSSING_MARGIN_M: Final = 2.0
"""A pedestrian this close beside a crossing or its end counts as near it (one stride and the width
of the kerb)."""


@dataclass(frozen=True, slots=True)
class Observables:
    """Observables of n agents of a `Frame`, or of the n rows of `Tracks`.

    Distances are +inf and indices -1 where there is nothing; for pedestrians everything is.

    Attributes:
        lane: (n,) index into ``Road.lanes`` of the lane within whose width the agent's centre is.
        s: (n,) distance along the lane, m.
        offset: (n,) signed distance to the left of the lane's centre line, m.
        lane_heading: (n,) heading relative to the lane's, rad in (-pi, pi]; near pi: the wrong way.
        limit: (n,) speed limit, m/s; NaN where unknown.
        leader: (n,) row of the vehicle ahead.
        gap: (n,) bumper to bumper to the leader, m; negative when boxes overlap.
        closing: (n,) own speed minus the leader's, m/s; 0 without leader.
        follower: (n,) row of the nearest vehicle that has this one as its leader.
        stop_distance: (n,) front bumper to the next junction entry, m; negative when inside one.
        signal: (n,) code into ``SIGNALS`` of the signal there; ``OFF`` if none.
        crossing_distance: (n,) front bumper to the near edge of the next crossing, m.
        crossing_occupied: (n,) whether a pedestrian is on that crossing.
        crossing_waiting: (n,) whether one stands within reach of either end of it.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray
    lane_heading: FloatArray
    limit: FloatArray
    leader: IntArray
    gap: FloatArray
    closing: FloatArray
    follower: IntArray
    stop_distance: FloatArray
    signal: CodeArray
    crossing_distance: FloatArray
    crossing_occupied: BoolArray
    crossing_waiting: BoolArray


def observe(traffic: Frame | Tracks, road: Road) -> Observables:
    """Everything `Observables` lists, for one frame or a whole episode.

    Args:
        traffic: a frame, or an episode or a recording.
        road: where it happens.

    Returns:
        Arrays in the order of the frame's agents, or of the rows; so are the indices in them.

    Examples:
        >>> from pathlib import Path
        >>> from sim.road import Lane
        >>> lane = Lane("a", "e", 0, np.array([[0.0, 0.0], [100.0, 0.0]]), 3.2, 10.0)
        >>> road = Road("line", (lane,), (), (), (), Path("none"))
        >>> frame = Frame(
        ...     time_s=0.0, ids=[0, 1], xy=[[10.0, 0.0], [34.0, 0.0]], heading=[0.0, 0.0],
        ...     speed=[10.0, 5.0], length=[4.0, 4.0], width=[2.0, 2.0], kind=[0, 0])
        >>> seen = observe(frame, road)
        >>> seen.leader.tolist(), seen.gap.tolist(), seen.closing[0].item()
        ([1, -1], [20.0, inf], 5.0)
    """
    if isinstance(traffic, Frame):
        n = len(traffic)
        return _observe(
            road, traffic.xy, traffic.heading, traffic.speed, traffic.length,
            traffic.kind == PEDESTRIAN, traffic.signals[:, None],
            np.zeros(n, np.int64), np.arange(n), np.array([0, n]),
        )  # fmt: skip
    row_index, whole = traffic.index, dict[str, Any]()
    for rows, first, begins in row_index.time_blocks():
        agent, end = row_index.agent[rows], first + begins.size - 1
        part = _observe(
            road, traffic.row_xy[rows], traffic.row_heading[rows], traffic.row_speed[rows],
            traffic.length[agent], (traffic.kind == PEDESTRIAN)[agent],
            traffic.signals[:, first:end], row_index.step[rows] - first, np.arange(rows.size),
            begins,
        )  # fmt: skip
        for name in (field.name for field in fields(Observables)):
            values = getattr(part, name)
            if name in ("leader", "follower"):
                there = values >= 0
                values[there] = rows[values[there]]
            if name not in whole:
                whole[name] = np.empty(row_index.agent.size, values.dtype)
            whole[name][rows] = values
    return Observables(**whole)


def _crossing_people(
    road: Road, instant: IntArray, xy: FloatArray, instants: int
) -> tuple[BoolArray, BoolArray]:
    """(C, instants) crossings with a pedestrian on them, or within `CROSSING_MARGIN_M` of an end.

    The (p,) pedestrians seen are each at one instant and (p, 2) place, m.
    """
    occupied = np.zeros((len(road.crossings), instants), dtype=bool)
    waiting = np.zeros_like(occupied)
    for c, crossing in enumerate(road.crossings):
        u, across, total = lane_search.along(crossing.centerline, xy)
        beside = np.abs(across) <= crossing.width_m / 2 + CROSSING_MARGIN_M
        on = beside & (u > 0) & (u < total)
        near = beside & ~on & (u > -CROSSING_MARGIN_M) & (u < total + CROSSING_MARGIN_M)
        occupied[c, instant[on]] = True
        waiting[c, instant[near]] = True
    return occupied, waiting


def _observe(
    road: Road, xy: FloatArray, heading: FloatArray, speed: FloatArray, length: FloatArray,
    walking: BoolArray, signals: CodeArray, instant: IntArray, by_time: IntArray, begins: IntArray,
) -> Observables:  # fmt: skip
    """Observables of m rows of T instants."""
    graph = LaneGraph.of(road)
    m = speed.size
    xy, heading, length = xy.copy(), heading.copy(), length.copy()  # kernels compile once for these
    place = graph.project(xy, heading)
    view = lane_search.perceive(
        xy, heading, length, ~walking, place.lane, place.s, place.offset, by_time, begins, graph
    )
    on_road, leader = view.lane >= 0, view.leader
    has = leader >= 0
    closing = np.zeros(m)
    closing[has] = speed[has] - speed[leader[has]]

    signal = np.full(m, Signal.OFF.code, dtype=np.int8)
    group, crossing = view.signal_group, view.crossing
    lit = np.flatnonzero((group >= 0) & (group < signals.shape[0]))
    signal[lit] = signals[group[lit], instant[lit]]

    occupied, waiting = _crossing_people(road, instant[walking], xy[walking], signals.shape[1])
    meets = crossing >= 0
    is_occupied, is_waiting = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
    is_occupied[meets] = occupied[crossing[meets], instant[meets]]
    is_waiting[meets] = waiting[crossing[meets], instant[meets]]
    return Observables(
        lane=view.lane,
        s=np.where(on_road, place.s, np.nan),
        offset=np.where(on_road, place.offset, np.nan),
        lane_heading=np.where(on_road, view.lane_heading, np.nan),
        limit=np.where(on_road, graph.limit[place.lane], np.nan),
        leader=leader,
        gap=view.gap,
        closing=closing,
        follower=view.follower,
        stop_distance=view.stop_distance,
        signal=signal,
        crossing_distance=view.crossing_distance,
        crossing_occupied=is_occupied,
        crossing_waiting=is_waiting,
    )


def detector_inputs(
    tracks: Tracks, road: Road, observed: Observables | None = None
) -> DetectorInputs:
    """Inputs of the trait detectors, without the rules that applied (`sim.episode.annotate`).

    ``observed`` are the observables of ``tracks``, if the caller has them.
    """
    observed = observe(tracks, road) if observed is None else observed
    edges = {edge: i for i, edge in enumerate(dict.fromkeys(lane.edge for lane in road.lanes))}
    edge_of = np.array([*(edges[lane.edge] for lane in road.lanes), -1], dtype=np.int64)
    width_of = np.append(LaneGraph.of(road).width, np.inf)
    lane = observed.lane
    known = lane >= 0
    held = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        at = road.lane_index[link.from_lane]
        held[at] |= link.must_stop or (link.must_yield and link.signal < 0)
    off_crossing, on_red = _jaywalkers(tracks, road)
    return DetectorInputs(
        row_index=tracks.index,
        time_s=tracks.time_s,
        drives=np.asarray(tracks.kind != PEDESTRIAN),
        length=tracks.length,
        width=tracks.width,
        speed=tracks.row_speed,
        limit=np.where(np.isnan(observed.limit), np.inf, observed.limit),
        edge=edge_of[lane],
        lane=lane,
        offset=np.where(known, observed.offset, 0.0),
        lane_width=width_of[lane],
        lane_heading=np.where(known, observed.lane_heading, 0.0),
        leader=observed.leader,
        follower=observed.follower,
        gap=observed.gap,
        closing=observed.closing,
        stop_distance=observed.stop_distance,
        stop_ahead=says_stop(observed.signal) | held[lane],
        crossing_distance=observed.crossing_distance,
        crossing_used=observed.crossing_occupied | observed.crossing_waiting,
        off_crossing=off_crossing,
        on_red=on_red,
    )


def _jaywalkers(tracks: Tracks, road: Road) -> tuple[BoolArray, BoolArray]:
    """(m,) rows of pedestrians on the carriageway off any crossing, and on one entered on red."""
    row_index = tracks.index
    off, on_red = np.zeros((2, tracks.row_speed.size), dtype=bool)
    rows = np.flatnonzero(tracks.walking)
    if not rows.size:
        return off, on_red
    xy = tracks.row_xy[rows]
    graph = LaneGraph.of(road)
    place = graph.project(xy, tracks.row_heading[rows])
    on_road = np.abs(place.offset) < graph.width[place.lane] / 2
    on_road &= ~graph.internal[place.lane]
    for crossing in road.crossings:
        u, across, total = lane_search.along(crossing.centerline, xy)
        near = (np.abs(across) <= crossing.width_m / 2 + 1.0) & (u > -2.0) & (u < total + 2.0)
        on_road &= ~near
        if not 0 <= crossing.signal < tracks.signals.shape[0]:  # recordings show no signals
            continue
        inside = np.zeros_like(off)
        inside[rows] = near & (u > 0.3) & (u < total - 0.3)
        for run in row_index.runs(inside):
            entered = int(row_index.step[run.start])
            # the entry of pedestrians present in the first frame is unknown
            if entered > 0 and tracks.signals[crossing.signal, entered] == Signal.RED.code:
                on_red[run] = True
    off[rows[on_road]] = True
    return off, on_red
