"""The commands ``graphrqi generate``, ``merge`` and ``upgrade``."""

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
    from sim.store.dataset import open_dataset
    from sim.store.places import place_of

    dataset = open_dataset(out)
    steps = sum(dataset.totals.column("agent_steps").to_pylist())
    return f"{place_of(out).url}: {len(dataset)} episodes, {steps} agent-steps"


def generate(
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")],
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="A scenario's name, its TOML file, or a map; repeat for several. Needed, here or "
            "in the file.",
            autocompletion=names_of("scenario"),
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Episodes per scenario. Needed, here or in the file.")
    ] = None,
    worlds: Annotated[
        int | None,
        typer.Option(help="So many random worlds instead of scenarios; takes no other traffic."),
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
    part: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Only the K-th of N parts; graphrqi merge joins them."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make a dataset, or what is missing of it."""
    from experiments.data.array_job.parts import generate_part
    from experiments.data.configuration import read_cluster, read_config
    from experiments.data.generate import generate_shards as make
    from experiments.data.shards.plan import read_part
    from experiments.data.worlds.episode import read_worlds_config
    from sim.store.places import place_of

    given = {
        "scenarios": scenario or None, "episodes": episodes, "engine": engine, "flow": flow,
        "mix": mix, "spread": spread, "population": population, "duration_s": duration_s,
        "seed": seed, "net": net, "routes": routes,
        "scenario_options": read_options(option or [], FLAGS) or None,
    }  # fmt: skip
    chosen = (
        read_config(config, **given)
        if worlds is None
        else (read_worlds_config(config, worlds, **given))
    )
    chosen_part, scheduler = read_part(part), read_cluster(config, cluster)
    if chosen_part is not None:
        if scheduler is not None:
            raise typer.BadParameter("found --part beside --cluster, expected one of them")
        count = generate_part(chosen, out, chosen_part, jobs, quiet)
        say(f"{place_of(out).url}: part {chosen_part}, {count} episodes; see graphrqi merge")
        return
    make(chosen, out, jobs, quiet, scheduler)
    say(size_of(out))


def merge(
    dataset: Annotated[Path, typer.Argument(help="Folder or URL that all parts wrote to.")],
    quiet: Quiet = False,
) -> None:
    """Check that no part of a dataset is missing, and complete it."""
    from experiments.data.array_job.parts import merge as join

    join(dataset, quiet)
    say(size_of(dataset))


def upgrade(
    dataset: Annotated[Path, typer.Argument(help="Folder or URL of an older dataset.")],
    out: Annotated[Path, typer.Option(help="Folder or URL of the new one; new or empty.")],
) -> None:
    """Rewrite a dataset that has a folder per episode as shards."""
    from experiments.data.shards.upgrade import upgrade as rewrite

    rewrite(dataset, out)
    say(size_of(out))
