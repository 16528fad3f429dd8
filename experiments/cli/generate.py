"""The command ``graphrqi generate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import (
    FLAGS,
    DurationS,
    Flow,
    Jobs,
    Mix,
    OwnNet,
    PopulationName,
    Quiet,
    Routes,
    ScenarioOptions,
    Spread,
    names_of,
    read_options,
)
from experiments.console.notices import say


def size_of(out: Path) -> str:
    """Where a dataset is and how large it is, for the last line of a command."""
    from sim.files import place_of
    from sim.store.dataset import open_dataset

    dataset = open_dataset(out)
    steps = sum(dataset.totals.column("agent_steps").to_pylist())
    return f"{place_of(out).url}: {len(dataset)} episodes, {steps} agent-steps"


def generate(
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")],
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="A scenario's name, its TOML file, or a map; random_world draws one for each "
            "episode; repeat for several. Needed, here or in the file.",
            autocompletion=names_of("scenario"),
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Episodes per scenario. Needed, here or in the file.")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(dir_okay=False, metavar="FILE.toml", help="The same options in a file."),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(help="Which simulator [default: sumo].", autocompletion=names_of("engine")),
    ] = None,
    flow: Flow = None,
    mix: Mix = None,
    spread: Spread = None,
    population: PopulationName = None,
    duration_s: DurationS = None,
    option: ScenarioOptions = None,
    seed: Annotated[int | None, typer.Option(help="Same seed, same bytes [default: 0].")] = None,
    jobs: Jobs = None,
    net: OwnNet = None,
    routes: Routes = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, instead of processes.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make a dataset, or what is missing of it."""
    from experiments.generate.configuration import read_cluster, read_config
    from experiments.generate.dataset import generate as make

    given = {
        "scenarios": scenario or None, "episodes": episodes, "engine": engine, "flow": flow,
        "mix": mix, "spread": spread, "population": population, "duration_s": duration_s,
        "seed": seed, "net": net, "routes": routes,
        "scenario_options": read_options(option or [], FLAGS) or None,
    }  # fmt: skip
    chosen = read_config(config, **given)
    make(chosen, out, jobs, quiet, read_cluster(config, cluster))
    say(size_of(out))
