"""The plain rival: its nine numbers of a platoon, and what it learns."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.rival import NAMES, PlainRival, nine_numbers, whole_tracks
from scenarios import SCENARIOS
from sim.frames import Tracks
from sim.store.dataset import open_dataset


def platoon(headway_s: float = 2.0) -> Tracks:
    """Two cars at 10 m/s, 5 m long, one behind the other on the straight road's middle lane."""
    lane = next(x for x in SCENARIOS["straight_road"]().road.lanes if x.id == "east_in_1")
    time_s = np.arange(100) / 10.0
    x = 20.0 + 10.0 * time_s + np.array([[0.0], [10.0 * headway_s + 5.0]])
    xy = np.stack([x, np.full_like(x, lane.centerline[0, 1])], axis=2)
    flat = np.zeros_like(x)
    return Tracks.of_dense(
        ids=np.arange(2), names=("a", "b"), kind=np.zeros(2), length=np.full(2, 5.0),
        width=np.full(2, 1.8), time_s=time_s, xy=xy, heading=flat, speed=flat + 10.0,
        valid=flat == 0.0, signals=np.zeros((2, 100), dtype=np.int8),
    )  # fmt: skip


@pytest.mark.parametrize("mapped", [True, False])
def test_nine_numbers_of_a_platoon(mapped):
    road = SCENARIOS["straight_road"]().road if mapped else None
    tracks = platoon()
    if road is not None:
        signals = np.zeros((len(road.signal_groups), 100), dtype=np.int8)
        tracks = dataclasses.replace(tracks, signals=signals)
    follower, leader = (dict(zip(NAMES, row, strict=True)) for row in nine_numbers(tracks, road))
    assert follower["mean_speed_mps"] == pytest.approx(10.0)
    assert follower["deviation_of_accel_mps2"] == pytest.approx(0.0, abs=1e-6)
    assert follower["median_headway_s"] == pytest.approx(2.0)
    assert follower["least_gap_m"] == pytest.approx(20.0)
    assert np.isnan(leader["median_gap_m"])
    assert follower["lane_changes_per_km"] == 0.0 if mapped else True


def test_the_rival_learns_and_gives_probabilities_of_all_behaviours(tmp_path: Path):
    config = GenerateConfig(scenarios=("straight_road",), episodes=4, duration_s=30.0, seed=3)
    generate(config, tmp_path / "data", 1, quiet=True)
    tracks = whole_tracks(open_dataset(tmp_path / "data"), None, 1)
    driver = tracks.episode * 10**9 + tracks.agent
    assert (np.diff(driver) > 0).all()
    some = tracks.where(np.isin(tracks.codes, (1, 5)))
    answers = PlainRival(some).posterior(some.features)
    assert answers.shape[1] == len(BEHAVIORS)
    np.testing.assert_allclose(answers.sum(axis=1), 1.0)
    assert answers[:, [0, 2, 3, 4]].sum() == 0.0
    assert (answers.argmax(axis=1) == some.codes).mean() > 0.8
