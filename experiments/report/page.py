"""One self-contained page per run: tables with intervals, confusion matrices, one scene drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from behaviors.labels import BEHAVIORS, Style
from experiments.report.figures import confusion_figure, gradient_figure, map_figure
from experiments.report.run_file import Metrics, RunFile, Score, read_run
from graphrqi.features.graph_spectrum import NEIGHBORS, RESET
from graphrqi.graph import TrafficGraph
from graphrqi.methods import Model, load_model
from graphrqi.predict import predict
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import BehaviorStream
from sim.atomic import write_whole
from sim.dataset import Dataset, open_dataset

SHOWN_PREDICTOR: Final = "car-following"
HORIZON_S: Final = 5.0

_HEADINGS: Final = {
    "weighted_accuracy": "accuracy (A_w)",
    "majority_weighted_accuracy": "majority class",
    "balanced_accuracy": "balanced accuracy",
    "macro_f1": "macro-F1",
    "style_balanced_accuracy": "style balanced accuracy",
}


@dataclass(frozen=True, slots=True)
class Cell:
    """One number of a table, in words."""

    value: str
    interval: str
    best: bool


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a page."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


@dataclass(frozen=True, slots=True)
class Scene:
    """One instant of an unseen episode, drawn."""

    scenario: str
    episode: str
    time: str
    predictor: str
    map: str
    gradient: str
    w_aggressive: str
    w_conservative: str


def _table(
    columns: Mapping[str, str], rows: Mapping[str, Sequence[Score]], smaller_is_better: bool
) -> Table:
    """Rows of scores, the best of each column marked."""
    choose = min if smaller_is_better else max
    best = [choose(s.value for s in column) for column in zip(*rows.values(), strict=True)]
    return Table(
        tuple(columns.values()),
        tuple(
            (
                name,
                tuple(
                    Cell(
                        f"{s.value:.3f}",
                        "" if s.low is None or s.high is None else f"[{s.low:.3f}, {s.high:.3f}]",
                        s.value == best[i] and "majority" not in list(columns)[i],
                    )
                    for i, s in enumerate(scores)
                ),
            )
            for name, scores in rows.items()
        ),
    )


def classification_tables(metrics: Metrics) -> list[tuple[str, Table]]:
    """One table per scenario, methods down, metrics across."""
    return [
        (
            scenario,
            _table(
                _HEADINGS,
                {name: [scores[m] for m in _HEADINGS] for name, scores in methods.items()},
                smaller_is_better=False,
            ),
        )
        for scenario, methods in metrics.classification.items()
    ]


def prediction_tables(metrics: Metrics) -> list[tuple[str, Table]]:
    """One table per scenario, predictors down, errors and horizons across."""
    tables = []
    for scenario, predictors in metrics.prediction.items():
        first = next(iter(predictors.values()))
        keys = [(kind, horizon) for kind, by in first.items() for horizon in by]
        columns = {f"{k} {h}": f"{k.removesuffix('_m').upper()} {h[:-1]} s" for k, h in keys}
        rows = {name: [by[k][h] for k, h in keys] for name, by in predictors.items()}
        tables.append((scenario, _table(columns, rows, smaller_is_better=True)))
    return tables


def draw_scene(dataset: Dataset, model: Model, scenario: str) -> Scene | None:
    """The fullest instant of the first test episode that has a road, drawn.

    Args:
        dataset: labelled.
        model: the classifier whose beliefs are drawn.
        scenario: which scenario.

    Returns:
        The scene, or None if the scenario has no test episode with a road.
    """
    for entry in dataset.episodes("test", scenario):
        road = dataset.road(entry)
        if road is None:
            continue
        tracks = dataset.read(entry).tracks
        steps = round(HORIZON_S / tracks.step_s)
        last = tracks.time_s.size - steps - 1
        first = min(round(30.0 / tracks.step_s), last)
        if last <= 0:
            continue
        stop = first + int(tracks.valid[:, first : last + 1].sum(axis=0).argmax())
        stream = BehaviorStream(model)
        graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
        for step in range(stop + 1):
            frame = tracks.frame(step)
            posterior = stream.update(frame)
            graph = graph.observe(frame.ids, frame.xy)
        prediction = predict(stream.history, posterior, road, HORIZON_S, SHOWN_PREDICTOR)
        rows = np.searchsorted(tracks.ids, frame.ids)
        codes = np.full(rows.size, -1, dtype=np.int8)
        if tracks.behavior is not None:
            codes = tracks.behavior[rows]
        spectrum = SOLVERS["eigh"](graph, num_pairs=1, end="largest")
        w = np.asarray(graph.laplacian @ spectrum.eigenvectors[:, 0])
        here = np.abs(w)[graph.rows_of(frame.ids)]
        return Scene(
            scenario=scenario,
            episode=entry.id,
            time=f"{frame.time_s:.1f}",
            predictor=SHOWN_PREDICTOR,
            map=map_figure(
                road, frame, codes, posterior, prediction,
                tracks.xy[rows, stop + 1 : stop + 1 + steps],
            ),
            gradient=gradient_figure(frame, codes, graph, w),
            w_aggressive=_mean_of(here, codes, Style.AGGRESSIVE),
            w_conservative=_mean_of(here, codes, Style.CONSERVATIVE),
        )  # fmt: skip
    return None


def _mean_of(values: Any, codes: Any, style: Style) -> str:
    chosen = np.isin(codes, [b.code for b in BEHAVIORS if b.style is style])
    return f"{values[chosen].mean():.3f}" if chosen.any() else "unknown"


def write_report(folder: Path) -> Path:
    """Draw the page of a run from what it left behind.

    Args:
        folder: a run's folder, with ``run.json`` and ``metrics.json``.

    Returns:
        The page, ``report.html`` in that folder: self-contained, it loads nothing.

    Raises:
        InputError: if a part of the run is missing or broken.
    """
    run, metrics = read_run(folder)
    dataset = open_dataset(folder / run.dataset)
    model = load_model(folder / run.model)
    scenes = [draw_scene(dataset, model, name) for name in metrics.classification]
    environment = Environment(
        loader=PackageLoader("experiments.report", "."),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    page = environment.get_template("page.html").render(
        run=run,
        classification=classification_tables(metrics),
        prediction=prediction_tables(metrics),
        confusions=_confusions(run),
        scenes=[scene for scene in scenes if scene is not None],
    )
    path = folder / "report.html"
    write_whole(path, page.encode())
    return path


def _confusions(run: RunFile) -> list[str]:
    return [
        confusion_figure(matrix, f"{method}, {scenario}: % of each true behaviour")
        for scenario, methods in run.confusion.items()
        for method, matrix in methods.items()
    ]
