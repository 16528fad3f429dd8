"""Maps of Argoverse 2 read as a `Road`, and written.

Lane segments carry a centre line, borders, neighbours and successors; crosswalks two edges. Limits,
signals and priority are not in the format: they are unknown (a limit is NaN, no crossing or way has
priority).

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from sim.frames import FloatArray
from sim.geometry import borders
from sim.input_files import broken_as_one_line, read_bytes, read_once
from sim.road import Crossing, Road
from sim.road.maps.lanelets import Lanelet, between, followers, road_of_lanelets

MAP_NOTE: Final = "limits, signals and who has priority are not in this format: unknown"
"""The note of recordings with such a map."""


@read_once
def read_map(path: Path, name: str | None = None) -> Road | None:
    """The road of a map (``log_map_archive_<id>.json``), None for one without lane segments.

    Lane and crossing ids are those of the file.

    Raises:
        InputError: if the file is missing or no such map.
    """
    with broken_as_one_line(path, "a map of Argoverse 2"):
        archive = json.loads(read_bytes(path))
        segments = sorted(archive["lane_segments"].values(), key=lambda one: one["id"])
        if not segments:
            return None
        return road_of_lanelets(
            path,
            path.stem if name is None else name,
            {int(one["id"]): _lanelet(one) for one in segments},
            [_crossing(one) for one in archive["pedestrian_crossings"].values()],
        )


def _array(line: list[dict[str, float]]) -> FloatArray:
    """(P, 2) the points of a line, m."""
    return np.array([(point["x"], point["y"]) for point in line], dtype=np.float64).reshape(-1, 2)


def _lanelet(segment: Mapping[str, Any]) -> Lanelet:
    """A segment as a lanelet; its width is the mean of its ends."""
    left, right = (_array(segment[f"{side}_lane_boundary"]) for side in ("left", "right"))
    own = segment.get("centerline")  # maps of sensor logs have none
    across = left[[0, -1]] - right[[0, -1]]
    return Lanelet(
        id=int(segment["id"]),
        centerline=between(left, right)[0] if own is None else _array(own),
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
    width_m = float(np.hypot(*(one - other).T).mean())
    return Crossing(str(crosswalk["id"]), (one + other) / 2, width_m, (), priority=False)


def static_map(road: Road | None) -> dict[str, Any]:
    """The map of a road as the official package reads it; an empty one of none."""
    segments, areas, crossings = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    archive = {
        "drivable_areas": areas,
        "lane_segments": segments,
        "pedestrian_crossings": crossings,
    }
    if road is None:
        return archive
    numbers = {lane.id: i for i, lane in enumerate(road.lanes, 1) if not lane.walking}
    before, after = followers(road)
    lanes = [lane for lane in road.lanes if not lane.walking]
    by_place = {(lane.edge, lane.index): numbers[lane.id] for lane in lanes}
    for lane in lanes:
        number = numbers[lane.id]
        left, right = borders(lane.centerline, lane.width_m)
        beside = {
            "left": by_place.get((lane.edge, lane.index + 1)),
            "right": by_place.get((lane.edge, lane.index - 1)),
        }
        marks = {
            side: "NONE" if lane.internal else "SOLID_WHITE" if other is None else "DASHED_WHITE"
            for side, other in beside.items()
        }
        segments[str(number)] = {
            "id": number,
            "is_intersection": lane.internal,
            "lane_type": "VEHICLE",
            "centerline": _points(lane.centerline),
            "left_lane_boundary": _points(left),
            "right_lane_boundary": _points(right),
            **{f"{side}_neighbor_id": other for side, other in beside.items()},
            **{f"{side}_lane_mark_type": mark for side, mark in marks.items()},
            "predecessors": sorted(numbers[i] for i in before[lane.id] if i in numbers),
            "successors": sorted(numbers[i] for i in after[lane.id] if i in numbers),
        }
        boundary = np.concatenate([left, right[::-1]])
        areas[str(number)] = {"id": number, "area_boundary": _points(boundary)}
    for number, crossing in enumerate(road.crossings, len(road.lanes) + 1):
        left, right = borders(crossing.centerline[[0, -1]], crossing.width_m)
        edges = {"edge1": _points(left), "edge2": _points(right)}
        crossings[str(number)] = {"id": number, **edges}
    return archive


def _points(line: FloatArray) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": 0.0} for x, y in line]
