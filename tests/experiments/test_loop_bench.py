"""The closed loop is timed stage by stage, and its rows add up."""

from __future__ import annotations

import dataclasses

import numpy as np

from experiments.benches.loop import BENCH, STAGES


def test_every_stage_of_the_real_loop_is_timed():
    rows = BENCH.run(dataclasses.replace(BENCH.quick, engines=("sumo",), duration_s=6.0))
    stages = {*STAGES, "all"}
    assert {row["stage"] for row in rows} == stages
    assert {row["metric"] for row in rows} == {"ms_median", "ms_p99", "real_time_factor"}
    assert all(row["agents"] > 0 for row in rows)
    value = {(row["stage"], row["metric"]): row["value"] for row in rows}
    assert all(0.0 < value[s, "ms_median"] <= value[s, "ms_p99"] for s in stages - {"remember"})
    together = sum(1 / value[s, "real_time_factor"] for s in STAGES)
    assert np.isclose(together, 1 / value["all", "real_time_factor"])
