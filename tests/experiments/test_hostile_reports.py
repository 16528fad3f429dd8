"""Rows, runs and models that were made to break a report, or to fail long after they were read."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from behaviors.errors import InputError
from experiments.report.run_file import Metrics, read_run
from experiments.report.source import read_source
from experiments.rows import read_rows
from graphrqi.model_files import MODELS, load_model
from graphrqi.predict.networks.perceptron import load_perceptron, weights_file

ROW = {
    "bench": "prediction", "scenario": "s", "predictor": "p", "behavior": "all", "horizon_s": 5.0,
    "metric": "ade_m", "value": 1.0, "low": None, "high": None, "n": 3,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"horizon_s": "soon"}, "horizon_s: found 'soon', expected a number"),
        ({"horizon_s": 10**400}, "horizon_s: found 1000"),
        ({"horizon_s": -1}, "horizon_s: found -1, expected more than 0"),
        ({"horizon_s": None}, "found no horizon_s"),
        ({"predictor": None}, "found no predictor"),
        ({"value": float("inf")}, "value: found inf, expected a number"),
        ({"value": float("nan")}, "value: found nan, expected a number"),
        ({"value": True}, "value: found True, expected a number"),
        ({"high": [1]}, "found a nested value"),
        ({"bench": "spectrum", "d": 10**400}, "d: found 1000"),
    ],
)
def test_rows_that_no_report_can_show_are_refused(
    tmp_path: Path, change: dict[str, Any], found: str
) -> None:
    path = tmp_path / "rows.json"
    path.write_text(json.dumps([ROW]))
    assert read_rows(path) == [ROW]
    path.write_text(json.dumps([{**ROW, **change}]))
    with pytest.raises(InputError) as caught:
        read_rows(path)
    assert str(caught.value).startswith(f"{path}: row 0: {found}")
    assert len(str(caught.value)) < len(str(path)) + 100


@pytest.mark.parametrize("horizon", ["5", "s", "infs", "1e400s", "five s", "-1s"])
def test_horizons_that_are_no_seconds_are_refused(horizon: str) -> None:
    score = {"value": 1.0, "low": None, "high": None, "n": 1, "split": "test"}
    prediction = {"s": {"p": {"ade_m": {"5s": score}}}}
    assert Metrics(classification={}, prediction=prediction)
    prediction = {"s": {"p": {"ade_m": {horizon: score}}}}
    with pytest.raises(ValueError, match="should match pattern"):
        Metrics(classification={}, prediction=prediction)
    with pytest.raises(ValueError, match="finite number"):
        Metrics(
            classification={"s": {"m": {"ece": {**score, "value": float("inf")}}}}, prediction={}
        )


def model(tmp_path: Path) -> Path:
    return Path(shutil.copytree(MODELS / "graphrqi-plus", tmp_path / "model"))


@pytest.mark.parametrize("temperature", [5e-324, 1e-300, 1e30, float("nan"), 0.0])
def test_temperatures_that_make_no_probabilities_are_refused(
    tmp_path: Path, temperature: float
) -> None:
    folder = model(tmp_path)
    load_model(folder)
    arrays = load_file(folder / "weights.safetensors")
    arrays["temperature"] = np.array([temperature])
    save_file(arrays, folder / "weights.safetensors")
    with pytest.raises(InputError, match=r"weights\.safetensors.*temperature: found"):
        load_model(folder)


def test_weights_that_answer_no_probabilities_are_refused(tmp_path: Path) -> None:
    folder = model(tmp_path)
    arrays = load_file(folder / "weights.safetensors")
    for name, values in arrays.items():
        if values.dtype.kind == "f" and name != "temperature":
            arrays[name] = np.full_like(values, np.finfo(values.dtype).max)
    save_file(arrays, folder / "weights.safetensors")
    with pytest.raises(InputError, match=r"weights\.safetensors"):
        load_model(folder)


@pytest.mark.parametrize("scores", [[], {"s": []}, {"s": {"ece": [1]}}, {"s": {"ece": {"v": [1]}}}])
def test_scores_of_another_shape_are_refused(tmp_path: Path, scores: object) -> None:
    folder = model(tmp_path)
    card = json.loads((folder / "model.json").read_text())
    card["card"]["scores"] = scores
    (folder / "model.json").write_text(json.dumps(card))
    with pytest.raises(InputError, match=r"model\.json: card\.scores"):
        read_source(folder)


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    folder = model(tmp_path)
    weights = folder / "weights.safetensors"
    weights.unlink()
    os.mkfifo(weights)
    with pytest.raises(InputError, match="found no file"):
        load_model(folder)
    rows = tmp_path / "rows"
    rows.mkdir()
    os.mkfifo(rows / "a.json")
    for read in (read_rows, load_perceptron):
        with pytest.raises(InputError, match="found no file"):
            read(rows / "a.json")
    for path in (rows, rows / "a.json"):
        with pytest.raises(InputError, match="found no file"):
            read_source(path)
    with pytest.raises(InputError, match="found no file"):
        read_run(rows)


@pytest.mark.parametrize("broken", ["spread", "weights", "about"])
def test_networks_that_answer_no_numbers_are_refused(tmp_path: Path, broken: str) -> None:
    with weights_file("mlp.safetensors") as shipped:
        arrays = load_file(shipped)
    content: dict[str, Any] = {"schema_version": 1, "spread_scale": 1.0, "card": {}}
    if broken == "spread":
        content["spread_scale"] = "NaN"
    if broken == "weights":
        name = next(name for name in arrays if name.startswith("weight_"))
        arrays[name] = np.full_like(arrays[name], np.nan)
    about = json.dumps([1] if broken == "about" else content)
    path = tmp_path / "network.safetensors"
    save_file(arrays, path, {"about": about})
    with pytest.raises(InputError, match=r"network\.safetensors: "):
        load_perceptron(path)
