"""The commands ``graphrqi classify`` and ``graphrqi evaluate``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from experiments.cli.options import (
    FormatName,
    GivenLabels,
    Jobs,
    Json,
    LabelsFile,
    ModelName,
    Net,
    Quiet,
    Source,
)

if TYPE_CHECKING:
    from experiments.rows import Row


def classify(
    source: Source,
    out: LabelsFile = None,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    labels: GivenLabels = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Name each driver's behaviour as it drives."""
    from experiments.console.tables import show_table
    from experiments.data.exchange import as_dataset
    from experiments.rows import write_json
    from experiments.scoring.classification import (
        classify_dataset,
        episodes_table,
        foreign_notice,
        totals_table,
    )
    from experiments.scoring.evaluation import evaluation_rows, is_scored

    with as_dataset(source, format, net) as dataset:
        rows, answers = classify_dataset(dataset, model, out, quiet, labels)
    if json is not None:
        write_json(rows, json)
    if str(json) != "-":
        show_table(episodes_table(rows), title="drivers by their last answer")
        show_table(totals_table(rows), title="in all")
        scores = evaluation_rows(answers, model)
        if is_scored(scores):
            show_evaluation(scores)
    if notice := foreign_notice(rows):
        typer.echo(notice, err=True)


def evaluate(
    model: Annotated[str, typer.Argument(help="A model that ships, or a folder.")],
    source: Source,
    format: FormatName = None,
    net: Net = None,
    labels: GivenLabels = None,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Score a model where drivers are known; report makes a page of the JSON."""
    from experiments.data.exchange import as_dataset
    from experiments.rows import write_json
    from experiments.scoring.evaluation import evaluate, trained_here

    with as_dataset(source, format, net) as dataset:
        rows = evaluate(model, dataset, labels, jobs=jobs, quiet=quiet)
        known = trained_here(model, dataset)
    if json is not None:
        write_json(rows, json)
    if str(json) != "-":
        show_evaluation(rows)
        if known:
            typer.echo("the model was trained on data like these: the test split counts", err=True)


def show_evaluation(rows: Sequence[Row]) -> None:
    """Print the scores of an evaluation for people."""
    from experiments.console.tables import show_table
    from experiments.scoring.evaluation import confusion_table, evaluation_table

    show_table(
        evaluation_table(rows),
        title="every driver once, by its last answer; 95 % intervals over episodes",
    )
    confusion, where = confusion_table(rows)
    if confusion:
        show_table(confusion, title=f"who is taken for whom, {where}")
