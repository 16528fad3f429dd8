"""``graphrqi train --from``: labels move the answers at a place."""

import csv
import json

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.cli.__main__ import main
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from graphrqi.model_files import load_model
from sim.store.dataset import open_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("place") / "data"
    generate(
        GenerateConfig(scenarios=("straight_road",), episodes=1, duration_s=70.0, seed=5),
        folder, 1, True,
    )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def labels(data, tmp_path_factory):
    """The drawn style of every driver that is seen for a second."""
    dataset = open_dataset(data)
    tracks = dataset.read(dataset.manifest.episodes[0]).tracks
    long_seen = tracks.valid.sum(axis=1) > 1.5 / tracks.step_s
    path = tmp_path_factory.mktemp("labels") / "few.csv"
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["name", "label"])
        for row in np.flatnonzero(long_seen & (tracks.behavior >= 0)):
            table.writerow([tracks.names[row], BEHAVIORS[tracks.behavior[row]].style.value])
    return path


def test_labels_adapt_a_model_and_the_gain_is_reported(data, labels, tmp_path):
    out, table = tmp_path / "adapted", tmp_path / "rows.json"
    arguments = ["train", "--from", "graphrqi-plus", data, "--labels", labels]
    arguments += ["--out", out, "--json", table]
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert not ended.value.code
    rows = json.loads(table.read_text())
    (known,) = [row["value"] for row in rows if row["metric"] == "labelled_drivers"]
    assert known > 20
    gains = [row for row in rows if row.get("labelled") == 10]
    assert {row["model"] for row in gains} == {"as it was", "adapted"}
    for row in gains:
        assert 0.0 <= row["value"] <= 5.0
    adapted, before = load_model(out), load_model("graphrqi-plus")
    assert adapted.adaptation is not None
    assert before.adaptation is None
