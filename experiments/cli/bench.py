"""``graphrqi bench NAME``: measures what the product does, and prints one row per figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Jobs, json_option

bench = typer.Typer(
    help="Measure, and print one row per figure.",
    epilog="example: graphrqi bench spectrum --quick --json spectrum.json",
    rich_markup_mode=None,
    invoke_without_command=True,
)

Json = Annotated[
    Path | None,
    json_option("Write the rows as JSON, after every part; - for standard output."),
]
Quick = Annotated[bool, typer.Option("--quick", help="Small sizes, in a minute or so.")]
Data = Annotated[
    Path,
    typer.Option(file_okay=False, exists=True, metavar="FOLDER", help="Folder of recordings."),
]
Episodes = Annotated[int | None, typer.Option(help="Episodes per scenario.")]


@bench.callback()
def show_help(context: typer.Context) -> None:
    """Measure, and print one row per figure."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@bench.command(epilog="example: graphrqi bench behaviors --quick --json behaviors.json")
def behaviors(
    scenario: Annotated[
        list[str] | None, typer.Option(help="Where; repeat for several [default: everywhere].")
    ] = None,
    engine: Annotated[str, typer.Option(help="Which simulator.")] = "sumo",
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure which behaviour shows which trait, in every scenario."""
    from experiments.benchmarks.behaviors import measure
    from experiments.score.parts import show_parts

    seeds, duration_s = ((0,), 60.0) if quick else (tuple(range(5)), 600.0)
    show_parts("behaviors", measure(scenario or (), engine, seeds, duration_s, jobs), json)


@bench.command(epilog="example: graphrqi bench classification --quick --json rows.json")
def classification(
    protocol: Annotated[
        list[str] | None, typer.Option(help="Only this; repeat for several [default: all].")
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Only this; repeat for several [default: all].")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Dataset to learn and score on [default: made]."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where datasets are made, and used again."),
    ] = None,
    episodes: Episodes = None,
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Score methods and the plain rival on unseen drivers, scenarios, engines, noise."""
    from experiments.benchmarks.classification import OURS, measure, table
    from experiments.score.parts import show_parts

    chosen, duration_s = (method or [], 150.0)
    if quick:
        protocol = protocol or ["inductive", "leak-probe"]
        chosen, duration_s = chosen or [OURS, "majority"], 60.0
    count = episodes or (5 if quick else 15)
    parts = measure(protocol or (), chosen, count, duration_s, jobs, data, out)
    show_parts("classification", parts, json, table)


@bench.command("real-data", epilog="example: graphrqi bench real-data --data FOLDER --quick")
def real_data(
    data: Data,
    task: Annotated[
        str, typer.Option(help="behavior, or prediction: where vehicles go.")
    ] = "behavior",
    leave_out: Annotated[
        str, typer.Option("--leave-out", help="Of prediction: dataset, place or nothing.")
    ] = "dataset",
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Score methods or predictors on recordings, each left out of the training in turn."""
    from behaviors.errors import lookup
    from experiments.benchmarks import real_data as behavior
    from experiments.benchmarks import recorded_prediction as prediction
    from experiments.score.parts import show_parts

    lookup({"behavior": 0, "prediction": 1}, task, "task")
    if task == "prediction":
        parts = prediction.measure(data, leave_out, 1 if quick else 4)
    else:
        views = ("majority", "leak-probe", "unit-free") if quick else tuple(behavior.VIEWS)
        tasks = (2,) if quick else tuple(behavior.TASKS)
        parts = behavior.measure(data, views, tasks, jobs)
    show_parts("real-data", parts, json)


@bench.command(epilog="example: graphrqi bench prediction --quick --json prediction.json")
def prediction(
    predictor: Annotated[
        list[str] | None,
        typer.Option(help="A name or module:function; repeat for several [default: all names]."),
    ] = None,
    model: Annotated[
        str, typer.Option(help="The classifier whose beliefs are used.")
    ] = "graphrqi-plus",
    beliefs: Annotated[
        list[str] | None,
        typer.Option(
            help="classifier, truth, shuffled or uniform; repeat for several [default: all]."
        ),
    ] = None,
    episodes: Episodes = None,
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure every predictor's errors on unseen episodes, and who is predicted to yield."""
    from experiments.benchmarks.prediction import QUICK, measure
    from experiments.score.parts import show_parts

    names = predictor or (QUICK if quick else ())
    duration_s = 30.0 if quick else None
    count = episodes or (2 if quick else 10)
    show_parts("prediction", measure(count, duration_s, names, model, beliefs or (), jobs), json)


@bench.command(epilog="example: graphrqi bench spectrum --quick --json spectrum.json")
def spectrum(
    graph: Annotated[
        list[str] | None,
        typer.Option(help="road, crossing or city; repeat for several [default: road, crossing]."),
    ] = None,
    size: Annotated[
        list[int] | None, typer.Option(help="Vehicles; repeat for several [default: 25 to 20000].")
    ] = None,
    solver: Annotated[
        list[str] | None, typer.Option(help="Only this; repeat for several [default: all].")
    ] = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure every eigenvalue algorithm on the same graphs, in one process."""
    from experiments.benchmarks.spectrum import measure, table
    from experiments.score.parts import show_parts

    sizes = size or ([25] if quick else [25, 100, 400, 1000, 4000, 20000])
    graphs = graph or ("road", "crossing")
    parts = measure(sizes, graphs, solver or (), 5 if quick else 60)
    show_parts("spectrum", parts, json, table)


@bench.command(epilog="example: graphrqi bench loop --quick --json loop.json")
def loop(
    engine: Annotated[
        list[str] | None,
        typer.Option(help="Simulator; repeat for several [default: sumo, highway]."),
    ] = None,
    city: Annotated[
        bool, typer.Option("--city", help="In cities, all but the smallest need netgenerate.")
    ] = False,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Time classifying and predicting while a simulation runs, stage by stage."""
    from itertools import chain

    from experiments.benchmarks.loop import measure_cities, measure_road, stock_rows
    from experiments.score.parts import show_parts

    engines = engine or ["sumo", "highway"]
    if city:
        blocks, vehicles = ((3,), (30, 90)) if quick else ((3, 8, 20, 60), (300, 1000, 3000))
        parts = measure_cities(engines, blocks, vehicles)
    else:
        duration_s, repeats = (20.0, 1) if quick else (180.0, 3)
        road = measure_road(engines, duration_s, repeats)
        parts = chain(road, [stock_rows(20.0, 10) if quick else stock_rows()])
    show_parts("loop", parts, json)


@bench.command(epilog="example: graphrqi bench generate --quick --json generate.json")
def generate(quick: Quick = False, json: Json = None) -> None:
    """Measure the cost of generating data."""
    from experiments.benchmarks.generate import measure
    from experiments.score.parts import show_parts

    parts = measure(1, 30.0, 2) if quick else measure()
    show_parts("generate", parts, json)
