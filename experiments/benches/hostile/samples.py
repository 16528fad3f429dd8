"""A small valid input of every family of files that are read, and how it is read."""

from __future__ import annotations

import gzip
import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import pyarrow as pa

from experiments.benches.hostile import scenes
from experiments.benches.hostile.documents import document_samples
from experiments.benches.hostile.grammars import STEPS, TABLES, grown
from experiments.benches.hostile.maps import map_samples
from experiments.benches.hostile.oracles.recordings import other_rows, rows_told
from experiments.benches.hostile.sample import Sample, csv_text, parquet_bytes
from sim.formats import get_reader
from sim.formats.common.recording import Recording
from sim.road.files import read_road_file

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


def _argoverse2() -> bytes:
    from sim.formats.argoverse.forecasting2 import SCHEMA

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
    return parquet_bytes(pa.Table.from_pylist(rows, schema=SCHEMA))


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


def samples() -> dict[str, Sample]:
    """A valid input of every family, by its name."""
    return _recording_samples() | map_samples() | document_samples()


def _recording_samples() -> dict[str, Sample]:
    highd = [[k, a + 1, 30 * a + k, 5.5, 4.5, 2, 25, 0] for k in range(STEPS) for a in range(3)]
    pairs = [[0, "p", 1, 2, k / 10, k, 10, 20 + k, 10, 15] for k in range(STEPS)]
    kitti = {
        "label_02/0000.txt": scenes.KITTI_LABELS.encode(),
        "oxts/0000.txt": scenes.KITTI_OXTS.encode(),
        "calib/0000.txt": scenes.KITTI_CALIB.encode(),
    }
    ind_meta = csv_text("recordingId,trackId,class", [[0, 0, "car"], [0, 1, "van"], [0, 2, "car"]])
    walkers = csv_text(
        "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy",
        [
            ["P1", k + 1, 100 * k + 100, "pedestrian/bicycle", 1, 0.1 * k, 0, 1]
            for k in range(STEPS)
        ],
    )
    interaction = {
        "vehicle_tracks_000.csv": grown(TABLES["interaction"]),
        "pedestrian_tracks_000.csv": walkers,
    }
    recordings: dict[str, tuple[str, dict[str, bytes]]] = {
        "argoverse1": ("a.csv", {"a.csv": grown(TABLES["argoverse1"])}),
        "argoverse2": ("scenario_s.parquet", {"scenario_s.parquet": _argoverse2()}),
        "argoverse2-log": ("annotations.feather", scenes.sensor_log()),
        "ngsim": ("a.csv", {"a.csv": csv_text(NGSIM_HEADER, _ngsim())}),
        "ind": ("00_tracks.csv", {"00_tracks.csv": grown(TABLES["ind"]),
                                  "00_tracksMeta.csv": ind_meta}),
        "highd": ("01_tracks.csv", {"01_tracks.csv": csv_text(
            "frame,id,x,y,width,height,xVelocity,yVelocity", highd)}),
        "interaction": ("vehicle_tracks_000.csv", interaction),
        "sumo-fcd": ("a.xml", {"a.xml": _fcd()}),
        "traf": ("a_gt.txt", {"a_gt.txt": csv_text("", _traf())}),
        "argo": ("argo1_tracks.csv", {"argo1_tracks.csv": csv_text(
            "frame,id,x,y", [[k, a, 3 * a, k] for k in range(STEPS) for a in range(4)])}),
        "pairs": ("pairs.csv", {"pairs.csv": csv_text(
            "pair,period,follower,leader,t,x_follower,v_follower,x_leader,v_leader,leader_length",
            pairs)}),
        "commonroad": ("scene.xml", {"scene.xml": scenes.COMMONROAD.encode()}),
        "kitti": ("label_02/0000.txt", kitti),
        "womd": ("a.tfrecord", {"a.tfrecord": scenes.waymo_record()}),
        "scenarionet": ("sd_turn.pkl", {
            "sd_turn.pkl": pickle.dumps(scenes.scenarionet_scene(), protocol=4)}),
    }  # fmt: skip

    def sample(key: str, file: str, files: dict[str, bytes]) -> Sample:
        return Sample(
            files, _recordings(key, file), lambda folder: rows_told(key, folder / file),
            partial(other_rows, key), key,
        )  # fmt: skip

    found = {name: sample(name, *given) for name, given in recordings.items()}
    found["round"] = sample("round", *recordings["ind"])
    found["ngsim-text"] = sample("ngsim", "a.txt", {"a.txt": csv_text("", _ngsim(), " ")})
    for name in ("argoverse1", "sumo-fcd", "commonroad"):
        ((file, data),) = recordings[name][1].items()
        packed = {f"{file}.gz": gzip.compress(data, 1, mtime=0)}
        found[f"{name}.gz"] = sample(name, f"{file}.gz", packed)
    return found
