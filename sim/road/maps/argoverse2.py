"""The map of an Argoverse 2 scenario as a `Road`.

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
from typing import Any

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import FloatArray
from sim.input_files import broken_as_one_line, read_bytes, read_once
from sim.road import Crossing, Road
from sim.road.maps.lanelets import Lanelet, between, road_of_lanelets


@read_once
def read_map(path: Path, name: str | None = None) -> Road | None:
    """The road of a map (``log_map_archive_<id>.json``), None for one without lane segments.

    Lane and crossing ids are those of the file.

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
    width_m = float(np.hypot(*(one - other).T).mean())
    return Crossing(str(crosswalk["id"]), (one + other) / 2, width_m, (), priority=False)
