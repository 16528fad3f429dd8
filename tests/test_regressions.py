"""Files on which readers once failed: each is read, or refused in one line.

`data/regressions/table.json` says of each what reads it, which of its files is opened, and the
numbers that are read or a part of the message. Files of 30 kB and more are packed with gzip.
"""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from behaviors.errors import LONGEST, InputError
from behaviors.populations import read_population
from experiments.generate.configuration import read_config
from experiments.replay.scene import read_beliefs
from scenarios import get_scenario
from sim.formats import get_reader
from sim.frames import Frame, Tracks
from sim.road.road_files import read_road_file
from sim.store.dataset import open_dataset

FOLDER = Path(__file__).parent / "data" / "regressions"
CASES = json.loads((FOLDER / "table.json").read_text())


def unpacked(case: str, folder: Path) -> None:
    for source in (path for path in (FOLDER / case).rglob("*") if path.is_file()):
        target = folder / source.relative_to(FOLDER / case)
        target.parent.mkdir(parents=True, exist_ok=True)
        data = source.read_bytes()
        if source.suffix == ".packed":
            target, data = target.with_suffix(""), gzip.decompress(data)
        target.write_bytes(data)


def read_recording(key: str, path: Path) -> dict[str, Any]:
    (recording,) = get_reader(key)(path)
    tracks = recording.tracks
    agents, steps = tracks.valid.shape
    return {
        "agents": agents,
        "steps": steps,
        "positions": int(tracks.valid.sum()),
        "xy_sum": pytest.approx(float(tracks.xy[tracks.valid].sum()), abs=1e-3),
    }


def read_road(path: Path) -> dict[str, Any]:
    lanes = read_road_file(path).lanes
    internal = sum(lane.internal for lane in lanes)
    return {"lanes": len(lanes) - internal, "paths": internal}


def read_labels_of_two_cars(path: Path) -> None:
    cars = (np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.full(2, 4.5), np.full(2, 2.0))
    times = (0.0, 0.5, 1.0)
    frames = [Frame(t, np.arange(2), *cars, np.zeros(2, np.int8)) for t in times]
    read_beliefs(path, "0123456789abcdef", Tracks.from_frames(frames))


def read_dataset(folder: Path) -> None:
    dataset = open_dataset(folder)
    for entry in dataset.episodes():
        dataset.read(entry)


READERS = {
    "road": read_road,
    "study": lambda path: read_config(path).scenario("straight_road"),
    "scenario": lambda path: get_scenario(str(path))(),
    "population": read_population,
    "labels": read_labels_of_two_cars,
    "dataset": read_dataset,
}


@pytest.mark.parametrize("case", CASES, ids=[case["case"] for case in CASES])
def test_a_file_that_once_broke_a_reader(case: dict[str, Any], tmp_path: Path) -> None:
    unpacked(case["case"], tmp_path)
    path = tmp_path / case["file"]
    if "doubted" in case:
        from_road = case["reader"] == "road"
        found = read_road_file(path) if from_road else next(get_reader(case["reader"])(path))
        assert case["doubted"] in "; ".join(found.doubts)
        return
    read = READERS.get(case["reader"], lambda path: read_recording(case["reader"], path))
    if "read" in case:
        assert read(path) == case["read"]
        return
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert case["refused"] in message.replace(f"{tmp_path}/", "")
    assert "\n" not in message
    assert len(message) <= LONGEST


def test_every_saved_file_is_read() -> None:
    folders = {path.name for path in FOLDER.iterdir() if path.is_dir()}
    assert folders == {case["case"] for case in CASES}
