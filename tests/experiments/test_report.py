"""Reports of rows: tables, charts, comparisons, and what they refuse."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from markupsafe import escape
from matplotlib import rcParams
from pydantic import ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, TRAITS
from experiments.report import write_comparison, write_report
from experiments.report.charts import Axis, Chart, Line, Point
from experiments.report.excerpts import _trait_table
from experiments.report.run_file import RunFile
from experiments.report.sections import LAYOUTS, sections
from experiments.report.source import read_source
from experiments.report.tables import pivot
from tests.experiments.shared import content

HOSTILE = '</td><script>document.title = "x"</script>'


KINDS = (*LAYOUTS, "from elsewhere")


def rows_of(kind, shift=0.0):
    """A few rows such as each bench writes."""
    figure = {"value": 0.5 + shift, "low": 0.4 + shift, "high": 0.6 + shift, "n": 12}
    if kind == "spectrum":
        keys = [
            {"solver": s, "d": d, "graph": "road", "kind": "accumulated", "end": "largest",
             "metric": m}
            for s in ("graphrqi", "eigh") for d in (25, 100, 400)
            for m in ("cpu_ms", "residual_max")
        ]  # fmt: skip
    elif kind == "prediction":
        keys = [
            {"scenario": "straight_road", "predictor": p, "horizon_s": h, "behavior": b,
             "split": "test", "metric": m}
            for p in ("constant-velocity", "graphrqi-predict") for h in (1.0, 3.0, 5.0)
            for b in ("all", *map(str, BEHAVIORS)) for m in ("ade_m", "fde_m", "nll")
        ]  # fmt: skip
    elif kind == "classification":
        keys = [
            {"protocol": "inductive", "scenario": "straight_road", "method": method,
             "window_s": w, "variation": v, "metric": m}
            for method in ("majority", "graphrqi-plus", HOSTILE) for w in (3.0, 10.0)
            for v in ("", "noise") for m in ("weighted_accuracy", "balanced_accuracy")
        ]  # fmt: skip
    elif kind == "real-data":
        keys = [{"dataset": "traf", "protocol": "leave-one-video-out", "method": "graphrqi",
                 "classes": 6, "fold": f, "metric": "auc"} for f in ("one", "all")]  # fmt: skip
    elif kind == "loop":
        keys = [{"engine": "sumo", "stage": s, "agents": 50, "metric": "ms_median"}
                for s in ("classify", "predict")]  # fmt: skip
    elif kind == "generate":
        keys = [{"scenario": "all", "jobs": j, "metric": "agent_steps_per_s"} for j in (1, 2)]
    elif kind == "navigation":
        keys = [{"environment": "straight", "arm": a, "metric": "ttc"} for a in ("blind", "told")]
    elif kind == "highway":
        keys = [{"road": r, "cars": 50, "metric": "frames_per_cpu_s"} for r in ("stock", "fast")]
    elif kind == "behaviors":
        keys = [{"engine": "sumo", "scenario": "straight_road", "behavior": str(b),
                 "metric": "red_run_share"} for b in BEHAVIORS]  # fmt: skip
    else:
        keys = [{"thing": "a", "metric": "size"}]
    return [{"bench": kind, **key, **figure} for key in keys]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    for kind in KINDS:
        (folder / f"{kind}.json").write_text(json.dumps(rows_of(kind)))
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_rows_of_every_bench_are_shown(kind, study):
    page = write_report(study / f"{kind}.json")
    assert page == study / f"{kind}.html"
    text = page.read_text()
    assert "0.500" in text
    assert "0.400 – 0.600" in text
    assert text.count("<table") >= 1


def test_the_page_of_rows_stands_where_it_is_wanted(study, tmp_path):
    wanted = tmp_path / "page.html"
    assert write_report(study / "loop.json", out=wanted) == wanted
    assert "0.500" in wanted.read_text()


def test_a_study_is_one_page_with_every_section_and_says_what_is_missing(study, tmp_path):
    text = write_report(study).read_text()
    for kind in KINDS:
        assert f'<h2 id="{kind}">' in text
    assert "Not measured here" not in text
    (tmp_path / "loop.json").write_text(json.dumps(rows_of("loop")))
    alone = write_report(tmp_path).read_text()
    assert "Not measured here" in alone
    assert "graphrqi bench spectrum" in alone


def test_charts_of_early_answers_horizons_and_runtime_are_there(study):
    text = write_report(study).read_text()
    for title in ("against seconds observed", "by true behaviour", "CPU time per step"):
        assert title in text
    assert "fill-opacity: 0.16" in text  # the bands of intervals
    for drawn in ("#010101", "#020202", "#030303"):
        assert drawn not in text  # the page's own colours stand in their place
    assert "currentColor" in text


def test_strings_from_files_stay_text(study):
    text = write_report(study / "classification.json").read_text()
    assert "<script" not in text
    assert "&lt;script&gt;" in text


def test_predictions_of_several_splits_are_told_apart(tmp_path):
    rows = [{**row, "split": split} for split in ("unseen", "unseen, no map")
            for row in rows_of("prediction", 0.0 if split == "unseen" else 0.2)]  # fmt: skip
    (section,) = sections({"prediction": rows})
    assert len(section.charts) == 4
    assert {c.title.split(": ")[0] for c in section.charts} == {
        "straight_road, unseen", "straight_road, unseen, no map"
    }  # fmt: skip
    for chart in section.charts:
        for line in chart.lines:
            assert len({p.x for p in line.points}) == len(line.points)
    titles = [table.title for table in section.tables]
    assert titles == ["straight_road, unseen, all", "straight_road, unseen, no map, all"]


def test_a_logarithmic_axis_puts_powers_of_ten_evenly():
    line = Line("one", tuple(Point(10.0**k, 10.0**k) for k in range(1, 4)))
    chart = escape(Chart("t", Axis("x", log=True), Axis("y", log=True), (line,)))
    markers = re.findall(r'<use [^>]*x="([\d.]+)"[^>]*fill: #4477aa', chart)
    first, second, third = (float(x) for x in markers[:3])  # the fourth is the legend's
    assert second - first == pytest.approx(third - second, abs=0.01)
    assert first < second


def test_marks_at_the_edge_of_a_chart_are_whole():
    line = Line("kalman", (Point(1.0, 0.1), Point(5.0, 1.0)))
    chart = escape(Chart("errors", Axis("horizon, s", high=5.0), Axis("ADE, m", high=1.0), (line,)))
    assert "<use" in chart
    assert re.findall(r"<g clip-path", chart) == []


def test_a_chart_is_the_same_whenever_it_is_drawn():
    line = Line("one", (Point(1.0, 2.0, 1.5, 2.5), Point(2.0, 1.0, 0.5, 1.5)))
    charts = [Chart("t", Axis("x"), Axis("y"), (line,)) for _ in range(2)]
    assert escape(charts[0]) == escape(charts[1])
    assert charts[0].pdf() == charts[1].pdf()
    nothing = Chart("t", Axis("x", log=True), Axis("y"), (Line("none", (Point(0.0, 1.0),)),))
    assert not nothing
    assert escape(nothing) == ""


def test_a_pages_charts_are_figures_for_a_paper_too(study, tmp_path, monkeypatch):
    monkeypatch.setitem(rcParams, "pdf.compression", 0)
    page = write_report(study, figures=tmp_path / "figures").read_text()
    found = {path.name: path.read_bytes() for path in (tmp_path / "figures").iterdir()}
    assert len(found) == page.count('<figure class="chart">') == 4
    told = found["straight-road-error-against-horizon.pdf"]
    assert told.startswith(b"%PDF")
    assert b"/Subtype /Image" not in told
    kept = {"a.pdf": b"mine"}
    (tmp_path / "figures" / "a.pdf").write_bytes(kept["a.pdf"])
    write_report(study, figures=tmp_path / "figures")
    assert content(tmp_path / "figures") == found | kept


def test_the_best_of_a_column_is_marked_but_never_the_majority():
    rows = [
        {"method": name, "metric": "weighted_accuracy", "value": value, "low": None, "high": None}
        for name, value in (("majority", 0.9), ("ours", 0.6), ("theirs", 0.5))
    ]
    table = pivot(rows, "t", ["method"], ["metric"])
    assert [cells[0].best for _, cells in table.rows] == [False, True, False]


def test_captions_promise_intervals_and_bold_figures_only_where_there_are_some():
    rows = [
        {"method": name, "metric": "weighted_accuracy", "value": value, "low": low, "high": low}
        for name, value, low in (("ours", 0.6, None), ("theirs", 0.5, None))
    ]
    plain = pivot(rows[:1], "t", ["method"], ["metric"])
    assert "interval" not in plain.caption
    assert "bold" not in plain.caption
    assert "bold: best of its column" in pivot(rows, "t", ["method"], ["metric"]).caption
    rows[0] |= {"low": 0.5, "high": 0.7}
    assert "95 % intervals" in pivot(rows, "t", ["method"], ["metric"]).caption


def test_a_wide_table_keeps_its_first_column_and_says_that_it_goes_on(browser, tmp_path):
    metrics = ("weighted_accuracy", "balanced_accuracy", "macro_f1", "ece", "auc", "ms_per_frame")
    keys = {"bench": "classification", "protocol": "inductive", "scenario": "straight_road"}
    rows = [
        {**keys, "method": name, "window_s": 10, "variation": "", "metric": m, "value": 0.5,
         "low": 0.4, "high": 0.6, "n": 9}
        for name in ("graphrqi-invariant", "majority") for m in metrics
    ]  # fmt: skip
    (tmp_path / "rows.json").write_text(json.dumps(rows))
    report = write_report(tmp_path / "rows.json")
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(report.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.locator(".hint").first.is_visible()
    scroll, name = page.locator(".scroll").first, page.locator("tbody th").first
    before = name.bounding_box()
    assert before["width"] >= 90
    assert before["height"] < 60, "words are not broken letter by letter"
    moved = scroll.evaluate("(e) => { e.scrollLeft = 200; return e.scrollLeft; }")
    assert moved == 200
    assert name.bounding_box()["x"] == before["x"]
    page.set_viewport_size({"width": 1280, "height": 800})
    assert not page.locator(".hint").first.is_visible()
    page.close()


def test_one_style_means_the_best_and_another_what_was_expected():
    shown, drivers = np.eye(len(BEHAVIORS), len(TRAITS), dtype=int), np.full(len(BEHAVIORS), 2)
    table = _trait_table(shown, drivers)
    cells = [cell for _, line in table.rows for cell in line]
    assert any(cell.expected for cell in cells)
    assert not any(cell.best for cell in cells)
    assert "Framed" in table.caption
    assert "Bold" not in table.caption


def test_runs_are_compared_column_by_column(study, tmp_path):
    (tmp_path / "later.json").write_text(json.dumps(rows_of("classification", shift=0.1)))
    page = write_comparison(
        [study / "classification.json", tmp_path / "later.json"], tmp_path / "c.html"
    )
    text = page.read_text()
    assert '<th scope="col">classification</th><th scope="col">later</th>' in text
    assert "best" not in text.split("<body>")[1]
    assert "0.500" in text
    assert "0.600" in text
    (tmp_path / "loop.json").write_text(json.dumps(rows_of("loop")))
    with pytest.raises(InputError, match="in common"):
        write_comparison([tmp_path / "loop.json", tmp_path / "later.json"], tmp_path / "d.html")
    with pytest.raises(InputError, match="found 1, expected at least 2"):
        write_comparison([tmp_path / "loop.json"], tmp_path / "d.html")
    assert not (tmp_path / "d.html").exists()


def test_a_dataset_is_no_run(tmp_path):
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="found a dataset, expected a run"):
        read_source(tmp_path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "found no JSON"),
        ("{}", "found dict, expected a list of rows"),
        ('[{"value": 1}]', "row 0: found no metric"),
        (
            '[{"metric": "m", "value": 1}]',
            "row 0: found no bench, expected its name",
        ),
        ('[{"bench": "b", "metric": "m", "value": "much"}]', "row 0: value: found 'much'"),
        ('[{"bench": "b", "metric": "m", "value": 1, "more": {}}]', "row 0: found a nested value"),
    ],
)
def test_what_is_no_file_of_rows_is_refused_by_name(content, said, tmp_path):
    (tmp_path / "rows.json").write_text(content)
    with pytest.raises(InputError, match=r"rows\.json: ") as error:
        read_source(tmp_path / "rows.json")
    assert said in str(error.value)


@pytest.mark.parametrize("matrix", [[[1, 2], [3]], [[0] * 6] * 5, [[-1] * 6] * 6])
def test_a_confusion_that_is_none_is_refused_by_name(matrix):
    whole = {"name": "r", "seed": 0, "configuration": {}, "packages": {}, "dataset": "d"}
    whole |= {"model": "m", "protocol": "p", "findings": []}
    RunFile.model_validate(whole | {"confusion": {"here": {"m": [[1] * 6] * 6}}})
    with pytest.raises(ValidationError, match="confusion"):
        RunFile.model_validate(whole | {"confusion": {"here": {"m": matrix}}})


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_a_report_can_be_read_in_a_browser(browser, contrasts, study, scheme, width):
    path = write_report(study)
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    wrong, requests = [], []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    assert [found for found in contrasts(page) if found[0] < 4.5] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()
    assert wrong == []
    assert [url for url in requests if not url.startswith("data:")] == [path.as_uri()]
