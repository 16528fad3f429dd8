"""The map of an Argoverse 2 scenario, read as a `Road` and written from one.

Lane segments carry a centre line, borders, neighbours and successors; crosswalks two edges. Limits,
signals and priority are not in the format: they are unknown (a limit is NaN, no crossing or way has
priority).

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.geometry import offset_line
from sim.input_files import read_bytes, read_once
from sim.invalid_fields import first_wrong_field
from sim.road import Crossing, Lane, Road
from sim.road.maps.lanelets import Lanelet, between, road_of_lanelets

# --- reading ------------------------------------------------------------------------------------

_Identity = Annotated[int, Field(ge=0, lt=2**63)]


class _Part(BaseModel):
    """A part of a map; what else is in it is not read."""

    model_config = ConfigDict(frozen=True, strict=True, extra="ignore")


class _Point(_Part):
    x: float
    y: float


_Line = Annotated[list[_Point], Field(min_length=2)]


class _Segment(_Part):
    id: _Identity
    is_intersection: bool
    lane_type: str
    centerline: _Line | None = None
    left_lane_boundary: _Line
    right_lane_boundary: _Line
    left_neighbor_id: _Identity | None
    right_neighbor_id: _Identity | None
    successors: list[_Identity]


class _Crosswalk(_Part):
    id: _Identity
    edge1: _Line
    edge2: _Line


class _Archive(_Part):
    lane_segments: dict[str, _Segment]
    pedestrian_crossings: dict[str, _Crosswalk]


@read_once
def read_map(path: Path, name: str | None = None) -> Road | None:
    """Read a map.

    Args:
        path: ``log_map_archive_<id>.json``.
        name: what to call the road; by default the file's name without its ending.

    Returns:
        Its lanes, ways and crossings; lane and crossing ids are those of the file. None for a map
        without lane segments.

    Raises:
        InputError: if the file is missing or no such map; names the place in it.
    """
    try:
        archive = _Archive.model_validate_json(read_bytes(path))
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None
    segments = _by_id(path, archive.lane_segments)
    _by_id(path, archive.pedestrian_crossings)
    if not segments:
        return None
    lanelets = {i: _lanelet(segment) for i, segment in segments.items()}
    crossings = [_crossing(c) for c in archive.pedestrian_crossings.values()]
    return road_of_lanelets(path, path.stem if name is None else name, lanelets, crossings)


def _by_id(path: Path, parts: Mapping[str, Any]) -> dict[int, Any]:
    """Parts in order of their ids."""
    found = {part.id: part for part in parts.values()}
    if len(found) != len(parts):
        raise InputError(f"{path}: found an id twice, expected each once")
    return dict(sorted(found.items()))


def _array(line: list[_Point]) -> NDArray[np.float64]:
    return frozen(np.array([(point.x, point.y) for point in line]))


def _lanelet(segment: _Segment) -> Lanelet:
    """A segment as a lanelet; its width is the mean of its ends."""
    borders = _array(segment.left_lane_boundary), _array(segment.right_lane_boundary)
    own = segment.centerline  # maps of sensor logs have none
    across = borders[0][[0, -1]] - borders[1][[0, -1]]
    return Lanelet(
        id=segment.id,
        centerline=between(*borders)[0] if own is None else _array(own),
        width_m=float(np.hypot(*across.T).mean()),
        successors=tuple(segment.successors),
        internal=segment.is_intersection,
        left=segment.left_neighbor_id,
        right=segment.right_neighbor_id,
        use=segment.lane_type,
    )


def _crossing(crosswalk: _Crosswalk) -> Crossing:
    one, other = _array(crosswalk.edge1)[[0, -1]], _array(crosswalk.edge2)[[0, -1]]
    if (one[1] - one[0]) @ (other[1] - other[0]) < 0:
        other = other[::-1]
    return Crossing(
        id=str(crosswalk.id),
        centerline=(one + other) / 2,
        width_m=float(np.hypot(*(one - other).T).mean()),
        edges=(),
        priority=False,
    )


# --- writing ------------------------------------------------------------------------------------


def _points(line: NDArray[np.float64]) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": 0.0} for x, y in line]


def static_map(road: Road | None) -> dict[str, Any]:
    """The map as the official package reads it.

    Args:
        road: what to describe; None for an empty map.

    Returns:
        Lane segments, drivable areas and pedestrian crossings by id.
    """
    if road is None:
        return {"drivable_areas": {}, "lane_segments": {}, "pedestrian_crossings": {}}
    number = {lane.id: i + 1 for i, lane in enumerate(road.lanes) if not lane.walking}
    chains = [(c.from_lane, *c.via, c.to_lane) for c in road.connections]
    follows = {pair for chain in chains for pair in pairwise(chain)}
    by_place = {(lane.edge, lane.index): lane for lane in road.lanes if not lane.walking}
    segments = {}
    areas = {}
    for lane in road.lanes:
        if lane.walking:
            continue
        left = offset_line(lane.centerline, 0.5 * lane.width_m)
        right = offset_line(lane.centerline, -0.5 * lane.width_m)
        identity = number[lane.id]
        segments[str(identity)] = {
            "id": identity,
            "is_intersection": lane.internal,
            "lane_type": "VEHICLE",
            "centerline": _points(lane.centerline),
            "left_lane_boundary": _points(left),
            "right_lane_boundary": _points(right),
            **_sides(lane, by_place, number),
            "predecessors": sorted(number[a] for a, b in follows if b == lane.id and a in number),
            "successors": sorted(number[b] for a, b in follows if a == lane.id and b in number),
        }
        boundary = np.concatenate([left, right[::-1]])
        areas[str(identity)] = {"id": identity, "area_boundary": _points(boundary)}
    crossings = {}
    for i, crossing in enumerate(road.crossings):
        identity = len(road.lanes) + 1 + i
        ends = crossing.centerline[[0, -1]]
        crossings[str(identity)] = {
            "id": identity,
            "edge1": _points(offset_line(ends, 0.5 * crossing.width_m)),
            "edge2": _points(offset_line(ends, -0.5 * crossing.width_m)),
        }
    return {
        "drivable_areas": areas,
        "lane_segments": segments,
        "pedestrian_crossings": crossings,
    }


def _sides(
    lane: Lane, by_place: dict[tuple[str, int], Lane], number: dict[str, int]
) -> dict[str, Any]:
    left = by_place.get((lane.edge, lane.index + 1))
    right = by_place.get((lane.edge, lane.index - 1))
    outer = "NONE" if lane.internal else "SOLID_WHITE"
    inner = "NONE" if lane.internal else "DASHED_WHITE"
    return {
        "left_neighbor_id": None if left is None else number[left.id],
        "right_neighbor_id": None if right is None else number[right.id],
        "left_lane_mark_type": outer if left is None else inner,
        "right_lane_mark_type": outer if right is None else inner,
    }
