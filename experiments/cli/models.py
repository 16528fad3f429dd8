"""The commands about models: ``train``, ``classify``, ``evaluate``, ``predict``, ``calibrate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from experiments.cli.options import (
    FormatName,
    GivenLabels,
    Jobs,
    Json,
    ModelName,
    Net,
    Quiet,
    Seed,
    Source,
    TableFile,
    TrafficKind,
    file_option,
    named_dataset,
    option,
    refuse_to_overwrite,
    table_to_write,
)

if TYPE_CHECKING:
    from experiments.score.rows import Row


def train(
    data: Annotated[
        list[Path], typer.Argument(help="Datasets; recordings for --from and --predictor.")
    ],
    out: Annotated[Path, option("Folder of the model.")],
    method: Annotated[str, option("See graphrqi list.", names="method")] = "graphrqi-plus",
    start: Annotated[
        str | None,
        option("Adapt this model to the place of recordings instead.", "--from", metavar="MODEL"),
    ] = None,
    labels: GivenLabels = None,
    predictor: Annotated[
        bool, option("Train the predictor for recordings instead.", "--predictor")
    ] = False,
    epochs: Annotated[int, option("Passes over the data (--predictor).", min=1)] = 4,
    format: FormatName = None,
    net: Net = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Train a classifier on datasets, adapt one to recordings, or train the predictor."""
    from behaviors.errors import InputError
    from experiments.score.rows import melted, show_table, stamped

    if labels is not None and start is None:
        raise InputError("--labels: found no --from, expected the model that labels adapt")
    if predictor:
        if start is not None:
            raise InputError("--predictor: found --from, too, expected one of them")
        from experiments.training.recorded import train_on_recordings

        scores = train_on_recordings(data, out, epochs=epochs, seed=seed, quiet=quiet)
        lines: list[Row] = [
            {"recordings": name, "ade_over_constant_velocity": round(value, 3)}
            for name, value in scores.items()
        ]
        rows = melted(lines, ["recordings"])
        show_table(stamped(rows, "train --predictor", seed), json, f"{out}: trained", lines)
        return
    if start is not None:
        from experiments.data.exchange import as_dataset
        from experiments.training.adapt import adapt

        if labels is None:
            raise InputError("--from: found no --labels, expected labels of some drivers")
        if len(data) != 1:
            raise InputError(f"--from: found {len(data)} recordings, expected one or a folder")
        with as_dataset(data[0], format, net) as dataset:
            rows = adapt(start, dataset, out, labels, quiet)
        show_table(stamped(rows, "train --from"), json, f"{out}: {start} adapted", rows)
        return
    from experiments.score.rows import dataset_id
    from experiments.training.classifier import train_on
    from sim.store.dataset import open_dataset

    rows = train_on(data, method, out, seed, quiet, jobs).card["scores"]
    known = ", ".join(dataset_id(open_dataset(path)) for path in data)
    _show_scores(stamped(rows, "train", seed, known), json)
    if not rows:
        typer.echo("not scored: the data have no test episode with a driver seen for 1 s", err=True)


def classify(
    source: Source,
    out: TableFile = None,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    labels: GivenLabels = None,
    conflicts: Annotated[
        Path | None,
        file_option("File for the conflicts of any two road users: .parquet or .csv.",
                    "--conflicts", callback=table_to_write),
    ] = None,
    traffic: TrafficKind = None,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Name each driver's behaviour as it drives."""
    from experiments.score.labels import classify_dataset, domain_notice, named_table
    from experiments.score.rows import show_table, stamped
    from experiments.score.tables import write_conflicts

    refuse_to_overwrite([source, net, labels], [out, conflicts, json])
    with named_dataset(source, format, net) as (dataset, known):
        if conflicts is not None:
            write_conflicts(dataset, conflicts)
        found = classify_dataset(
            dataset, model, out, labels, traffic=traffic, jobs=jobs, quiet=quiet
        )
    rows = stamped(found, "classify", dataset=known)
    if str(json) != "-":
        show_table(named_table(rows), title="drivers by their last answer")
    _show_scores(rows, json)
    if notice := domain_notice(rows):
        typer.echo(notice, err=True)


def evaluate(
    model: Annotated[str, typer.Argument(help="A model that ships, or a folder.")],
    source: Source,
    format: FormatName = None,
    net: Net = None,
    labels: GivenLabels = None,
    answers: Annotated[
        Path | None,
        file_option("Answers of your own model about the test split, to compare: columns episode, "
                    "agent, time_s, label.", "--answers"),
    ] = None,
    traffic: TrafficKind = None,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Score a model where drivers are known; report makes a page of the JSON."""
    from experiments.score.evaluate import evaluate
    from experiments.score.rows import stamped

    refuse_to_overwrite([source, net, labels, answers], [json])
    with named_dataset(source, format, net) as (dataset, known):
        rows = evaluate(model, dataset, labels, answers, traffic=traffic, jobs=jobs, quiet=quiet)
    _show_scores(stamped(rows, "evaluate", dataset=known), json)


def predict(
    source: Source,
    predictors: Annotated[
        str,
        option("Names (see graphrqi list) or module:function of your own, separated by commas.",
               metavar="A,B"),
    ] = "constant-velocity,graphrqi-predict",
    horizon_s: Annotated[float, option("How far ahead, s.", "--horizon-s")] = 5.0,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    out: TableFile = None,
    weights: Annotated[
        Path | None,
        option("From train --predictor (default: the weights that ship).", metavar="FOLDER"),
    ] = None,
    traffic: TrafficKind = None,
    split: Annotated[
        str | None, option("test, validation, train or all [default: test; all of recordings].")
    ] = None,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Predict the motion of every agent, and score it."""
    from experiments.score.predictions import default_split, errors_table, predict_dataset
    from experiments.score.rows import show_table, stamped

    refuse_to_overwrite([source, net], [out, json])
    names = [word.strip() for word in predictors.split(",") if word.strip()]
    with named_dataset(source, format, net) as (dataset, known):
        found = predict_dataset(
            dataset, names, horizon_s, model, out=out, weights=weights, traffic=traffic,
            split=split or default_split(dataset), jobs=jobs,
            quiet=quiet,
        )  # fmt: skip
    rows = stamped(found, "predict", dataset=known)
    show_table(rows, json, "prediction", errors_table(rows))


def calibrate(
    source: Source,
    out: Annotated[Path, option("New folder for the results.", metavar="FOLDER", file_okay=False)],
    format: FormatName = None,
    net: Net = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Infer every driver's car-following numbers, and the population they come from."""
    from experiments.calibration import population_rows, quantile_rows, write_calibration
    from experiments.score.rows import melted, show_table, stamped

    calibrated = write_calibration(source, out, format, net, quiet)
    lines = population_rows(calibrated)
    rows = stamped(melted(lines, ["number"]), "calibrate")
    show_table(rows, json, f"{out}: {len(calibrated.drivers)} drivers", lines)
    if str(json) != "-":
        places = quantile_rows(calibrated.population(calibrated.better))
        show_table(places, title="quantiles at which each behaviour's median driver lies")


def _show_scores(rows: Sequence[Row], json: Path | None) -> None:
    """Write all rows, and print the scores and confusions of those over many episodes."""
    from experiments.score.answers import confusion_table, is_scored, scores_table
    from experiments.score.rows import show_table

    totals = [row for row in rows if row.get("name") is None]
    if not is_scored(totals) and json is None:
        return
    paired = [row for row in totals if row.get("against")]
    down = ["model", "scenario", "split"] if paired else ["scenario", "split"]
    title = "every driver once, by its last answer; 95 % intervals over episodes"
    show_table(rows, json, title, scores_table([row for row in totals if row not in paired], down))
    if str(json) == "-":
        return
    if paired:
        keys = ("model", "against", "metric", "value", "low", "high")
        lines = [{key: row[key] for key in keys} for row in paired]
        show_table(lines, title="differences on the same drivers")
    confusions = confusion_table(totals)
    if confusions:
        show_table(confusions, title="how often each behaviour gets each answer")
