"""Beliefs about recorded drivers: what goes with them, where anything can."""

from __future__ import annotations

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recorded import LEAST_DRIVERS, Drivers, place_rows
from experiments.benches.second_half import MEASURES


def test_a_measure_that_all_drivers_share_has_no_correlation():
    rng = np.random.default_rng(0)
    n = 2 * LEAST_DRIVERS
    does = rng.uniform(size=(n, 2, len(MEASURES)))
    does[:, :, MEASURES.index("lane_changes")] = 0.0
    drivers = Drivers(
        halves=rng.dirichlet(np.ones(len(BEHAVIORS)), (n, 2)),
        does=does,
        life=rng.dirichlet(np.ones(len(BEHAVIORS)), n),
        unknown=np.zeros(n),
        doubted=0,
        recordings=1,
    )
    rows = {row["metric"]: row for row in place_rows("somewhere", drivers, "graphrqi-plus")}
    assert [name for name, row in rows.items() if row["value"] is None] == []
    assert {f"persistence_{measure}" for measure in MEASURES} - set(rows) == {
        "persistence_lane_changes"
    }
    assert "spearman_lane_changes" not in rows
    assert rows["spearman_split_half"]["n"] == n
