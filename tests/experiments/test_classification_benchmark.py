"""The classification benchmark on a few short episodes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from experiments.benchmarks.classification import (
    OURS,
    RIVAL,
    Data,
    Recordings,
    across_scenarios,
    inductive,
    leak_probe,
)
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.answers import known_answers, score_answers
from graphrqi.methods import METHODS
from sim.store.dataset import open_dataset

KEYS = {"protocol", "scenario", "method", "window_s", "variation", "metric", "value", "low",
        "high", "n"}  # fmt: skip


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Recordings:
    """Episodes of two scenarios."""
    folder = tmp_path_factory.mktemp("episodes") / "data"
    names = ("straight_road", "two_way_road")
    generate(GenerateConfig(scenarios=names, episodes=5, duration_s=30.0, seed=3), folder, 1, True)
    return Recordings(open_dataset(folder), jobs=1)


@pytest.fixture
def data(recordings, tmp_path, monkeypatch) -> Data:
    """The benchmark on those episodes, with a quick classifier."""
    few = dataclasses.replace(METHODS[OURS], options={"rounds": 10})
    monkeypatch.setitem(METHODS, OURS, few)
    made = Data(tmp_path, (OURS, "majority"), 5, 30.0, 1)
    made["base"] = recordings
    return made


# --- samples ------------------------------------------------------------------------------------


def test_the_majority_of_the_training_stands_beside_every_score():
    codes, episode = np.array([0, 0, 0, 1] * 10), np.repeat(np.arange(4), 10)
    rows = score_answers(known_answers(np.eye(6)[codes], codes, episode), {}, majority=1)
    value = {r["metric"]: r["value"] for r in rows}
    assert value["weighted_accuracy"] == 1.0
    assert value["majority_weighted_accuracy"] == 0.25


def test_no_episode_is_both_learned_and_scored(recordings):
    learned = set(recordings.training("majority").episode.tolist())
    scored = set(recordings.scored("majority", (10.0,)).episode.tolist())
    assert learned
    assert scored
    assert not learned & scored
    assert learned >= set(recordings.training_tracks.episode.tolist())


# --- protocols ----------------------------------------------------------------------------------


def test_the_rival_and_the_ceiling_stand_beside_ours(data):
    rows = [row for part in inductive(data) for row in part]
    assert all(set(row) - {"behavior"} == KEYS for row in rows)
    whole = {r["method"] for r in rows if r["variation"] == "whole track"}
    assert whole == {OURS, "majority", RIVAL, "ceiling"}
    count = {
        (r["scenario"], r["method"]): r["n"]
        for r in rows
        if r["metric"] == "macro_f1" and r["variation"] == "whole track"
    }
    for scenario in data["base"].dataset.scenarios:
        assert 0 < count[scenario, RIVAL] <= count[scenario, OURS]


def test_each_scenario_is_scored_with_what_was_learned_on_the_other(data):
    rows = [row for part in across_scenarios(data) for row in part]
    names = data["base"].dataset.scenarios
    found = {(r["scenario"], r["variation"].removeprefix("whole track, ")) for r in rows}
    assert found == {(one, f"trained on {other}") for one, other in (names, names[::-1])}
    assert {r["method"] for r in rows} == {OURS, RIVAL}


def test_the_leak_probe_sees_no_driving(data):
    data["many"] = data["base"]
    rows = [row for part in leak_probe(data) for row in part]
    assert {r["variation"] for r in rows} == {"", "first window", "random rows"}
    score = [r for r in rows if r["metric"] == "weighted_accuracy"]
    assert all(r["value"] < 0.6 for r in score if r["variation"] == "first window")
    by_rows = {r["scenario"]: r["value"] for r in score if r["variation"] == "random rows"}
    assert by_rows["two_way_road"] > 0.7  # it knows again whom it has learned from
