"""What a report is made from: a run's folder, a trained model's, or the rows that a bench wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

from behaviors.errors import InputError
from experiments.data.windows import OBSERVED_S
from experiments.report.run_file import Metrics, RunFile, read_run
from experiments.rows import Cell, Row, checked_rows, of_bench, read_rows
from experiments.scoring.prediction_errors import prediction_keys
from graphrqi.model_files import load_model
from sim.invalid_fields import first_wrong_field
from sim.store.catalogue import is_dataset

_SCORES: Final = TypeAdapter(dict[str, dict[str, dict[str, str | int | float | None]]])
"""Scores in a model's card: by scenario and metric."""

_NOT_ROWS: Final = frozenset({"run.json", "metrics.json", "model.json"})


@dataclass(frozen=True, slots=True)
class Source:
    """One thing to report on.

    Attributes:
        path: the run's folder, or the file of rows.
        name: what it is called.
        run: how a run was made and where its parts are; None for rows alone.
        rows: every number, by bench.
        protocol: how the numbers were obtained, in words; "" where nobody says.
    """

    path: Path
    name: str
    run: RunFile | None
    rows: Mapping[str, tuple[Row, ...]]
    protocol: str = ""


def read_source(path: Path) -> Source:
    """Read a run's folder or a file of rows.

    Args:
        path: a folder with ``run.json``, a model's folder, a folder with files of rows, or one
            such file.

    Returns:
        The source.

    Raises:
        InputError: if there is nothing to report on, or a file is broken.
    """
    if path.is_file():
        return Source(path, path.stem, None, by_bench(read_rows(path)))
    if not path.is_dir():
        raise InputError(f"{path}: found no file and no folder, expected a run or files of rows")
    files = [p for p in sorted(path.glob("*.json")) if p.name not in _NOT_ROWS]
    if (path / "run.json").is_file():
        run, metrics = read_run(path)
        rows = [row for file in files for row in read_rows(file)]
        measured = {row["bench"] for row in rows}
        rows += [row for row in rows_of(metrics) if row["bench"] not in measured]
        return Source(path, run.name, run, by_bench(rows), run.protocol)
    if (path / "model.json").is_file():
        return _read_model(path)
    if is_dataset(path):
        raise InputError(
            f"{path}: found a dataset, expected a run, a model or files of rows; graphrqi replay "
            "shows an episode, and graphrqi predict and bench write rows with --json"
        )
    if not files:
        raise InputError(
            f"{path}: found no run.json, no model.json and no file of rows, expected a folder that "
            "make demo or train wrote, or files that graphrqi bench NAME --json FILE wrote"
        )
    rows = [row for file in files for row in read_rows(file)]
    return Source(path, path.resolve().name, None, by_bench(rows))


def _read_model(path: Path) -> Source:
    """The scores in a model's card."""
    model = load_model(path)
    try:
        scores = _SCORES.validate_python(model.card.get("scores", {}))
    except ValidationError as error:
        wrong = first_wrong_field(error)
        raise InputError(f"{path / 'model.json'}: card.scores.{wrong}") from None
    rows: list[Row] = [
        {
            **_classification_keys(scenario, model.method.name), "metric": metric,
            **{k: None if v != v else v for k, v in score.items()},  # NaN: no interval
        }
        for scenario, metrics in scores.items()
        for metric, score in metrics.items()
    ]  # fmt: skip
    evaluation = checked_rows(
        model.card.get("evaluation", []), f"{path / 'model.json'}: card: evaluation"
    )
    name = path.resolve().name
    rows += [{**row, "model": name} for row in evaluation]
    if not rows:
        raise InputError(f"{path / 'model.json'}: found no scores in its card, expected some")
    protocol = str(model.card.get("protocol", ""))
    return Source(path, name, None, by_bench(rows), protocol)


def by_bench(rows: Sequence[Row]) -> dict[str, tuple[Row, ...]]:
    """Rows by the bench that measured them; those without a value are left out."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row.get("value") is not None:
            found.setdefault(str(row["bench"]), []).append(row)
    return {bench: tuple(rows) for bench, rows in found.items()}


def rows_of(metrics: Metrics) -> list[Row]:
    """The tables of ``metrics.json`` as rows."""
    rows: list[Row] = []
    for scenario, methods in metrics.classification.items():
        for method, scores in methods.items():
            keys = _classification_keys(scenario, method)
            rows += [{**keys, "metric": m, **score.model_dump()} for m, score in scores.items()]
    for scenario, predictors in metrics.prediction.items():
        for predictor, kinds in predictors.items():
            for metric, horizons in kinds.items():
                for horizon, score in horizons.items():
                    keys = prediction_keys(scenario, predictor, float(horizon[:-1]), score.split)
                    figure = {"metric": metric, **score.model_dump()}
                    rows += of_bench("prediction", [{**keys, **figure}])
    return rows


def _classification_keys(scenario: str, method: str) -> dict[str, Cell]:
    return {
        "bench": "classification", "protocol": "inductive", "scenario": scenario,
        "method": method, "window_s": OBSERVED_S, "variation": "",
    }  # fmt: skip
