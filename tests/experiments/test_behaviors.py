import json

import numpy as np
import pandas as pd

from behaviors.labels import BEHAVIORS
from experiments.benchmarks.behaviors import COUNTS, METRICS, WALKS, measure, rows_of


def test_rows_are_tidy_and_say_what_the_drivers_did():
    (rows,) = measure(("straight_road",), seeds=(0,), duration_s=90.0)
    json.dumps(rows)
    keys = {"engine", "scenario", "behavior", "metric", "value", "low", "high", "n"}
    assert all(row.keys() == keys for row in rows)
    found = {(r["behavior"], r["metric"]) for r in rows}
    assert {(b.value, m) for b in BEHAVIORS for m in METRICS} <= found
    value = {(r["behavior"], r["metric"]): r["value"] for r in rows}
    assert value["timid", "headway_median_s"] > 2 * value["threatening", "headway_median_s"]
    for row in rows:
        if row["low"] is not None:
            assert row["low"] <= row["value"] <= row["high"]


def test_ratios_are_sums_over_drivers():
    made = pd.DataFrame(0.0, index=range(7), columns=COUNTS)
    made["behavior"] = [0, 0, *[WALKS] * 5]
    made.loc[:1, ["km", "lane_changes", "headway"]] = [[1.0, 4.0, np.nan], [3.0, 0.0, 2.0]]
    made.loc[2, "jaywalks"] = 1.0
    value = {(r["behavior"], r["metric"]): r for r in rows_of(made, "sumo", "x")}
    assert value["impatient", "lane_changes_per_km"]["value"] == 1.0
    assert value["impatient", "headway_median_s"]["n"] == 1
    assert value["timid", "lane_changes_per_km"]["value"] is None
    assert value["pedestrian", "jaywalks"]["value"] == 1.0
