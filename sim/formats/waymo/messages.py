"""Waymo's records without TensorFlow, and their messages without generated code.

A TFRecord file is length, checksum, data, checksum; again and again. Of a message only what is read
has a field; everything else is skipped by its tag.

References:
    Ettinger et al. (2021), Large scale interactive motion forecasting for autonomous driving: the
    Waymo Open Motion Dataset, ICCV; ``scenario.proto`` and ``map.proto`` of the open dataset;
    tensorflow/core/lib/io/record_writer.h: the checksums are CRC-32C, rotated and offset.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import google_crc32c
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from behaviors.errors import InputError
from sim.input_files import opened

PACKAGE: Final = "waymo.open_dataset"

_PLAIN: Final = ("double", "float", "int32", "int64", "bool", "string")
"""Kinds of fields that are no messages."""

MESSAGES: Final[dict[str, dict[str, tuple[int, str]]]] = {
    "ObjectState": {
        "center_x": (2, "double"),
        "center_y": (3, "double"),
        "length": (5, "float"),
        "width": (6, "float"),
        "heading": (8, "float"),
        "velocity_x": (9, "float"),
        "velocity_y": (10, "float"),
        "valid": (11, "bool"),
    },
    "Track": {"id": (1, "int32"), "object_type": (2, "ObjectType"), "states": (3, "*ObjectState")},
    "MapPoint": {"x": (1, "double"), "y": (2, "double")},
    "LaneNeighbor": {"feature_id": (1, "int64")},
    "LaneCenter": {
        "speed_limit_mph": (1, "double"),
        "type": (2, "LaneType"),
        "interpolating": (3, "bool"),
        "polyline": (8, "*MapPoint"),
        "entry_lanes": (9, "*int64"),
        "exit_lanes": (10, "*int64"),
        "left_neighbors": (11, "*LaneNeighbor"),
        "right_neighbors": (12, "*LaneNeighbor"),
    },
    "StopSign": {"lane": (1, "*int64")},
    "Crosswalk": {"polygon": (1, "*MapPoint")},
    "MapFeature": {
        "id": (1, "int64"),
        "lane": (3, "LaneCenter"),
        "stop_sign": (7, "StopSign"),
        "crosswalk": (8, "Crosswalk"),
    },
    "TrafficSignalLaneState": {"lane": (1, "int64"), "state": (2, "State")},
    "DynamicMapState": {"lane_states": (1, "*TrafficSignalLaneState")},
    "Scenario": {
        "timestamps_seconds": (1, "*double"),
        "tracks": (2, "*Track"),
        "scenario_id": (5, "string"),
        "sdc_track_index": (6, "int32"),
        "dynamic_map_states": (7, "*DynamicMapState"),
        "map_features": (8, "*MapFeature"),
    },
}
"""Number and kind of every field that is read, by message; ``*`` marks what repeats."""


ENUMS: Final[dict[str, tuple[str, ...]]] = {
    "Track.ObjectType": (
        "TYPE_UNSET", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_CYCLIST", "TYPE_OTHER",
    ),
    "LaneCenter.LaneType": (
        "TYPE_UNDEFINED", "TYPE_FREEWAY", "TYPE_SURFACE_STREET", "TYPE_BIKE_LANE",
    ),
    "TrafficSignalLaneState.State": (
        "LANE_STATE_UNKNOWN", "LANE_STATE_ARROW_STOP", "LANE_STATE_ARROW_CAUTION",
        "LANE_STATE_ARROW_GO", "LANE_STATE_STOP", "LANE_STATE_CAUTION", "LANE_STATE_GO",
        "LANE_STATE_FLASHING_STOP", "LANE_STATE_FLASHING_CAUTION",
    ),
}  # fmt: skip
"""The names of numbers from 0 on, by message and enumeration; JSON has the names."""


@functools.lru_cache(maxsize=1)
def scenario_class() -> Any:
    """The class of the message ``Scenario``."""
    file = descriptor_pb2.FileDescriptorProto(
        name="graphrqi/waymo_scenario.proto", package=PACKAGE, syntax="proto2"
    )
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for label, (number, kind) in fields.items():
            repeated, plain = kind.startswith("*"), kind.removeprefix("*")
            field = message.field.add(name=label, number=number)
            field.label = field.LABEL_REPEATED if repeated else field.LABEL_OPTIONAL
            values = ENUMS.get(f"{name}.{plain}")
            if plain in _PLAIN:
                field.type = getattr(field, f"TYPE_{plain.upper()}")
            elif values is not None:
                field.type = field.TYPE_ENUM
                field.type_name = f".{PACKAGE}.{name}.{plain}"
                enum = message.enum_type.add(name=plain)
                for value, word in enumerate(values):
                    enum.value.add(name=word, number=value)
            else:
                field.type = field.TYPE_MESSAGE
                field.type_name = f".{PACKAGE}.{plain}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.Scenario"))


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
    """The records of a file, each checked.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.

    Yields:
        Each record's data.

    Raises:
        InputError: naming the file and the record that is broken.
    """
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
