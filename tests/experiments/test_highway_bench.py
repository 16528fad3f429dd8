"""The highway bench has a row for every road and compares their results."""

from __future__ import annotations

from experiments.benches.highway import BENCH, Settings


def test_every_road_is_measured_and_ends_where_its_reference_does():
    rows = BENCH.run(Settings(cars=(12,), seconds=1.0, warmup_s=20.0, most_stock_frames=5))
    keys = {(row["road"], row["metric"]) for row in rows}
    assert ("fast", "ratio_to_stock") in keys
    apart = {r["road"]: r["value"] for r in rows if r["metric"] == "farthest_m"}
    assert apart["fast"] == 0.0
    assert apart["compiled"] == apart["four-way compiled"] == 0.0
    assert ("four-way stock", "agent_steps_per_cpu_s") in keys
