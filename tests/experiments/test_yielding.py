"""Encounters before a crossing, and the scores of the chances given to them."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score

from behaviors.labels import BEHAVIORS
from experiments.benchmarks.statistics import auc, auc_within
from experiments.benchmarks.yielding import encounter_chances
from graphrqi.posterior import Posterior
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Frame, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


@pytest.fixture(scope="module")
def road():
    return SCENARIOS["straight_road"]().road


def episode(road, *, brakes: bool, walker: bool = True) -> Tracks:
    """One car towards the zebra, two seconds away at 6 s; it brakes to a stop or drives on."""
    crossing = road.crossings[0].centerline
    lane = next(x for x in road.lanes if x.id == "east_in_2").centerline
    along_x = crossing[:, 0].mean()
    frames = []
    front = along_x - 2.0 - 20.0
    speed = 10.0
    x = front - 2.25 - 60.0
    for step in range(131):
        t = step * 0.1
        if brakes and t > 6.0:
            speed = max(0.0, speed - 0.35)
        x += speed * 0.1
        u = min(max((t - 6.0) * 1.0 + 2.0, 0.5), 8.0)
        toward = (crossing[-1] - crossing[0]) / np.linalg.norm(crossing[-1] - crossing[0])
        heading = float(np.arctan2(toward[1], toward[0]))
        n = 2 if walker else 1
        frames.append(
            Frame(
                time_s=t, ids=np.arange(n),
                xy=np.array([[x, lane[0, 1]], crossing[0] + u * toward])[:n],
                heading=np.array([0.0, heading])[:n], speed=np.array([speed, 1.0])[:n],
                length=np.array([4.5, 0.3])[:n], width=np.array([1.8, 0.5])[:n],
                kind=np.array([0, PEDESTRIAN])[:n],
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


@pytest.mark.parametrize("brakes", [True, False])
def test_an_encounter_and_its_outcome_are_seen(road, brakes):
    asked = encounter_chances(
        episode(road, brakes=brakes), road, dict.fromkeys(range(55, 65), NOBODY),
        ["constant-velocity"],
    )  # fmt: skip
    assert asked.waited.tolist() == [float(brakes)]
    assert np.isnan(asked.yielded).all()  # no event, no answer
    assert asked.chance["constant-velocity"][0] < 0.05


def test_auc_by_hand_and_as_scikit_learn_has_it():
    assert auc(np.array([0.9, 0.8, 0.3, 0.1]), np.array([True, False, True, False])) == 0.75
    rng = np.random.default_rng(0)
    chance = rng.integers(0, 20, 200) / 20.0  # with ties
    happened = rng.random(200) < chance
    assert auc(chance, happened) == pytest.approx(roc_auc_score(happened, chance), abs=1e-12)
    one_group = np.zeros(200, dtype=np.int64)
    assert auc_within(chance, happened, one_group)[0] == pytest.approx(auc(chance, happened))
