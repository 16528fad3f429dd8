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
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.driving_scene import STATES, DrivingScene, check_counts, recording_of
from sim.formats.common.packed import stem
from sim.formats.common.recording import Recording
from sim.formats.waymo.messages import scenario_class
from sim.formats.waymo.tfrecord import MAX_RECORD_BYTES, read_records
from sim.frames import AgentKind
from sim.road.maps.waymo import WaymoLane, with_neighbours
from sim.written_numbers import real, whole
from sim.xml_tree import read_bytes

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
"""The same in words; of ``TYPE_VEHICLE`` and its like, the end."""

STATE_WORDS: Final = (
    "unknown", "arrow_stop", "arrow_caution", "arrow_go", "stop", "caution", "go",
    "flashing_stop", "flashing_caution",
)  # fmt: skip
"""The same in words, as JSON has it."""

LANE_WORDS: Final = {"type_undefined": 0, "type_freeway": 1, "type_surface_street": 2}
"""Types of lanes in words; ``type_bike_lane`` is 3."""


def read(path: Path) -> Iterator[Recording]:
    """Read the scenarios of a file.

    Args:
        path: a TFRecord file, or a JSON of one scenario.

    Yields:
        One recording per scenario, with its road.

    Raises:
        InputError: if the file is broken; the message names file, record and field.
    """
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(".json"):
        yield recording_of(_from_json(path))
        return
    message = scenario_class()
    for number, record in enumerate(read_records(path), 1):
        try:
            scenario = message.FromString(record)
        except DecodeError as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"{path}: record {number}: {reason}, expected a Waymo scenario"
            ) from None
        yield recording_of(_from_message(path, scenario, number))


# --- messages -----------------------------------------------------------------------------------


def _from_message(path: Path, scenario: Any, number: int) -> DrivingScene:
    where = f"{path}: record {number}"
    check_counts(where, len(scenario.tracks), len(scenario.timestamps_seconds))
    scene = DrivingScene(
        path,
        scenario.scenario_id.decode("utf-8", "replace")[:100] or f"{stem(path)}-{number}",
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
        scene.lights.append(
            {s.lane: s.state for s in shown.lane_states if 0 <= s.state < len(STATES)}
        )
    scene.lanes = with_neighbours(scene.lanes)
    return scene


# --- JSON ---------------------------------------------------------------------------------------


def _from_json(path: Path) -> DrivingScene:
    data = read_bytes(path, MAX_RECORD_BYTES)
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: found {type(found).__name__}, expected an object of a scenario")
    try:
        if "objects" in found:
            return _from_nocturne(path, found)
        return _from_protobuf_json(path, found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        reason = f"{type(error).__name__} {' '.join(str(error).split())[:120]}"
        raise InputError(f"{path}: expected a Waymo scenario, found another: {reason}") from None


def _real(value: Any) -> float:
    """A number; protobuf's JSON may write it as text."""
    return real(value) if isinstance(value, str) else float(value)


def _whole(value: Any) -> int:
    """A whole number; protobuf's JSON writes long ones as text."""
    return whole(value) if isinstance(value, str) else int(value)


def _field(part: Mapping[str, Any], name: str, default: Any = None) -> Any:
    """A field of a message in JSON, whose names are in snake_case or camelCase."""
    if name in part:
        return part[name]
    head, *rest = name.split("_")
    return part.get(head + "".join(word.capitalize() for word in rest), default)


def _from_protobuf_json(path: Path, found: Mapping[str, Any]) -> DrivingScene:
    times = [_real(t) for t in _field(found, "timestamps_seconds", [])]
    tracks = _field(found, "tracks", [])
    check_counts(str(path), len(tracks), len(times))
    name = str(_field(found, "scenario_id", stem(path)))[:100]
    scene = DrivingScene(path, name, np.array(times), [], [], [], [], [], {}, [])
    for track in tracks:
        kind = _kind(_field(track, "object_type", 0))
        states = _field(track, "states", [])
        if kind is None or len(states) > len(times):
            if kind is not None:
                raise InputError(f"{path}: found {len(states)} states, expected {len(times)}")
            scene.left_out += 1
            continue
        scene.names.append(str(_whole(_field(track, "id", 0))))
        scene.kinds.append(kind)
        seen = [(t, s) for t, s in enumerate(states) if _field(s, "valid", False) is True]
        scene.steps.append([t for t, _ in seen])
        scene.values.append([_state(s) for _, s in seen])
    features = _field(found, "map_features", [])
    stops = {
        _whole(lane) for f in features if (sign := _field(f, "stop_sign"))
        for lane in _field(sign, "lane", [])
    }  # fmt: skip
    for feature in features:
        identity = _whole(_field(feature, "id", 0))
        lane, crosswalk = _field(feature, "lane"), _field(feature, "crosswalk")
        if lane is not None:
            beside = [_field(lane, f"{side}_neighbors", []) for side in ("left", "right")]
            left, right = (_whole(_field(b[0], "feature_id")) if b else None for b in beside)
            scene.lanes.append(
                WaymoLane(
                    id=identity,
                    line=_xy(_field(lane, "polyline", [])),
                    limit_mph=_real(_field(lane, "speed_limit_mph", 0.0)),
                    type=_lane_type(_field(lane, "type", 0)),
                    interpolating=bool(_field(lane, "interpolating", False)),
                    before=tuple(_whole(i) for i in _field(lane, "entry_lanes", [])[:16]),
                    after=tuple(_whole(i) for i in _field(lane, "exit_lanes", [])[:16]),
                    left=left,
                    right=right,
                    stops=identity in stops,
                )
            )
        elif crosswalk is not None:
            scene.crosswalks[str(identity)] = _xy(_field(crosswalk, "polygon", []))
    for shown in _field(found, "dynamic_map_states", []):
        scene.lights.append(
            {
                _whole(_field(s, "lane")): _light(_field(s, "state", 0))
                for s in _field(shown, "lane_states", [])
            }
        )
    scene.lanes = with_neighbours(scene.lanes)
    return scene


def _state(state: Mapping[str, Any]) -> tuple[float, ...]:
    x, y, heading, vx, vy, length, width = (
        _real(_field(state, name, 0.0))
        for name in ("center_x", "center_y", "heading", "velocity_x", "velocity_y", "length",
                     "width")
    )  # fmt: skip
    return x, y, heading, math.hypot(vx, vy), length, width


def _xy(points: Sequence[Mapping[str, Any]]) -> FloatArray:
    return np.array([(_real(p["x"]), _real(p["y"])) for p in points]).reshape(-1, 2)


def _kind(word: Any) -> AgentKind | None:
    if isinstance(word, str):
        return WORDS.get(word.lower().removeprefix("type_"))
    return KINDS.get(word)


def _lane_type(word: Any) -> int:
    if isinstance(word, str):
        return LANE_WORDS.get(word.lower(), 3 if word.lower().endswith("bike_lane") else 0)
    return _whole(word)


def _light(word: Any) -> int:
    if isinstance(word, str):
        plain = word.lower().removeprefix("lane_state_")
        return STATE_WORDS.index(plain) if plain in STATE_WORDS else 0
    return _whole(word) if 0 <= _whole(word) < len(STATES) else 0


def _from_nocturne(path: Path, found: Mapping[str, Any]) -> DrivingScene:
    objects = found["objects"]
    steps = max((len(one["position"]) for one in objects), default=0)
    check_counts(str(path), len(objects), steps)
    name = str(found.get("scenario_id") or found.get("name") or stem(path))[:100]
    times = np.arange(steps, dtype=np.float64) * PERIOD_S
    scene = DrivingScene(path, name.removesuffix(".json"), times, [], [], [], [], [], {}, [])
    headings, courses = list[float](), list[float]()
    for index, one in enumerate(objects):
        kind = _kind(one["type"])
        if kind is None:
            scene.left_out += 1
            continue
        scene.names.append(str(_whole(one.get("id", index))))
        scene.kinds.append(kind)
        length, width = _real(one["length"]), _real(one["width"])
        seen, values = list[int](), list[tuple[float, ...]]()
        for t, (place, heading, velocity, valid) in enumerate(
            zip(one["position"], one["heading"], one["velocity"], one["valid"], strict=True)
        ):
            if not valid:
                continue
            vx, vy = _real(velocity["x"]), _real(velocity["y"])
            speed, angle = math.hypot(vx, vy), _real(heading)
            seen.append(t)
            values.append((_real(place["x"]), _real(place["y"]), angle, speed, length, width))
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
            identity = _whole(road.get("id", index))
            scene.lanes.append(WaymoLane(id=identity, line=_xy(road["geometry"])))
        elif road["type"] == "crosswalk":
            scene.crosswalks[str(road.get("id", index))] = _xy(road["geometry"])
    known = {lane.id for lane in scene.lanes}
    scene.lights = [{} for _ in range(scene.time_s.size)]
    for lane, shown in (found.get("tl_states") or {}).items():
        if _whole(lane) not in known:
            continue
        for t, state in zip(shown["time_index"], shown["state"], strict=True):
            if 0 <= _whole(t) < len(scene.lights):
                scene.lights[_whole(t)][_whole(lane)] = _light(state)
