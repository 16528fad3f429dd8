"""Waymo Open Motion scenarios: TFRecord files of ``scenario.proto``, and JSON made from them.

A TFRecord file is length, checksum, data, checksum; again and again. It is read without TensorFlow,
and its messages without generated code: of a message only what is read has a field.

Two kinds of JSON circulate: the messages in protobuf's own JSON form (``tracks``, ``mapFeatures``),
and the one of Nocturne and GPUDrive (``objects``, ``roads``, ``tl_states``), which has no limits,
no neighbours and no successors, and assumes 10 Hz. Centres in metres, headings in radians (in
degrees in Nocturne's).

References:
    Ettinger et al. (2021), Large scale interactive motion forecasting for autonomous driving: the
    Waymo Open Motion Dataset, ICCV; ``scenario.proto`` and ``map.proto`` of the open dataset.
    tensorflow/core/lib/io/record_writer.h: the checksums are CRC-32C, rotated and offset.
    Vinitsky et al. (2022), Nocturne, NeurIPS. Kazemkhani et al. (2025), GPUDrive, ICLR.
"""

from __future__ import annotations

import functools
import json
import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import google_crc32c
import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from google.protobuf.message import DecodeError

from behaviors.errors import InputError
from sim.formats.common.recording import Recording
from sim.formats.driving_scenes import DrivingScene, recording_of
from sim.frames import AgentKind, FloatArray, Signal
from sim.input_files import opened, plain_name, read_bytes, stem
from sim.road.maps.lanelets import Lanelet
from sim.units import in_si

PERIOD_S: Final = 0.1
"""Time between two steps where the file does not say it, s."""

KINDS: Final = {1: AgentKind.CAR, 2: AgentKind.PEDESTRIAN, 3: AgentKind.BICYCLE}
"""Types of objects that are road-agents; 0 and 4 (unset, other) are left out."""

WORDS: Final = dict(zip(("vehicle", "pedestrian", "cyclist"), KINDS.values(), strict=True))
"""The same in Nocturne's words."""

BIKE_LANE: Final = 3
"""The type of lanes for bicycles."""

STATES: Final = {
    "UNKNOWN": Signal.OFF, "ARROW_STOP": Signal.RED, "ARROW_CAUTION": Signal.YELLOW,
    "ARROW_GO": Signal.GREEN, "STOP": Signal.RED, "CAUTION": Signal.YELLOW, "GO": Signal.GREEN,
    "FLASHING_STOP": Signal.RED, "FLASHING_CAUTION": Signal.YELLOW,
}  # fmt: skip
"""What lights show, by the words of Nocturne, which stand in the order of Waymo's numbers."""


def read(path: Path) -> Iterator[Recording]:
    """A recording, with its road, for each scenario of a TFRecord file, or the one of a JSON."""
    if plain_name(path).lower().endswith(".json"):
        yield recording_of(_from_json(path))
        return
    for number, record in enumerate(read_records(path), 1):
        try:
            scenario = scenario_class().FromString(record)
        except DecodeError:
            raise InputError(
                f"{path}: record {number}: found another message, such as a tf.Example, expected "
                "a Waymo scenario"
            ) from None
        yield recording_of(_from_message(path, scenario, number))


# --- records ------------------------------------------------------------------------------------

_HEAD: Final = struct.Struct("<QI")
_TAIL: Final = struct.Struct("<I")
_OFFSET: Final = 0xA282EAD8


def masked_checksum(data: bytes) -> int:
    """The checksum of data as such files have it.

    Examples:
        >>> hex(masked_checksum(b"123456789"))
        '0xc78ab0e5'
    """
    crc = int(google_crc32c.value(data))
    return (((crc >> 15) | (crc << 17)) + _OFFSET) & 0xFFFFFFFF


def read_records(path: Path) -> Iterator[bytes]:
    """The data of each record of a TFRecord file, checked."""
    number = 0
    with opened(path) as file:
        while head := file.read(_HEAD.size):
            number += 1
            whole = len(head) == _HEAD.size and masked_checksum(head[:8]) == _HEAD.unpack(head)[1]
            data = file.read(_HEAD.unpack(head)[0]) if whole else b""
            tail = file.read(_TAIL.size)
            if not whole or tail != _TAIL.pack(masked_checksum(data)):
                raise InputError(
                    f"{path}: record {number}: found other bytes than its checksums say, expected "
                    "a whole TFRecord"
                )
            yield data
    if not number:
        raise InputError(f"{path}: found no record, expected at least one")


# --- messages -----------------------------------------------------------------------------------

PACKAGE: Final = "waymo.open_dataset"

MESSAGES: Final[dict[str, dict[str, tuple[int, str]]]] = {
    "ObjectState": {
        "center_x": (2, "double"), "center_y": (3, "double"), "length": (5, "float"),
        "width": (6, "float"), "heading": (8, "float"), "velocity_x": (9, "float"),
        "velocity_y": (10, "float"), "valid": (11, "bool"),
    },
    "Track": {"id": (1, "int32"), "object_type": (2, "ObjectType"), "states": (3, "*ObjectState")},
    "MapPoint": {"x": (1, "double"), "y": (2, "double")},
    "LaneNeighbor": {"feature_id": (1, "int64")},
    "LaneCenter": {
        "speed_limit_mph": (1, "double"), "type": (2, "LaneType"), "interpolating": (3, "bool"),
        "polyline": (8, "*MapPoint"), "entry_lanes": (9, "*int64"), "exit_lanes": (10, "*int64"),
        "left_neighbors": (11, "*LaneNeighbor"), "right_neighbors": (12, "*LaneNeighbor"),
    },
    "StopSign": {"lane": (1, "*int64")},
    "Crosswalk": {"polygon": (1, "*MapPoint")},
    "MapFeature": {
        "id": (1, "int64"), "lane": (3, "LaneCenter"), "stop_sign": (7, "StopSign"),
        "crosswalk": (8, "Crosswalk"),
    },
    "TrafficSignalLaneState": {"lane": (1, "int64"), "state": (2, "State")},
    "DynamicMapState": {"lane_states": (1, "*TrafficSignalLaneState")},
    "Scenario": {
        "timestamps_seconds": (1, "*double"), "tracks": (2, "*Track"),
        "scenario_id": (5, "string"), "sdc_track_index": (6, "int32"),
        "dynamic_map_states": (7, "*DynamicMapState"), "map_features": (8, "*MapFeature"),
    },
}  # fmt: skip
"""Number and kind of every field that is read, by message; ``*`` marks what repeats."""

ENUMS: Final[dict[str, tuple[str, ...]]] = {
    "ObjectType": ("TYPE_UNSET", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_CYCLIST", "TYPE_OTHER"),
    "LaneType": ("TYPE_UNDEFINED", "TYPE_FREEWAY", "TYPE_SURFACE_STREET", "TYPE_BIKE_LANE"),
    "State": tuple(f"LANE_STATE_{word}" for word in STATES),
}
"""The names of numbers from 0 on, by enumeration; JSON has the names."""


@functools.lru_cache(maxsize=1)
def scenario_class() -> Any:
    """The class of the message ``Scenario``."""
    file = descriptor_pb2.FileDescriptorProto(
        name="graphrqi/waymo_scenario.proto", package=PACKAGE, syntax="proto2"
    )
    for name, words in ENUMS.items():
        enum = file.enum_type.add(name=name)
        for number, word in enumerate(words):
            enum.value.add(name=word, number=number)
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for label, (number, kind) in fields.items():
            plain = kind.removeprefix("*")
            field = message.field.add(name=label, number=number)
            field.label = field.LABEL_OPTIONAL if plain == kind else field.LABEL_REPEATED
            if plain in MESSAGES or plain in ENUMS:
                field.type = field.TYPE_MESSAGE if plain in MESSAGES else field.TYPE_ENUM
                field.type_name = f".{PACKAGE}.{plain}"
            else:
                field.type = getattr(field, f"TYPE_{plain.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.Scenario"))


def _from_message(path: Path, scenario: Any, number: int) -> DrivingScene:
    """A scenario in Waymo's own message."""
    if not scenario.tracks:
        raise InputError(
            f"record {number}: found no tracks, as in a tf.Example, expected a Waymo scenario: "
            "those are in the dataset's folder scenario, not tf_example"
        )
    name = scenario.scenario_id[:100] or f"{stem(path)}-{number}"
    scene = DrivingScene(path, name, np.array(scenario.timestamps_seconds, dtype=np.float64))
    for track in scenario.tracks:
        kind = KINDS.get(track.object_type)
        if kind is None:
            scene.left_out += 1
            continue
        seen = [(t, s) for t, s in enumerate(track.states) if s.valid]
        values = [
            (s.center_x, s.center_y, s.heading, math.hypot(s.velocity_x, s.velocity_y), s.length,
             s.width)
            for _, s in seen
        ]  # fmt: skip
        steps = np.array([t for t, _ in seen], dtype=np.int64)
        scene.agents.append((str(track.id), kind, steps, np.reshape(values, (-1, 6))))
    features = scenario.map_features
    stops = {i for one in features if one.HasField("stop_sign") for i in one.stop_sign.lane}
    for feature in features:
        if feature.HasField("lane"):
            lane = feature.lane
            scene.lanes.append(
                Lanelet(
                    id=feature.id,
                    centerline=_xy(lane.polyline),
                    width_m=math.nan,
                    limit_mps=in_si(lane.speed_limit_mph, "mph") or math.nan,
                    cars=lane.type != BIKE_LANE,
                    internal=lane.interpolating,
                    predecessors=tuple(lane.entry_lanes),
                    successors=tuple(lane.exit_lanes),
                    left=next((one.feature_id for one in lane.left_neighbors), None),
                    right=next((one.feature_id for one in lane.right_neighbors), None),
                    must_stop=feature.id in stops,
                )
            )
        elif feature.HasField("crosswalk"):
            scene.crosswalks[str(feature.id)] = _xy(feature.crosswalk.polygon)
    signals = tuple(STATES.values())
    for shown in scenario.dynamic_map_states:
        scene.lights.append({s.lane: signals[s.state] for s in shown.lane_states})
    return scene


# --- JSON ---------------------------------------------------------------------------------------


def _from_json(path: Path) -> DrivingScene:
    """A scenario in either kind of JSON."""
    found = json.loads(read_bytes(path))
    if "objects" in found:
        return _from_nocturne(path, found)
    message = json_format.ParseDict(found, scenario_class()(), ignore_unknown_fields=True)
    if not message.scenario_id:
        message.scenario_id = stem(path)
    return _from_message(path, message, 1)


def _xy(points: Any) -> FloatArray:
    """(P, 2) the points of a line, messages or dictionaries, m."""
    pairs = [(p["x"], p["y"]) if isinstance(p, Mapping) else (p.x, p.y) for p in points]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2)


def _from_nocturne(path: Path, found: Mapping[str, Any]) -> DrivingScene:
    """A scenario of Nocturne or GPUDrive."""
    steps = max((len(one["position"]) for one in found["objects"]), default=0)
    name = str(found.get("scenario_id") or found.get("name") or stem(path))[:100]
    time_s = np.arange(steps, dtype=np.float64) * PERIOD_S
    scene = DrivingScene(path, name.removesuffix(".json"), time_s)
    for index, one in enumerate(found["objects"]):
        kind = WORDS.get(one["type"].lower().removeprefix("type_"))
        if kind is None:
            scene.left_out += 1
            continue
        xy, velocity = _xy(one["position"]), _xy(one["velocity"])
        sides = [np.broadcast_to(one[side], len(xy)) for side in ("length", "width")]
        speed = np.hypot(*velocity.T)
        table = np.column_stack([xy, one["heading"], speed, *sides]).astype(np.float64)
        seen = np.flatnonzero(one["valid"])
        scene.agents.append((str(one.get("id", index)), kind, seen, table[seen]))
    headings = [values[:, 2] for *_, values in scene.agents]
    if max((np.abs(one).max(initial=0.0) for one in headings), default=0.0) > 2 * math.pi + 0.01:
        for one in headings:  # Nocturne's degrees
            one[:] = np.radians(one)
    for index, road in enumerate(found.get("roads") or []):
        identity, line = road.get("id", index), road.get("geometry")
        if isinstance(line, list) and road["type"] == "lane":
            scene.lanes.append(Lanelet(int(identity), _xy(line), math.nan))
        elif isinstance(line, list) and road["type"] == "crosswalk":
            scene.crosswalks[str(identity)] = _xy(line)
    known = {lane.id for lane in scene.lanes}
    scene.lights = [{} for _ in time_s]
    for lane, shown in (found.get("tl_states") or {}).items():
        for t, state in zip(shown["time_index"], shown["state"], strict=False):
            word = str(state).upper().removeprefix("LANE_STATE_")
            if int(lane) in known and 0 <= t < steps:
                scene.lights[t][int(lane)] = STATES.get(word, Signal.OFF)
    return scene
