"""Small recordings with maps, by hand: what the tests of formats read, alter and break."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import feather

from sim.formats.waymo import masked_checksum
from sim.frames import FloatArray


def _xy(x: float, y: float) -> str:
    return f"<point><x>{x}</x><y>{y}</y></point>"


def _state(x: float, y: float, heading: float, time: float, speed: float) -> str:
    return (
        f"<position>{_xy(x, y)}</position><orientation><exact>{heading}</exact></orientation>"
        f"<time><exact>{time}</exact></time><velocity><exact>{speed}</exact></velocity>"
    )


COMMONROAD = f"""<?xml version="1.0" encoding="utf-8"?>
<commonRoad benchmarkID="A_B-1_1_T-1" commonRoadVersion="2020a" timeStepSize="0.1">
<lanelet id="1"><leftBound>{_xy(0, 2)}{_xy(50, 2)}</leftBound>
<rightBound>{_xy(0, -2)}{_xy(50, -2)}</rightBound>
<successor ref="2"/><trafficSignRef ref="5"/><trafficLightRef ref="6"/></lanelet>
<lanelet id="2"><leftBound>{_xy(50, 2)}{_xy(90, 2)}</leftBound>
<rightBound>{_xy(50, -2)}{_xy(70, -2)}{_xy(90, -2)}</rightBound></lanelet>
<trafficSign id="5"><trafficSignElement><trafficSignID>274</trafficSignID>
<additionalValue>13.5</additionalValue></trafficSignElement></trafficSign>
<trafficLight id="6"><cycle><cycleElement><duration>300</duration><color>green</color>
</cycleElement><cycleElement><duration>30</duration><color>yellow</color></cycleElement>
<cycleElement><duration>270</duration><color>red</color></cycleElement></cycle></trafficLight>
<intersection id="7"><incoming id="8"><incomingLanelet ref="1"/><successorsStraight ref="2"/>
</incoming></intersection>
<dynamicObstacle id="30"><type>truck</type>
<shape><rectangle><length>8.5</length><width>2.5</width></rectangle></shape>
<initialState>{_state(1, 0, 0, 0, 10)}</initialState>
<trajectory><state>{_state(2, 0.5, 0.25, 1, 10.5)}</state></trajectory></dynamicObstacle>
<staticObstacle id="31"><type>parkedVehicle</type>
<initialState>{_state(9, -3, 0, 0, 0)}</initialState></staticObstacle>
<staticObstacle id="32"><type>pillar</type>
<initialState>{_state(9, -9, 0, 0, 0)}</initialState></staticObstacle>
</commonRoad>
"""
"""A truck and a parked car on two lanelets, the second of which is a junction."""


KITTI_LABELS = """\
0 -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1
0 3 Car 0 0 -1.5 1 2 3 4 1.5 1.75 4.25 2 1.5 10 -1.5707963
0 7 Pedestrian 0 0 0 1 2 3 4 1.75 0.5 0.75 -3 1.5 8 0
1 3 Car 0 0 -1.5 1 2 3 4 1.5 1.75 4.25 2 1.5 9 -1.5707963
"""
"""A car ahead on the right, and a pedestrian on the left, seen from a car that drives a metre."""

KITTI_CALIB = """\
P0: 1 0 0 0 0 1 0 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0
Tr_imu_velo 1 0 0 -0.5 0 1 0 0 0 0 1 0
"""
"""A camera half a metre before the measuring unit: its x is the car's right, its z ahead."""

KITTI_OXTS = "".join(
    f"49.0 {8.0 + metres / 73034.0:.12f} 100 0 0 0" + " 0" * 24 + "\n" for metres in (0.0, 1.0)
)
"""Two poses a metre apart, eastward: a degree of longitude at 49 degrees north is 73.03 km."""


def waymo_message() -> bytes:
    """A scenario of two steps as protobuf: a car, a cyclist seen once, a light and three lanes."""
    from sim.formats.waymo import scenario_class

    scenario = scenario_class()(scenario_id=b"abc123", sdc_track_index=0)
    scenario.timestamps_seconds.extend([0.0, 0.1])
    car = scenario.tracks.add(id=5, object_type=1)
    car.states.add(
        center_x=1, center_y=2, length=4.5, width=2, heading=0.5, velocity_x=3, velocity_y=4,
        valid=True,
    )  # fmt: skip
    car.states.add(
        center_x=1.3, center_y=2.4, length=4.5, width=2, heading=0.5, velocity_x=3, velocity_y=4,
        valid=True,
    )  # fmt: skip
    cyclist = scenario.tracks.add(id=9, object_type=3)
    cyclist.states.add(valid=False)
    cyclist.states.add(
        center_x=8, center_y=9, length=2, width=0.5, heading=-1, velocity_x=1, valid=True
    )
    scenario.tracks.add(id=11, object_type=4).states.add(valid=True, length=1, width=1)
    for identity, y, begin in ((21, 0.0, 0.0), (22, 0.0, 30.0), (23, 3.5, 0.0)):
        lane = scenario.map_features.add(id=identity).lane
        lane.speed_limit_mph, lane.type, lane.interpolating = 30, 2, identity == 22
        for x in (begin, begin + 15, begin + 30):
            lane.polyline.add(x=x, y=y)
    scenario.map_features[0].lane.exit_lanes.append(22)
    scenario.map_features[0].lane.left_neighbors.add(feature_id=23)
    walk = scenario.map_features.add(id=31).crosswalk
    for x, y in ((10, -2), (13, -2), (13, 6), (10, 6)):
        walk.polygon.add(x=x, y=y)
    scenario.map_features.add(id=32).stop_sign.lane.append(23)
    for state in (4, 6):
        scenario.dynamic_map_states.add().lane_states.add(lane=22, state=state)
    data: bytes = scenario.SerializeToString()
    return data


def tfrecord(data: bytes) -> bytes:
    """A record as it is in a file."""
    size = len(data).to_bytes(8, "little")
    sums = [masked_checksum(part).to_bytes(4, "little") for part in (size, data)]
    return b"".join([size, sums[0], data, sums[1]])


def waymo_record() -> bytes:
    """The same as a TFRecord file."""
    return tfrecord(waymo_message())


def scenarionet_scene() -> dict[str, Any]:
    """A scenario as ScenarioNet's converters write one: a turn, a walker, a cone and a light."""
    steps = 5
    zeros = np.zeros(steps, dtype=np.float32)

    def track(kind: str, x: FloatArray, speed: float, size: tuple[float, float]) -> dict[str, Any]:
        flat = x.astype(np.float32)
        return {
            "type": kind,
            "state": {
                "position": np.stack([flat, zeros, zeros], axis=1),
                "velocity": np.stack([zeros + np.float32(speed), zeros], axis=1),
                "heading": zeros,
                "length": zeros + np.float32(size[0]),
                "width": zeros[:, None] + np.float32(size[1]),
                "valid": np.arange(steps) != 1,
            },
            "metadata": {"type": kind, "object_id": kind.lower()},
        }

    line = np.stack([np.linspace(0.0, 20.0, 11), np.zeros(11)], axis=1)
    lanes = {
        str(name): {
            "type": "LANE_SURFACE_STREET", "polyline": line + offset, "speed_limit_mph": 25.0,
            "entry_lanes": before, "exit_lanes": after, "width": np.zeros(2),
            "left_neighbor": [{"feature_id": beside}] if beside else [], "right_neighbor": [],
        }
        for name, offset, before, after, beside in (
            (7, (0.0, 0.0), [], [9], 8), (8, (0.0, 3.25), [], [], None),
            (9, (20.0, 0.0), [7], [], None),
        )
    }  # fmt: skip
    moves = np.linspace(0.0, 4.0, steps)
    return {
        "id": "turn", "version": "0.1", "length": steps,
        "metadata": {"ts": np.arange(steps, dtype=np.float32) / np.float32(10.0), "sdc_id": "car"},
        "tracks": {
            "car": track("VEHICLE", moves, 10.0, (4.5, 1.75)),
            "walker": track("PEDESTRIAN", moves / 10.0, 1.0, (0.5, 0.5)),
            "cone": track("TRAFFIC_CONE", 0.0 * moves, 0.0, (0.25, 0.25)),
        },
        "map_features": {
            **lanes,
            "55": {"type": "CROSSWALK",
                   "polygon": np.array([[18.0, -2.0], [20.0, -2.0], [20.0, 5.0], [18.0, 5.0]])},
            "56": {"type": "ROAD_LINE_SOLID_SINGLE_WHITE", "polyline": line},
        },
        "dynamic_map_states": {
            "7": {"type": "TRAFFIC_LIGHT", "lane": 7, "stop_point": np.zeros(3),
                  "state": {"object_state": ["LANE_STATE_STOP", "LANE_STATE_STOP", None,
                                             "TRAFFIC_LIGHT_GREEN", "LANE_STATE_CAUTION"]}},
        },
    }  # fmt: skip


def feather_bytes(table: pa.Table, compression: str = "lz4", rows: int = 10**6) -> bytes:
    """A table as a Feather file, so many rows in a batch."""
    sink = io.BytesIO()
    feather.write_feather(table, sink, compression=compression, chunksize=rows)
    return sink.getvalue()


def sensor_log() -> dict[str, bytes]:
    """The files of an Argoverse 2 sensor log: three agents and a cone in four sweeps.

    The car drives north-west and turns; there are poses between the sweeps, as in originals.
    """
    stamps = 315968112437425433 + np.array([0, 99_987_421, 200_010_113, 299_999_871])
    half = np.array([0.9, 1.0, 1.1, 1.2])  # half of the heading, rad
    turn = {"qw": -np.cos(half), "qx": 0 * half, "qy": 0 * half, "qz": -np.sin(half)}
    places = {"tx_m": 747.4 - half, "ty_m": 1275.3 + 2 * half, "tz_m": -24.0 + half}
    stamps_of_poses = np.append(stamps, stamps[:-1] + 50_000_017)
    poses = {"timestamp_ns": stamps_of_poses} | {
        name: np.append(values, values[:-1]) for name, values in (turn | places).items()
    }
    rows = [
        {
            "timestamp_ns": int(stamp), "track_uuid": f"{agent:08d}-0000", "category": category,
            "length_m": 4.5, "width_m": 1.9, "height_m": 1.6,
            "qw": float(np.cos(0.3 * agent)), "qx": 0.0, "qy": 0.0,
            "qz": float(np.sin(0.3 * agent)), "tx_m": 10.0 * agent + k, "ty_m": -5.0 + agent,
            "tz_m": 0.5, "num_interior_pts": 40 - k,
        }
        for k, stamp in enumerate(stamps)
        for agent, category in enumerate(
            ("REGULAR_VEHICLE", "PEDESTRIAN", "BICYCLIST", "CONSTRUCTION_CONE")
        )
    ]  # fmt: skip
    line = [{"x": 740.0 + x, "y": 1270.0 + 2.0 * x, "z": 0.0} for x in range(0, 30, 10)]
    lane: dict[str, Any] = {
        "id": 7, "is_intersection": False, "lane_type": "VEHICLE",
        "left_lane_boundary": [one | {"x": one["x"] - 3.5} for one in line],
        "right_lane_boundary": line, "left_neighbor_id": None, "right_neighbor_id": None,
        "predecessors": [], "successors": [],
    }  # fmt: skip
    archive = {"drivable_areas": {}, "lane_segments": {"7": lane}, "pedestrian_crossings": {}}
    return {
        "annotations.feather": feather_bytes(pa.Table.from_pylist(rows)),
        "city_SE3_egovehicle.feather": feather_bytes(pa.table(poses)),
        "map/log_map_archive_s____PIT_city_31785.json": json.dumps(archive).encode(),
    }
