"""The bench's made-up scene is a scene, and its timing row is whole."""

from __future__ import annotations

import numpy as np

from experiments.prediction_bench import busy_road, rollout_time
from graphrqi.predict.scene import make_scene
from scenarios import SCENARIOS


def test_the_timed_scene_has_everyone_on_a_path_and_leaders():
    scene = make_scene(busy_road(40), SCENARIOS["straight_road"]().road)
    assert scene.on_path.all()
    assert (scene.seen.leader >= 0).sum() > 20
    assert np.isfinite(scene.accel).all()


def test_the_timing_row_is_whole():
    row = rollout_time(agents=20, repeats=3)
    assert row["n"] == 3
    assert 0 < row["low"] <= row["value"] <= row["high"]
