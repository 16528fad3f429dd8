"""The commands ``what-if`` and ``drive``: what would have happened, and how safe a policy is."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from experiments.cli.options import (
    Flow,
    Jobs,
    Json,
    Quiet,
    ScenarioName,
    Seed,
    Traffic,
    file_option,
    option,
    with_traffic,
)

if TYPE_CHECKING:
    from experiments.generate.configuration import GenerateConfig


@with_traffic
def what_if(
    scenario: ScenarioName = None,
    at_s: Annotated[float | None, option("From when on the driver differs, s.", "--at-s")] = None,
    agent: Annotated[int | None, option("The driver.", metavar="ID")] = None,
    out: Annotated[Path | None, option("Folder of the dataset.")] = None,
    behavior: Annotated[
        list[str] | None, option("A behaviour to go on with; repeat for several.", metavar="B")
    ] = None,
    action: Annotated[
        list[str] | None,
        option("brake, keep, accelerate, change-left or change-right at that instant; repeat for "
               "several.", metavar="A"),
    ] = None,
    episode: Annotated[
        int, option("Which of the scenario's episodes, as by generate.", min=0, metavar="N")
    ] = 0,
    seed: Seed = 0,
    blame: Annotated[
        bool,
        option("Instead, say whose careful driving would have prevented each collision and near "
               "miss.", "--blame"),
    ] = False,
    picture: Annotated[
        Path | None,
        file_option("Draw the paths over the factual ones too: .png, .pdf or .svg."),
    ] = None,
    json: Json = None,
    quiet: Quiet = False,
    *,
    traffic: Traffic,
) -> None:  # fmt: skip
    """Drive one episode on from one instant with one driver different (Linux only)."""
    from behaviors.errors import InputError, lookup
    from behaviors.labels import BEHAVIORS, read_behaviors
    from experiments.figure_files import check_figure_file
    from experiments.replay.pictures import write_paths
    from experiments.score.rows import dataset_id, melted, show_table, stamped
    from experiments.what_if.branches import WhatIf, make_what_if
    from experiments.what_if.outcomes import outcomes
    from sim.store.dataset import open_dataset
    from sim.sumo.control.acting import Action

    drawn = traffic.config([scenario] if scenario else None, episodes=episode + 1, seed=seed)
    if blame:
        _show_blame(drawn, episode, seed, json)
        return
    if at_s is None or agent is None or out is None:
        missing = "--at-s" if at_s is None else "--agent" if agent is None else "--out"
        raise InputError(f"{missing}: found none, expected it, or --blame")
    known = (*BEHAVIORS, *read_behaviors(drawn.behaviors))
    behaviors, actions = {str(b): b for b in known}, {a.value: a for a in Action}
    config = WhatIf(
        episode=drawn,
        index=episode,
        at_s=at_s,
        agent=agent,
        behaviors=tuple(lookup(behaviors, word, "behavior") for word in behavior or ()),
        actions=tuple(lookup(actions, word, "action") for word in action or ()),
    )
    if picture is not None:
        check_figure_file(picture, "--picture")
    make_what_if(config, out, quiet)
    dataset = open_dataset(out)
    lines = outcomes(dataset)
    rows = stamped(melted(lines, ["change"]), "what-if", seed, dataset_id(dataset))
    show_table(rows, json, lines=lines)
    if picture is not None:
        write_paths(dataset, picture)


def _show_blame(config: GenerateConfig, episode: int, seed: int, json: Path | None) -> None:
    """Print a line for each incident of an episode and driver who was tried."""
    from experiments.generate.episode import Task
    from experiments.score.rows import melted, show_table, stamped
    from experiments.what_if.blame import judge
    from sim.scenario import sample_agents

    task = Task(config, config.scenarios[0], episode)
    made = config.scenario(task.scenario, episode)
    agents = sample_agents(made, task.seed)
    lines = list(judge(made, agents, task.seed, config.engine))
    if lines or json is not None:
        keys = ["time_s", "incident", "agent", "other", "rule", "driver", "role", "behavior"]
        show_table(stamped(melted(lines, keys), "what-if --blame", seed), json, lines=lines)
    else:
        typer.echo(f"{made.name}: no collision and no near miss in {made.duration_s:g} s")


def drive(
    policy: Annotated[
        list[str] | None,
        option("planner, another of ours, or module:function of your own; repeat for several "
               "(default: ours).", metavar="NAME"),
    ] = None,
    scenario: Annotated[
        list[str] | None, option("Where; repeat for several (default: everywhere).")
    ] = None,
    crowd: Annotated[
        list[str] | None,
        option("Among whom: a behaviour, mixed, recorded, homogeneous, or a mix such as "
               "timid=.9,novice=.1; repeat for several (default: all).", metavar="NAME or MIX"),
    ] = None,
    behaviors: Annotated[
        str | None,
        option("Behaviours of your own: a TOML file, or distracted, novice.",
               metavar="FILE or NAMES"),
    ] = None,
    episodes: Annotated[
        int | None, option("Of each policy in each scenario and crowd (default: 20).")
    ] = None,
    seed: Annotated[int | None, option("Of the first episode.", min=0)] = None,
    flow: Flow = None,
    duration_s: Annotated[
        float | None, option("Longest episode, s (default: 60).", "--duration-s")
    ] = None,
    warmup_s: Annotated[
        float | None, option("How long the traffic drives before, s (default: 20).", "--warmup-s")
    ] = None,
    quick: Annotated[
        bool, option("Two scenarios, two crowds, two short episodes.", "--quick")
    ] = False,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Test how driving policies do in every scenario among drivers of every kind."""
    from experiments.drive.run import QUICK, LicenceTest, run_test, short_table
    from experiments.score.rows import show_parts

    given: dict[str, Any] = {
        "policies": tuple(policy or ()), "scenarios": tuple(scenario or ()),
        "crowds": tuple(crowd or ()), "episodes": episodes, "seed": seed, "flow": flow,
        "duration_s": duration_s, "warmup_s": warmup_s, "behaviors": behaviors,
    }  # fmt: skip
    chosen = {name: value for name, value in given.items() if value not in (None, ())}
    test = dataclasses.replace(QUICK if quick else LicenceTest(), **chosen)
    show_parts("drive", run_test(test, jobs, quiet), json, short_table)
