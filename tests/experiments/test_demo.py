"""The whole loop at its smallest: generate, train, classify, predict, report."""

from __future__ import annotations

import json
import re

import pytest

from behaviors.errors import InputError
from experiments.demo import METHODS, PREDICTORS, SCENARIOS, run_demo
from experiments.report import write_comparison, write_report
from experiments.report.run_file import read_run
from graphrqi.model_files import load_model


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "tiny"
    run_demo(out, seed=3, episodes=3, duration_s=45.0, jobs=1, quiet=True)
    write_report(out)
    return out


def test_metrics_have_every_number_with_its_interval_and_split(run):
    metrics = json.loads((run / "metrics.json").read_text())
    assert set(metrics) == {"classification", "prediction"}
    for scenario in SCENARIOS:
        assert list(metrics["classification"][scenario]) == list(METHODS)
        for scores in metrics["classification"][scenario].values():
            assert set(scores) == {
                "weighted_accuracy",
                "balanced_accuracy",
                "macro_f1",
                "style_balanced_accuracy",
                "majority_weighted_accuracy",
            }
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


def test_the_majority_class_is_what_the_majority_method_scores(run):
    metrics = json.loads((run / "metrics.json").read_text())["classification"]
    for methods in metrics.values():
        scores = methods["majority"]
        assert scores["weighted_accuracy"]["value"] == pytest.approx(
            scores["majority_weighted_accuracy"]["value"]
        )


def test_the_model_is_left_and_loads(run):
    model = load_model(run / "model")
    assert model.method.name == "graphrqi-plus"
    assert model.card["data"]["episodes"] == {"train": 2, "validation": 2, "test": 2}


def test_the_page_is_self_contained_and_tells_everything(run):
    page = (run / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](https?:)?//", page)
    assert "@import" not in page
    for word in (*METHODS, *PREDICTORS, *SCENARIOS, "macro-F1", "|w|", "Where it was most wrong"):
        assert word in page
    assert page.count('class="confusion"') == len(SCENARIOS)
    links = re.findall(r'href="(replays/[0-9a-f]{16}\.html)#([^"]+)"', page)
    assert len(links) > 2 * len(SCENARIOS)
    for name, moment in links:
        assert (run / name).is_file()
        assert "t=" in moment


def test_the_report_is_made_again_alike(run):
    before = (run / "report.html").read_bytes()
    write_report(run)
    assert (run / "report.html").read_bytes() == before


def test_the_page_of_a_run_stays_beside_its_replays(run, tmp_path):
    with pytest.raises(InputError, match="links to the replays beside it"):
        write_report(run, out=tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_models_folder_and_a_run_beside_it_are_told_too(run, tmp_path):
    assert "never trained on" in write_report(run / "model").read_text()
    page = write_comparison([run, run / "model"], tmp_path / "c.html").read_text()
    assert '<th scope="col">tiny</th><th scope="col">model</th>' in page


def test_a_broken_run_is_refused_by_name(run, tmp_path):
    with pytest.raises(InputError, match=r"found no run\.json"):
        write_report(tmp_path)
    for name in ("run.json", "metrics.json"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    file = json.loads((run / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps(file | {"schema_version": 99}))
    with pytest.raises(InputError, match="schema_version: found 99"):
        read_run(tmp_path)
    (tmp_path / "run.json").write_text(json.dumps(file | {"colour": "blue"}))
    with pytest.raises(InputError, match="colour"):
        read_run(tmp_path)
