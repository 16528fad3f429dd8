"""Encounters before a crossing, and the scores of the chances given to them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score

from behaviors.labels import BEHAVIORS
from experiments.benchmarks.prediction import yield_chances
from experiments.score.metrics import auc_over_episodes
from graphrqi.posterior import Posterior
from graphrqi.predict.rollout.driver_table import YIELDS
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Event, EventKind, Frame, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


@pytest.fixture(scope="module")
def road():
    return SCENARIOS["straight_road"]().road


def episode(road) -> Tracks:
    """One car towards the zebra, two seconds away at 6 s; it drives on."""
    crossing = road.crossings[0].centerline
    lane = next(x for x in road.lanes if x.id == "east_in_2").centerline
    along_x = crossing[:, 0].mean()
    frames = []
    front = along_x - 2.0 - 20.0
    speed = 10.0
    x = front - 2.25 - 60.0
    for step in range(131):
        t = step * 0.1
        x += speed * 0.1
        u = min(max((t - 6.0) * 1.0 + 2.0, 0.5), 8.0)
        toward = (crossing[-1] - crossing[0]) / np.linalg.norm(crossing[-1] - crossing[0])
        heading = float(np.arctan2(toward[1], toward[0]))
        frames.append(
            Frame(
                time_s=t, ids=np.arange(2),
                xy=np.array([[x, lane[0, 1]], crossing[0] + u * toward]),
                heading=np.array([0.0, heading]), speed=np.array([speed, 1.0]),
                length=np.array([4.5, 0.3]), width=np.array([1.8, 0.5]),
                kind=np.array([0, PEDESTRIAN]),
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


@pytest.mark.parametrize("yields", [True, False])
def test_an_encounter_and_its_outcome_are_seen(road, yields):
    kind = EventKind.YIELDED if yields else EventKind.NOT_YIELDED
    tracks = episode(road)
    way = np.abs(tracks.xy[0, :, 0] - (road.crossings[0].centerline[:, 0].mean() - 4.25))
    event = Event(kind, float(tracks.time_s[way.argmin()]), 0, 1)
    asked = dict.fromkeys(range(55, 65), NOBODY)
    (found,) = yield_chances(dataclasses.replace(tracks, events=(event,)), road, asked)
    assert found[0] == pytest.approx(YIELDS.mean())
    assert found[1] == yields
    assert len(yield_chances(tracks, road, asked)) == 0  # no event, no answer


def test_pairs_of_one_group_count_as_scikit_learn_has_it():
    rng = np.random.default_rng(0)
    chance = rng.integers(0, 20, 200) / 20.0  # with ties
    happened = rng.random(200) < chance
    area = auc_over_episodes(chance, happened, np.arange(200), np.zeros(200))[0]
    assert area == pytest.approx(roc_auc_score(happened, chance))
