"""Encounters before a crossing, and the scores of the chances given to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import brier_score_loss, roc_auc_score

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILES
from experiments.benchmarks.statistics import auc, auc_within, brier
from experiments.benchmarks.yielding import (
    BELIEFS,
    EncounterChances,
    approaching,
    encounter_chances,
    score_chances,
    travelled,
)
from graphrqi.posterior import Posterior
from graphrqi.predict.scene.scene import make_scene
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Event, EventKind, Frame, Tracks

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


def with_event(tracks: Tracks, yielded: bool, time_s: float = 8.0, agent: int = 0) -> Tracks:
    """The same, and that the agent yielded or did not at that time."""
    kind = EventKind.YIELDED if yielded else EventKind.NOT_YIELDED
    return replace(tracks, events=(Event(kind, time_s, agent=agent, other=1),))


@pytest.mark.parametrize("yielded", [True, False])
def test_who_yielded_is_what_the_events_at_that_crossing_say(road, yielded):
    tracks = episode(road, brakes=False)
    stops = dict.fromkeys(range(55, 65), Posterior(np.array([0]), np.eye(len(BEHAVIORS))[1:2]))
    asked = encounter_chances(with_event(tracks, yielded), road, stops, [])
    assert asked.yielded.tolist() == [float(yielded)]
    assert asked.chance[BELIEFS] == pytest.approx(PROFILES[BEHAVIORS[1]].yield_probability)
    for elsewhere in (with_event(tracks, yielded, 12.0), with_event(tracks, yielded, agent=7)):
        assert np.isnan(encounter_chances(elsewhere, road, stops, []).yielded).all()


def test_nobody_on_the_crossing_is_no_encounter(road):
    tracks = episode(road, brakes=False, walker=False)
    assert not approaching(make_scene(tracks.window(61, 50), road))[0].size
    asked = encounter_chances(tracks, road, {61: NOBODY}, ["constant-velocity"])
    assert asked.waited.size == 0


def test_travelled_adds_up_the_way():
    way = travelled(np.array([[[3.0, 4.0], [3.0, 8.0]]]), np.array([[0.0, 0.0]]))
    assert way.tolist() == [9.0]


def test_auc_and_brier_by_hand_and_as_scikit_learn_has_them():
    assert auc(np.array([0.9, 0.8, 0.3, 0.1]), np.array([1.0, 0.0, 1.0, 0.0])) == 0.75
    assert brier(np.array([1.0, 0.5]), np.array([1.0, 0.0])) == 0.125
    rng = np.random.default_rng(0)
    chance = rng.integers(0, 20, 200) / 20.0  # with ties
    happened = (rng.random(200) < chance).astype(float)
    assert auc(chance, happened) == pytest.approx(roc_auc_score(happened, chance), abs=1e-12)
    assert brier(chance, happened) == pytest.approx(brier_score_loss(happened, chance), abs=1e-12)
    one_group = np.zeros(200, dtype=np.int64)
    assert auc_within(chance, happened > 0, one_group)[0] == pytest.approx(auc(chance, happened))


def test_rows_need_both_outcomes():
    both = EncounterChances(
        {"a": np.array([0.9, 0.2, 0.7])}, np.array([1.0, 0.0, np.nan]), np.ones(3)
    )
    rows = score_chances([both], "somewhere", "test")
    assert {(r["metric"], r["n"]): r["value"] for r in rows}["yield_auc", 2] == 1.0
    assert {r["metric"] for r in rows} == {"yield_auc", "yield_brier"}  # all waited
    one = EncounterChances({"a": np.ones(2)}, np.ones(2), np.ones(2))
    assert score_chances([one], "somewhere", "test") == []
