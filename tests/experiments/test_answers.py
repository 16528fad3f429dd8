"""Commands say what people want to know: scores, totals, names, versions, what went wrong where."""

from __future__ import annotations

import json
import logging
import re
from importlib import metadata
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from experiments.console.notices import LOGGER
from experiments.data.exchange import import_recordings
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.labels import LABELS
from sim.formats import formats_in, left_out_files
from sim.store.dataset import open_dataset
from tests.experiments.shared import call

ARGO = "frame,id,x,y\n" + "".join(
    f"{t},{i},{t * (1 + i)},{4 * i}\n" for t in range(60) for i in (0, 1)
)
IND = "trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,yVelocity\n" + "".join(
    f"{i},{t},{t * 0.3},{4 * i},0,1.8,4.5,7.5,0\n" for i in (0, 1) for t in range(60)
)


@pytest.fixture(autouse=True)
def logger_as_before():
    level, handlers = LOGGER.level, list(LOGGER.handlers)
    yield
    LOGGER.setLevel(level)
    LOGGER.handlers[:] = handlers


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("answers") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=5, seed=1, duration_s=30.0)
    generate(config, folder, jobs=1, quiet=True)
    return folder


def test_training_ends_with_its_scores(data, tmp_path, capsys) -> None:
    out = tmp_path / "model"
    assert call("train", data, "--method", "majority", "--out", out, "-q", "--jobs", 1) == 0
    said = capsys.readouterr().out
    assert re.search(r"straight_road.*0\.\d\d", said)
    assert call("train", data, "--method", "majority", "--out", out, "-q", "--json", "-") == 0
    rows = json.loads(capsys.readouterr().out)
    keys = {"command", "version", "seed", "dataset", "model", "scenario", "split"}
    assert keys | {"metric", "value", "low", "high", "n"} == set(rows[0])
    assert {"macro_f1", "ece", "answered_share", "confusion"} <= {row["metric"] for row in rows}


def test_training_without_test_episodes_says_so(tmp_path, capsys) -> None:
    config = GenerateConfig(scenarios=("straight_road",), episodes=1, seed=1, duration_s=30.0)
    generate(config, tmp_path / "data", jobs=1, quiet=True)
    out = tmp_path / "model"
    assert call("train", tmp_path / "data", "--method", "majority", "--out", out, "-q") == 0
    assert "not scored" in capsys.readouterr().err


def test_classifying_ends_with_totals_per_split(data, tmp_path, capsys) -> None:
    labels, table = tmp_path / "labels.parquet", tmp_path / "table.json"
    assert call("classify", data, "--out", labels, "--json", table, "-q") == 0
    said = capsys.readouterr().out
    assert "straight_road 0" in said
    rows = json.loads(table.read_text())
    drivers = {r["split"]: r["value"] for r in rows
               if r["metric"] == "drivers" and "name" not in r}  # fmt: skip
    assert set(drivers) == {"train", "validation", "test", "all"}
    for split in ("train", "validation", "test"):
        parts = [r for r in rows if r["split"] == split and "name" in r]
        assert drivers[split] == sum(r["value"] for r in parts if r["metric"] == "drivers")


def test_labels_carry_names_beside_hashes(tmp_path) -> None:
    (tmp_path / "argo7_tracks.csv").write_text(ARGO)
    labels = tmp_path / "labels.parquet"
    assert call("classify", tmp_path / "argo7_tracks.csv", "--out", labels, "-q") == 0
    table = pq.read_table(labels)
    assert table.schema.equals(LABELS)
    assert set(table["recording"].to_pylist()) == {"argo7_tracks"}
    assert set(table["file"].to_pylist()) == {"argo7_tracks.csv"}
    assert set(table["scenario"].to_pylist()) == {"argo"}
    assert set(table["split"].to_pylist()) == {"test"}
    assert set(table["name"].to_pylist()) == {"0", "1"}
    assert table["truth"].null_count == table.num_rows
    assert set(table["style"].to_pylist()) <= {"aggressive", "conservative", None}
    wanted = tmp_path / "predictions.parquet"
    names = ["--predictors", "constant-velocity", "--horizon-s", 1, "--out", wanted, "-q"]
    assert call("predict", tmp_path / "argo7_tracks.csv", *names) == 0
    assert set(pq.read_table(wanted)["recording"].to_pylist()) == {"argo7_tracks"}


def test_the_version_and_what_it_runs_on(capsys) -> None:
    assert call("--version") == 0
    assert capsys.readouterr().out.startswith(f"graphrqi {metadata.version('graphrqi')}, Python 3.")


@pytest.mark.parametrize(
    ("arguments", "level"),
    [
        (["list"], logging.INFO),
        (["list", "-v"], logging.DEBUG),
        (["-v", "list"], logging.DEBUG),
        (["-q", "list"], logging.WARNING),
    ],
    ids=["plain", "after", "before", "quiet"],
)
def test_v_and_q_set_the_level(arguments, level, capsys) -> None:
    assert call(*arguments) == 0
    assert LOGGER.level == level
    assert ("graphrqi: done in" in capsys.readouterr().err) == (level == logging.DEBUG)


# --- mixed folders ------------------------------------------------------------------------------


def mixed(folder: Path) -> Path:
    folder.mkdir()
    (folder / "a.csv").write_text(ARGO)
    (folder / "00_tracks.csv").write_text(IND)
    (folder / "00_tracksMeta.csv").write_text("trackId,class\n0,car\n1,car\n")
    (folder / "01_tracks.csv").write_text(IND)
    (folder / "notes.csv").write_text("who,what\n")
    return folder


def test_a_mixed_folder_is_read_whole(tmp_path, caplog) -> None:
    source = mixed(tmp_path / "mixed")
    assert formats_in(source) == ["ind", "argo"]
    assert [f.name for f in left_out_files(source, ["ind", "argo"])] == ["notes.csv"]
    manifest = import_recordings(source, tmp_path / "data", quiet=True)
    names = {entry.name: entry.engine for entry in manifest.episodes}
    assert names == {"00_tracks": "ind", "01_tracks": "ind", "a": "argo"}
    assert manifest.configuration["format"] == "ind, argo"
    assert "left out, because they are not in the format ind or argo: notes.csv" in caplog.text
    assert len(open_dataset(tmp_path / "data").manifest.episodes) == 3


# --- errors name the user's thing ---------------------------------------------------------------


def test_errors_name_the_path_that_was_given(tmp_path, capsys) -> None:
    recording = tmp_path / "short.csv"
    recording.write_text("frame,id,x,y\n0,0,0,0\n1,0,1,0\n")
    assert call("predict", recording, "--predictors", "constant-velocity", "-q") == 2
    said = capsys.readouterr().err
    assert said.startswith(f"graphrqi: error: {recording}: ")
    assert "graphrqi-import" not in said


@pytest.mark.parametrize(
    "arguments",
    [
        ["bench", "loop", "--quick", "--json", "nowhere/x.json"],
        ["classify", ".", "--out", "nowhere/x.parquet"],
        ["list", "--json", "nowhere/x.json"],
    ],
    ids=["bench", "classify", "list"],
)
def test_a_missing_folder_is_named_before_any_work(
    arguments, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*arguments) == 2
    said = capsys.readouterr().err
    assert f"{arguments[-1]}: found no folder nowhere, expected one" in said
    assert ".partial" not in said
