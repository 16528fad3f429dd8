"""A small valid input of everything that is read beside recordings and maps."""

from __future__ import annotations

import io
import itertools
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches.hostile.grammars import TABLES, grown
from experiments.benches.hostile.oracles import altered
from experiments.benches.hostile.sample import EPISODE, Sample, csv_text, files_in, table_bytes

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


SCENARIO: Final = b"""scenario = "straight_road"
name = "slow"
flow = 900.0
mix = "timid=.5,reckless=.5"
spread = 0.1
duration_s = 30.0
lanes = 2
limits_mps = [8.0, 12.5]
"""

RUN: Final = {
    "schema_version": 1, "name": "r", "seed": 3, "configuration": {"episodes": 2},
    "packages": {"numpy": "2.0"}, "dataset": "data", "model": "model", "protocol": "inductive",
    "findings": ["one"], "confusion": {"s": {"m": [[1] * 6] * 6}},
}  # fmt: skip

SCORE: Final = {"value": 0.5, "low": 0.25, "high": None, "n": 3, "split": "test"}

METRICS: Final = {
    "classification": {"s": {"m": {"macro_f1": SCORE}}},
    "prediction": {"s": {"p": {"ade_m": {"1s": SCORE, "5s": SCORE}}}},
}

DRIVERS: Final = (["a", "timid", "conservative"], ["b", "", "aggressive"], ["c", "reckless", ""])


def _sheet() -> bytes:
    from openpyxl import Workbook

    book = Workbook()
    for row in ([7, 0, 0, 1, 1], [8, 0, 1, 2, 101, 102], [9, 0, "", ""]):
        book.active.append(row)
    packed = io.BytesIO()
    book.save(packed)
    return packed.getvalue()


def _table(reader: Callable[..., object]) -> Callable[[Path], object]:
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
    return lambda path: reader(path, EPISODE, tracks)


def _labels() -> bytes:
    from experiments.scoring.classification import LABELS

    rows = [
        {"episode": EPISODE, "recording": "r", "agent": a, "name": str(a), "time_s": t}
        for a in (0, 1) for t in (0.0, 0.5, 1.0)
    ]  # fmt: skip
    return table_bytes(LABELS, rows)


def _predictions() -> bytes:
    from experiments.scoring.prediction_file import PREDICTIONS

    rows = [
        {
            "episode": EPISODE, "recording": "r", "predictor": "p", "agent": a, "name": str(a),
            "time_s": 0.5, "mode": 0, "probability": 1.0, "ahead_s": h, "x_m": 1.0, "y_m": 2.0,
        }
        for a in (0, 1) for h in (0.5, 1.0)
    ]  # fmt: skip
    return table_bytes(PREDICTIONS, rows)


def _dataset() -> dict[str, bytes]:
    from experiments.data.exchange import import_recordings

    with tempfile.TemporaryDirectory() as scratch:
        source, out = Path(scratch) / "a.csv", Path(scratch) / "data"
        source.write_bytes(grown(TABLES["argoverse1"]))
        import_recordings(source, out, "argoverse1", quiet=True)
        return files_in(out)


def _read_dataset(folder: Path) -> int:
    """Rows of all episodes."""
    from experiments.data.verify import find_flaws
    from sim.store.dataset import open_dataset

    dataset = open_dataset(folder)
    rows = 0
    for entry in dataset.episodes():
        rows += dataset.read(entry).tracks.as_rows().speed.size
        dataset.road(entry)
    find_flaws(dataset)
    return rows


def _model(method: str) -> dict[str, bytes]:
    """A small trained model, or the one that ships."""
    from graphrqi.classify import make_classifier
    from graphrqi.methods import METHODS, Model
    from graphrqi.model_files import MODELS, save_model

    if method == "graphrqi-plus":
        return files_in(Path(MODELS) / method)
    way = METHODS[method]
    classifier = make_classifier(way.classifier, len(BEHAVIORS))
    with tempfile.TemporaryDirectory() as scratch:
        save_model(Model(way, "graphrqi", classifier, (1 / 6,) * 6, {}), Path(scratch) / "model")
        return files_in(Path(scratch) / "model")


def _weights() -> bytes:
    """A small network for recordings."""
    from graphrqi.predict.recorded.features import feature_count
    from graphrqi.predict.recorded.network import MODES, PER_MODE, RecordedNetwork, TrainedRange

    numbers = np.random.default_rng(0)
    inputs = feature_count()
    sizes = (inputs, 4, MODES * PER_MODE)
    layers = [numbers.normal(size=pair).astype(np.float32) for pair in itertools.pairwise(sizes)]
    network = RecordedNetwork(
        np.zeros(inputs), np.ones(inputs), tuple(layers),
        tuple(np.zeros(size, np.float32) for size in sizes[1:]), 1.0,
        TrainedRange(30.0, 0.1, 0.2, 0.1),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        network.save(Path(scratch) / "w", {})
        return (Path(scratch) / "w").read_bytes()


def _answered(path: Path) -> Any:
    """A network that has answered once."""
    from graphrqi.predict.recorded.network import load_network

    network = load_network(path)
    network(np.zeros((1, network.mean.size)))
    network.trained.trust(np.ones(1), np.ones(1), np.ones(1), 0.1)
    return network


def document_samples() -> dict[str, Sample]:
    """A valid input of each family."""
    from behaviors.populations.files import POPULATIONS, read_population
    from experiments.data.configuration import read_cluster, read_config
    from experiments.replay.beliefs import read_beliefs
    from experiments.replay.forecasts import read_forecasts
    from experiments.report.source import read_source
    from graphrqi.model_files import load_model
    from scenarios import get_scenario
    from scenarios.own.file import read_scenario_file
    from sim.formats.argo import read_labels
    from sim.formats.common.label_file import read_driver_labels
    from sim.formats.traf_sheets import read_sheet

    def study(path: Path) -> Any:
        read_cluster(path)
        return read_config(path)

    def scenario(path: Path) -> Any:
        read = read_scenario_file(path)
        entry = get_scenario(str(path))
        entry()
        return read

    beliefs, forecasts = _table(read_beliefs), _table(read_forecasts)
    of_file: dict[str, tuple[str, bytes, Callable[..., Any], Callable[..., Any], Any]] = {
        "rows": ("rows.json", ROWS, read_source, altered.document, altered.other_rows),
        "study": ("study.toml", STUDY, study, altered.study, altered.other_settings),
        "scenario": ("s.toml", SCENARIO, scenario, altered.settings, altered.other_settings),
        "population": ("p.toml", POPULATIONS["us101"].read_bytes(), read_population,
                       altered.settings, altered.other_population),
        "sheet": ("a1.xlsx", _sheet(), read_sheet, altered.sheet_rows, altered.other_sheet),
        "driver-labels": ("labels.csv", csv_text("name,behavior,style", DRIVERS),
                          read_driver_labels, altered.csv_rows, altered.other_count),
        "argo-labels": ("argo1_labels.csv", csv_text("id,code", [[a, a] for a in range(6)]),
                        read_labels, altered.csv_rows, altered.other_count),
        "weights": ("w.safetensors", _weights(), _answered, altered.tensors,
                    altered.other_network),
        "labels": ("labels.parquet", _labels(), beliefs, altered.told_beliefs,
                   altered.other_beliefs),
        "predictions": ("p.parquet", _predictions(), forecasts, altered.told_places,
                        altered.other_forecasts),
    }  # fmt: skip

    def one(
        file: str, data: bytes, read: Callable[..., Any], oracle: Callable[..., Any], differs: Any
    ) -> Sample:
        return Sample(
            {file: data}, lambda folder: read(folder / file),
            lambda folder: oracle(folder / file), differs,
        )  # fmt: skip

    found = {name: one(*given) for name, given in of_file.items()}
    for name, method in (("model", "graphrqi-plus"), ("model-small", "majority")):
        found[name] = Sample(
            _model(method), load_model,
            lambda folder: altered.tensors(folder / "weights.safetensors"), altered.other_model,
        )  # fmt: skip
    run = {"run.json": json.dumps(RUN).encode(), "metrics.json": json.dumps(METRICS).encode(),
           "loop.json": ROWS}  # fmt: skip
    found["run"] = Sample(run, read_source, altered.run_files, altered.other_run)
    found["dataset"] = Sample(
        _dataset(), _read_dataset, altered.dataset_rows, altered.other_dataset
    )
    return found
