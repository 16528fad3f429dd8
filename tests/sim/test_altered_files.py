"""Files of every format, altered anywhere: each is read, or refused in one line."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from behaviors.errors import LONGEST, InputError
from scenarios import get_scenario
from sim.formats import get_reader
from sim.road.maps.argoverse2 import static_map
from sim.road.road_files import read_road_file
from tests.sim.scenes import (
    COMMONROAD,
    KITTI_CALIB,
    KITTI_LABELS,
    KITTI_OXTS,
    scenarionet_scene,
    sensor_log,
    waymo_record,
)

ROAD = get_scenario("straight_road")().road
STEPS = range(6)
VEHICLES = range(3)
FCD = "".join(
    f'<timestep time="{k / 10}">'
    + "".join(f'<vehicle id="v{a}" x="{k}" y="{4 * a}" angle="90" speed="9"/>' for a in VEHICLES)
    + "</timestep>\n"
    for k in STEPS
)
TRAF = "".join(
    f"{k},3," + ",".join(f"{10 + 3 * k},{20 + 30 * a},18,15,{a}" for a in VEHICLES) + "\n"
    for k in STEPS
)


def table(header: str, row: str) -> bytes:
    """A CSV file: the row of every agent ``a`` at every step ``k``."""
    rows = [row.format(a=a, k=k, t=k / 10, ms=100 * k + 100) for k in STEPS for a in VEHICLES]
    return "\n".join([header, *rows, ""]).encode()


FILES: dict[str, dict[str, bytes]] = {
    "argoverse1": {
        "a.csv": table(
            "TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME", "{t:.1f},t{a},OTHERS,{k},{a},PIT"
        )
    },
    "interaction": {
        "vehicle_tracks_000.csv": table(
            "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width",
            "{a},{k},{ms},car,{k},{a},10,0,0,4.5,1.9",
        )
    },
    "highd": {
        "01_tracks.csv": table(
            "frame,id,x,y,width,height,xVelocity,yVelocity", "{k},{a},{k},{a},4.5,1.9,25,0"
        )
    },
    "ind": {
        "00_tracks.csv": table(
            "trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,yVelocity",
            "{a},{k},{k},{a},12,1.9,4.5,9,0",
        )
    },
    "sumo-fcd": {"a.xml": f"<fcd-export>\n{FCD}</fcd-export>\n".encode()},
    "traf": {"a_gt.txt": TRAF.encode()},
    "commonroad": {"scene.xml": COMMONROAD.encode()},
    "kitti": {
        "label_02/0000.txt": KITTI_LABELS.encode(),
        "oxts/0000.txt": KITTI_OXTS.encode(),
        "calib/0000.txt": KITTI_CALIB.encode(),
    },
    "womd": {"a.tfrecord": waymo_record()},
    "scenarionet": {"sd_turn.pkl": pickle.dumps(scenarionet_scene(), protocol=4)},
    "argoverse2-log": sensor_log(),
    "net": {"road.net.xml": ROAD.source.read_bytes() if ROAD.source else b""},
    "argoverse2-map": {"log_map_archive_a.json": json.dumps(static_map(ROAD)).encode()},
}
"""A small valid input of every kind; the first file is the one that is opened."""

MAPS = ("net", "argoverse2-map")
WORDS = st.sampled_from(
    [b"", b"nan", b"1e400", b"-1", b"1_0", b"9" * 30, b'"', b",", b"\n", b"\x00", b"<", b"\xff"]
)
EDITS = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 8), WORDS | st.binary(max_size=4)),
    min_size=1,
    max_size=4,
)
"""Where, how many bytes are cut out there, and what is put in."""


def altered(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    for where, cut, word in edits:
        at = int(where * len(data))
        data = data[:at] + word + data[at + cut :]
    return data


def reader_of(kind: str) -> Callable[[Path], object]:
    if kind in MAPS:
        return read_road_file
    return lambda path: [one.tracks.row_xy for one in get_reader(kind)(path)]


@pytest.mark.parametrize("kind", FILES)
@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(edits=EDITS, which=st.integers(0, 2))
def test_a_file_that_was_altered_is_read_or_refused_in_one_line(
    kind: str, edits: list[tuple[float, int, bytes]], which: int, tmp_path: Path
) -> None:
    folder = tmp_path / "input"
    shutil.rmtree(folder, ignore_errors=True)
    names = list(FILES[kind])
    for name, data in FILES[kind].items():
        chosen = name == names[which % len(names)]
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(altered(data, edits) if chosen else data)
    message = ""
    try:
        reader_of(kind)(folder / names[0])
    except (InputError, FileNotFoundError, MemoryError) as error:  # the guard names the last one
        message = str(error)
    assert "\n" not in message
    assert len(message) <= LONGEST


@pytest.mark.parametrize("kind", FILES)
def test_the_files_are_read_as_they_are(kind: str, tmp_path: Path) -> None:
    for name, data in FILES[kind].items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    assert reader_of(kind)(tmp_path / next(iter(FILES[kind])))
