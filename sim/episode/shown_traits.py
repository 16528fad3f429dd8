"""The traits that agents showed: `behaviors.traits` on `TrajectoryRows`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from behaviors.traits import Exhibit, RuleEncounter, Seen, detect
from sim.episode.observables import Observables, observe
from sim.episode.rows import TrajectoryRows
from sim.frames import PEDESTRIAN, BoolArray, Event, EventKind, IntArray, Signal, says_stop
from sim.road import Road
from sim.road.lane_graph import LaneGraph, project
from sim.road.lane_search import along

RULES = {
    EventKind.RED_RUN: False,
    EventKind.STOP_ROLLED: False,
    EventKind.NOT_YIELDED: False,
    EventKind.WRONG_WAY: False,
    EventKind.STOPPED: True,
    EventKind.YIELDED: True,
}
"""Events that are rules met, and whether they were kept."""


def exhibited(ids: IntArray, seen: Seen) -> tuple[Exhibit, ...]:
    """Every trait that was shown.

    Args:
        ids: (N,) ids of the agents.
        seen: what the detectors look at, with the rules that were met (`met`).

    Returns:
        Exhibits in order of time; their ``agent`` and ``other`` are agent ids (-1: nobody).
    """
    return tuple(
        dataclasses.replace(
            exhibit,
            agent=int(ids[exhibit.agent]),
            other=int(ids[exhibit.other]) if exhibit.other >= 0 else -1,
        )
        for exhibit in detect(seen)
    )


def met(ids: IntArray, seen: Seen, events: Sequence[Event]) -> Seen:
    """What the detectors look at, with the rules that were met.

    Args:
        ids: (N,) ids of the agents.
        seen: what `see` gives.
        events: what `sim.episode.incidents.incidents` found in it.
    """
    rows = {int(i): row for row, i in enumerate(ids)}
    encounters = tuple(
        RuleEncounter(rows[e.agent], e.time_s, RULES[e.kind])
        for e in events
        if e.kind in RULES and e.agent in rows
    )
    return dataclasses.replace(seen, encounters=encounters)


def see(steps: TrajectoryRows, road: Road, observed: Observables | None = None) -> Seen:
    """What the detectors look at, before anything is known of the rules that were met.

    Args:
        steps: an episode or a recording.
        road: where it happened.
        observed: its observables, if they are at hand.

    Returns:
        Arrays with the rows of ``steps``.
    """
    observed = observe(steps, road) if observed is None else observed
    graph = LaneGraph.of(road)
    edges = {edge: i for i, edge in enumerate(dict.fromkeys(lane.edge for lane in road.lanes))}
    edge_of = np.array([*(edges[lane.edge] for lane in road.lanes), -1], dtype=np.int64)
    width_of = np.append(graph.width, np.inf)
    lane = observed.lane
    known = lane >= 0
    held = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        at = road.lane_index[link.from_lane]
        held[at] |= link.must_stop or (link.must_yield and link.signal < 0)
    off_crossing, on_red = _walkers(steps, road)
    return Seen(
        row_index=steps.row_index,
        time_s=steps.time_s,
        drives=np.asarray(steps.kind != PEDESTRIAN),
        length=steps.length,
        width=steps.width,
        speed=steps.speed,
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


def _walkers(steps: TrajectoryRows, road: Road) -> tuple[BoolArray, BoolArray]:
    """(m,) who walks on the carriageway off any crossing, and on one entered on red."""
    row_index = steps.row_index
    off, on_red = np.zeros(steps.speed.size, dtype=bool), np.zeros(steps.speed.size, dtype=bool)
    rows = np.flatnonzero(steps.walking)
    if not rows.size:
        return off, on_red
    xy = steps.xy[rows]
    place = project(road, xy, steps.heading[rows])
    width = np.array([lane.width_m for lane in road.lanes])
    internal = np.array([lane.internal for lane in road.lanes])
    on_road = (np.abs(place.offset) < width[place.lane] / 2) & ~internal[place.lane]
    for crossing in road.crossings:
        u, across, total = along(crossing.centerline, xy)
        near = (np.abs(across) <= crossing.width_m / 2 + 1.0) & (u > -2.0) & (u < total + 2.0)
        on_road &= ~near
        if crossing.signal < 0:
            continue
        inside = np.zeros(steps.speed.size, dtype=bool)
        inside[rows] = near & (u > 0.3) & (u < total - 0.3)
        for run in row_index.runs(inside):
            entered = int(row_index.step[run.start])
            # who is there from the first frame on was not seen to enter
            if entered > 0 and steps.signals[crossing.signal, entered] == Signal.RED.code:
                on_red[run] = True
    off[rows[on_road]] = True
    return off, on_red
