"""The traits that agents of an episode or recording showed: `behaviors.traits` on `Tracks`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from behaviors.traits import Exhibit, RuleEncounter, Seen, detect
from sim.frames import PEDESTRIAN, BoolArray, Event, EventKind, Signal, Tracks
from sim.lane_graph import LaneGraph, project
from sim.observables import Observables, along, observe
from sim.road import Road

RULES = {
    EventKind.RED_RUN: False,
    EventKind.STOP_ROLLED: False,
    EventKind.NOT_YIELDED: False,
    EventKind.WRONG_WAY: False,
    EventKind.STOPPED: True,
    EventKind.YIELDED: True,
}
"""Events that are rules met, and whether they were kept."""


def exhibited(tracks: Tracks, seen: Seen) -> tuple[Exhibit, ...]:
    """Every trait that was shown.

    Args:
        tracks: an episode or a recording.
        seen: what the detectors look at, with the rules that were met (`met`).

    Returns:
        Exhibits in order of time; their ``agent`` and ``other`` are agent ids (-1: nobody).
    """
    return tuple(
        dataclasses.replace(
            exhibit,
            agent=int(tracks.ids[exhibit.agent]),
            other=int(tracks.ids[exhibit.other]) if exhibit.other >= 0 else -1,
        )
        for exhibit in detect(seen)
    )


def met(tracks: Tracks, seen: Seen, events: Sequence[Event]) -> Seen:
    """What the detectors look at, with the rules that were met.

    Args:
        tracks: an episode or a recording.
        seen: what `see` gives.
        events: what `sim.incidents.incidents` found in it.
    """
    rows = {int(i): row for row, i in enumerate(tracks.ids)}
    encounters = tuple(
        RuleEncounter(rows[e.agent], e.time_s, RULES[e.kind])
        for e in events
        if e.kind in RULES and e.agent in rows
    )
    return dataclasses.replace(seen, encounters=encounters)


def see(tracks: Tracks, road: Road, observed: Observables | None = None) -> Seen:
    """What the detectors look at, before anything is known of the rules that were met.

    Args:
        tracks: an episode or a recording.
        road: where it happened.
        observed: its observables, if they are at hand.

    Returns:
        Arrays with the rows of ``tracks``.
    """
    observed = observe(tracks, road) if observed is None else observed
    graph = LaneGraph.of(road)
    edges = {edge: i for i, edge in enumerate(dict.fromkeys(lane.edge for lane in road.lanes))}
    edge_of = np.array([edges[lane.edge] for lane in road.lanes], dtype=np.int64)
    lane = observed.lane
    known = lane >= 0
    held = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        at = road.lane_index[link.from_lane]
        held[at] |= link.must_stop or (link.must_yield and link.signal < 0)
    red = (observed.signal == Signal.RED.code) | (observed.signal == Signal.YELLOW.code)
    off_crossing, on_red = _walkers(tracks, road)
    return Seen(
        time_s=tracks.time_s,
        valid=tracks.valid,
        drives=np.asarray(tracks.kind != PEDESTRIAN),
        length=tracks.length,
        width=tracks.width,
        speed=np.where(tracks.valid, tracks.speed, 0.0),
        limit=np.where(known, observed.limit, np.inf),
        edge=np.where(known, edge_of[np.maximum(lane, 0)], -1),
        lane=lane,
        offset=np.where(known, observed.offset, 0.0),
        lane_width=np.where(known, graph.width[np.maximum(lane, 0)], np.inf),
        lane_heading=np.where(known, observed.lane_heading, 0.0),
        leader=observed.leader,
        follower=observed.follower,
        gap=observed.gap,
        closing=observed.closing,
        stop_distance=observed.stop_distance,
        stop_ahead=red | held[lane],
        crossing_distance=observed.crossing_distance,
        crossing_used=observed.crossing_occupied | observed.crossing_waiting,
        off_crossing=off_crossing,
        on_red=on_red,
    )


def _walkers(tracks: Tracks, road: Road) -> tuple[BoolArray, BoolArray]:
    """(N, T) who walks on the carriageway off any crossing, and on one entered on red."""
    off, on_red = np.zeros(tracks.valid.shape, dtype=bool), np.zeros(tracks.valid.shape, dtype=bool)
    walkers = np.flatnonzero(tracks.kind == PEDESTRIAN)
    row, column = np.nonzero(tracks.valid[walkers])
    if not row.size:
        return off, on_red
    agent = walkers[row]
    xy, heading = tracks.xy[agent, column], tracks.heading[agent, column]
    place = project(road, xy, heading)
    width = np.array([lane.width_m for lane in road.lanes])
    internal = np.array([lane.internal for lane in road.lanes])
    on_road = (np.abs(place.offset) < width[place.lane] / 2) & ~internal[place.lane]
    for crossing in road.crossings:
        u, across, total = along(crossing.centerline, xy)
        near = (np.abs(across) <= crossing.width_m / 2 + 1.0) & (u > -2.0) & (u < total + 2.0)
        on_road &= ~near
        if crossing.signal < 0:
            continue
        inside = near & (u > 0.3) & (u < total - 0.3)
        flags = np.zeros((walkers.size, tracks.time_s.size), dtype=bool)
        flags[row[inside], column[inside]] = True
        entered = np.zeros_like(flags)
        entered[:, 1:] = flags[:, 1:] & ~flags[:, :-1]
        for i, begin in zip(*np.nonzero(entered), strict=True):
            if tracks.signals[crossing.signal, begin] == Signal.RED.code:
                rest = flags[i, begin:]
                end = begin + (int(np.argmin(rest)) if not rest.all() else rest.size)
                on_red[walkers[i], begin:end] = True
    off[agent[on_road], column[on_road]] = True
    return off, on_red
