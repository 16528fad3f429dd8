"""The map of a Waymo Open Motion scenario as a `Road`.

Lanes have centre lines, limits (miles per hour), neighbours and successors, but no widths: where a
neighbour is known, its distance is the width. Lights are those that the recording car saw.

References:
    ``map.proto`` of the Waymo open dataset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.road import Crossing, Road
from sim.road.checks import MAX_COORDINATE_M
from sim.road.maps.lanelets import Lanelet, road_of_lanelets
from sim.units import FACTORS

MPS_PER_MPH: Final = FACTORS["mph"]

WIDTH_M: Final = 3.5
"""Width of a lane without a neighbour, m (urban lanes have 3.3, freeways 3.7)."""

NARROWEST_M, WIDEST_M = 2.5, 5.0
"""Widths that the distance to a neighbour may give, m."""

MOST_MPH: Final = 200.0
"""Highest limit, miles per hour."""

MOST_WAYS: Final = 16
"""Most lanes that may begin where one ends."""

BIKE_LANE: Final = 3
"""The type of lanes for bicycles."""

JOIN_M: Final = 0.5
"""Lanes whose ends are this close follow each other where the map does not say it, m (the distance
of its points)."""


@dataclass(frozen=True, eq=False)
class WaymoLane:
    """A lane of the map.

    Attributes:
        id: its number.
        line: (P, 2) points in driving direction, m.
        limit_mph: miles per hour; NaN or 0 where unknown.
        type: 0 unknown, 1 freeway, 2 surface street, 3 bicycles.
        interpolating: whether it joins two others, as the ways across junctions do; None where
            the map does not say it.
        before, after: ids of the lanes that it is entered from, and leads to.
        left, right: id of the lane beside it on either side, of its direction; None without one.
        stops: whether a stop sign controls it.
        width_m: m; NaN where the map does not say it.
    """

    id: int
    line: FloatArray
    limit_mph: float = math.nan
    type: int = 0
    interpolating: bool | None = None
    before: tuple[int, ...] = ()
    after: tuple[int, ...] = ()
    left: int | None = None
    right: int | None = None
    stops: bool = False
    width_m: float = math.nan


def waymo_road(
    path: Path,
    name: str,
    lanes: Sequence[WaymoLane],
    crosswalks: Mapping[str, FloatArray],
    lights: Sequence[int],
) -> Road | None:
    """The road of a scenario, None without a lane for cars.

    Crosswalks are (P, 2) outlines, m, by id. Lights are the ids of the lanes whose light was seen;
    each is a signal group.

    Raises:
        InputError: if an id is twice, or the map is larger than any.
    """
    if len({lane.id for lane in lanes}) != len(lanes):
        raise InputError(f"{path}: map_features: found an id twice, expected each once")
    named = {lane.id: lane for lane in lanes if len(lane.line) >= 2}
    by_id = dict(named)
    for lane in named.values():  # neighbours that only one of the two names
        for mine, its in (("left", "right"), ("right", "left")):
            other = named.get(getattr(lane, mine))
            if other is not None and getattr(other, its) is None:
                change: dict[str, Any] = {its: lane.id}
                by_id[other.id] = replace(by_id[other.id], **change)
    if all(lane.type == BIKE_LANE for lane in by_id.values()):
        return None
    signal = {lane: group for group, lane in enumerate(lights)}
    following = _following(by_id)
    found = {
        i: Lanelet(
            id=i,
            centerline=frozen(np.array(lane.line, dtype=np.float64)),
            width_m=_width(lane, by_id),
            successors=following[i],
            internal=bool(lane.interpolating),
            left=lane.left,
            right=lane.right,
            use="bicycles" if lane.type == BIKE_LANE else "",
            limit_mps=_limit(path, lane),
            cars=lane.type != BIKE_LANE,
            signal=signal.get(i, -1),
            must_stop=lane.stops,
        )
        for i, lane in sorted(by_id.items())
    }
    return road_of_lanelets(
        path,
        name,
        found,
        [_crossing(path, label, line) for label, line in crosswalks.items()],
        find_junctions=all(lane.interpolating is None for lane in by_id.values()),
        signal_groups=tuple(map(str, lights)),
    )


def _limit(path: Path, lane: WaymoLane) -> float:
    if math.isnan(lane.limit_mph) or lane.limit_mph == 0:
        return math.nan
    if not 0 < lane.limit_mph <= MOST_MPH:
        found = f"found speed limit {lane.limit_mph:g} mph, expected up to {MOST_MPH:g}"
        raise InputError(f"{path}: lane {lane.id}: {found}")
    return lane.limit_mph * MPS_PER_MPH


def _following(lanes: Mapping[int, WaymoLane]) -> dict[int, tuple[int, ...]]:
    """The lanes after each: as the map says, or those that begin where it ends."""
    after = {i: list(lane.after) for i, lane in lanes.items()}
    for i, lane in lanes.items():
        for j in lane.before:
            if j in after:
                after[j].append(i)
    if not any(after.values()):
        ids = np.array(list(lanes))
        begins = np.array([lane.line[0] for lane in lanes.values()])
        for i, lane in lanes.items():
            near = np.hypot(*(begins - lane.line[-1]).T) <= JOIN_M
            after[i] = [j for j in ids[near][:MOST_WAYS].tolist() if j != i]
    return {i: tuple(j for j in dict.fromkeys(ways) if j in lanes) for i, ways in after.items()}


def _width(lane: WaymoLane, lanes: Mapping[int, WaymoLane]) -> float:
    """Width by the map, by the distance to a neighbour's line, or the usual width, m."""
    if math.isfinite(lane.width_m):
        return lane.width_m
    few = lane.line[:: max(len(lane.line) // 8, 1)]
    for beside in (lane.left, lane.right):
        if beside is not None and beside in lanes:
            apart = few[:, None] - lanes[beside].line[None, ::2]
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
