"""A small valid input of every family of files that are read, and how it is read."""

from __future__ import annotations

import gzip
import io
import json
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from experiments.benches.hostile import scenes
from experiments.benches.hostile.grammars import TABLES, Table
from sim.formats import get_reader
from sim.formats.common.recording import Recording
from sim.road.files import read_road_file

STEPS: Final = 12
"""Times of the recordings."""

EPISODE: Final = "0123456789abcdef"


@dataclass(frozen=True)
class Sample:
    """A family of inputs.

    Attributes:
        files: a valid input, by the files' paths in its folder.
        read: reads it, from its folder: everything that a command does with it before it works.
    """

    files: dict[str, bytes]
    read: Callable[[Path], object]


def _csv(header: str, rows: Iterable[Iterable[object]], separator: str = ",") -> bytes:
    lines = [separator.join(map(str, row)) for row in rows]
    return "\n".join([*([header] if header else []), *lines, ""]).encode()


def _grown(table: Table) -> bytes:
    rows = ([make(a, k) for make in table.columns.values()] for k in range(STEPS) for a in range(3))
    return _csv(",".join(table.columns), rows)


NGSIM_HEADER: Final = (
    "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_Length,"
    "v_Width,v_Class,v_Vel,v_Acc,Lane_ID,Preceding,Following,Space_Headway,Time_Headway"
)


def _ngsim() -> list[list[object]]:
    return [
        [a + 1, k, STEPS, 1113433135300 + 100 * k, 16.5 + a, 35.25 + 4 * k, 6451137, 1873344,
         14.5, 4.9, 2, 40.0, 0, 2, 0, 0, 0, 0]
        for a in range(3) for k in range(STEPS)
    ]  # fmt: skip


def _fcd() -> bytes:
    agent = '<vehicle id="v{}" x="{:.2f}" y="{}" angle="90.00" type="car" speed="9.5"/>'
    walker = '<person id="p" x="1" y="{:.1f}" angle="0.00" speed="1.25"/>'
    steps = (
        f'<timestep time="{k / 10:.2f}">'
        + "".join(agent.format(a, k + 9 * a, 4 * a) for a in range(3))
        + walker.format(k / 10)
        + "</timestep>"
        for k in range(STEPS)
    )
    return ("<fcd-export>\n" + "\n".join(steps) + "\n</fcd-export>\n").encode()


def _traf() -> list[list[object]]:
    return [
        [k, 3, *(v for a in range(3) for v in (10 + 3 * k, 20 + 30 * a, 18, 15, a))]
        for k in range(STEPS)
    ]


def _parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def _argoverse2() -> bytes:
    from sim.formats.argoverse2 import SCHEMA

    rows = [
        {
            "observed": k < 5, "track_id": f"t{a}", "object_type": "vehicle", "object_category": 2,
            "timestep": k, "position_x": 3.0 * k, "position_y": 2.0 * a, "heading": 0.0,
            "velocity_x": 30.0, "velocity_y": 0.0, "scenario_id": "s", "start_timestamp": 0.0,
            "end_timestamp": 1e9, "num_timestamps": STEPS, "focal_track_id": "t0", "city": "PIT",
            "map_id": 0, "slice_id": "s",
        }
        for k in range(STEPS) for a in range(3)
    ]  # fmt: skip
    return _parquet(pa.Table.from_pylist(rows, schema=SCHEMA))


def _sheet() -> bytes:
    from openpyxl import Workbook

    book = Workbook()
    for row in ([7, 0, 0, 1, 1], [8, 0, 1, 2, 101, 102], [9, 0, "", ""]):
        book.active.append(row)
    packed = io.BytesIO()
    book.save(packed)
    return packed.getvalue()


def _lanelets() -> bytes:
    nodes = {1: (0, 3), 2: (20, 3), 3: (40, 3), 4: (0, 0), 5: (20, 0), 6: (40, 0)}
    ways = {11: (1, 2), 12: (2, 3), 13: (4, 5), 14: (5, 6)}
    text = "".join(
        f'<node id="{i}" lat="0" lon="0"><tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/>'
        "</node>\n"
        for i, (x, y) in nodes.items()
    )
    for i, ends in ways.items():
        text += f'<way id="{i}">' + "".join(f'<nd ref="{n}"/>' for n in ends) + "</way>\n"
    for i, (left, right) in {21: (11, 13), 22: (12, 14)}.items():
        text += (
            f'<relation id="{i}"><member type="way" ref="{left}" role="left"/>'
            f'<member type="way" ref="{right}" role="right"/><tag k="type" v="lanelet"/>'
            '<tag k="speed_limit" v="50 km/h"/></relation>\n'
        )
    return f'<osm version="0.6">\n{text}</osm>\n'.encode()


# --- what reads them ----------------------------------------------------------------------------


def _recordings(name: str, file: str) -> Callable[[Path], object]:
    def read(folder: Path) -> list[Recording]:
        found = list(get_reader(name)(folder / file))
        for one in found:
            one.tracks.as_rows()
            if isinstance(one.road, Path):
                read_road_file(one.road)
        return found

    return read


def _road(file: str) -> Callable[[Path], object]:
    return lambda folder: read_road_file(folder / file)


def _table(file: str, reader: Callable[..., object]) -> Callable[[Path], object]:
    """Reads a table that speaks of the agents of one episode."""
    from sim.frames import Frame, Tracks

    frames = [
        Frame(
            time_s, np.arange(2), np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.full(2, 4.5),
            np.full(2, 2.0), np.zeros(2, np.int8),
        )
        for time_s in (0.0, 0.5, 1.0)
    ]  # fmt: skip
    tracks = Tracks.from_frames(frames)
    return lambda folder: reader(folder / file, EPISODE, tracks)


def _told(schema: pa.Schema, known: Sequence[dict[str, Any]]) -> bytes:
    """A table of a schema; what rows do not say is null in texts and 1/6 in numbers."""
    others = {field.name: 1 / 6 if pa.types.is_floating(field.type) else None for field in schema}
    return _parquet(pa.Table.from_pylist([others | row for row in known], schema=schema))


def _labels() -> bytes:
    from experiments.scoring.classification import LABELS

    rows = [
        {"episode": EPISODE, "recording": "r", "agent": a, "name": str(a), "time_s": t}
        for a in (0, 1) for t in (0.0, 0.5, 1.0)
    ]  # fmt: skip
    return _told(LABELS, rows)


def _predictions() -> bytes:
    from experiments.scoring.prediction_file import PREDICTIONS

    rows = [
        {
            "episode": EPISODE, "recording": "r", "predictor": "p", "agent": a, "name": str(a),
            "time_s": 0.5, "mode": 0, "probability": 1.0, "ahead_s": h, "x_m": 1.0, "y_m": 2.0,
        }
        for a in (0, 1) for h in (0.5, 1.0)
    ]  # fmt: skip
    return _told(PREDICTIONS, rows)


def _of_folder(root: Path) -> dict[str, bytes]:
    files = (path for path in sorted(root.rglob("*")) if path.is_file() and path.name != ".lock")
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}


def _dataset() -> dict[str, bytes]:
    from experiments.data.exchange import import_recordings

    with tempfile.TemporaryDirectory() as scratch:
        source, out = Path(scratch) / "a.csv", Path(scratch) / "data"
        source.write_bytes(_grown(TABLES["argoverse1"]))
        import_recordings(source, out, "argoverse1", quiet=True)
        return _of_folder(out)


def _read_dataset(folder: Path) -> None:
    from sim.store.dataset import open_dataset

    dataset = open_dataset(folder)
    for entry in dataset.episodes():
        dataset.read(entry).tracks.as_rows()
        dataset.road(entry)


def _model() -> dict[str, bytes]:
    from graphrqi.model_files import MODELS

    return _of_folder(Path(MODELS) / "graphrqi-plus")


def _load(name: str) -> Callable[[Path], object]:
    """Calls a reader that is imported when it is first used."""

    def read(folder: Path) -> object:
        from experiments.data.configuration import read_config
        from experiments.report.source import read_source
        from graphrqi.model_files import load_model
        from sim.formats.argo_labels import read_labels
        from sim.formats.common.label_file import read_driver_labels
        from sim.formats.traf_sheets import read_sheet

        readers: dict[str, Callable[[], object]] = {
            "model": lambda: load_model(folder),
            "rows": lambda: read_source(folder / "rows.json"),
            "study": lambda: read_config(folder / "study.toml"),
            "sheet": lambda: read_sheet(folder / "a1.xlsx"),
            "argo-labels": lambda: read_labels(folder / "argo1_labels.csv"),
            "driver-labels": lambda: read_driver_labels(folder / "labels.csv"),
        }
        return readers[name]()

    return read


ROWS: Final = b"""[{"bench": "prediction", "scenario": "s", "predictor": "p", "behavior": "all",
"horizon_s": 5.0, "metric": "ade_m", "value": 1.0, "low": null, "high": null, "n": 3}]
"""

STUDY: Final = b"""scenarios = ["straight_road", "two_way_road"]
episodes = 3
seed = 7
duration_s = 60.0
engine = "sumo"
[mix]
timid = 0.5
reckless = 0.5
"""


DRIVERS: Final = (["a", "timid", "conservative"], ["b", "", "aggressive"], ["c", "reckless", ""])


def samples() -> dict[str, Sample]:
    """A valid input of every family, by its name."""
    from experiments.replay.beliefs import read_beliefs
    from experiments.replay.forecasts import read_forecasts
    from scenarios import get_scenario
    from sim.road.maps.argoverse2 import static_map

    net_file = get_scenario("four_way_intersection")().road.source
    assert net_file is not None
    net = net_file.read_bytes()
    road = read_road_file(net_file)
    highd = [[k, a + 1, 30 * a + k, 5.5, 4.5, 2, 25, 0] for k in range(STEPS) for a in range(3)]
    pairs = [[0, "p", 1, 2, k / 10, k, 10, 20 + k, 10, 15] for k in range(STEPS)]
    kitti = {
        "label_02/0000.txt": scenes.KITTI_LABELS.encode(),
        "oxts/0000.txt": scenes.KITTI_OXTS.encode(),
        "calib/0000.txt": scenes.KITTI_CALIB.encode(),
    }
    ind_meta = _csv("recordingId,trackId,class", [[0, 0, "car"], [0, 1, "van"], [0, 2, "car"]])
    walkers = _csv(
        "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy",
        [
            ["P1", k + 1, 100 * k + 100, "pedestrian/bicycle", 1, 0.1 * k, 0, 1]
            for k in range(STEPS)
        ],
    )
    interaction = {
        "vehicle_tracks_000.csv": _grown(TABLES["interaction"]),
        "pedestrian_tracks_000.csv": walkers,
    }
    recordings: dict[str, tuple[str, dict[str, bytes]]] = {
        "argoverse1": ("a.csv", {"a.csv": _grown(TABLES["argoverse1"])}),
        "argoverse2": ("scenario_s.parquet", {"scenario_s.parquet": _argoverse2()}),
        "ngsim": ("a.csv", {"a.csv": _csv(NGSIM_HEADER, _ngsim())}),
        "ind": ("00_tracks.csv", {"00_tracks.csv": _grown(TABLES["ind"]),
                                  "00_tracksMeta.csv": ind_meta}),
        "highd": ("01_tracks.csv", {"01_tracks.csv": _csv(
            "frame,id,x,y,width,height,xVelocity,yVelocity", highd)}),
        "interaction": ("vehicle_tracks_000.csv", interaction),
        "sumo-fcd": ("a.xml", {"a.xml": _fcd()}),
        "traf": ("a_gt.txt", {"a_gt.txt": _csv("", _traf())}),
        "argo": ("argo1_tracks.csv", {"argo1_tracks.csv": _csv(
            "frame,id,x,y", [[k, a, 3 * a, k] for k in range(STEPS) for a in range(4)])}),
        "pairs": ("pairs.csv", {"pairs.csv": _csv(
            "pair,period,follower,leader,t,x_follower,v_follower,x_leader,v_leader,leader_length",
            pairs)}),
        "commonroad": ("scene.xml", {"scene.xml": scenes.COMMONROAD.encode()}),
        "kitti": ("label_02/0000.txt", kitti),
        "womd": ("a.tfrecord", {"a.tfrecord": scenes.waymo_record()}),
    }  # fmt: skip
    found = {
        name: Sample(files, _recordings(name, file)) for name, (file, files) in recordings.items()
    }
    found["ngsim-text"] = Sample({"a.txt": _csv("", _ngsim(), " ")}, _recordings("ngsim", "a.txt"))
    for name in ("argoverse1", "sumo-fcd", "commonroad"):
        ((file, data),) = recordings[name][1].items()
        packed = {f"{file}.gz": gzip.compress(data, 1, mtime=0)}
        found[f"{name}.gz"] = Sample(packed, _recordings(name, f"{file}.gz"))
    maps: dict[str, tuple[str, bytes]] = {
        "net": ("road.net.xml", net),
        "net.gz": ("road.net.xml.gz", gzip.compress(net, 1, mtime=0)),
        "lanelet2": ("a.osm", _lanelets()),
        "argoverse2-map": ("log_map_archive_a.json", json.dumps(static_map(road)).encode()),
        "commonroad-map": ("scene.xml", scenes.COMMONROAD.encode()),
    }
    for name, (file, data) in maps.items():
        found[name] = Sample({file: data}, _road(file))
    others: dict[str, dict[str, bytes]] = {
        "model": _model(),
        "rows": {"rows.json": ROWS},
        "study": {"study.toml": STUDY},
        "sheet": {"a1.xlsx": _sheet()},
        "driver-labels": {"labels.csv": _csv("name,behavior,style", DRIVERS)},
        "argo-labels": {"argo1_labels.csv": _csv("id,code", [[a, a] for a in range(6)])},
    }
    found |= {name: Sample(files, _load(name)) for name, files in others.items()}
    found["dataset"] = Sample(_dataset(), _read_dataset)
    found["labels"] = Sample({"labels.parquet": _labels()}, _table("labels.parquet", read_beliefs))
    found["predictions"] = Sample(
        {"p.parquet": _predictions()}, _table("p.parquet", read_forecasts)
    )
    return found
