"""The commands ``graphrqi run`` and ``graphrqi generate``, which simulate traffic.

``python -m scenarios.NAME`` calls ``run``, too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from experiments.cli.options import (
    Jobs,
    Json,
    ModelName,
    NewDataset,
    Quiet,
    ScenarioName,
    Seed,
    Traffic,
    file_option,
    option,
    with_traffic,
)


@with_traffic
def run(
    scenario: ScenarioName = None,
    stream: Annotated[bool, option("Classify drivers as they go.", "--stream")] = False,
    predict: Annotated[bool, option("Predict, and score it.", "--predict")] = False,
    model: ModelName = "graphrqi-plus",
    window: Annotated[
        str | None,
        option("Classify and predict only an agent and those within 100 m (or M), or an area.",
               metavar="AGENT[:M] or X0,Y0,X1,Y1"),
    ] = None,
    out: Annotated[
        Path | None, option("Keep the episode as a dataset, too.", metavar="FOLDER")
    ] = None,
    seed: Seed = 0,
    json: Json = None,
    quiet: Quiet = False,
    *,
    traffic: Traffic,
) -> None:  # fmt: skip
    """Run a scenario headless and sum up what happened."""
    from experiments.run import read_window, run_scenario, shown
    from experiments.score.rows import show_table, stamped

    config = traffic.config([scenario] if scenario else None, episodes=1, seed=seed)
    used = model if stream or predict else None
    found = run_scenario(config, used, predict, quiet, read_window(window), out)
    show_table(stamped(found, "run", seed), json, lines=shown(found))


@with_traffic
def generate(
    out: NewDataset,
    scenario: Annotated[
        list[str] | None,
        option("A scenario's name, its TOML file, or a map; random_world draws one for each "
               "episode; repeat for several. Needed, here or in the file.", names="scenario"),
    ] = None,
    episodes: Annotated[
        int | None, option("Episodes per scenario. Needed, here or in the file.")
    ] = None,
    config: Annotated[
        Path | None, file_option("The same options in a file.", metavar="FILE.toml")
    ] = None,
    seed: Annotated[int | None, option("Same seed, same bytes (default: 0).")] = None,
    jobs: Jobs = None,
    cluster: Annotated[
        str | None, option("Dask scheduler, instead of processes.", metavar="ADDRESS")
    ] = None,
    quiet: Quiet = False,
    *,
    traffic: Traffic,
) -> None:  # fmt: skip
    """Make a dataset, or what is missing of it."""
    from experiments.cli.files import say_size
    from experiments.generate.dataset import generate as make

    chosen = traffic.config(scenario, config, episodes=episodes, seed=seed)
    make(chosen, out, jobs, quiet, cluster)
    say_size(out)
