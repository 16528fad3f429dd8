"""Argoverse 2 sensor logs, written by the published schema; the official package reads them."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import feather
from scipy.spatial.transform import Rotation

from behaviors import InputError
from experiments.data.exchange import import_recordings
from sim.formats import left_out_files, read_recordings
from sim.formats.common.recording import Recording
from sim.formats.sensor_logs import AV, CATEGORIES
from sim.formats.sensor_logs import read_argoverse2 as read_log
from sim.frames import KINDS
from sim.store.dataset import open_dataset
from tests.sim.scenes import feather_bytes, sensor_log

POSES = "city_SE3_egovehicle.feather"


def put(home: Path, **changed: bytes | None) -> Path:
    """A log in a folder; files named by their first letters are others, or None: not there."""
    for name, data in sensor_log().items():
        key = next((key for key in changed if name.lower().startswith(key)), None)
        content = data if key is None else changed[key]
        if content is not None:
            (home / name).parent.mkdir(parents=True, exist_ok=True)
            (home / name).write_bytes(content)
    return home / "annotations.feather"


def table(name: str) -> pa.Table:
    return feather.read_table(io.BytesIO(sensor_log()[name]))


def only(path: Path) -> Recording:
    (recording,) = read_log(path)
    return recording


def columns(turn: Rotation, place: np.ndarray) -> dict[str, np.ndarray]:
    """Poses as the format has them."""
    names = ("qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m")
    return dict(zip(names, (*turn.as_quat().T, *place.T), strict=True))


def driven(home: Path, sweeps: int = 150, seed: int = 3) -> None:
    """A log of 15 s as published: agents go straight, the car turns on a slope."""
    draw = np.random.default_rng(seed)
    stamps = 315966265259836000 + np.cumsum(draw.integers(99_900_000, 100_100_000, sweeps))
    more = np.setdiff1d(draw.integers(stamps[0], stamps[-1], 2500), stamps)
    every = np.sort(np.append(stamps, more))
    time_s = (every - every[0]) / 1e9
    yaw = 1.0 + 0.05 * time_s
    slope = np.full(time_s.size, 0.03)
    car = Rotation.from_euler("ZYX", np.stack([yaw, slope, -slope], axis=1))
    along = np.cumsum(
        np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * np.gradient(time_s)[:, None], 0
    )
    place = np.column_stack([747.4 + 8 * along[:, 0], 1275.3 + 8 * along[:, 1], -24.0 + 0 * yaw])

    home.mkdir(parents=True)
    pd.DataFrame({"timestamp_ns": every} | columns(car, place)).to_feather(home / POSES)
    seen, parts = np.searchsorted(every, stamps), []
    for k, category in enumerate([*CATEGORIES, "BOLLARD", "BICYCLE"]):
        course, speed = draw.uniform(-3, 3), draw.uniform(0, 12)
        way = speed * (stamps - stamps[0]) / 1e9
        start = place[0] + np.append(draw.uniform(-40, 40, 2), 0.5)
        city = start + np.column_stack([np.cos(course) * way, np.sin(course) * way, 0 * way])
        back = car[seen].inv()
        box = columns(back * Rotation.from_euler("z", course), back.apply(city - place[seen]))
        size = {"length_m": 4.5 + k, "width_m": 1.75, "height_m": 1.5}
        about = {"timestamp_ns": stamps, "track_uuid": f"uuid-{k}", "category": category}
        parts.append(pd.DataFrame(about | size | box | {"num_interior_pts": k}))
    boxes = pd.concat(parts).sort_values("timestamp_ns", kind="stable", ignore_index=True)
    boxes.to_feather(home / "annotations.feather")


# --- what is read -------------------------------------------------------------------------------


def test_boxes_by_hand(tmp_path: Path) -> None:
    # the car stands at (100, 50) and looks north: what is ahead of it is north, what is left west
    half = np.sqrt(0.5)
    one = {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0}
    box = {"timestamp_ns": 1000, "category": "BUS", "length_m": 12.0, "width_m": 2.5, **one}
    boxes = [
        {**box, "track_uuid": "ahead", "tx_m": 10.0, "ty_m": 0.0, "tz_m": 1.0},
        {
            **box,
            "track_uuid": "left",
            "tx_m": 0.0,
            "ty_m": 10.0,
            "tz_m": 1.0,
            "qw": half,
            "qz": half,
        },
    ]
    pose = {"timestamp_ns": 1000, "qw": half, "qx": 0.0, "qy": 0.0, "qz": half}
    pose |= {"tx_m": 100.0, "ty_m": 50.0, "tz_m": 3.0}
    path = put(
        tmp_path / "here",
        annotations=feather_bytes(pa.Table.from_pylist(boxes)),
        city=feather_bytes(pa.Table.from_pylist([pose])),
    )
    recording = only(path)
    tracks = recording.tracks
    assert recording.name == "here"
    assert tracks.names == ("AV", "ahead", "left")
    np.testing.assert_allclose(tracks.xy[:, 0], [[100, 50 + AV.centre_m[0]], [100, 60], [90, 50]])
    np.testing.assert_allclose(np.sin(tracks.heading[:, 0]), [1, 1, 0], atol=1e-9)
    np.testing.assert_allclose(np.cos(tracks.heading[:, 0]), [0, 0, -1], atol=1e-9)
    assert tracks.length.tolist() == [4.87, 12.0, 12.0]
    assert tracks.width.tolist() == [1.85, 2.5, 2.5]
    assert [KINDS[code].value for code in tracks.kind] == ["car", "bus", "bus"]


def test_a_log_as_the_official_package_reads_it(tmp_path: Path) -> None:
    pytest.importorskip("av2")
    from av2.structures.cuboid import CuboidList
    from av2.utils.io import read_city_SE3_ego

    driven(tmp_path / "log", sweeps=20)
    cuboids = CuboidList.from_feather(tmp_path / "log" / "annotations.feather").cuboids
    poses = read_city_SE3_ego(tmp_path / "log")
    tracks = only(tmp_path / "log" / "annotations.feather").tracks
    first, seen = min(one.timestamp_ns for one in cuboids), 0
    at = {round(time_s * 1e9): step for step, time_s in enumerate(tracks.time_s)}
    for cuboid in cuboids:
        if cuboid.category in CATEGORIES:
            there = cuboid.transform(poses[cuboid.timestamp_ns]).dst_SE3_object.translation[:2]
            step = at[cuboid.timestamp_ns - first]
            near = np.abs(tracks.xy[:, step] - there).max(axis=1) < 1e-6
            assert near.sum() == 1
            assert tracks.length[near.argmax()] == cuboid.length_m
            seen += 1
    assert seen == tracks.valid.sum() - len(tracks.time_s)  # all but the recording car


def test_a_real_scenario_seen_from_its_recording_car(tmp_path: Path, shared_data: Path) -> None:
    """A real motion forecasting scenario, written as a log, is read as the scenario is."""
    source = shared_data / "argoverse2"
    assert left_out_files(source, ["argoverse2"]) == []  # its map is no recording
    (scenario,) = read_recordings(source)
    tracks = scenario.tracks
    ego, stamps = tracks.names.index("AV"), 10**17 + np.arange(110) * 99_950_000
    assert tracks.valid[ego].all()
    car = Rotation.from_euler("z", tracks.heading[ego][:, None])
    back = car.apply([AV.centre_m[0], 0.0, 0.0])
    place = np.column_stack([tracks.xy[ego], np.zeros(110)]) - back

    agent, step = np.nonzero(tracks.valid & (np.array(tracks.names) != "AV")[:, None])
    turn = Rotation.from_euler("z", tracks.heading[agent, step][:, None])
    inverse = car[step].inv()
    there = np.column_stack([tracks.xy[agent, step], np.zeros(agent.size)])
    boxes = columns(inverse * turn, inverse.apply(there - place[step]))
    about = {
        "timestamp_ns": stamps[step], "track_uuid": np.array(tracks.names)[agent],
        "category": "REGULAR_VEHICLE", "length_m": 4.5, "width_m": 1.8,
    }  # fmt: skip
    pd.DataFrame(about | boxes).to_feather(tmp_path / "annotations.feather")
    pd.DataFrame({"timestamp_ns": stamps} | columns(car, place)).to_feather(tmp_path / POSES)
    read_back = only(tmp_path / "annotations.feather").tracks
    assert read_back.names == tracks.names
    np.testing.assert_array_equal(read_back.valid, tracks.valid)
    seen = tracks.valid
    np.testing.assert_allclose(read_back.xy[seen], tracks.xy[seen], atol=1e-6)
    turned = read_back.heading[seen] - tracks.heading[seen]
    np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-12)


# --- folders ------------------------------------------------------------------------------------


def test_an_imported_log_has_its_road_and_every_digit(tmp_path: Path) -> None:
    driven(tmp_path / "logs" / "one")
    straight = json.loads(sensor_log()["map/log_map_archive_s____PIT_city_31785.json"])
    (tmp_path / "logs" / "one" / "map").mkdir()
    archive = tmp_path / "logs" / "one" / "map" / "log_map_archive_one____PIT_city_1.json"
    archive.write_text(json.dumps(straight))
    expected = only(tmp_path / "logs" / "one" / "annotations.feather").tracks
    import_recordings(tmp_path / "logs", tmp_path / "data", quiet=True)
    dataset = open_dataset(tmp_path / "data")
    (entry,) = dataset.episodes()
    tracks = dataset.read(entry).tracks
    np.testing.assert_array_equal(tracks.xy[tracks.valid], expected.xy[expected.valid])
    np.testing.assert_array_equal(tracks.time_s, expected.time_s)


@pytest.mark.parametrize("packed", ["", ".gz"])
@pytest.mark.parametrize("both", [True, False])
def test_annotations_with_the_recording_car(tmp_path: Path, packed: str, both: bool) -> None:
    """Copies of a log that list the recording car too are read as the log is, once."""
    path = put(tmp_path / "log")
    expected = only(path).tracks
    car = table("annotations.feather").slice(0, 1).to_pylist()[0]
    car |= {"track_uuid": "ego", "category": "EGO_VEHICLE"}
    rows = pa.Table.from_pylist([*table("annotations.feather").to_pylist(), car])
    data = feather_bytes(rows)
    copy = path.with_name(f"annotations_with_ego.feather{packed}")
    copy.write_bytes(gzip.compress(data) if packed else data)
    if not both:
        path.unlink()
    (recording,) = read_recordings(path.parent)
    assert recording.tracks.names == expected.names
    np.testing.assert_array_equal(recording.tracks.xy, expected.xy)


# --- what is refused ----------------------------------------------------------------------------


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        list(read_log(path))
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_files_that_are_not_there(tmp_path: Path) -> None:
    assert "found no city_SE3_egovehicle.feather" in refused(put(tmp_path / "a", city=None))
    assert "found no file" in refused(put(tmp_path / "b", annotations=None))
    empty = feather_bytes(table("annotations.feather").slice(0, 0))
    assert "found no rows" in refused(put(tmp_path / "c", annotations=empty))
    without = feather_bytes(table("annotations.feather").drop_columns(["qy"]))
    assert "expected a column qy" in refused(put(tmp_path / "d", annotations=without))
    twice = table("annotations.feather").append_column("qy", table("annotations.feather")["qx"])
    sink = io.BytesIO()
    with pa.ipc.new_file(sink, twice.schema) as writer:  # write_feather refuses such names
        writer.write_table(twice)
    assert "qy 2 times" in refused(put(tmp_path / "e", annotations=sink.getvalue()))
