"""The command ``drive``: the licence test of driving policies."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Flow, Jobs, Json, Quiet


def drive(
    policy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="planner, another of ours, or module:function of your own; repeat for several "
            "[default: ours].",
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option(help="Where; repeat for several [default: everywhere].")
    ] = None,
    crowd: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Among whom: a behaviour, mixed, recorded or homogeneous; repeat for several "
            "[default: all].",
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(help="Of each policy in each scenario and crowd [default: 20]."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the first episode.")] = None,
    flow: Flow = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", help="Longest episode, s [default: 60].")
    ] = None,
    warmup_s: Annotated[
        float | None,
        typer.Option("--warmup-s", help="How long the traffic drives before, s [default: 20]."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Two scenarios, two crowds, two short episodes.")
    ] = False,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Test how driving policies do in every scenario among drivers of every kind."""
    from experiments.console.tables import show_table
    from experiments.drive.run import QUICK, LicenceTest, run_test, short_table
    from experiments.rows import Row, of_bench, write_json

    given = {
        "policies": tuple(policy or ()), "scenarios": tuple(scenario or ()),
        "crowds": tuple(crowd or ()), "episodes": episodes, "seed": seed, "flow": flow,
        "duration_s": duration_s, "warmup_s": warmup_s,
    }  # fmt: skip
    chosen = {name: value for name, value in given.items() if value not in (None, ())}
    test = dataclasses.replace(QUICK if quick else LicenceTest(), **chosen)
    rows: list[Row] = []
    for part in run_test(test, jobs, quiet):
        rows += of_bench("drive", part)
        if json is not None and str(json) != "-":
            write_json(rows, Path(json))  # after every scenario, for a test that is stopped
    if str(json) == "-":
        write_json(rows, Path("-"))
    else:
        show_table(short_table(rows), title="means per episode over all scenarios")
