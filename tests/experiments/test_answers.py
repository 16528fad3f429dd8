"""Commands read mixed folders, and their answers carry names beside hashes."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from experiments.console.notices import LOGGER
from experiments.data.exchange import import_recordings
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.tables import LABELS
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
