"""The whole loop at its smallest: generate, train, classify, predict, report."""

from __future__ import annotations

import json
import re

import pytest

from experiments.demo import METHODS, PREDICTORS, SCENARIOS, SCORES, run_demo
from experiments.report.findings import findings
from experiments.report.page import write_report
from experiments.report.source import read_source
from graphrqi.model_files import load_model


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "tiny"
    run_demo(out, seed=3, episodes=3, duration_s=30.0, jobs=1, quiet=True)
    write_report([out], jobs=1)
    return out


def test_metrics_have_every_number_with_its_interval_and_split(run):
    metrics = json.loads((run / "metrics.json").read_text())
    assert set(metrics) == {"classification", "prediction"}
    for scenario in SCENARIOS:
        assert list(metrics["classification"][scenario]) == list(METHODS)
        for scores in metrics["classification"][scenario].values():
            assert set(scores) == set(SCORES)
            for score in scores.values():
                assert set(score) == {"value", "low", "high", "n", "split"}
                assert 0.0 <= score["value"] <= 1.0
                assert score["split"] == "test"
        assert list(metrics["prediction"][scenario]) == list(PREDICTORS)
        for kinds in metrics["prediction"][scenario].values():
            assert set(kinds) == {"ade_m", "fde_m"}
            for horizons in kinds.values():
                assert list(horizons) == ["1s", "3s", "5s"]
                assert horizons["1s"]["value"] < horizons["5s"]["value"]


def test_the_model_is_left_and_loads(run):
    model = load_model(run / "model")
    assert model.method.name == "graphrqi-plus"
    assert model.card["data"]["episodes"] == {"train": 2, "validation": 2, "test": 2}


def test_the_page_is_self_contained_and_links_to_replays(run):
    page = (run / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](https?:)?//", page)
    for word in (*METHODS, *PREDICTORS, *SCENARIOS, "macro-F1", *findings(read_source(run).rows)):
        assert word in page
    links = re.findall(r'href="(replays/[0-9a-f]{16}\.html)#([^"]+)"', page)
    assert len(links) > 2 * len(SCENARIOS)
    for name, moment in links:
        assert (run / name).is_file()
        assert "t=" in moment
