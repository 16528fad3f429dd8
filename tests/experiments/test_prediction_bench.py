"""The bench's made-up scene is a scene, and its timing row is whole."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.benches.prediction.bench import busy_road, compare, rollout_time, shifted_in_time
from experiments.score.predictions import GROUPS, MEASURES, Errors
from graphrqi.predict.scene.scene import make_scene
from scenarios import SCENARIOS
from sim.frames import Tracks


def test_the_timed_scene_has_everyone_on_a_path_and_leaders():
    scene = make_scene(busy_road(40), SCENARIOS["straight_road"]().road)
    assert scene.on_path.all()
    assert (scene.states.leader >= 0).sum() > 20
    assert np.isfinite(scene.accel).all()


def test_the_timing_row_is_whole():
    row = rollout_time(agents=20, repeats=3)
    assert row["n"] == 3
    assert 0 < row["low"] <= row["value"] <= row["high"]


def made_up(ade, collisions=0.1) -> Errors:
    total = np.zeros((len(GROUPS), 3, len(MEASURES)))
    total[0, -1, MEASURES.index("ade_m")] = 10 * ade
    total[0, -1, MEASURES.index("collisions")] = 10 * collisions
    count = np.zeros(len(GROUPS))
    count[0] = 10
    return Errors(total, count)


def test_ratios_and_shares_compare_what_was_run():
    blind, told, truth = (
        "graphrqi-predict-unlabelled",
        "graphrqi-predict",
        "graphrqi-predict-oracle",
    )
    episodes = [
        {"constant-velocity": made_up(4 * d, 0.4), blind: made_up(1.4 * d), told: made_up(1.1 * d),
         truth: made_up(1.0 * d)}
        for d in (0.8, 1.0, 1.2)
    ]  # fmt: skip
    value = {(r["predictor"], r["metric"]): r for r in compare(episodes, "here", "test")}
    assert value[told, "ade_m_over_constant-velocity"]["value"] == pytest.approx(0.275)
    assert value[told, "collisions_over_constant-velocity"]["value"] == pytest.approx(0.25)
    assert value[told, "label_gain_share"]["value"] == pytest.approx(0.75)
    assert (told, "ade_m_over_lstm") not in value
    assert compare([], "here", "test") == []


def test_shifted_clocks_keep_every_agents_own_way():
    tracks = busy_road(12)
    tracks = Tracks.from_frames(list(tracks.frames()))
    late = shifted_in_time(tracks, seed=1)
    assert late.valid.sum() < tracks.valid.sum()
    for i in range(12):
        seen = late.xy[i, late.valid[i]]
        own = tracks.xy[i]
        assert all(np.isclose(own, place).all(axis=1).any() for place in seen)
