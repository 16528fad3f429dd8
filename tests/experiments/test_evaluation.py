"""Evaluating says what joining the answers with the truth gives."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from sklearn.metrics import balanced_accuracy_score, f1_score, roc_auc_score

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.answers import score_answers
from experiments.score.labels import read_answers
from experiments.score.tables import LABELS
from sim.store.dataset import open_dataset
from tests.experiments.shared import call

FOLLOWERS = "frame,id,x,y\n" + "".join(
    f"{t},{i},{t * (1 + i) * 0.8},{4 * i}\n" for t in range(60) for i in (0, 1, 2)
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("evaluated") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=4, duration_s=25.0)
    generate(config, folder, jobs=1, quiet=True)
    return folder


def figures(path: Path, **keys: str) -> dict[str, dict]:
    rows = json.loads(path.read_text())
    return {
        row["metric"]: row
        for row in rows
        if all(row.get(key) == value for key, value in keys.items())
        and not {"behavior", "confidence"} & set(row)
    }


def test_scores_are_those_of_the_joined_tables(data, tmp_path, capsys) -> None:
    labels, scores = tmp_path / "labels.parquet", tmp_path / "scores.json"
    assert call("classify", data, "--out", labels, "-q") == 0
    assert call("evaluate", "graphrqi-plus", data, "--json", scores, "--jobs", 1, "-q") == 0
    said = capsys.readouterr().out
    assert "majority class" in said
    table = pq.read_table(labels).to_pandas()
    opened = open_dataset(data)
    drawn = pd.DataFrame(
        [
            {"episode": entry.id, "agent": agent.id, "drawn": agent.behavior}
            for entry in opened.episodes()
            for agent in opened.read(entry).agents
        ]
    )
    joined = table.merge(drawn, on=["episode", "agent"], how="left")
    assert (joined["truth"] == joined["drawn"]).all()
    last = table.sort_values("time_s").groupby(["episode", "agent"]).tail(1)
    columns = [f"p_{b.value}" for b in BEHAVIORS]
    answer = np.array([b.value for b in BEHAVIORS])[last[columns].to_numpy().argmax(axis=1)]
    found = figures(scores, scenario="straight_road", split="all")
    expected = {
        "drivers": len(last),
        "weighted_accuracy": (answer == last["truth"]).mean(),
        "majority_weighted_accuracy": last["truth"].value_counts().max() / len(last),
        "balanced_accuracy": balanced_accuracy_score(last["truth"], answer),
        "macro_f1": f1_score(last["truth"], answer, average="macro"),
        "answered_share": last["behavior"].notna().mean(),
        "style_auc": roc_auc_score(
            last["true_style"] == "aggressive", last[columns[:3]].sum(axis=1)
        ),
    }
    for metric, value in expected.items():
        assert found[metric]["value"] == pytest.approx(value, abs=1e-6), metric
    assert found["weighted_accuracy"]["low"] <= expected["weighted_accuracy"]
    each = figures(scores, split="test")
    assert each["weighted_accuracy"]["low"] is None  # one episode says nothing of the spread
    rows = json.loads(scores.read_text())
    assert {row["command"] for row in rows} == {"evaluate"}
    counts = [r["value"] for r in rows if r["metric"] == "confusion" and r["split"] == "all"]
    assert sum(counts) == len(last)
    right = [
        r["value"] * r["n"] for r in rows if r["metric"] == "reliability" and r["split"] == "all"
    ]
    assert sum(right) == pytest.approx((answer == last["truth"]).sum())


def last_answers(answers, truths, styles, confidence=0.7) -> pa.Table:
    """A table of last answers, each as certain."""
    rows = []
    for agent, (answer, truth, style) in enumerate(zip(answers, truths, styles, strict=True)):
        rest = (1.0 - confidence) / 5
        rows.append({
            "episode": "e", "scenario": "s", "split": "test", "agent": agent, "name": str(agent),
            "behavior": answer, "style": getattr(Behavior, answer.upper()).style,
            "domain": 0.0, "unknown": 0.0,
            "truth": truth, "true_style": style,
            **{f"p_{b.value}": confidence if b.value == answer else rest for b in BEHAVIORS},
        })  # fmt: skip
    return pa.Table.from_pylist(rows, schema=LABELS)


def test_known_answers_give_known_figures() -> None:
    """Two of three behaviours right, at 70 %; of a fourth driver only the style is known."""
    table = last_answers(
        ["timid", "timid", "reckless", "careful"],
        ["timid", "timid", "impatient", None],
        ["conservative", "conservative", "aggressive", "aggressive"],
    )
    rows = score_answers(table.to_pandas(), {})
    found = {row["metric"]: row for row in rows if "behavior" not in row}
    value = {metric: row["value"] for metric, row in found.items()}
    assert value["weighted_accuracy"] == pytest.approx(2 / 3)
    assert value["majority_weighted_accuracy"] == pytest.approx(2 / 3)
    assert value["balanced_accuracy"] == pytest.approx(0.5)
    assert value["ece"] == pytest.approx(0.7 - 2 / 3)
    assert found["reliability"]["confidence"] == pytest.approx(0.7)
    assert value["reliability"] == pytest.approx(2 / 3)
    assert (found["style_accuracy"]["n"], found["weighted_accuracy"]["n"]) == (4, 3)
    assert value["style_accuracy"] == pytest.approx(3 / 4)
    assert value["style_balanced_accuracy"] == pytest.approx(3 / 4)
    assert value["majority_style_accuracy"] == pytest.approx(1 / 2)
    recalls = {r["behavior"]: r["value"] for r in rows if r["metric"] == "recall"}
    assert recalls == {"impatient": 0.0, "timid": 1.0}


def test_answers_from_a_file_are_scored_like_ours(data, tmp_path, capsys) -> None:
    """Truth as answers is right everywhere; a driver without an answer counts as unanswered."""
    opened = open_dataset(data)
    (entry,) = opened.episodes("test")
    drawn = [
        {"episode": entry.id, "agent": agent.id, "time_s": t, "label": b}
        for agent in opened.read(entry).agents
        if agent.behavior is not None
        for t, b in ((9.0, str(agent.behavior)), (1.0, "timid"))
    ]
    pd.DataFrame(drawn).to_csv(tmp_path / "true.csv", index=False)
    pd.DataFrame(drawn[6:]).to_parquet(tmp_path / "partial.parquet")
    for name in ("true.csv", "partial.parquet"):
        given = ("--answers", tmp_path / name, "--json", tmp_path / "scores.json", "--jobs", 1)
        assert call("evaluate", "graphrqi-plus", data, *given, "-q") == 0
        rows = json.loads((tmp_path / "scores.json").read_text())
        own = [row for row in rows if row["model"] == name.split(".")[0]]
        value = {row["metric"]: row["value"] for row in own if "against" not in row}
        assert (value["weighted_accuracy"] == 1.0) == (name == "true.csv")
        assert value["answered_accuracy"] == 1.0
        assert (value["answered_share"] == 1.0) == (name == "true.csv")
        assert {row["against"] for row in own if "against" in row} == {
            "graphrqi-plus", "plain rival"
        }  # fmt: skip
    assert "plain rival" in capsys.readouterr().out
    (tmp_path / "other.csv").write_text("episode,agent,label\nx,1,timid\n")
    assert call("evaluate", "graphrqi-plus", data, "--answers", tmp_path / "other.csv") == 2
    assert "found no answer about a driver of the test split" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("label", "chances", "message"),
    [
        ("timid", {"careful": 40.0, "timid": 60.0}, "probabilities from 0 on that add to 1"),
        ("timid", {"careful": -0.5, "timid": 1.5}, "probabilities from 0 on that add to 1"),
        ("timid", {"careful": np.nan, "timid": 1.0}, "probabilities from 0 on that add to 1"),
        ("careful", {"timid": 1.0}, "the behaviour with the largest p_ column"),
    ],
)
def test_answers_have_probabilities_that_agree_with_the_label(label, chances, message, tmp_path):
    row = {"episode": "x", "agent": 1, "label": label, **{f"p_{b}": 0.0 for b in BEHAVIORS}}
    row |= {f"p_{b}": value for b, value in chances.items()}
    pd.DataFrame([row]).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=message):
        read_answers(tmp_path / "a.parquet")


def test_answers_may_name_behaviours_of_ones_own(tmp_path) -> None:
    mix = {"careful": 0.5, "novice": 0.5}
    config = GenerateConfig(
        scenarios=("straight_road",), episodes=3, seed=4, duration_s=25.0, behaviors="novice",
        mix=mix,
    )  # fmt: skip
    generate(config, tmp_path / "data", jobs=1, quiet=True)
    assert len(open_dataset(tmp_path / "data").episodes("test", behavior="novice")) == 1
    agents = open_dataset(tmp_path / "data").scan("agents", split="test").to_table().to_pandas()
    drivers = agents.dropna(subset=["behavior"]).rename(columns={"behavior": "label"})
    drivers[["episode", "agent", "label"]].to_csv(tmp_path / "graphrqi-plus.csv", index=False)
    given = ("--answers", tmp_path / "graphrqi-plus.csv", "--json", tmp_path / "s.json", "-q")
    assert call("evaluate", "graphrqi-plus", tmp_path / "data", *given) == 0
    found = figures(tmp_path / "s.json", model="graphrqi-plus.csv", scenario="straight_road")
    assert found["weighted_accuracy"]["value"] == 1.0


def recording(folder: Path) -> Path:
    path = folder / "argo7_tracks.csv"
    path.write_text(FOLLOWERS)
    return path


def test_without_labels_shares_are_shown_and_nothing_is_scored(tmp_path, capsys) -> None:
    source = recording(tmp_path)
    met = tmp_path / "met.csv"
    assert call("classify", source, "--conflicts", met, "-q") == 0
    assert set(pd.read_csv(met)[["first_name", "second_name"]].to_numpy().ravel()) <= {0, 1, 2}
    said = capsys.readouterr().out
    assert "confidence" in said
    assert "majority" not in said
    assert call("evaluate", "graphrqi-plus", source) == 2
    message = capsys.readouterr().err
    assert "found no driver whose behaviour or style is known" in message
    assert "--labels FILE.csv" in message
