"""Formats: hand-made samples with hand-computed answers, and round trips."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from behaviors import BEHAVIORS, InputError
from scenarios import SCENARIOS
from sim.formats import FORMATS, get_reader, get_writer, read_recordings, recognise
from sim.formats.common.recording import row_motion
from sim.frames import KINDS, AgentKind, Tracks
from tests.sim.scenes import (
    COMMONROAD,
    KITTI_CALIB,
    KITTI_LABELS,
    KITTI_OXTS,
    scenarionet_scene,
    sensor_log,
    waymo_record,
)

AV1 = """TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME
100.0,b,AGENT,0,0,MIA
100.0,a,AV,5,5,MIA
101.0,b,AGENT,3,4,MIA
101.0,a,AV,5,5,MIA
"""
NGSIM_ROW = (
    "2224 {frame} 1902 {time} 41.429 {y} 6042814.264 2133542.012 14.3 6.9 2 26.54 -0.76 4 2208 "
    "2211 53.34 2.01\n"
)
NGSIM_ROWS = NGSIM_ROW.format(frame=6548, time=1113437421700, y=472.901) + NGSIM_ROW.format(
    frame=6549, time=1113437421800, y=475.555
)
NGSIM_HEADER = (
    "vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_Length,"
    "v_Width,v_Class,v_Vel,v_Acc,Lane_ID,Preceding,Following,Space_Headway,Time_Headway"
)
NGSIM_CSV = "\n".join([NGSIM_HEADER, *(r.replace(" ", ",") for r in NGSIM_ROWS.splitlines()), ""])
IND = """recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,\
yVelocity
7,0,50,0,12.5,-30.25,90.0,1.9,4.7,0.0,8.0
7,1,50,0,2.0,3.0,270.0,0.0,0.0,0.6,-0.8
7,0,51,1,12.5,-29.93,90.0,1.9,4.7,0.0,8.0
"""
IND_META = "recordingId,trackId,class\n7,0,truck_bus\n7,1,pedestrian\n"
HIGHD = """frame,id,x,y,width,height,xVelocity,yVelocity
25,1,10.0,5.0,4.0,2.0,-20.0,0.0
26,1,9.2,5.0,4.0,2.0,-20.0,0.0
25,2,100.0,20.0,12.0,2.5,30.0,1.0
"""
INTERACTION = """track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width
1,1,100,car,1000.5,990.25,3.0,-4.0,-0.9273,4.2,1.8
1,2,200,car,1000.8,989.85,3.0,-4.0,-0.9273,4.2,1.8
"""
INTERACTION_WALKERS = """track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy
P1,1,100,pedestrian/bicycle,1.0,2.0,0.0,1.5
"""
FCD = """<?xml version="1.0" encoding="UTF-8"?>
<fcd-export>
    <timestep time="0.10">
        <vehicle id="east" x="10.00" y="5.00" angle="90.00" type="long" speed="7.5" pos="1" \
lane="e_0" slope="0" behavior="timid"/>
        <vehicle id="north" x="1.00" y="2.00" angle="0.00" type="unheard" speed="3"/>
        <person id="walker" x="0.00" y="0.00" angle="180.00" speed="1.25" pos="1" edge="e"/>
    </timestep>
    <timestep time="0.20"/>
</fcd-export>
"""
FCD_TYPES = '<additional><vType id="long" vClass="bus" length="5" width="2.5"/></additional>'
TRAF = "1,2,100,200,40,20,7,0,0,10,10,9\n2,2,104,200,40,20,7,4,3,10,10,9\n"
ARGO = "frame,id,x,y\n0,1,0,0\n1,1,0.3,0.4\n"


def argoverse2() -> bytes:
    rows: list[dict[str, Any]] = []
    for step, (x, y) in enumerate([(0.1, 0.2), (0.7, 1.0)]):
        rows.append({"track_id": "AV", "object_type": "vehicle", "position_x": x, "position_y": y})
        rows[-1] |= {"heading": 0.9272952180016122, "velocity_x": 6.0, "velocity_y": 8.0}
        rows[-1] |= {"timestep": step, "observed": True, "object_category": 3}
    rows.append({**rows[0], "track_id": "7", "object_type": "cyclist", "velocity_y": 0.0})
    rows.append({**rows[0], "track_id": "8", "object_type": "static"})
    for row in rows:
        row |= {"scenario_id": "s", "start_timestamp": 0.0, "end_timestamp": 10.9e9}
        row |= {"num_timestamps": 110, "focal_track_id": "AV", "city": "austin", "map_id": 1}
        row |= {"slice_id": "s"}
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows), sink)
    return sink.getvalue().to_pybytes()


PAIRS = """pair,period,follower,leader,t,x_follower,v_follower,x_leader,v_leader,leader_length
0,0400pm,1032,1025,293.2,62.5,17.5,192.5,35.0,15.0
0,0400pm,1032,1025,293.3,64.25,18.5,196.0,35.0,15.0
"""

SAMPLES: dict[str, tuple[str, bytes]] = {
    "argoverse2": ("scenario_s.parquet", argoverse2()),
    "argoverse2-log": ("annotations.feather", sensor_log()["annotations.feather"]),
    "argoverse1": ("one.csv", AV1.encode()),
    "ngsim": ("trajectories.csv", NGSIM_CSV.encode()),
    "ind": ("07_tracks.csv", IND.encode()),
    "round": ("07_tracks.csv", IND.encode()),
    "highd": ("01_tracks.csv", HIGHD.encode()),
    "interaction": ("vehicle_tracks_000.csv", INTERACTION.encode()),
    "sumo-fcd": ("fcd.xml", FCD.encode()),
    "commonroad": ("scene.xml", COMMONROAD.encode()),
    "kitti": ("label_02/0000.txt", KITTI_LABELS.encode()),
    "womd": ("a.tfrecord", waymo_record()),
    "scenarionet": ("sd_turn.pkl", pickle.dumps(scenarionet_scene(), protocol=4)),
    "traf": ("TRAF_gt.txt", TRAF.encode()),
    "argo": ("argo1_tracks.csv", ARGO.encode()),
    "pairs": ("pairs.csv", PAIRS.encode()),
}
for key, entry in FORMATS.items():
    if entry.example:  # formats added from outside bring their own sample
        SAMPLES[key] = (entry.files[0].replace("*", "example"), entry.example)
BESIDE = {
    "kitti": {"oxts/0000.txt": KITTI_OXTS.encode(), "calib/0000.txt": KITTI_CALIB.encode()},
    "argoverse2-log": {name: data for name, data in sensor_log().items() if "SE3" in name},
}
"""Files that must lie beside a format's sample."""
READABLE = [name for name, entry in FORMATS.items() if entry.reader]
WRITABLE = [name for name, entry in FORMATS.items() if entry.writer]
WITH_HEADER = ("argoverse1", "ngsim", "ind", "round", "highd", "interaction", "argo", "pairs")
"""Text formats whose first line names the columns."""


def put(folder: Path, name: str, content: bytes | None = None) -> Path:
    file, sample = SAMPLES[name]
    for beside, text in BESIDE.get(name, {}).items():
        (folder / beside).parent.mkdir(exist_ok=True)
        (folder / beside).write_bytes(text)
    path = folder / file
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(sample if content is None else content)
    return path


def read(path: Path, name: str) -> Tracks:
    (recording,) = get_reader(name)(path)
    return recording.tracks


def row(tracks: Tracks, name: str) -> int:
    return tracks.names.index(name)


# --- hand-computed ------------------------------------------------------------------------------


def test_every_readable_format_has_a_sample() -> None:
    assert set(SAMPLES) == set(READABLE)


def test_argoverse2(tmp_path: Path) -> None:
    tracks = read(put(tmp_path, "argoverse2"), "argoverse2")
    assert tracks.names == ("7", "AV")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.BICYCLE, AgentKind.CAR]
    assert tracks.xy[1].tolist() == [[0.1, 0.2], [0.7, 1.0]]
    assert tracks.heading[1].tolist() == [0.9272952180016122] * 2
    assert tracks.speed[:, 0].tolist() == [6.0, 10.0]
    assert tracks.time_s.tolist() == [0.0, 0.1]
    assert tracks.valid.tolist() == [[True, False], [True, True]]


def test_argoverse1(tmp_path: Path) -> None:
    tracks = read(put(tmp_path, "argoverse1"), "argoverse1")
    b = row(tracks, "b")
    assert tracks.time_s.tolist() == [0.0, 1.0]
    assert tracks.speed[b].tolist() == [5.0, 5.0]
    np.testing.assert_allclose(tracks.heading[b], math.atan2(4, 3))
    assert tracks.speed[row(tracks, "a")].tolist() == [0.0, 0.0]
    assert tracks.length.tolist() == [4.5, 4.5]


@pytest.mark.parametrize("text", [True, False], ids=["text", "csv"])
def test_ngsim_is_in_feet_and_gives_the_front(tmp_path: Path, text: bool) -> None:
    path = tmp_path / "trajectories.txt"
    path.write_text(NGSIM_ROWS)
    tracks = read(path if text else put(tmp_path, "ngsim"), "ngsim")
    assert tracks.names == ("2224",)
    np.testing.assert_allclose(tracks.time_s, [0.0, 0.1], atol=1e-9)
    np.testing.assert_allclose(tracks.xy[0, 0], [12.6275592, 141.9609048], atol=1e-7)
    np.testing.assert_allclose(tracks.heading[0], math.pi / 2)
    np.testing.assert_allclose(tracks.speed[0], 8.089392)
    np.testing.assert_allclose([tracks.length[0], tracks.width[0]], [4.35864, 2.10312])


def test_ngsim_locations_and_ids_used_again(tmp_path: Path) -> None:
    lines = NGSIM_CSV.splitlines()
    again = lines[1].replace(",1902,", ",300,").replace(",41.429,", ",10.0,")
    path = tmp_path / "all.csv"
    path.write_text(f"{lines[0]},Location\n{lines[1]},us-101\n{lines[2]},i-80\n{again},us-101\n")
    recordings = list(read_recordings(path))
    assert [r.name for r in recordings] == ["all-i-80", "all-us-101"]
    assert recordings[1].tracks.names == ("2224-1902", "2224-300")


def test_ind_has_degrees(tmp_path: Path) -> None:
    (tmp_path / "07_tracksMeta.csv").write_text(IND_META)
    (tmp_path / "07_recordingMeta.csv").write_text("recordingId,frameRate\n7,50\n")
    tracks = read(put(tmp_path, "ind"), "ind")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.TRUCK, AgentKind.PEDESTRIAN]
    assert tracks.time_s.tolist() == [1.0, 1.02]
    assert tracks.xy[0, 0].tolist() == [12.5, -30.25]
    np.testing.assert_allclose(tracks.heading[:, 0], [math.pi / 2, -math.pi / 2])
    np.testing.assert_allclose(tracks.speed[:, 0], [8.0, 1.0])
    assert tracks.length.tolist() == [4.7, 0.25]


def test_highd_gives_the_upper_left_corner_and_y_down(tmp_path: Path) -> None:
    tracks = read(put(tmp_path, "highd"), "highd")
    assert tracks.time_s.tolist() == [1.0, 1.04]
    np.testing.assert_allclose(tracks.xy[0], [[12.0, -6.0], [11.2, -6.0]])
    assert tracks.xy[1, 0].tolist() == [106.0, -21.25]
    np.testing.assert_allclose(tracks.heading[:, 0], [math.pi, -math.atan2(1, 30)])
    assert tracks.length.tolist() == [4.0, 12.0]
    assert tracks.width.tolist() == [2.0, 2.5]


def test_interaction_with_pedestrians(tmp_path: Path) -> None:
    (tmp_path / "pedestrian_tracks_000.csv").write_text(INTERACTION_WALKERS)
    put(tmp_path, "interaction")
    (recording,) = read_recordings(tmp_path)  # one recording, not one per file
    tracks = recording.tracks
    assert tracks.names == ("1", "P1")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.CAR, AgentKind.PEDESTRIAN]
    assert tracks.time_s.tolist() == [0.1, 0.2]
    assert tracks.xy[0, 0].tolist() == [1000.5, 990.25]
    assert tracks.heading[0, 0] == -0.9273
    assert tracks.speed[:, 0].tolist() == [5.0, 1.5]
    assert tracks.heading[1, 0] == pytest.approx(math.pi / 2)


def test_sumo_fcd_gives_the_front_bumper_clockwise_from_north(tmp_path: Path) -> None:
    path = put(tmp_path, "sumo-fcd")
    (tmp_path / "fcd.types.xml").write_text(FCD_TYPES)
    (recording,) = get_reader("sumo-fcd")(path)
    tracks = recording.tracks
    east, north, walker = (row(tracks, name) for name in ("east", "north", "walker"))
    np.testing.assert_allclose(tracks.xy[east, 0], [7.5, 5.0])
    np.testing.assert_allclose(tracks.xy[north, 0], [1.0, -0.25])
    np.testing.assert_allclose(tracks.xy[walker, 0], [0.0, 0.125], atol=1e-12)
    np.testing.assert_allclose(tracks.heading[:, 0], [0.0, math.pi / 2, -math.pi / 2])
    kinds = [KINDS[k] for k in tracks.kind]
    assert kinds == [AgentKind.BUS, AgentKind.CAR, AgentKind.PEDESTRIAN]
    assert tracks.behavior is not None
    assert [BEHAVIORS[c] if c >= 0 else None for c in tracks.behavior] == ["timid", None, None]
    assert "no known vType" in recording.notes[0]
    assert tracks.time_s.tolist() == [0.1, 0.2]  # nobody is seen at the second


def test_traf_gives_corners_of_boxes_in_pixels(tmp_path: Path) -> None:
    tracks = read(put(tmp_path, "traf"), "traf")
    assert tracks.names == ("7", "9")
    assert tracks.xy[0].tolist() == [[120.0, 270.0], [124.0, 270.0]]
    np.testing.assert_allclose(tracks.speed[1], 5.0 * 25.0)
    assert (tracks.length[0], tracks.width[0]) == (40.0, 20.0)


def test_traf_ids_that_name_two_boxes_at_once(tmp_path: Path) -> None:
    lines = [
        "1,1,0,0,10,10,3",
        "2,2,300,0,10,10,3,1,0,10,10,3",
        "3,2,2,0,10,10,3,301,0,10,10,3",
    ]
    path = put(tmp_path, "traf", ("\n".join(lines) + "\n").encode())
    (recording,) = get_reader("traf")(path)
    tracks = recording.tracks
    assert tracks.names == ("3", "3-2")
    assert tracks.xy[0, :, 0].tolist() == [5.0, 6.0, 7.0]
    assert tracks.xy[1, 1:, 0].tolist() == [305.0, 306.0]
    assert "1 boxes had an id" in recording.notes[-1]


def test_argo(tmp_path: Path) -> None:
    tracks = read(put(tmp_path, "argo"), "argo")
    np.testing.assert_allclose(tracks.speed[0], 5.0)
    np.testing.assert_allclose(tracks.time_s, [0.0, 0.1])


def test_pairs_of_cars_on_a_line(tmp_path: Path) -> None:
    """In feet where a leader of 15 is no lorry; else in metres, and x_leader is its rear."""
    tracks = read(put(tmp_path, "pairs"), "pairs")
    assert tracks.names == ("1025", "1032")
    np.testing.assert_allclose(tracks.xy[0, :, 0], (np.array([192.5, 196.0]) - 7.5) * 0.3048)
    np.testing.assert_allclose(tracks.xy[1, 0], [62.5 * 0.3048 - 2.25, 0.0])
    np.testing.assert_allclose(tracks.speed[:, 0], [35.0 * 0.3048, 17.5 * 0.3048])
    assert tracks.length.tolist() == [15.0 * 0.3048, 4.5]
    path = tmp_path / "test_track.csv"
    path.write_text("t,x_follower,v_follower,x_leader,v_leader,leader_length\n"
                    "1,0,14,48,16,0\n1.1,1.4,14,49.6,16,0\n")  # fmt: skip
    (recording,) = read_recordings(path)
    gap = recording.tracks.xy[1, 0, 0] - recording.tracks.xy[0, 0, 0] - 4.5
    assert recording.tracks.names == ("follower", "leader")
    assert gap == pytest.approx(48.0)


def test_motion_holds_the_heading_at_rest() -> None:
    x = np.array([0.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    xy, time_s = np.stack([x, np.zeros(6)], axis=1), np.array([0.0, 1.0, 2.0, 3.0, 4.0, 6.0])
    heading, speed = row_motion(np.zeros(6, dtype=np.int64), xy, time_s, rest_heading=9.0)
    assert speed[:5].tolist() == [1.0, 1.0, 0.5, 0.0, 0.0]
    assert heading.tolist() == [0.0] * 6
    agent, time_s = np.array([0, 0, 0, 1, 1, 1, 1]), np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 3.0])
    xy = np.array([[7, 0], [7, 0], [7, 0], [0, 0], [0, 0], [0, 8], [0, 8]], dtype=float)
    held, _ = row_motion(agent, xy, time_s, rest_heading=9.0)
    assert held.tolist() == [9.0] * 3 + [np.pi / 2] * 4


# --- the contract of every reader ---------------------------------------------------------------


@pytest.mark.parametrize("name", READABLE)
def test_formats_are_recognised(tmp_path: Path, name: str) -> None:
    path = put(tmp_path, name)
    assert recognise(path) == ("ind" if name == "round" else name)
    assert recognise(tmp_path) == ("ind" if name == "round" else name)
    (recording,) = read_recordings(tmp_path)
    assert recording.tracks.valid.any()


def same(one: Tracks, two: Tracks) -> bool:
    return one.names == two.names and all(
        np.array_equal(getattr(one, f), getattr(two, f), equal_nan=True)
        for f in ("time_s", "xy", "heading", "speed", "valid", "length", "width", "kind")
    )


@pytest.mark.parametrize("name", WITH_HEADER)
def test_the_order_of_rows_does_not_matter(tmp_path: Path, name: str) -> None:
    path = put(tmp_path, name)
    expected = read(path, name)
    header, *rows = SAMPLES[name][1].decode().splitlines()
    put(tmp_path, name, "\r\n".join([header, *rows[::-1], ""]).encode())
    assert same(read(path, name), expected)


TEXTS = [n for n in READABLE if n not in ("argoverse2", "argoverse2-log", "womd", "scenarionet")]


def refused(path: Path, name: str, *told: str) -> None:
    with pytest.raises(InputError) as caught:
        list(get_reader(name)(path))
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    for word in told:
        assert word in message, message


@pytest.mark.parametrize("name", [n for n in TEXTS if n != "traf"])
def test_an_agent_twice_at_one_time(tmp_path: Path, name: str) -> None:
    content = SAMPLES[name][1]
    if name == "sumo-fcd":
        line = next(one for one in content.splitlines() if b"person" in one)
        content = content.replace(line, line + b"\n" + line)
    elif name == "commonroad":
        content = content.replace(b"<time><exact>1<", b"<time><exact>0<")
    else:
        content += content.splitlines()[-1] + b"\n"
    found = list(get_reader(name)(put(tmp_path, name, content)))
    if name != "commonroad":
        assert any("twice" in doubt for doubt in found[0].doubts)


# --- writing ------------------------------------------------------------------------------------


def episode(steps: int = 120) -> Tracks:
    """Three vehicles and a pedestrian; one vehicle leaves early, one drives a curve."""
    t = np.arange(steps) / 10.0
    curve = np.stack([50 * np.sin(t / 10), 50 - 50 * np.cos(t / 10)], axis=1)
    straight = np.stack([13.0 * t, 0 * t], axis=1)
    beside = np.stack([7.0 * t, 3.2 + 0 * t], axis=1)
    walking = np.stack([20 + 0 * t, -5 + 1.3 * t], axis=1)
    xy = np.stack([straight, curve, beside, walking])
    heading = np.stack([0 * t, t / 10, 0 * t, np.pi / 2 + 0 * t])
    speed = np.stack([13 + 0 * t, 5 + 0 * t, 7 + 0 * t, 1.3 + 0 * t])
    valid = np.ones((4, steps), dtype=bool)
    valid[2, 60:] = False
    return Tracks.of_dense(
        ids=np.arange(4),
        names=("0", "1", "2", "3"),
        kind=np.array([0, 2, 3, 5], dtype=np.int8),
        length=np.array([4.4, 9.0, 2.2, 0.25]),
        width=np.array([1.8, 2.5, 0.8, 0.5]),
        time_s=t,
        xy=np.where(valid[..., None], xy, np.nan),
        heading=np.where(valid, heading, np.nan),
        speed=np.where(valid, speed, np.nan),
        valid=valid,
        signals=np.empty((0, steps), dtype=np.int8),
        behavior=np.array([0, 5, 3, -1], dtype=np.int8),
    )


@pytest.mark.parametrize("name", [n for n in WRITABLE if n in READABLE])
def test_what_is_written_reads_back(tmp_path: Path, name: str) -> None:
    tracks = episode()
    road = SCENARIOS["straight_road"]().road
    assert get_writer(name)(tmp_path, "episode", tracks, road)
    back = next(iter(read_recordings(tmp_path, name))).tracks
    steps = back.time_s.size
    np.testing.assert_allclose(back.time_s, tracks.time_s[:steps], atol=1e-9)
    assert back.names == tracks.names
    np.testing.assert_array_equal(back.valid, tracks.valid[:, :steps])
    np.testing.assert_allclose(back.xy, tracks.xy[:, :steps], atol=1e-9)
    if name != "argoverse1":
        np.testing.assert_allclose(back.heading, tracks.heading[:, :steps], atol=1e-9)
        np.testing.assert_allclose(back.speed, tracks.speed[:, :steps], atol=1e-9)


def test_the_official_argoverse2_package_takes_what_is_written(tmp_path: Path) -> None:
    loader = pytest.importorskip("av2.datasets.motion_forecasting.scenario_serialization")
    from av2.datasets.motion_forecasting.viz.scenario_visualization import visualize_scenario
    from av2.map.map_api import ArgoverseStaticMap

    road = SCENARIOS["four_way_intersection"]().road
    (home,) = get_writer("argoverse2")(tmp_path, "episode", episode(), road)
    scenario = loader.load_argoverse_scenario_parquet(home / f"scenario_{home.name}.parquet")
    assert [track.track_id for track in scenario.tracks] == ["0", "1", "2", "3"]
    tracks = episode()
    for row, track in enumerate(scenario.tracks):
        places = [state.position for state in track.object_states]
        there = tracks.xy[row, :110][tracks.valid[row, :110]]
        np.testing.assert_array_equal(places, there)
    archive = ArgoverseStaticMap.from_json(home / f"log_map_archive_{home.name}.json")
    assert len(archive.vector_lane_segments) == sum(not lane.walking for lane in road.lanes)
    assert archive.vector_pedestrian_crossings
    visualize_scenario(scenario, archive, tmp_path / "drawn.mp4")
    assert (tmp_path / "drawn.mp4").stat().st_size > 10_000


def test_scenarionet_is_a_plain_dictionary(tmp_path: Path) -> None:
    from sim.formats.scenarionet import description

    told = description("episode", episode(), SCENARIOS["straight_road"]().road)
    agent = told["tracks"]["2"]
    assert agent["metadata"]["behavior"] == "careful"
    assert agent["type"] == "CYCLIST"
    assert agent["state"]["position"].shape == (120, 3)
    assert not agent["state"]["position"][60:].any()
    assert not agent["state"]["length"][60:].any()
    assert {f["type"] for f in told["map_features"].values()} >= {
        "LANE_SURFACE_STREET",
        "CROSSWALK",
    }
    (path,) = get_writer("scenarionet")(tmp_path, "episode", episode(), None)
    assert path.name == "sd_graphrqi_episode.pkl"
    back = read(path, "scenarionet")
    assert back.behavior is not None
    assert back.behavior.tolist() == episode().behavior.tolist()


# --- real recordings ----------------------------------------------------------------------------


def test_the_real_argoverse2_scenario_comes_in_to_the_last_digit(
    tmp_path: Path, shared_data: Path
) -> None:
    from experiments.data.exchange import import_recordings
    from sim.store.dataset import open_dataset

    import_recordings(shared_data / "argoverse2", tmp_path / "data", quiet=True)
    dataset = open_dataset(tmp_path / "data")
    tracks = dataset.read(dataset.episodes()[0]).tracks
    source = next((shared_data / "argoverse2").rglob("scenario_*.parquet"))
    frames = list(tracks.frames())
    compared = 0
    for r in pq.read_table(source).to_pylist():
        if r["track_id"] in tracks.names:
            frame = frames[r["timestep"]]
            at = int(np.searchsorted(frame.ids, tracks.ids[tracks.names.index(r["track_id"])]))
            assert frame.xy[at].tolist() == [r["position_x"], r["position_y"]]
            assert frame.heading[at] == r["heading"]
            assert frame.speed[at] == np.hypot(r["velocity_x"], r["velocity_y"])
            compared += 1
    assert compared == tracks.valid.sum() > 1000
