"""Scenarios: roads with their demand, by name; ``SCENARIOS["straight_road"]()`` makes one."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Final

from behaviors.registry import Registry
from scenarios.demand import ScenarioEntry
from scenarios.environments import ENVIRONMENTS

SCENARIOS: Final[Registry[ScenarioEntry]] = Registry(
    "scenario",
    "graphrqi.scenarios",
    {
        "straight_road": "scenarios.straight_road:straight_road",
        "two_way_road": "scenarios.straight_road:two_way_road",
        "four_way_intersection": "scenarios.four_way_intersection:four_way_intersection",
        "priority_intersection": "scenarios.four_way_intersection:priority_intersection",
        "all_way_stop": "scenarios.four_way_intersection:all_way_stop",
        "right_before_left": "scenarios.four_way_intersection:right_before_left",
        "city": "scenarios.city:city",
        "motorway": "scenarios.motorway:motorway",
        "motorway_ramps": "scenarios.motorway:motorway_ramps",
        "roundabout": "scenarios.roundabout:roundabout",
    },
    made=ScenarioEntry,
)
"""Every scenario by name."""


def get_scenario(name: str) -> ScenarioEntry:
    """The scenario of that name, or that a file describes.

    Args:
        name: a key of ``SCENARIOS``, the path of a scenario's file (``.toml``) or that of a map.

    Raises:
        InputError: if there is none; the message suggests the nearest name.
    """
    from scenarios.own.scenario_file import is_path, scenario_at

    return scenario_at(Path(name), SCENARIOS) if is_path(name) else SCENARIOS[name]


def run_as_command(name: str) -> None:
    """Run a key of ``SCENARIOS`` as ``graphrqi run NAME`` does, with this process's options."""
    sys.argv[1:1] = ["run", name]
    runpy.run_module("experiments.cli", run_name="__main__", alter_sys=True)


__all__ = ["ENVIRONMENTS", "SCENARIOS", "ScenarioEntry", "get_scenario"]
