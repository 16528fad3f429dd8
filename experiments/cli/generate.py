"""The command ``graphrqi generate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Jobs, Quiet, Traffic, names_of, with_traffic
from experiments.console.notices import say


def size_of(out: Path) -> str:
    """Where a dataset is and how large it is, for the last line of a command."""
    from sim.files import place_of
    from sim.store.dataset import open_dataset

    dataset = open_dataset(out)
    steps = sum(dataset.totals.column("agent_steps").to_pylist())
    return f"{place_of(out).url}: {len(dataset)} episodes, {steps} agent-steps"


@with_traffic
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
    seed: Annotated[int | None, typer.Option(help="Same seed, same bytes (default: 0).")] = None,
    jobs: Jobs = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, instead of processes.")
    ] = None,
    quiet: Quiet = False,
    *,
    traffic: Traffic,
) -> None:
    """Make a dataset, or what is missing of it."""
    from experiments.generate.configuration import read_cluster
    from experiments.generate.dataset import generate as make

    chosen = traffic.config(scenario, config, episodes=episodes, seed=seed)
    make(chosen, out, jobs, quiet, read_cluster(config, cluster))
    say(size_of(out))
