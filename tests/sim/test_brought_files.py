"""Files as people bring them: other dialects, units, duplicates, broken agents, other layouts."""

from __future__ import annotations

import json
import math
import pickle
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas
import pytest

from behaviors.errors import InputError
from sim.formats import formats_in, read_recordings
from sim.formats.common.recording import Recording
from sim.frames import KINDS, AgentKind
from tests.sim.scenes import tfrecord


def one(path: Path, **options: object) -> Recording:
    (found,) = read_recordings(path, **options)  # type: ignore[arg-type]
    return found


def own(n: int = 4, steps: int = 40, step_s: float = 0.1, speed: float = 9.0) -> pandas.DataFrame:
    """Cars side by side that drive along x."""
    rows = [
        {"id": i, "t": k * step_s, "x": speed * k * step_s + 20.0 * i, "y": 4.0 * i}
        for i in range(n)
        for k in range(steps)
    ]
    return pandas.DataFrame(rows)


def interaction(steps: int = 20) -> pandas.DataFrame:
    frame = own(3, steps)
    return pandas.DataFrame(
        {
            "track_id": frame["id"],
            "frame_id": (frame["t"] * 10).round().astype(int),
            "timestamp_ms": (frame["t"] * 1000).round().astype(int),
            "agent_type": "car",
            "x": frame["x"],
            "y": frame["y"],
            "vx": 9.0,
            "vy": 0.0,
            "psi_rad": 0.0,
            "length": 4.5,
            "width": 1.8,
        }
    )


# --- dialects -----------------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_fields_and_decimals(tmp_path: Path, delimiter: str, decimal: str) -> None:
    path = tmp_path / "own.csv"
    own().to_csv(path, index=False, sep=delimiter, decimal=decimal)
    found = one(path)
    assert len(found.tracks.names) == 4
    assert found.tracks.xy[0, -1, 0] == pytest.approx(35.1)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "own.csv"
    frame = own().assign(ort="Köln")
    path.write_bytes(frame.to_csv(index=False).encode(encoding))
    assert len(one(path).tracks.names) == 4


@pytest.mark.parametrize("ending", ["parquet", "feather", "csv.gz"])
def test_tables_of_other_kinds(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"own.{ending}"
    if ending == "csv.gz":
        own().to_csv(path, index=False)
    else:
        getattr(own(), f"to_{ending}")(path)
    assert len(one(path).tracks.names) == 4


def test_separator_line_of_spreadsheets(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    path.write_text("sep=;\n" + own().to_csv(index=False, sep=";"))
    assert len(one(path).tracks.names) == 4


# --- units and doubts ---------------------------------------------------------------------------


def doubts(path: Path) -> str:
    return "; ".join(one(path).doubts)


def put(tmp_path: Path, frame: pandas.DataFrame, name: str = "own.csv") -> Path:
    path = tmp_path / name
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("by", [1e3, 1e6, 1e9, 1e-3, 1e-6])
def test_times_in_other_units_are_doubted(tmp_path: Path, by: float) -> None:
    frame = own()
    frame["t"] = frame["t"] * by + 1.7e9 * (by >= 1e3)
    path = put(tmp_path, frame)
    if by == 1e9:
        with pytest.raises(InputError, match="nanoseconds"):
            one(path)
    else:
        assert "seconds" in doubts(path)


@pytest.mark.parametrize(
    ("by", "cause"),
    [(1e-3, "kilometres"), (1 / 111_195, "degrees"), (100.0, "centimetres"), (1e3, "millimetres")],
)
def test_places_in_other_units_are_doubted(tmp_path: Path, by: float, cause: str) -> None:
    frame = own()
    frame[["x", "y"]] *= by
    assert cause in doubts(put(tmp_path, frame))


@pytest.mark.parametrize(
    ("by", "cause"), [(0.3048, "feet"), (1 / 0.3048, "feet"), (100.0, "centi"), (1e3, "milli")]
)
def test_sizes_in_other_units_are_doubted(tmp_path: Path, by: float, cause: str) -> None:
    frame = interaction()
    frame[["length", "width"]] *= by
    if by == 1e3:
        with pytest.raises(InputError, match="length and width"):
            one(put(tmp_path, frame, "vehicle_tracks_000.csv"))
    else:
        assert cause in doubts(put(tmp_path, frame, "vehicle_tracks_000.csv"))


@pytest.mark.parametrize(
    ("course", "written", "cause"),
    [
        (2.0, math.degrees(2.0), "degrees had been taken for radians"),
        (2.0, math.pi / 2 - 2.0, "clockwise from north"),
        (2.0, -2.0, "counted clockwise"),
        (2.0, 2.0 - math.pi, "backwards"),
    ],
)
def test_headings_that_contradict_motion(
    tmp_path: Path, course: float, written: float, cause: str
) -> None:
    frame = interaction()
    along, across = frame["x"].copy(), frame["y"].copy()
    frame["x"] = along * math.cos(course) - across * math.sin(course)
    frame["y"] = along * math.sin(course) + across * math.cos(course)
    frame["psi_rad"] = written
    assert cause in doubts(put(tmp_path, frame, "vehicle_tracks_000.csv"))


@pytest.mark.parametrize("share", [1, 2, 3])
def test_sides_that_are_exchanged(tmp_path: Path, share: int) -> None:
    frame = interaction()
    some = frame["track_id"] < share
    frame.loc[some, ["length", "width"]] = [1.8, 4.5]
    assert f"{share} of 3 vehicles wider" in doubts(put(tmp_path, frame, "vehicle_tracks_000.csv"))


def test_right_files_are_not_doubted(tmp_path: Path) -> None:
    assert doubts(put(tmp_path, own())) == ""
    assert doubts(put(tmp_path, interaction(), "vehicle_tracks_000.csv")) == ""
    parked = own(speed=0.0)
    parked["x"] += np.random.default_rng(0).normal(0, 0.005, len(parked))
    assert doubts(put(tmp_path, parked)) == ""


# --- rows and agents that are left out ----------------------------------------------------------


@pytest.mark.parametrize("times", [2, 3, 5])
def test_exact_duplicates_count_once(tmp_path: Path, times: int) -> None:
    frame = own()
    found = one(put(tmp_path, pandas.concat([frame] * times)))
    assert found.tracks.row_speed.size == len(frame)
    assert f"{(times - 1) * len(frame)} rows" in found.doubts[0]


def test_other_numbers_at_one_time_are_refused(tmp_path: Path) -> None:
    frame = own()
    with pytest.raises(InputError, match="twice at time"):
        one(put(tmp_path, pandas.concat([frame, frame.assign(x=frame["x"] + 1.0)])))


@pytest.mark.parametrize("bad", ["", "nan", "inf", "1e12"])
def test_one_bad_agent_among_many(tmp_path: Path, bad: str) -> None:
    frame = own(6).astype({"x": object})
    frame.loc[frame["id"] == 2, "x"] = bad
    found = one(put(tmp_path, frame))
    assert found.tracks.names == ("0", "1", "3", "4", "5")
    assert "left out" in found.doubts[0]


@pytest.mark.parametrize("ending", ["csv", "parquet", "feather"])
def test_numbers_of_rows_are_no_ids(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"own.{ending}"
    frame = own(6).assign(id=range(240))
    frame.to_csv(path, index=False) if ending == "csv" else getattr(frame, f"to_{ending}")(path)
    with pytest.raises(InputError, match="240 agents that are seen once each"):
        one(path)


@pytest.mark.parametrize("length", [-4.5, 5000.0, 0.0])
def test_a_size_that_no_agent_has(tmp_path: Path, length: float) -> None:
    frame = interaction()
    frame.loc[frame["track_id"] == 1, "length"] = length
    found = one(put(tmp_path, frame, "vehicle_tracks_000.csv"))
    assert found.tracks.length.tolist() == [4.5, 4.5, 4.5]
    assert bool(found.doubts) == (length != 0.0)


# --- INTERACTION --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lacks", [["psi_rad"], ["length", "width"], ["psi_rad", "length", "width"]]
)
@pytest.mark.parametrize("identity", ["P1", "1", "77"])
def test_multi_agent_files(tmp_path: Path, lacks: list[str], identity: str) -> None:
    cars = interaction().assign(case_id=1.0)
    walker = cars[cars["track_id"] == 0].assign(
        track_id=identity, agent_type="pedestrian/bicycle", vx=0.0, vy=1.2, x=5.0
    )
    walker["y"] = 30 + 0.12 * walker["frame_id"]
    walker = walker.astype(dict.fromkeys(lacks, object))
    walker.loc[:, lacks] = ""
    found = one(put(tmp_path, pandas.concat([cars, walker]), "DR_train.csv"))
    assert len(found.tracks.names) == 4
    (at,) = np.flatnonzero(found.tracks.kind == AgentKind.PEDESTRIAN.code)
    assert found.tracks.heading[at, -1] == pytest.approx(math.pi / 2 if "psi_rad" in lacks else 0.0)
    assert (found.tracks.length > 0).all()


# --- SUMO FCD -----------------------------------------------------------------------------------


def fcd(attributes: str, clock: str = "{:.2f}", more: str = "") -> str:
    steps = "".join(
        f'<timestep time="{clock.format(0.5 * k)}"><vehicle id="a" x="{5.0 * k + 10:.2f}" y="2" '
        f"{attributes}/>{more.format(x=5.0 * k + 10)}</timestep>"
        for k in range(12)
    )
    return f"<fcd-export>{steps}</fcd-export>"


@pytest.mark.parametrize(
    "attributes", ["", 'speed="10"', 'angle="90"', 'type="car" lane="e_0"', 'speed="10" angle="90"']
)
def test_fcd_by_attributes(tmp_path: Path, attributes: str) -> None:
    path = tmp_path / "fcd.xml"
    path.write_text(fcd(attributes))
    tracks = one(path).tracks
    assert tracks.speed[0, 5] == pytest.approx(10.0)
    assert tracks.heading[0, 5] == pytest.approx(0.0)
    assert tracks.xy[0, 0, 0] == pytest.approx(10 - 4.5 / 2)


@pytest.mark.parametrize("clock", ["00:00:{:05.2f}", "2:00:00:{:05.2f}", "13:07:{:05.2f}"])
def test_fcd_times_as_people_read_them(tmp_path: Path, clock: str) -> None:
    path = tmp_path / "fcd.xml"
    path.write_text(fcd('speed="10" angle="90"', clock))
    assert np.diff(one(path).tracks.time_s) == pytest.approx(0.5)


@pytest.mark.parametrize("inside", ["person", "container"])
def test_riders_and_containers_are_left_out(tmp_path: Path, inside: str) -> None:
    rider = f'<{inside} id="r" x="{{x:.2f}}" y="2" speed="10" angle="90"/>'
    path = tmp_path / "fcd.xml"
    path.write_text(fcd('speed="10" angle="90" type="bus"', more=rider))
    found = one(path)
    assert found.tracks.names == ("a",)
    assert "left out" in found.doubts[0]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@pytest.mark.parametrize("clock", ["{:.2f}", "00:00:{:05.2f}"])
def test_fcd_tables(tmp_path: Path, ending: str, clock: str) -> None:
    rows = [
        {"timestep_time": clock.format(0.5 * k), "vehicle_id": name, "vehicle_x": 5.0 * k + x,
         "vehicle_y": 2.0, "vehicle_angle": 90.0, "vehicle_type": kind, "vehicle_speed": 10.0}
        for k in range(8)
        for name, x, kind in (("a", 0.0, "car"), ("b", 30.0, "bus"), ("p", 60, "DEFAULT_PEDTYPE"))
    ]  # fmt: skip
    path = tmp_path / f"fcd.{ending}"
    if ending == "csv":
        pandas.DataFrame(rows).to_csv(path, index=False, sep=";")
    else:
        pandas.DataFrame(rows).to_parquet(path)
    assert formats_in(path) == ["sumo-fcd"]
    tracks = one(path).tracks
    assert [str(KINDS[k]) for k in tracks.kind] == ["car", "bus", "pedestrian"]
    assert tracks.speed[:, 0].tolist() == [10.0] * 3


# --- Waymo's JSON and ScenarioNet ---------------------------------------------------------------


def nocturne(length: object, width: object, steps: int = 12) -> dict[str, object]:
    return {
        "objects": [
            {
                "type": "vehicle",
                "position": [{"x": float(k), "y": 0.0} for k in range(steps)],
                "heading": [0.0] * steps,
                "velocity": [{"x": 10.0, "y": 0.0}] * steps,
                "valid": [k >= 4 for k in range(steps)],
                "length": length,
                "width": width,
            }
        ],
        "roads": [],
    }


@pytest.mark.parametrize(
    ("length", "width", "expected"),
    [
        (0.0, 0.0, 4.5),
        ([0.0] * 4 + [5.2] * 8, [0.0] * 4 + [2.0] * 8, 5.2),
        ([0.0] * 6 + [5.2] * 6, [0.0] * 6 + [2.0] * 6, 5.2),
        (-1.0, -1.0, None),
    ],
)
def test_sizes_before_an_agent_is_seen(
    tmp_path: Path, length: object, width: object, expected: float | None
) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(nocturne(length, width)))
    if expected is None:
        with pytest.raises(InputError, match="length and width"):
            one(path)
    else:
        assert one(path).tracks.length.tolist() == [expected]


def scenario(kind: type = dict) -> dict[str, object]:
    t = 12
    position = np.zeros((t, 3))
    position[:, 0] = np.arange(t)
    state = {
        "position": position,
        "heading": np.zeros(t),
        "velocity": np.tile([10.0, 0.0], (t, 1)),
        "valid": np.ones(t, dtype=bool),
        "length": np.full(t, 4.0),
        "width": np.full(t, 1.7),
    }
    return kind(
        id="s", version="1", length=t, metadata={"ts": np.arange(t) / 10},
        tracks={"a": {"type": "VEHICLE", "state": state, "metadata": {}}},
        map_features={}, dynamic_map_states={},
    )  # fmt: skip


@pytest.mark.parametrize("layout", ["columns", "size", "size of each step", "one number", "(T, 3)"])
def test_states_of_scenarionet(tmp_path: Path, layout: str) -> None:
    found = scenario()
    state = found["tracks"]["a"]["state"]  # type: ignore[index]
    if layout == "columns":
        for name in ("heading", "valid", "length", "width"):
            state[name] = state[name][:, None]
    elif layout == "one number":
        state["length"], state["width"] = 4.0, 1.7
    else:
        del state["length"], state["width"]
        each = np.array([4.0, 1.7, 1.5])
        state["size"] = each if layout == "size" else np.tile(each, (12, 1))
    path = tmp_path / "sd_a.pkl"
    path.write_bytes(pickle.dumps(found))
    tracks = one(path).tracks
    assert (tracks.length[0], tracks.width[0]) == (4.0, 1.7)


@pytest.mark.parametrize("name", ["ScenarioDescription", "EasyDict", "Config"])
def test_dictionaries_of_scenarionets_class(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ModuleType("metadrive_scenario")
    made = type(name, (dict,), {"__module__": "metadrive_scenario"})
    setattr(module, name, made)
    monkeypatch.setitem(sys.modules, "metadrive_scenario", module)
    path = tmp_path / "sd_a.pkl"
    path.write_bytes(pickle.dumps(scenario(made)))
    monkeypatch.delitem(sys.modules, "metadrive_scenario")
    assert one(path).tracks.names == ("a",)


# --- what is no recording -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("a.json", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "LFS"),
        ("a.parquet", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "LFS"),
        ("a.csv", b"/annex/objects/MD5E-s1--0\n", "annex"),
        ("scenario_a.parquet", b"version https://git-lfs.github.com/spec/v1\n", "LFS"),
        ("a.csv", b"<!DOCTYPE html><html><body>404</body></html>", "web page"),
        ("a.csv", b"PK\x03\x04aaaaaaaa", "ZIP"),
        ("a.csv", b"\x1f\x8b\x08\0aaaa", "gzip"),
        ("a.json", b'{"type": "FeatureCollection", "features": []}', "JSON"),
        ("a.json", b"[1, 2, 3]", "JSON"),
        ("a.osm", b"<osm><node id='1'/></osm>", "map"),
    ],
)
def test_other_files_say_what_they_are(
    tmp_path: Path, name: str, content: bytes, word: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=word):
        list(read_recordings(path))


@pytest.mark.parametrize("columns", [["a", "b"], ["timestamp", "speed"], ["frame_id", "lat"]])
def test_other_tables_say_their_columns(tmp_path: Path, columns: list[str]) -> None:
    path = tmp_path / "table.parquet"
    pandas.DataFrame({name: [1.0] for name in columns}).to_parquet(path)
    with pytest.raises(InputError, match=", ".join(columns)):
        list(read_recordings(path))


@pytest.mark.parametrize("name", [b"state/current/x", b"roadgraph_samples/xyz", b"image/encoded"])
def test_features_of_tf_examples(tmp_path: Path, name: bytes) -> None:
    entry = b"\n" + bytes([len(name)]) + name + b"\x12\x04\x12\x02\n\x00"
    feature = b"\n" + bytes([len(entry)]) + entry
    path = tmp_path / "a.tfrecord"
    path.write_bytes(tfrecord(b"\n" + bytes([len(feature)]) + feature))
    with pytest.raises(InputError, match=r"tf\.Example"):
        list(read_recordings(path))


# --- a table of one's own -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("columns", "units", "by"),
    [
        ({"id": "track", "t": "time", "x": "X", "y": "Y"}, {}, (1.0, 1.0)),
        ({"id": "Car", "t": "ms", "x": "E", "y": "N"}, {"t": "ms"}, (1e3, 1.0)),
        ({"id": "n", "t": "us", "x": "xf", "y": "yf"}, {"t": "us", "x": "ft", "y": "ft"},
         (1e6, 1 / 0.3048)),
    ],
)  # fmt: skip
def test_own_columns(
    tmp_path: Path, columns: dict[str, str], units: dict[str, str], by: tuple[float, float]
) -> None:
    frame = own()
    frame["t"] *= by[0]
    frame[["x", "y"]] *= by[1]
    found = one(put(tmp_path, frame.rename(columns=columns)), columns=columns, units=units)
    assert found.tracks.time_s[-1] == pytest.approx(3.9)
    assert found.tracks.speed[:, 10] == pytest.approx(9.0)
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("columns", "units"),
    [
        ({"id": "id", "t": "t", "x": "x"}, {}),
        ({"id": "id", "t": "t", "x": "x", "y": "y", "z": "z"}, {}),
        ({"id": "id", "t": "t", "x": "x", "y": "y"}, {"x": "miles"}),
        ({"id": "id", "t": "t", "x": "x", "y": "other"}, {}),
    ],
)
def test_own_columns_that_are_wrong(
    tmp_path: Path, columns: dict[str, str], units: dict[str, str]
) -> None:
    with pytest.raises(InputError):
        one(put(tmp_path, own()), columns=columns, units=units)


TABLE = "id,t,x,y\n1,0.0,1.5,2\n1,0.1,2.5,2\n1,0.2,3.5,2\n"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("# camera 3\n" + TABLE, "found the columns '# camera 3', expected a column id"),
        (TABLE.replace("\n1,0.0", "\n-,s,m,m\n1,0.0"), "column t, row 2: found 's'"),
        (TABLE.replace("3.5", '"1,003.5"'), "found '1,003.5', expected a number"),
        (TABLE.replace("0.1", "2024-05-01T12:00:00.1"), "column t, row 3: found '2024-05-01T12"),
        (TABLE.removeprefix("id,t,x,y\n"), "found the columns '1, 0.0, 1.5, 2'"),
        ("PK\3\4\0\0" + TABLE, "found no text, expected a table as CSV"),
        (TABLE.replace("3.5", '"3.5'), "line 4: found a quotation mark that is not closed"),
        (TABLE.replace("\n", "\n\n"), ""),
        (TABLE.replace("\n", ",\n"), ""),
        (TABLE.replace("id,t,x,y", " ID ,T, X,y"), ""),
    ],
)
def test_own_tables_as_people_write_them(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "own.csv"
    path.write_text(text)
    columns = {key: key for key in ("id", "t", "x", "y")}
    if word:
        with pytest.raises(InputError, match=re.escape(word)):
            one(path, columns=columns)
    else:
        assert one(path, columns=columns).tracks.row_speed == pytest.approx(10.0)
