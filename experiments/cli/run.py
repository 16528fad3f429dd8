"""The command ``graphrqi run``, which ``python -m scenarios.NAME`` calls, too."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import (
    Json,
    ModelName,
    Quiet,
    ScenarioName,
    Seed,
    Traffic,
    with_traffic,
)


@with_traffic
def run(
    scenario: ScenarioName = None,
    stream: Annotated[bool, typer.Option("--stream", help="Classify drivers as they go.")] = False,
    predict: Annotated[bool, typer.Option("--predict", help="Predict, and score it.")] = False,
    model: ModelName = "graphrqi-plus",
    window: Annotated[
        str | None,
        typer.Option(
            metavar="AGENT[:M] or X0,Y0,X1,Y1",
            help="Classify and predict only an agent and those within 100 m (or M), or an area.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Keep the episode as a dataset, too.")
    ] = None,
    seed: Seed = 0,
    json: Json = None,
    quiet: Quiet = False,
    *,
    traffic: Traffic,
) -> None:
    """Run a scenario headless and sum up what happened."""
    from experiments.console.tables import show_table
    from experiments.run import read_window, run_scenario, shown
    from experiments.score.rows import stamped

    config = traffic.config([scenario] if scenario else None, episodes=1, seed=seed)
    used = model if stream or predict else None
    found = run_scenario(config, used, predict, quiet, read_window(window), out)
    show_table(stamped(found, "run", seed), json, lines=shown(found))
