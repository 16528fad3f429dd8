"""The command ``drive``: the licence test of driving policies."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from experiments.cli.options import Flow, Jobs, Json, Quiet, option


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
        option("Among whom: a behaviour, mixed, recorded or homogeneous; repeat for several "
               "(default: all).", metavar="NAME"),
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
        "duration_s": duration_s, "warmup_s": warmup_s,
    }  # fmt: skip
    chosen = {name: value for name, value in given.items() if value not in (None, ())}
    test = dataclasses.replace(QUICK if quick else LicenceTest(), **chosen)
    show_parts("drive", run_test(test, jobs, quiet), json, short_table)
