"""The command that asks what would have happened: ``what-if``, also about whom to blame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from experiments.cli.options import (
    DurationS,
    Engine,
    Flow,
    Json,
    Mix,
    PopulationName,
    Quiet,
    Seed,
    Spread,
    names_of,
)

if TYPE_CHECKING:
    from experiments.data.configuration import GenerateConfig

ScenarioName = Annotated[
    str,
    typer.Argument(
        help="Name of a scenario; see graphrqi list.", autocompletion=names_of("scenario")
    ),
]
Episode = Annotated[
    int, typer.Option(min=0, metavar="N", help="Which of the scenario's episodes, as by generate.")
]


def what_if(
    scenario: ScenarioName,
    at_s: Annotated[
        float | None, typer.Option("--at-s", help="From when on the driver differs, s.")
    ] = None,
    agent: Annotated[int | None, typer.Option(metavar="ID", help="The driver.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the dataset.")] = None,
    behavior: Annotated[
        list[str] | None,
        typer.Option(metavar="B", help="A behaviour to go on with; repeat for several."),
    ] = None,
    action: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A",
            help="brake, keep, accelerate, change-left or change-right at that instant; repeat "
            "for several.",
        ),
    ] = None,
    episode: Episode = 0,
    engine: Engine = "sumo",
    seed: Seed = 0,
    flow: Flow = None,
    mix: Mix = None,
    spread: Spread = None,
    population: PopulationName = None,
    duration_s: DurationS = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="Draw the paths over the factual ones too: .png, .pdf or .svg.",
        ),
    ] = None,
    blame: Annotated[
        bool,
        typer.Option(
            "--blame",
            help="Instead, say whose careful driving would have prevented each collision and "
            "near miss.",
        ),
    ] = False,
    bystanders: Annotated[
        int, typer.Option(min=0, help="Of --blame: drivers beside the two parties who are tried.")
    ] = 4,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Drive one episode on from one instant with one driver different (Linux only)."""
    from behaviors.errors import InputError, lookup
    from behaviors.labels import Behavior
    from experiments.console.tables import show_table
    from experiments.data.configuration import read_config
    from experiments.data.what_if import WhatIf, make_what_if
    from experiments.figure_files import check_figure_file
    from experiments.replay.pictures.paths import write_paths
    from experiments.scoring.what_if import outcomes
    from sim.store.dataset import open_dataset
    from sim.sumo.control.acting import Action

    traffic = read_config(
        None, scenarios=[scenario], episodes=episode + 1, seed=seed, engine=engine, flow=flow,
        mix=mix, spread=spread, population=population, duration_s=duration_s,
    )  # fmt: skip
    if blame:
        _show_blame(traffic, scenario, episode, bystanders, json)
        return
    if at_s is None or agent is None or out is None:
        missing = "--at-s" if at_s is None else "--agent" if agent is None else "--out"
        raise InputError(f"{missing}: found none, expected it, or --blame")
    behaviors, actions = {b.value: b for b in Behavior}, {a.value: a for a in Action}
    config = WhatIf(
        episode=traffic,
        index=episode,
        at_s=at_s,
        agent=agent,
        behaviors=tuple(lookup(behaviors, word, "behavior") for word in behavior or ()),
        actions=tuple(lookup(actions, word, "action") for word in action or ()),
    )  # fmt: skip
    if picture is not None:
        check_figure_file(picture, "--picture")
    make_what_if(config, out, quiet)
    dataset = open_dataset(out)
    show_table(outcomes(dataset), json)
    if picture is not None:
        write_paths(dataset, picture)


def _show_blame(
    config: GenerateConfig, scenario: str, episode: int, bystanders: int, json: Path | None
) -> None:
    """Print a line for each incident of an episode and driver who was tried."""
    from experiments.console.tables import show_table
    from experiments.data.episode import Task
    from experiments.scoring.blame import judge, verdict_rows
    from sim.scenario import sample_agents

    made = config.scenario(scenario, episode)
    drawn = Task(config, scenario, episode).seed
    verdicts = list(judge(made, sample_agents(made, drawn), drawn, config.engine, bystanders))
    if verdicts or json is not None:
        show_table(verdict_rows(verdicts), json)
    else:
        typer.echo(f"{scenario}: no collision and no near miss in {made.duration_s:g} s")
