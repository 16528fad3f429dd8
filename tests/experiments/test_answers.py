"""Commands say what people want to know: scores, totals, names, versions, what went wrong where."""

from __future__ import annotations

import json
import logging
import re
from importlib import metadata
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from packaging.requirements import Requirement

from behaviors import InputError
from behaviors.labels import BEHAVIORS
from experiments.cli import doctor
from experiments.console.notices import LOGGER
from experiments.data.exchange import import_recordings
from experiments.generate.configuration import GenerateConfig, read_config
from experiments.generate.dataset import generate
from experiments.scoring.classification import LABELS
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
    assert f"{out}: majority trained on {data}" in said
    assert re.search(r"straight_road.*0\.\d\d", said)
    assert call("train", data, "--method", "majority", "--out", out, "-q", "--json", "-") == 0
    rows = json.loads(capsys.readouterr().out)
    keys = {"bench", "model", "scenario", "split", "metric", "value", "low", "high", "n"}
    assert keys == set(rows[0])
    assert {"macro_f1", "ece", "unknown_share", "confusion"} <= {row["metric"] for row in rows}


def test_training_without_test_episodes_says_so(tmp_path, capsys) -> None:
    config = GenerateConfig(scenarios=("straight_road",), episodes=1, seed=1, duration_s=30.0)
    generate(config, tmp_path / "data", jobs=1, quiet=True)
    out = tmp_path / "model"
    assert call("train", tmp_path / "data", "--method", "majority", "--out", out, "-q") == 0
    assert "not scored: the dataset has no test episode" in capsys.readouterr().out


def test_classifying_ends_with_totals_per_split(data, tmp_path, capsys) -> None:
    labels, table = tmp_path / "labels.parquet", tmp_path / "table.json"
    assert call("classify", data, "--out", labels, "--json", table, "-q") == 0
    said = capsys.readouterr().out
    assert "straight_road 0" in said
    assert said.index("drivers by their last answer") < said.index("in all")
    rows = json.loads(table.read_text())
    totals = {row["split"]: row for row in rows if row["episode"] == "all"}
    assert set(totals) == {"train", "validation", "test"}
    for split, total in totals.items():
        parts = [r for r in rows if r["split"] == split and r["episode"] != "all"]
        assert total["drivers"] == sum(r["drivers"] for r in parts)
        assert total["right_at_end"] == sum(r["right_at_end"] for r in parts)
        assert total["drivers"] == sum(total[b.value] for b in BEHAVIORS) + total["unknown"]
        assert 1 / 6 < total["confidence"] <= 1.0


def test_classifying_needs_no_file_to_write(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "argo7_tracks.csv").write_text(ARGO)
    assert call("classify", "argo7_tracks.csv", "-q") == 0
    assert "drivers by their last answer" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["argo7_tracks.csv"]


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


def test_q_before_the_command_is_quiet_too(tmp_path, capsys) -> None:
    options = ["--scenario", "straight_road", "--episodes", 1, "--duration-s", 5, "--jobs", 1]
    assert call("-q", "generate", *options, "--out", tmp_path / "a") == 0
    assert capsys.readouterr().err == ""
    assert call("generate", *options, "--out", tmp_path / "b") == 0
    assert "generating episodes" in capsys.readouterr().err


def test_doctor_advises_what_pip_takes(monkeypatch) -> None:
    def none_installed(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(doctor.metadata, "version", none_installed)
    findings = list(doctor._packages())
    assert len(findings) > 20
    for finding in findings:
        (named,) = re.findall(r"^pip install '([^']+)'", finding.fix)
        assert Requirement(named).name in finding.what


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


def test_one_format_asked_for_names_the_others(tmp_path, caplog) -> None:
    source = mixed(tmp_path / "mixed")
    manifest = import_recordings(source, tmp_path / "data", "argo", quiet=True)
    assert [entry.name for entry in manifest.episodes] == ["a"]
    for name in ("00_tracks.csv", "01_tracks.csv", "notes.csv"):
        assert name in caplog.text


# --- errors name the user's thing ---------------------------------------------------------------


def test_errors_name_the_path_that_was_given(tmp_path, capsys) -> None:
    recording = tmp_path / "short.csv"
    recording.write_text("frame,id,x,y\n0,0,0,0\n1,0,1,0\n")
    assert call("predict", recording, "--predictors", "constant-velocity", "-q") == 2
    said = capsys.readouterr().err
    assert said.startswith(f"graphrqi: error: {recording}: ")
    assert "graphrqi-import" not in said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'scenario = ["straight_road"]',
            "scenario: found an unknown key, did you mean 'scenarios'?",
        ),
        ("episodes = 0", "episodes: found 0, expected at least 1"),
        ("seed = 'x'", "seed: found 'x', expected a valid integer"),
        ("scenarios = []", "scenarios: found [], expected 1 or more entries"),
        ("xyz = 1", "xyz: found an unknown key, expected one of scenarios, episodes"),
    ],
)
def test_a_wrong_key_of_a_file_is_named_with_the_right_one(tmp_path, text, message) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    given = {} if "scenarios" in text else {"scenarios": ["straight_road"]}
    given |= {} if "episodes" in text else {"episodes": 1}
    with pytest.raises(InputError) as raised:
        read_config(path, **given)
    assert str(raised.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize("content", ["{", "{}", "[1]", '[{"value": 1}]'])
def test_a_report_says_what_a_file_of_rows_looks_like(tmp_path, content, capsys) -> None:
    (tmp_path / "rows.json").write_text(content)
    assert call("report", tmp_path / "rows.json") == 2
    assert "as graphrqi bench NAME --json FILE writes it" in capsys.readouterr().err


def test_a_report_of_nothing_names_what_is_missing(tmp_path, capsys) -> None:
    assert call("report", tmp_path / "nowhere") == 2
    assert f"{tmp_path / 'nowhere'}: found no file and no folder" in capsys.readouterr().err
    assert call("report", tmp_path) == 2
    assert f"{tmp_path}: found no run.json, no model.json" in capsys.readouterr().err


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
