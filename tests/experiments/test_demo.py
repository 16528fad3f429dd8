"""The whole loop at its smallest: generate, train, classify, predict, report."""

from __future__ import annotations

import json
import re

import pytest

from experiments.demo import METHODS, PREDICTORS, SCENARIOS, run_demo
from experiments.report.findings import findings
from experiments.report.page import read_source, write_report
from graphrqi.model_files import load_model


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "tiny"
    run_demo(out, seed=3, episodes=3, duration_s=30.0, jobs=1, quiet=True)
    write_report([out], jobs=1)
    return out


def test_every_figure_has_its_interval_and_split(run):
    rows = json.loads((run / "rows.json").read_text())
    for scenario in SCENARIOS:
        scores = [r for r in rows if r["metric"] == "macro_f1" and r["scenario"] == scenario]
        assert [row["method"] for row in scores] == list(METHODS)
        assert all(0.0 <= row["value"] <= 1.0 and row["split"] == "test" for row in scores)
        for name in PREDICTORS:
            errors = {
                row["horizon_s"]: row["value"]
                for row in rows
                if row["metric"] == "ade_m" and row["scenario"] == scenario
                if row["predictor"] == name and row["behavior"] == "all"
            }
            assert list(errors) == [1.0, 3.0, 5.0]
            assert errors[1.0] < errors[5.0]


def test_the_model_is_left_and_loads(run):
    model = load_model(run / "model")
    assert model.method.name == "graphrqi-plus"
    assert model.card["data"]["episodes"] == {"train": 2, "validation": 2, "test": 2}


def test_the_page_is_self_contained_and_links_to_replays(run):
    page = (run / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](https?:)?//", page)
    for word in (*METHODS, *PREDICTORS, *SCENARIOS, "macro-F1", *findings(read_source(run))):
        assert word in page
    links = re.findall(r'href="(replays/[0-9a-f]{16}\.html)#([^"]+)"', page)
    assert len(links) > 2 * len(SCENARIOS)
    for name, moment in links:
        assert (run / name).is_file()
        assert "t=" in moment
