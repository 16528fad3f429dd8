"""Waymo Open Motion scenarios: TFRecord files of ``scenario.proto``, and JSON made from them.

Two kinds of JSON circulate: the messages in protobuf's own JSON form (``tracks``, ``mapFeatures``),
and the one of Nocturne and GPUDrive (``objects``, ``roads``, ``tl_states``), which has no limits,
no neighbours and no successors, and assumes 10 Hz. Centres in metres, headings in radians (in
degrees in Nocturne's).

References:
    Ettinger et al. (2021), Large scale interactive motion forecasting for autonomous driving, ICCV.
    Vinitsky et al. (2022), Nocturne, NeurIPS. Kazemkhani et al. (2025), GPUDrive, ICLR.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from google.protobuf import json_format
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.driving_scene import DrivingScene, recording_of
from sim.formats.common.recording import Recording
from sim.formats.waymo.messages import ENUMS, scenario_class
from sim.formats.waymo.tfrecord import read_records
from sim.frames import AgentKind
from sim.input_files import plain_name, read_bytes, stem
from sim.road.maps.waymo import WaymoLane, with_neighbours

FloatArray = NDArray[np.float64]

PERIOD_S: Final = 0.1
"""Time between two steps where the file does not say it, s."""

KINDS: Final = {1: AgentKind.CAR, 2: AgentKind.PEDESTRIAN, 3: AgentKind.BICYCLE}
"""Types of objects that are road-agents; 0 and 4 (unset, other) are left out."""

WORDS: Final = {
    "vehicle": AgentKind.CAR,
    "pedestrian": AgentKind.PEDESTRIAN,
    "cyclist": AgentKind.BICYCLE,
}
"""The same in Nocturne's words."""


def read(path: Path) -> Iterator[Recording]:
    """Read the scenarios of a file.

    Args:
        path: a TFRecord file, or a JSON of one scenario.

    Yields:
        One recording per scenario, with its road.

    Raises:
        InputError: if the file is broken; the message names file, record and field.
    """
    if plain_name(path).lower().endswith(".json"):
        yield recording_of(_from_json(path))
        return
    message = scenario_class()
    for number, record in enumerate(read_records(path), 1):
        try:
            scenario = message.FromString(record)
        except DecodeError as error:
            raise InputError(
                f"{path}: record {number}: {error}, expected a Waymo scenario"
            ) from None
        yield recording_of(_from_message(path, scenario, number))


# --- messages -----------------------------------------------------------------------------------


def _from_message(path: Path, scenario: Any, number: int) -> DrivingScene:
    where = f"{path}: record {number}"
    scene = DrivingScene(
        path,
        scenario.scenario_id[:100] or f"{stem(path)}-{number}",
        np.array(scenario.timestamps_seconds, dtype=np.float64),
        [], [], [], [], [], {}, [],
    )  # fmt: skip
    hypot = math.hypot
    for track in scenario.tracks:
        kind = KINDS.get(track.object_type)
        if kind is None:
            scene.left_out += 1
            continue
        states = track.states
        if len(states) > scene.time_s.size:
            raise InputError(
                f"{where}: track {track.id}: found {len(states)} states, expected one for each of "
                f"the {scene.time_s.size} times"
            )
        scene.names.append(str(track.id))
        scene.kinds.append(kind)
        steps, values = list[int](), list[tuple[float, ...]]()
        for t, s in enumerate(states):
            if s.valid:
                steps.append(t)
                speed = hypot(s.velocity_x, s.velocity_y)
                values.append((s.center_x, s.center_y, s.heading, speed, s.length, s.width))
        scene.steps.append(steps)
        scene.values.append(values)
    stops = {lane for f in scenario.map_features if f.HasField("stop_sign")
             for lane in f.stop_sign.lane}  # fmt: skip
    for feature in scenario.map_features:
        if feature.HasField("lane"):
            lane = feature.lane
            scene.lanes.append(
                WaymoLane(
                    id=feature.id,
                    line=np.array([(p.x, p.y) for p in lane.polyline]).reshape(-1, 2),
                    limit_mph=lane.speed_limit_mph,
                    type=lane.type,
                    interpolating=lane.interpolating,
                    before=tuple(lane.entry_lanes)[:16],
                    after=tuple(lane.exit_lanes)[:16],
                    left=lane.left_neighbors[0].feature_id if lane.left_neighbors else None,
                    right=lane.right_neighbors[0].feature_id if lane.right_neighbors else None,
                    stops=feature.id in stops,
                )
            )
        elif feature.HasField("crosswalk"):
            outline = np.array([(p.x, p.y) for p in feature.crosswalk.polygon]).reshape(-1, 2)
            scene.crosswalks[str(feature.id)] = outline
    for shown in scenario.dynamic_map_states:
        scene.lights.append({s.lane: s.state for s in shown.lane_states})
    scene.lanes = with_neighbours(scene.lanes)
    return scene


# --- JSON ---------------------------------------------------------------------------------------


def _from_json(path: Path) -> DrivingScene:
    """A scenario in either kind of JSON."""
    found = json.loads(read_bytes(path))
    if not isinstance(found, dict):
        raise InputError(f"{path}: found {type(found).__name__}, expected an object of a scenario")
    if "objects" in found:
        return _from_nocturne(path, found)
    message = json_format.ParseDict(found, scenario_class()(), ignore_unknown_fields=True)
    if not message.scenario_id:
        message.scenario_id = stem(path)
    return _from_message(path, message, 1)


def _xy(points: Sequence[Mapping[str, Any]]) -> FloatArray:
    """(P, 2) the points of a line, m."""
    return np.array([(float(p["x"]), float(p["y"])) for p in points]).reshape(-1, 2)


def _from_nocturne(path: Path, found: Mapping[str, Any]) -> DrivingScene:
    objects = found["objects"]
    steps = max((len(one["position"]) for one in objects), default=0)
    name = str(found.get("scenario_id") or found.get("name") or stem(path))[:100]
    times = np.arange(steps, dtype=np.float64) * PERIOD_S
    scene = DrivingScene(path, name.removesuffix(".json"), times, [], [], [], [], [], {}, [])
    headings, courses = list[float](), list[float]()
    for index, one in enumerate(objects):
        kind = WORDS.get(str(one["type"]).lower().removeprefix("type_"))
        if kind is None:
            scene.left_out += 1
            continue
        scene.names.append(str(int(one.get("id", index))))
        scene.kinds.append(kind)
        length, width = float(one["length"]), float(one["width"])
        seen, values = list[int](), list[tuple[float, ...]]()
        for t, (place, heading, velocity, valid) in enumerate(
            zip(one["position"], one["heading"], one["velocity"], one["valid"], strict=True)
        ):
            if not valid:
                continue
            vx, vy = float(velocity["x"]), float(velocity["y"])
            speed, angle = math.hypot(vx, vy), float(heading)
            seen.append(t)
            values.append((float(place["x"]), float(place["y"]), angle, speed, length, width))
            headings.append(angle)
            courses.append(math.atan2(vy, vx) if 1.0 < speed < 1e9 else math.nan)
        scene.steps.append(seen)
        scene.values.append(values)
    if _in_degrees(np.array(headings), np.array(courses)):
        scene.values = [
            [(x, y, math.radians(h), *rest) for x, y, h, *rest in rows] for rows in scene.values
        ]
    _nocturne_map(scene, found)
    return scene


def _in_degrees(heading: FloatArray, course: FloatArray) -> bool:
    """Whether headings are degrees: whichever unit agrees better with where agents go."""
    if heading.size and np.abs(heading).max() > 2 * math.pi + 0.01:
        return True
    known = np.isfinite(course) & (np.abs(heading) < 1e6)
    as_radians, as_degrees = (
        np.cos(angle[known] - course[known]).sum() for angle in (heading, np.radians(heading))
    )
    return bool(as_degrees > as_radians)


def _nocturne_map(scene: DrivingScene, found: Mapping[str, Any]) -> None:
    """The lanes and lights of such a JSON: of lanes it has lines only."""
    for index, road in enumerate(found.get("roads") or []):
        if road["type"] == "lane":
            identity = int(road.get("id", index))
            scene.lanes.append(WaymoLane(id=identity, line=_xy(road["geometry"])))
        elif road["type"] == "crosswalk":
            scene.crosswalks[str(road.get("id", index))] = _xy(road["geometry"])
    known = {lane.id for lane in scene.lanes}
    scene.lights = [{} for _ in range(scene.time_s.size)]
    for lane, shown in (found.get("tl_states") or {}).items():
        if int(lane) not in known:
            continue
        for t, state in zip(shown["time_index"], shown["state"], strict=True):
            if 0 <= int(t) < len(scene.lights):
                scene.lights[int(t)][int(lane)] = _light(state)


def _light(word: Any) -> int:
    """What a light shows, as the format's number."""
    words = ENUMS["TrafficSignalLaneState.State"]
    name = f"LANE_STATE_{str(word).upper().removeprefix('LANE_STATE_')}"
    return words.index(name) if name in words else 0
