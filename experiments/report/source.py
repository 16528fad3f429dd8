"""What a report is made from: a run's folder, a trained model's, or the rows that a bench wrote.

Every number of a report is a flat row: the keys that say what was measured, then ``metric``,
``value``, ``low``, ``high`` and ``n``. Which keys there are tells what kind of measurement it is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from behaviors.errors import InputError
from experiments.console.tables import Row
from experiments.data.windows import OBSERVED_S
from experiments.report.run_file import Metrics, RunFile, read_run
from graphrqi.methods import load_model

MAX_BYTES: Final = 2**28
"""Largest file of rows that is read (our choice)."""

KINDS: Final[dict[str, frozenset[str]]] = {
    "spectrum": frozenset({"solver", "d"}),
    "prediction": frozenset({"predictor", "horizon_s"}),
    "real-data": frozenset({"dataset", "protocol", "method"}),
    "classification": frozenset({"protocol", "scenario", "method"}),
    "loop": frozenset({"stage", "agents"}),
    "generate": frozenset({"scenario", "jobs"}),
    "behaviors": frozenset({"engine", "scenario", "behavior"}),
    "navigation": frozenset({"environment", "arm"}),
    "highway": frozenset({"road", "cars"}),
    "other": frozenset(),
}
"""Kinds of measurements by the keys that all of their rows have; the first that fits."""

_NOT_ROWS: Final = frozenset({"run.json", "metrics.json", "model.json"})


@dataclass(frozen=True, slots=True)
class Source:
    """One thing to report on.

    Attributes:
        path: the run's folder, or the file of rows.
        name: what it is called.
        run: how a run was made and where its parts are; None for rows alone.
        rows: every number, by kind of measurement.
        protocol: how the numbers were obtained, in words; "" where that is not told.
    """

    path: Path
    name: str
    run: RunFile | None
    rows: Mapping[str, tuple[Row, ...]]
    protocol: str = ""


def kind_of(row: Row) -> str:
    """What kind of measurement a row is of.

    Examples:
        >>> kind_of({"scenario": "all", "jobs": 2, "metric": "speedup", "value": 1.9})
        'generate'
    """
    return next(kind for kind, keys in KINDS.items() if keys <= row.keys())


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
        return Source(path, path.stem, None, by_kind(read_rows(path)))
    files = [p for p in sorted(path.glob("*.json")) if p.name not in _NOT_ROWS]
    if (path / "run.json").is_file():
        run, metrics = read_run(path)
        rows = [row for file in files for row in read_rows(file)]
        known = {kind_of(row) for row in rows}
        rows += [row for row in rows_of(metrics) if kind_of(row) not in known]
        return Source(path, run.name, run, by_kind(rows), run.protocol)
    if (path / "model.json").is_file():
        return _read_model(path)
    if not files:
        raise InputError(f"{path / 'run.json'}: found no file, expected a run or files of rows")
    rows = [row for file in files for row in read_rows(file)]
    return Source(path, path.resolve().name, None, by_kind(rows))


def _read_model(path: Path) -> Source:
    """The scores in a model's card."""
    model = load_model(path)
    scores = model.card.get("scores", {})
    rows: list[Row] = [
        {
            "protocol": "inductive", "scenario": scenario, "method": model.method.name,
            "window_s": OBSERVED_S, "variation": "", "metric": metric,
            **{k: None if v != v else v for k, v in score.items()},  # NaN: no interval
        }
        for scenario, metrics in scores.items()
        for metric, score in metrics.items()
    ]  # fmt: skip
    if not rows:
        raise InputError(f"{path / 'model.json'}: found no scores in its card, expected some")
    protocol = str(model.card.get("protocol", ""))
    return Source(path, path.resolve().name, None, by_kind(rows), protocol)


def read_rows(path: Path) -> list[Row]:
    """Rows as a bench's ``--json`` writes them.

    Raises:
        InputError: if the file is not a list of flat rows with a metric and a value.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_BYTES}")
    try:
        found: Any = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: found no JSON ({error})") from None
    if not isinstance(found, list):
        raise InputError(f"{path}: found {type(found).__name__}, expected a list of rows")
    for number, row in enumerate(found):
        if not isinstance(row, dict) or not isinstance(row.get("metric"), str):
            raise InputError(f"{path}: row {number}: found no metric, expected flat rows with one")
        for name in ("value", "low", "high"):
            value = row.get(name)
            if value is not None and type(value) not in (int, float):
                raise InputError(
                    f"{path}: row {number}: {name}: found {value!r}, expected a number"
                )
        if any(isinstance(value, dict | list) for value in row.values()):
            raise InputError(f"{path}: row {number}: found a nested value, expected flat rows")
    return cast("list[Row]", found)


def by_kind(rows: Sequence[Row]) -> dict[str, tuple[Row, ...]]:
    """Rows by the kind of measurement that they are of; those without a value are left out."""
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        if row.get("value") is not None:
            kinds.setdefault(kind_of(row), []).append(row)
    return {kind: tuple(kinds[kind]) for kind in KINDS if kind in kinds}


def rows_of(metrics: Metrics) -> list[Row]:
    """The tables of ``metrics.json`` as rows."""
    rows: list[Row] = []
    keys: dict[str, Any]
    for scenario, methods in metrics.classification.items():
        for method, scores in methods.items():
            keys = {"protocol": "inductive", "scenario": scenario, "method": method,
                    "window_s": OBSERVED_S, "variation": ""}  # fmt: skip
            rows += [{**keys, "metric": m, **score.model_dump()} for m, score in scores.items()]
    for scenario, predictors in metrics.prediction.items():
        for predictor, kinds in predictors.items():
            for metric, horizons in kinds.items():
                for horizon, score in horizons.items():
                    keys = {"scenario": scenario, "predictor": predictor,
                            "horizon_s": float(horizon[:-1]), "behavior": "all"}  # fmt: skip
                    rows.append({**keys, "metric": metric, **score.model_dump()})
    return rows
