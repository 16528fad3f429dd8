"""Reports of rows: tables, pictures and findings."""

from __future__ import annotations

import json

import pandas as pd
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.report.findings import findings
from experiments.report.page import write_report

HOSTILE = '</td><script>document.title = "x"</script>'
FIGURE = {"value": 0.5, "low": 0.4, "high": 0.625, "n": 12}


def rows_of(command, keys, shift=0.0):
    made = {"command": command, "version": "0", "seed": 0, "dataset": "d"}
    figure = {**FIGURE, "value": 0.5 + shift}
    return [{**made, **key, **figure} for key in keys]


def predictions(shift=0.0):
    keys = [
        {"scenario": "straight_road", "predictor": p, "horizon_s": h, "behavior": b, "metric": m}
        for p in ("constant-velocity", "graphrqi-predict") for h in (1.0, 3.0, 5.0)
        for b in ("all", *map(str, BEHAVIORS)) for m in ("ade_m", "fde_m", "nll")
    ]  # fmt: skip
    return rows_of("predict", keys, shift)


def answers():
    keys = [
        {"model": "mine", "scenario": "s", "split": "test", "metric": m}
        for m in ("weighted_accuracy", "macro_f1", "majority_weighted_accuracy",
                  "style_balanced_accuracy")
    ]  # fmt: skip
    keys += [
        {**keys[0], "metric": "confusion", "behavior": str(b), "answer": str(a)}
        for b in BEHAVIORS for a in BEHAVIORS
    ]  # fmt: skip
    keys += [{**keys[0], "metric": "reliability", "confidence": c} for c in (0.3, 0.6, 0.9)]
    return rows_of("evaluate", keys)


OTHER = {
    "bench spectrum": [
        {"solver": s, "d": d, "graph": "road", "metric": m}
        for s in ("graphrqi", "eigh") for d in (25, 100) for m in ("cpu_ms", "residual_max")
    ],
    "bench loop": [{"stage": s, "agents": 50, "metric": "ms_median"} for s in ("a", "b")],
    "something else": [{"thing": "a", "metric": "size"}],
    "hostile": [{"method": HOSTILE, "scenario": HOSTILE, "metric": m} for m in ("a", HOSTILE)],
}  # fmt: skip
KINDS = {"predict": predictions(), "evaluate": answers()} | {
    name: rows_of(name, keys) for name, keys in OTHER.items()
}


@pytest.mark.parametrize("kind", KINDS)
def test_rows_of_every_command_are_shown(kind, tmp_path):
    (tmp_path / "rows.json").write_text(json.dumps(KINDS[kind]))
    page = write_report([tmp_path / "rows.json"])
    text = page.read_text()
    assert page == tmp_path / "rows.html"
    assert "0.5 [0.4, 0.625]" in text
    assert "<script" not in text


def test_pictures_are_written_as_files_too(tmp_path):
    (tmp_path / "rows.json").write_text(json.dumps(answers()))
    for ending in ("svg", "pdf"):
        write_report([tmp_path / "rows.json"], figures=ending)
        assert len(list((tmp_path / "rows-figures").glob(f"*.{ending}"))) == 3
    with pytest.raises(InputError, match="unknown format of figures 'jpg'"):
        write_report([tmp_path / "rows.json"], figures="jpg")


def test_findings_compare_with_the_majority_class_and_plain_predictors():
    said = " ".join(findings(pd.DataFrame([*answers(), *predictions()])))
    assert "mine names the right behaviour in 50 % of all cases (majority class 50 %)" in said
    assert "graphrqi-predict over 5 s is 0.0 % larger than that of constant-velocity" in said


def test_the_last_of_several_rows_counts_in_findings():
    rows = [*answers(), *predictions()]
    before = [{**row, "value": 0.25} for row in rows]
    assert list(findings(pd.DataFrame([*before, *rows]))) == list(findings(pd.DataFrame(rows)))


@pytest.mark.parametrize(
    "rows",
    ["{", "{}", "[1]", '[{"value": 1}]', '[{"command": "a", "metric": "b", "value": "x"}]',
     '[{"command": "a", "metric": "b", "value": 1e999}]',
     '[{"command": "a", "metric": "b", "value": 1, "k": []}]', "[]"],
)  # fmt: skip
def test_what_is_no_list_of_rows_is_refused(rows, tmp_path):
    (tmp_path / "rows.json").write_text(rows)
    with pytest.raises(InputError, match=r"rows\.json"):
        write_report([tmp_path / "rows.json"])
