"""The map of an Argoverse 2 scenario, read as a `Road` and written from one.

Lane segments carry a centre line, borders, neighbours and successors; crosswalks two edges. Limits,
signals and priority are not in the format: they are unknown (a limit is NaN, no crossing or way has
priority).

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.geometry import offset_line
from sim.input_files import broken_as_one_line, read_bytes, read_once
from sim.road import Crossing, Lane, Road
from sim.road.maps.lanelets import Lanelet, between, road_of_lanelets

# --- reading ------------------------------------------------------------------------------------


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
    with broken_as_one_line(path, "a map of Argoverse 2"):
        archive = json.loads(read_bytes(path))
        segments = sorted(archive["lane_segments"].values(), key=lambda one: one["id"])
        lanelets = {int(one["id"]): _lanelet(one) for one in segments}
        crossings = [_crossing(one) for one in archive["pedestrian_crossings"].values()]
        if len(lanelets) < len(segments) or len({one.id for one in crossings}) < len(crossings):
            raise InputError("found an id twice, expected each once")
        if not segments:
            return None
        return road_of_lanelets(path, path.stem if name is None else name, lanelets, crossings)


def _array(line: list[dict[str, float]]) -> FloatArray:
    """(P, 2) the points of a line, m."""
    points = frozen(np.array([(point["x"], point["y"]) for point in line], dtype=np.float64))
    if len(points) < 2:
        raise InputError("found a line of one point, expected 2 or more")
    return points


def _lanelet(segment: Mapping[str, Any]) -> Lanelet:
    """A segment as a lanelet; its width is the mean of its ends."""
    borders = [_array(segment[f"{side}_lane_boundary"]) for side in ("left", "right")]
    own = segment.get("centerline")  # maps of sensor logs have none
    across = borders[0][[0, -1]] - borders[1][[0, -1]]
    return Lanelet(
        id=int(segment["id"]),
        centerline=between(*borders)[0] if own is None else _array(own),
        width_m=float(np.hypot(*across.T).mean()),
        successors=tuple(map(int, segment["successors"])),
        internal=bool(segment["is_intersection"]),
        left=segment["left_neighbor_id"],
        right=segment["right_neighbor_id"],
        use=str(segment["lane_type"]),
    )


def _crossing(crosswalk: Mapping[str, Any]) -> Crossing:
    one, other = (_array(crosswalk[edge])[[0, -1]] for edge in ("edge1", "edge2"))
    if (one[1] - one[0]) @ (other[1] - other[0]) < 0:
        other = other[::-1]
    return Crossing(
        id=str(crosswalk["id"]),
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
