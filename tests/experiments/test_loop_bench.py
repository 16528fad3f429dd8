"""The closed loop is timed stage by stage, and its rows add up."""

from __future__ import annotations

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches import loop
from graphrqi.posterior import Posterior
from sim.episode.buffer import FrameBuffer


class Undecided:
    """A stream that believes nothing of anybody."""

    def __init__(self) -> None:
        self._buffer = FrameBuffer(50)

    def update(self, frame):
        self._buffer.push(frame)
        return Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))

    @property
    def history(self):
        return self._buffer.tracks()


def test_every_stage_is_timed(monkeypatch):
    monkeypatch.setattr(loop, "load_stream", lambda model: Undecided())
    monkeypatch.setattr(loop, "QUICK_DURATION_S", 6.0)
    rows = loop.run_loop_bench(quick=True, predictor="car-following")
    stages = {*loop.STAGES, "all"}
    assert {row["stage"] for row in rows} == stages
    assert {row["metric"] for row in rows} == {"ms_median", "ms_p99", "real_time_factor"}
    value = {(row["stage"], row["metric"]): row["value"] for row in rows}
    assert all(value[s, "ms_median"] <= value[s, "ms_p99"] for s in stages)
    together = sum(1 / value[s, "real_time_factor"] for s in loop.STAGES)
    assert np.isclose(together, 1 / value["all", "real_time_factor"])
