"""The closed loop is timed stage by stage, and its rows add up."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.benches.city import STAGES, City, city_rows, measure_city, slopes
from experiments.benches.loop import BENCH


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


@pytest.mark.parametrize("engine", ["sumo", "highway"])
def test_a_city_is_measured_and_costs_are_compared(engine):
    small = measure_city(City(3, 12, engine), BENCH.quick.model, BENCH.quick.predictor, 1)
    assert small.lanes == 276
    assert 0.0 < small.agents <= 12.0
    assert small.spent_ms.shape[1] == len(STAGES)
    assert 0.0 < small.open_s < small.memory_mb
    large = small._replace(
        city=City(3, 24, engine), agents=2 * small.agents, spent_ms=4 * small.spent_ms
    )
    rows = slopes([small, large])
    assert {row["metric"] for row in rows} == {"slope_agents"}
    assert all(np.isclose(row["value"], 2.0) for row in rows)
    assert {row["stage"] for row in city_rows(small)} == {*STAGES, "all", "open"}


def test_a_first_use_says_what_each_kernel_cost(tmp_path: Path) -> None:
    program = (
        "from experiments.benches.loop import first_use; "
        "first_use('sumo', 'graphrqi-plus', 'constant-velocity')"
    )
    said = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    found = json.loads(said.stdout)
    spent = {name: sum(times) for name, times in found["kernels"].items()}
    assert "sim.sumo.vehicle_poses._find_poses" in spent
    assert min(spent.values()) > 0.0
    assert sum(spent.values()) < found["pair"][0]
    assert found["use"][0] < found["pair"][0]
    assert found["use"][1] < found["pair"][1] == sum(map(len, found["kernels"].values()))
