"""CommonRoad: a hand-made scenario with known answers, its versions, its map, and real ones."""

from __future__ import annotations

import dataclasses
import gzip
import math
import os
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import import_recordings
from sim.formats import read_recordings, recognise
from sim.formats.common.recording import Recording
from sim.frames import KINDS, AgentKind
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.road_files import encode_road, read_road_file, read_stored
from sim.store.dataset import open_dataset
from tests.sim.scenes import COMMONROAD


def read(folder: Path, text: str = COMMONROAD) -> Recording:
    path = folder / "scene.xml"
    path.write_text(text)
    (recording,) = read_recordings(path)
    return recording


def test_obstacles(tmp_path: Path) -> None:
    recording = read(tmp_path)
    tracks = recording.tracks
    assert recognise(tmp_path) == "commonroad"
    assert tracks.names == ("30", "31")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.TRUCK, AgentKind.CAR]
    assert tracks.time_s.tolist() == [0.0, 0.1]
    assert tracks.xy[0].tolist() == [[1.0, 0.0], [2.0, 0.5]]
    assert tracks.heading[0].tolist() == [0.0, 0.25]
    assert tracks.speed.tolist() == [[10.0, 10.5], [0.0, 0.0]]
    assert tracks.length.tolist() == [8.5, 4.5]
    assert tracks.signals.tolist() == [[2, 2]]
    assert "pillar" in " ".join(recording.notes)


def test_the_map(tmp_path: Path) -> None:
    road = read(tmp_path).road
    assert isinstance(road, Road)
    first, second = road.lanes
    assert (first.id, second.id) == ("1", "2")
    assert first.centerline.tolist() == [[0.0, 0.0], [50.0, 0.0]]
    assert (first.width_m, second.width_m) == (4.0, 4.0)
    assert (first.speed_limit_mps, second.internal) == (13.5, True)
    assert math.isnan(second.speed_limit_mps)
    (way,) = road.connections
    assert (way.from_lane, way.to_lane, way.direction, way.signal) == ("1", "2", "straight", 0)
    assert road.signal_plans[0].state_at(31.0) == (1,)
    assert road.knows.unknown == ("priority",)
    assert len(LaneGraph.of(road).length) == 2


def test_who_yields_at_signs(tmp_path: Path) -> None:
    side = COMMONROAD[COMMONROAD.index('<lanelet id="1"') :].split("</lanelet>")[0] + "</lanelet>"
    side = side.replace('id="1"', 'id="3"').replace('ref="5"', 'ref="9"')
    side = side.replace("<y>2<", "<y>22<").replace("<y>-2<", "<y>18<")
    text = COMMONROAD.replace("<trafficSign id", side + "<trafficSign id", 1)
    text = text.replace(
        "</trafficSign>",
        '</trafficSign><trafficSign id="9"><trafficSignElement><trafficSignID>205</trafficSignID>'
        "</trafficSignElement></trafficSign>",
    )
    text = text.replace(
        "</intersection>",
        '<incoming id="10"><incomingLanelet ref="3"/><successorsRight ref="2"/></incoming>'
        "</intersection>",
    )
    road = read(tmp_path, text).road
    assert isinstance(road, Road)
    assert [(way.from_lane, way.must_yield, way.yields_to) for way in road.connections] == [
        ("1", False, ()),
        ("3", True, (0,)),
    ]
    assert road.knows.priority


def test_a_road_is_stored_as_it_is(tmp_path: Path) -> None:
    road = read(tmp_path).road
    assert isinstance(road, Road)
    path = tmp_path / "a.road.json"
    path.write_bytes(encode_road(road))
    back = read_stored(path)
    assert encode_road(back) == path.read_bytes()
    assert back.connections == road.connections
    assert back.signal_plans == road.signal_plans
    assert back.knows == road.knows
    np.testing.assert_array_equal(back.lanes[1].centerline, road.lanes[1].centerline)
    twice = dataclasses.replace(road, signal_plans=2 * road.signal_plans)
    path.write_bytes(encode_road(twice))
    os.utime(path, (1, 1))
    with pytest.raises(InputError, match="signal_plans: found others, expected each group once"):
        read_stored(path)
    path.write_bytes(encode_road(road).replace(b'"to_lane": "2"', b'"to_lane": "9"'))
    os.utime(path, (0, 0))
    with pytest.raises(InputError, match="expected lanes of the road"):
        read_stored(path)


def test_import_keeps_the_map(tmp_path: Path) -> None:
    source = tmp_path / "scenes"
    source.mkdir()
    (source / "a.xml.gz").write_bytes(gzip.compress(COMMONROAD.encode()))
    (source / "b.xml").write_text(COMMONROAD.replace("<x>9</x>", "<x>8</x>"))
    import_recordings(source, tmp_path / "data", quiet=True)
    dataset = open_dataset(tmp_path / "data")
    first, second = dataset.episodes()
    assert first.road == second.road  # the map is the same, and kept once
    road = dataset.road(first)
    assert road is not None
    assert [lane.id for lane in road.lanes] == ["1", "2"]
    assert [lane.id for lane in read_road_file(source / "a.xml.gz").lanes] == ["1", "2"]


@pytest.mark.parametrize("place", ["us101", "lankershim", "peachtree"])
def test_real_scenarios(place: str, shared_data: Path) -> None:
    files = sorted((shared_data / "real" / f"ngsim_{place}").glob("*.gz"))[::7]
    for file in files:
        (recording,) = read_recordings(file)
        road, tracks = recording.road, recording.tracks
        assert isinstance(road, Road)
        assert tracks.step_s == pytest.approx(0.1)
        assert not any("step" in note for note in recording.notes)
        at = LaneGraph.of(road).project(tracks.xy[tracks.valid], tracks.heading[tracks.valid])
        width = np.array([lane.width_m for lane in road.lanes])[at.lane]
        assert np.mean(np.abs(at.offset) < width / 2) > 0.9


@pytest.mark.parametrize("bad", ["<rightBound/>", "<x>1</x>", "<speedLimit>-5</speedLimit>"])
def test_one_bad_lanelet_is_left_out(tmp_path: Path, bad: str) -> None:
    good = COMMONROAD[COMMONROAD.index('<lanelet id="1"') :].split("</lanelet>")[0] + "</lanelet>"
    one = good.replace('id="1"', 'id="3"').replace("</lanelet>", f"{bad}</lanelet>")
    if bad == "<rightBound/>":
        one = one[: one.index("<rightBound>")] + bad + one[one.index("</rightBound>") + 13 :]
    elif bad == "<x>1</x>":
        one = one.replace("<y>2<", "<y>two<", 1)
    road = read(tmp_path, COMMONROAD.replace(good, good + one, 1)).road
    assert isinstance(road, Road)
    assert [lane.id for lane in road.lanes] == ["1", "2"]
    assert "1 lanelets are left out, first" in road.doubts[0]
