"""Inputs of the trait detectors: an episode's observables and the rules of the road."""

from __future__ import annotations

import numpy as np

from behaviors.traits import DetectorInputs
from sim.episode.observables import Observables, observe
from sim.frames import PEDESTRIAN, BoolArray, Signal, Tracks, says_stop
from sim.road import Road
from sim.road.lane_coordinates import along
from sim.road.lane_graph import LaneGraph


def detector_inputs(
    tracks: Tracks, road: Road, observed: Observables | None = None
) -> DetectorInputs:
    """Inputs of the detectors without the rules that applied, which `annotate` adds.

    Args:
        tracks: an episode or a recording.
        road: where it happened.
        observed: the observables of ``tracks``, if the caller has them.
    """
    observed = observe(tracks, road) if observed is None else observed
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
    place = LaneGraph.of(road).project(xy, tracks.row_heading[rows])
    width = np.array([lane.width_m for lane in road.lanes])
    internal = np.array([lane.internal for lane in road.lanes])
    on_road = (np.abs(place.offset) < width[place.lane] / 2) & ~internal[place.lane]
    for crossing in road.crossings:
        u, across, total = along(crossing.centerline, xy)
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
