"""The map of a Waymo Open Motion scenario as a `Road`.

Lanes have centre lines, limits, neighbours and successors, but no widths: where a neighbour is
known, its distance is the width. Lights are those that the recording car saw.

References:
    ``map.proto`` of the Waymo open dataset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.road import MAX_COORDINATE_M, Crossing, Road
from sim.road.maps.lanelets import Lanelet, Lanelets, road_of_lanelets

WIDTH_M: Final = 3.5
"""Width of a lane without a neighbour, m (urban lanes have 3.3, freeways 3.7)."""

NARROWEST_M, WIDEST_M = 2.5, 5.0
"""Widths that the distance to a neighbour may give, m."""

MOST_WAYS: Final = 16
"""Most lanes that may begin where one ends."""

JOIN_M: Final = 0.5
"""Lanes whose ends are this close follow each other where the map does not say it, m (the distance
of its points)."""


def waymo_road(
    path: Path,
    name: str,
    lanes: Sequence[Lanelet],
    crosswalks: Mapping[str, FloatArray],
    lights: Sequence[int],
) -> Road | None:
    """The road of a scenario, None without a lane for cars.

    Lanes may have NaN for an unknown width; those that are not for cars are for bicycles.
    Crosswalks are (P, 2) outlines, m, by id. Lights are the ids of the lanes whose light was seen;
    each is a signal group.

    Raises:
        InputError: if an id is twice, or the map is larger than any.
    """
    if len({lane.id for lane in lanes}) != len(lanes):
        raise InputError(f"{path}: map_features: found an id twice, expected each once")
    named = {lane.id: lane for lane in lanes if len(lane.centerline) >= 2}
    if not any(lane.cars for lane in named.values()):
        return None
    found = dict(named)
    for lane in named.values():  # neighbours that only one of the two names
        for mine, its in (("left", "right"), ("right", "left")):
            other = named.get(getattr(lane, mine))
            if other is not None and getattr(other, its) is None:
                change: dict[str, Any] = {its: lane.id}
                found[other.id] = replace(found[other.id], **change)
    bare = not any(lane.successors or lane.predecessors for lane in named.values())
    signal = {lane: group for group, lane in enumerate(lights)}
    found = {
        i: replace(
            lane,
            centerline=frozen(np.array(lane.centerline, dtype=np.float64)),
            width_m=_width(lane, found),
            successors=_onward(lane, named) if bare else lane.successors,
            use="" if lane.cars else "bicycles",
            signal=signal.get(i, -1),
        )
        for i, lane in sorted(found.items())
    }
    return road_of_lanelets(
        path,
        name,
        found,
        [_crossing(path, label, line) for label, line in crosswalks.items()],
        find_junctions=bare,
        signal_groups=tuple(map(str, lights)),
    )


def _onward(lane: Lanelet, lanes: Lanelets) -> tuple[int, ...]:
    """The lanes that begin where one ends."""
    begins = np.array([other.centerline[0] for other in lanes.values()])
    near = np.hypot(*(begins - lane.centerline[-1]).T) <= JOIN_M
    return tuple(j for j in np.array(list(lanes))[near][:MOST_WAYS].tolist() if j != lane.id)


def _width(lane: Lanelet, lanes: Lanelets) -> float:
    """Width by the map, by the distance to a neighbour's line, or the usual width, m."""
    if math.isfinite(lane.width_m):
        return lane.width_m
    few = lane.centerline[:: max(len(lane.centerline) // 8, 1)]
    for beside in (lane.left, lane.right):
        if beside is not None and beside in lanes:
            apart = few[:, None] - lanes[beside].centerline[None, ::2]
            width = float(np.median(np.hypot(*np.moveaxis(apart, -1, 0)).min(axis=1)))
            if NARROWEST_M <= width <= WIDEST_M:
                return width
    return WIDTH_M


def _crossing(path: Path, label: str, outline: FloatArray) -> Crossing:
    """A crosswalk's middle line along its longer side, and its width."""
    if len(outline) < 3 or not (np.abs(outline) <= MAX_COORDINATE_M).all():
        raise InputError(f"{path}: crosswalk {label}: found {len(outline)} points, expected 3")
    middle = outline.mean(axis=0)
    _, _, axes = np.linalg.svd(outline - middle, full_matrices=False)
    along, across = ((outline - middle) @ axis for axis in axes)
    ends = np.array([along.min(), along.max()])
    line = frozen(middle + ends[:, None] * axes[0])
    return Crossing(label, line, float(np.ptp(across)), (), priority=False)
