import json

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.benches.behaviors import (
    BENCH,
    COUNTS,
    METRICS,
    DriverCounts,
    Settings,
    rows_of,
)
from experiments.console.tables import MADE
from experiments.score.rows import FIGURE


def test_rows_are_tidy_and_say_what_the_drivers_did():
    rows = BENCH.run(Settings(("straight_road",), seeds=(0,), duration_s=90.0))
    json.dumps(rows)
    keys = {*MADE, "engine", "scenario", "behavior", *FIGURE}
    assert all(row.keys() == keys for row in rows)
    found = {(r["behavior"], r["metric"]) for r in rows}
    assert {(b.value, m) for b in BEHAVIORS for m, _, _ in METRICS} <= found
    value = {(r["behavior"], r["metric"]): r["value"] for r in rows}
    assert value["timid", "headway_median_s"] > 2 * value["threatening", "headway_median_s"]
    assert value["all", "teleports"] == 0
    assert value["all", "left_behind"] == 0
    assert 0.0 < value["all", "longest_stand_s"] < 180.0
    for row in rows:
        if row["low"] is not None:
            assert row["low"] <= row["value"] <= row["high"]


def test_ratios_are_sums_over_drivers():
    counts = np.zeros((2, len(COUNTS)))
    counts[:, COUNTS.index("km")] = [1.0, 3.0]
    counts[:, COUNTS.index("lane_changes")] = [4.0, 0.0]
    counts[:, COUNTS.index("headway")] = [np.nan, 2.0]
    made = DriverCounts(np.array([0, 0], dtype=np.int8), counts, 1, 5, 0, 0, 30.0)
    value = {(r["behavior"], r["metric"]): r for r in rows_of(made, "sumo", "x")}
    assert value["impatient", "lane_changes_per_km"]["value"] == 1.0
    assert value["impatient", "headway_median_s"]["n"] == 1
    assert value["timid", "lane_changes_per_km"]["value"] is None
    assert value["pedestrian", "jaywalks"]["value"] == 1.0


def test_an_unknown_scenario_is_refused():
    with pytest.raises(InputError, match="did you mean 'straight_road'"):
        BENCH.run(Settings(("straight_rod",)))
