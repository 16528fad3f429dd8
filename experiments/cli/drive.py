"""The command ``drive``: the licence test of driving policies."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import typer

from experiments.cli.options import Jobs, Json, Quiet


def drive(
    policy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="planner, another of ours, or module:function of your own; repeat for several "
            "(default: ours).",
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option(help="Where; repeat for several (default: everywhere).")
    ] = None,
    crowd: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Among whom: a behaviour, mixed, recorded or homogeneous; repeat for several "
            "(default: all).",
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(help="Of each policy in each scenario and crowd (default: 20)."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the first episode.")] = None,
    flow: Annotated[
        str | None, typer.Option(metavar="FLOW", help="light, medium, dense or vehicles per hour.")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", help="Longest episode, s (default: 60).")
    ] = None,
    warmup_s: Annotated[
        float | None,
        typer.Option("--warmup-s", help="How long the traffic drives before, s (default: 20)."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Two scenarios, two crowds, two short episodes.")
    ] = False,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Test how driving policies do in every scenario among drivers of every kind."""
    from experiments.drive.run import QUICK, LicenceTest, run_test, short_table
    from experiments.score.parts import show_parts

    given: dict[str, Any] = {
        "policies": tuple(policy or ()), "scenarios": tuple(scenario or ()),
        "crowds": tuple(crowd or ()), "episodes": episodes, "seed": seed, "flow": flow,
        "duration_s": duration_s, "warmup_s": warmup_s,
    }  # fmt: skip
    chosen = {name: value for name, value in given.items() if value not in (None, ())}
    test = dataclasses.replace(QUICK if quick else LicenceTest(), **chosen)
    show_parts("drive", run_test(test, jobs, quiet), json, short_table)
