"""Waymo scenarios: written by the published schema, with known answers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.formats import read_recordings, recognise
from sim.formats.common.recording import Recording
from sim.frames import KINDS, AgentKind
from sim.road import Road
from tests.sim.scenes import waymo_message, waymo_record


def read(path: Path, content: bytes | str) -> Recording:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    (recording,) = read_recordings(path)
    return recording


# --- known answers ------------------------------------------------------------------------------


def check(recording: Recording) -> None:
    tracks, road = recording.tracks, recording.road
    assert tracks.names == ("5", "9")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.CAR, AgentKind.BICYCLE]
    assert tracks.xy[0].tolist() == [[1.0, 2.0], [1.3, 2.4]]
    assert tracks.speed[0].tolist() == [5.0, 5.0]
    assert tracks.valid.tolist() == [[True, True], [False, True]]
    assert (tracks.length[0], tracks.width[1]) == (4.5, 0.5)
    assert tracks.signals.tolist() == [[0, 2]]
    assert any("1 objects" in note for note in recording.notes)
    assert isinstance(road, Road)
    assert [lane.id for lane in road.lanes] == ["21", "22", "23"]
    assert [crossing.id for crossing in road.crossings] == ["31"]


def test_tfrecord(tmp_path: Path) -> None:
    path = tmp_path / "training.tfrecord-00000-of-01000"
    recording = read(path, waymo_record())
    check(recording)
    assert recognise(tmp_path) == "womd"
    road = recording.road
    assert isinstance(road, Road)
    first, across, left = road.lanes
    assert first.speed_limit_mps == pytest.approx(13.41, abs=0.01)
    assert (first.width_m, across.internal, left.edge) == (3.5, True, first.edge)
    (way,) = road.connections
    assert (way.from_lane, way.to_lane, way.signal) == ("21", "22", 0)
    assert road.crossings[0].width_m == pytest.approx(3.0)
    assert road.knows.unknown == ("priority",)


def protobuf_json() -> dict[str, Any]:
    from google.protobuf.json_format import MessageToDict

    from sim.formats.waymo import scenario_class

    told: dict[str, Any] = MessageToDict(scenario_class().FromString(waymo_message()))
    told["scenarioId"] = "abc123"
    for track, word in zip(told["tracks"], ("VEHICLE", "CYCLIST", "OTHER"), strict=True):
        track["objectType"] = f"TYPE_{word}"
    for shown, word in zip(told["dynamicMapStates"], ("STOP", "GO"), strict=True):
        shown["laneStates"][0]["state"] = f"LANE_STATE_{word}"
    return told


def test_protobufs_own_json(tmp_path: Path) -> None:
    recording = read(tmp_path / "a.json", json.dumps(protobuf_json()))
    check(recording)
    assert isinstance(recording.road, Road)
    assert recording.road.lanes[0].speed_limit_mps == pytest.approx(13.41, abs=0.01)


@pytest.mark.parametrize("unit", [1.0, 180 / math.pi], ids=["radians", "degrees"])
def test_the_json_of_nocturne_and_gpudrive(tmp_path: Path, unit: float) -> None:
    def one(name: str, identity: int, *states: tuple[float, ...] | None) -> dict[str, Any]:
        rows = [(-1e4,) * 5 if state is None else state for state in states]
        size = {5: (4.5, 2.0), 9: (2.0, 0.5), 11: (1.0, 1.0)}[identity]
        return {
            "type": name, "id": identity, "length": size[0], "width": size[1],
            "position": [{"x": r[0], "y": r[1], "z": 0.0} for r in rows],
            "heading": [r[2] * unit for r in rows],
            "velocity": [{"x": r[3], "y": r[4]} for r in rows],
            "valid": [state is not None for state in states],
            "goalPosition": {"x": 0, "y": 0},
        }  # fmt: skip

    lines = {21: (0, 0, 30), 22: (0, 30, 60), 23: (3.5, 0, 30)}
    scenario = {
        "name": "tfrecord-00000-of-01000_4.json", "scenario_id": "abc123",
        "objects": [
            one("vehicle", 5, (1, 2, 0.93, 3, 4), (1.3, 2.4, 0.93, 3, 4)),
            one("cyclist", 9, None, (8, 9, 0.1, 2, 0)),
            one("other", 11, (0, 0, 0, 0, 0), (0, 0, 0, 0, 0)),
        ],
        "roads": [
            {"type": "lane", "id": i, "geometry": [{"x": a, "y": y}, {"x": b, "y": y}]}
            for i, (y, a, b) in lines.items()
        ] + [{"type": "road_edge", "id": 40, "geometry": [{"x": 0, "y": 9}]},
             {"type": "crosswalk", "id": 31, "geometry": [
                 {"x": 10, "y": -2}, {"x": 13, "y": -2}, {"x": 13, "y": 6}, {"x": 10, "y": 6}]}],
        "tl_states": {"22": {"state": ["stop", "go"], "x": [0, 0], "y": [0, 0],
                             "time_index": [0, 1]}},
    }  # fmt: skip
    recording = read(tmp_path / "a.json", json.dumps(scenario))
    check(recording)
    assert recording.name == "abc123"
    np.testing.assert_allclose(recording.tracks.heading[0], 0.93)
    assert isinstance(recording.road, Road)
    assert [(w.from_lane, w.to_lane) for w in recording.road.connections] == [("21", "22")]
    assert recording.road.knows.unknown == ("limits", "priority")
