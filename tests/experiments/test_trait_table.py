"""The traits that the paper names, shown by the behaviours that it names, on both engines.

A small bench with wide bounds: a behaviour that loses one of its traits fails here.
"""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from experiments.benchmarks.behaviors import count_scenario, rows_of
from scenarios import SCENARIOS
from sim.scenario import Scenario

DRIVEN: dict[str, tuple[Callable[[], Scenario], tuple[int, ...]]] = {
    "straight": (
        lambda: SCENARIOS["straight_road"](duration_s=240.0, pedestrians_per_h=400.0),
        (0, 1),
    ),
    "signals": (
        lambda: SCENARIOS["four_way_intersection"](duration_s=240.0, flow="dense"),
        (0, 1),
    ),
    "two-way": (lambda: SCENARIOS["two_way_road"](duration_s=240.0), (0,)),
}
"""The roads, and the seeds of the episodes on each."""

AGGRESSIVE = ("impatient", "reckless", "threatening")
CONSERVATIVE = ("careful", "cautious", "timid")

ENGINES = ("sumo", "highway")


@pytest.fixture(scope="module", params=ENGINES)
def shown(request: pytest.FixtureRequest) -> dict[tuple[str, str, str], float]:
    """What each behaviour did on each road: value by road, metric and behaviour."""
    values: dict[tuple[str, str, str], float] = {}
    for road, (make, seeds) in DRIVEN.items():
        counted = [count_scenario(make(), seed, request.param, 60.0) for seed in seeds]
        for row in rows_of(pd.concat(counted), request.param, road):
            if row["value"] is not None and row["n"]:
                values[road, str(row["metric"]), str(row["behavior"])] = float(row["value"])
    return values


WITHIN = [
    ("signals", "red_run_share", {"reckless": (0.8, 1.0), "threatening": (0.0, 0.1)}),
    ("signals", "red_run_share", {name: (0.0, 0.1) for name in CONSERVATIVE}),
    (
        "straight",
        "yield_share",
        {"reckless": (0.0, 0.1), "threatening": (0.0, 0.85), "impatient": (0.7, 1.0)},
    ),
    ("straight", "yield_share", {name: (0.9, 1.0) for name in CONSERVATIVE}),
    (
        "straight",
        "headway_median_s",
        {"threatening": (0.5, 1.15), "impatient": (0.7, 1.3), "reckless": (1.0, 1.8)},
    ),
    (
        "straight",
        "headway_median_s",
        {"careful": (1.7, 2.8), "cautious": (2.6, 4.3), "timid": (3.3, 5.5)},
    ),
    ("straight", "lane_changes_per_km", {name: (2.0, 20.0) for name in AGGRESSIVE}),
    ("straight", "lane_changes_per_km", {name: (0.0, 1.9) for name in CONSERVATIVE}),
    ("straight", "cut_ins_per_km", {"threatening": (1.5, 10.0)}),
    ("straight", "cut_ins_per_km", {name: (0.0, 0.1) for name in CONSERVATIVE}),
    ("straight", "over_limit_share", {name: (0.25, 1.0) for name in AGGRESSIVE}),
    (
        "straight",
        "over_limit_share",
        {"careful": (0.0, 0.5), "cautious": (0.0, 0.25), "timid": (0.0, 0.05)},
    ),
    ("straight", "unprovoked_stops_per_km", {"timid": (0.2, 5.0), "careful": (0.0, 0.1)}),
    ("two-way", "wrong_way_m", {"reckless": (30.0, 300.0)}),
    (
        "two-way",
        "wrong_way_m",
        {name: (0.0, 1.0) for name in (*AGGRESSIVE, *CONSERVATIVE) if name != "reckless"},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("road", "metric", "bounds"), WITHIN)
def test_a_behaviour_shows_its_trait(
    shown: dict[tuple[str, str, str], float],
    road: str,
    metric: str,
    bounds: dict[str, tuple[float, float]],
) -> None:
    found = {name: shown[road, metric, name] for name in bounds}
    beyond = {n: v for n, v in found.items() if not bounds[n][0] <= v <= bounds[n][1]}
    assert not beyond, f"{metric} on {road}: {beyond} beyond {bounds}"


def test_conservative_drivers_hardly_ever_cause_a_collision(
    shown: dict[tuple[str, str, str], float],
) -> None:
    caused = [shown[road, "collisions_caused", name] for road in DRIVEN for name in CONSERVATIVE]
    assert sum(caused) <= 3  # of some 350 such drivers


def test_the_page_has_the_rows_of_the_bench() -> None:
    script = runpy.run_path(
        str(Path(__file__).resolve().parents[2] / "docs" / "behaviors_table.py")
    )
    assert script["table"](json.loads(script["ROWS"].read_text())) in script["PAGE"].read_text()
