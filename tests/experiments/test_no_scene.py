"""Recordings that are no scene, or too short, are named as such, and nobody is told."""

import csv
from pathlib import Path

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.data.exchange import as_dataset
from experiments.replay.scene import gather
from sim.store.dataset import open_dataset
from tests.experiments.shared import call, write_recording


def recording(folder: Path, overlapping: int, frames: int = 50) -> None:
    """Cars behind one another; some come in pairs, 1.5 m apart."""
    places = [20.0 * n for n in range(40)] + [20.0 * n + 1.5 for n in range(overlapping)]
    write_recording(folder, [(x, 0.0) for x in places], frames)


@pytest.mark.parametrize(("overlapping", "believed"), [(4, False), (0, True)])
def test_nobody_is_told_where_outlines_overlap(tmp_path, capsys, overlapping, believed):
    """They are too few for a stream, which does not know outlines, to doubt the scene."""
    recording(tmp_path, overlapping)
    assert call("classify", tmp_path, "--out", tmp_path / "answers.csv") == 0
    said = capsys.readouterr().err
    assert ("no scene that can be believed" in said) != believed
    with (tmp_path / "answers.csv").open(newline="") as file:
        answers = list(csv.DictReader(file))
    assert answers
    unknown = {float(row["unknown"]) for row in answers}
    assert (unknown == {1.0}) != believed
    if not believed:
        assert {(row["behavior"], row["style"]) for row in answers} == {("", "")}
    with as_dataset(tmp_path) as folder:
        dataset = open_dataset(folder)
        (entry,) = dataset.manifest.episodes
        scene = gather(dataset, entry, model="graphrqi-plus", predictor="none")
    beliefs = scene.beliefs.probability
    chance = np.isnan(beliefs) | np.isclose(beliefs, 1.0 / len(BEHAVIORS))
    assert chance.all() != believed


def test_where_nobody_is_seen_for_a_second_it_is_said(tmp_path, capsys):
    recording(tmp_path, 0, frames=4)
    assert call("classify", tmp_path, "-q") == 0
    assert "no driver is seen for 1 s or longer, so there is no answer" in capsys.readouterr().err
    labels = tmp_path.parent / "labels.csv"
    labels.write_text("name,label\n1,timid\n")
    assert call("evaluate", "graphrqi-plus", tmp_path, "--labels", labels, "-q") == 2
    assert "found no driver seen for 1 s, expected one" in capsys.readouterr().err
