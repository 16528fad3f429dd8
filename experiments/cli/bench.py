"""``graphrqi bench NAME``: measures what the product does, and prints one row per figure."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.cli.options import Jobs, Json, option, shared

bench = typer.Typer(
    help="Measure, and print one row per figure; --json writes them after every part.",
    epilog="example: graphrqi bench spectrum --quick --json spectrum.json",
    rich_markup_mode=None,
    invoke_without_command=True,
)

Quick = Annotated[bool, shared("Small sizes, in a minute or so.", "--quick")]
Only = Annotated[list[str] | None, shared("Only this; repeat for several [default: all].")]
Engine = Annotated[str, shared("Which simulator.")]
Episodes = Annotated[int | None, shared("Episodes per scenario.")]


def _show(name: str, json: Path | None, *given: Any) -> None:
    """Print the rows of a benchmark's function ``measure``, laid out by its ``table`` if any."""
    from experiments.score.rows import show_parts

    module = import_module(f"experiments.benchmarks.{name.replace('-', '_')}")
    show_parts(f"bench {name}", module.measure(*given), json, getattr(module, "table", None))


@bench.callback()
def show_help(context: typer.Context) -> None:
    """Measure, and print one row per figure."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@bench.command(epilog="example: graphrqi bench behaviors --quick --json behaviors.json")
def behaviors(
    scenario: Only = None,
    engine: Engine = "sumo",
    behaviors: str | None = option(
        "Behaviours of your own, too: a TOML file, or distracted, novice."),
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:  # fmt: skip
    """Measure which behaviour shows which trait, in every scenario."""
    seeds, duration_s = ((0,), 60.0) if quick else (tuple(range(5)), 600.0)
    _show("behaviors", json, scenario or (), engine, seeds, duration_s, jobs, behaviors)


@bench.command(epilog="example: graphrqi bench attention --quick --json attention.json")
def attention(
    behavior: str = option("Whose numbers the drivers have.", default="careful"),
    behaviors: str | None = option("Behaviours of your own, too: a TOML file."),
    engine: Engine = "sumo-idm",
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure reactions, rear-end collisions, and what is overlooked."""
    from behaviors.errors import lookup
    from behaviors.labels import BEHAVIORS, SHIPPED, read_behaviors

    own = *read_behaviors(",".join(SHIPPED)), *read_behaviors(behaviors)
    known = {str(one): one for one in (*BEHAVIORS, *own)}
    seeds, duration_s = (1, 120.0) if quick else (5, 300.0)
    _show("attention", json, lookup(known, behavior, "behavior"), engine, seeds, duration_s, jobs)


@bench.command(epilog="example: graphrqi bench classification --quick --json rows.json")
def classification(
    protocol: Only = None,
    method: Only = None,
    out: Path | None = option("Where datasets are made, and used again.", metavar="FOLDER"),
    episodes: Episodes = None,
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Score methods and the plain rival on unseen drivers, scenarios, engines, noise."""
    chosen, count, duration_s = method or [], 15, 150.0
    if quick:
        protocol = protocol or ["inductive", "leak-probe"]
        chosen, count, duration_s = chosen or ["graphrqi-plus", "majority"], 5, 60.0
    _show("classification", json, protocol or (), chosen, episodes or count, duration_s, jobs, out)


@bench.command("real-data", epilog="example: graphrqi bench real-data --data FOLDER --quick")
def real_data(
    data: Path = option(
        "Folder of recordings.", file_okay=False, exists=True, metavar="FOLDER", default=...),
    task: str = option(
        "behavior, classification: beliefs without labels, or prediction.", default="behavior"),
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:  # fmt: skip
    """Score methods or predictors on recordings, each left out of the training in turn."""
    from behaviors.errors import lookup
    from experiments.benchmarks import real_data as behavior
    from experiments.benchmarks import recorded_beliefs
    from experiments.benchmarks import recorded_prediction as prediction
    from experiments.score.rows import show_parts

    views = ("majority", "leak-probe", "nine-numbers") if quick else tuple(behavior.VIEWS)
    tasks = (2,) if quick else tuple(behavior.TASKS)
    parts = {
        "behavior": lambda: behavior.measure(data, views, tasks, jobs),
        "classification": lambda: recorded_beliefs.measure(data, jobs=jobs),
        "prediction": lambda: prediction.measure(data, 1 if quick else 4),
    }
    show_parts("bench real-data", lookup(parts, task, "task")(), json)


@bench.command(epilog="example: graphrqi bench prediction --quick --json prediction.json")
def prediction(
    predictor: Only = None,
    episodes: Episodes = None,
    jobs: Jobs = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure every predictor's errors on unseen episodes, and who is predicted to yield."""
    from experiments.benchmarks.prediction import QUICK

    names, duration_s, count = (QUICK, 30.0, 2) if quick else ((), None, 10)
    _show("prediction", json, episodes or count, duration_s, predictor or names, jobs)


@bench.command(epilog="example: graphrqi bench spectrum --quick --json spectrum.json")
def spectrum(
    graph: Only = None,
    size: list[int] | None = option("Vehicles; repeat for several [default: 25 to 20000]."),
    solver: Only = None,
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure every eigenvalue algorithm on the same graphs, in one process."""
    from experiments.benchmarks.spectrum import LAYOUTS

    sizes = size or ([25] if quick else [25, 100, 400, 1000, 4000, 20000])
    _show("spectrum", json, sizes, graph or LAYOUTS, solver or (), 5 if quick else 60)


@bench.command(epilog="example: graphrqi bench loop --quick --json loop.json")
def loop(
    engine: Only = None,
    city: bool = option(
        "In cities, all but the smallest need netgenerate.", "--city", default=False),
    quick: Quick = False,
    json: Json = None,
) -> None:  # fmt: skip
    """Time classifying and predicting while a simulation runs, stage by stage."""
    from experiments.benchmarks.loop import measure_cities, measure_loop
    from experiments.score.rows import show_parts

    engines = engine or ["sumo", "highway"]
    if city:
        blocks, vehicles = ((3,), (30, 90)) if quick else ((3, 8, 20, 60), (300, 1000, 3000))
        parts = measure_cities(engines, blocks, vehicles)
    else:
        parts = measure_loop(engines, 20.0, 1) if quick else measure_loop(engines)
    show_parts("bench loop", parts, json)


@bench.command(epilog="example: graphrqi bench generate --quick --json generate.json")
def generate(quick: Quick = False, json: Json = None) -> None:
    """Measure the cost of generating data."""
    _show("generate", json, *((1, 30.0, 2) if quick else ()))


@bench.command(epilog="example: graphrqi bench conflicts --quick --json rows.json")
def conflicts(quick: Quick = False, json: Json = None) -> None:
    """Compare our conflicts with those of SUMO's own device, in the same episodes."""
    _show("conflicts", json, *(((0,), 60.0) if quick else (range(3), 120.0)))
