"""Answers in other traffic: the networks, the range, and what is saved."""

import dataclasses

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from graphrqi.features.drivers import SCENE_NAMES
from graphrqi.features.observer import Observation
from graphrqi.model_files import load_model, save_model
from graphrqi.places.adaptation import Adaptation, from_labels
from graphrqi.places.other_traffic import FEATURES, TRAFFIC
from graphrqi.places.training import OTHER, NetworkOptions, train_other_traffic
from graphrqi.samples import Samples

F = len(FEATURES)
SCENE = slice(-1 - len(SCENE_NAMES), -1)
HEADWAY = FEATURES.index("scene: mean headway")
SECONDS = FEATURES.index("scene: seconds")
DRIVERS = 4
"""Drivers of one place."""
SMALL = NetworkOptions(members=1, own=24, shown=8, joint=16, dropout=0.3, passes=40)


def made(n: int, part: int, seed: int) -> Samples:
    """Samples whose first feature tells the class, and whose scenes tell their part."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 6, n).astype(np.int8)
    features = rng.normal(0.0, 1.0, (n, F)).astype(np.float32)
    features[:, 0] = codes + rng.normal(0.0, 0.3, n)
    features[:, SCENE] = rng.normal(5.0 * part, 1.0, (n, len(SCENE_NAMES)))
    features[:, HEADWAY] = np.abs(features[:, HEADWAY])  # a second and more: drivers follow
    places = np.arange(n) // DRIVERS
    return Samples(
        features=features, codes=codes, episode=1000 * seed + places, agent=np.arange(n),
        time_s=places.astype(float), seconds=np.full(n, 10.0), window_s=np.full(n, np.inf),
        moving=np.ones(n, dtype=bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def other():
    training = Samples.join([made(1200, part, part) for part in range(3)])
    return train_other_traffic(training, np.arange(3, dtype=np.int8).repeat(1200), options=SMALL)


def answers(other, features, traffic, seconds=20.0):
    """(n, 6) answers about drivers who are seen together."""
    n = len(features)
    seen = Observation(np.arange(n), np.full(n, seconds), np.zeros((n, 0)), np.zeros((n, 0)))
    answer = other.among(features, traffic, seen, 0.0, other.empty_place(traffic))
    assert np.allclose(answer.sum(axis=1), 1.0)
    return answer


def in_one_scene(samples):
    """Features of drivers of the first one's scene."""
    features = samples.features.astype(float)
    features[:, SCENE] = features[0, SCENE]
    return features


@pytest.mark.parametrize(("traffic", "part"), [("simulated", 1), ("other", 2)])
def test_each_kind_of_traffic_is_answered(other, traffic, part):
    drivers = made(200, part, 6)
    answer = answers(other, in_one_scene(drivers), traffic)
    assert (answer.argmax(axis=1) == drivers.codes).mean() > 0.6


@pytest.mark.parametrize("traffic", TRAFFIC)
def test_far_outside_the_training_nothing_is_known(other, traffic):
    far = in_one_scene(made(50, OTHER, 7))
    far[:, SCENE] += 100.0
    assert np.allclose(answers(other, far, traffic), 1.0 / len(BEHAVIORS))


@pytest.mark.parametrize(("seconds", "known"), [(0.8, 0.0), (1.5, 0.5), (2.0, 1.0)])
def test_a_scene_is_watched_for_two_seconds_before_an_answer_counts(other, seconds, known):
    features = in_one_scene(made(50, OTHER, 7))
    features[:, SECONDS] = np.log1p(seconds)
    assert answers(other, features, "other").max() <= known + (1.0 - known) / 6.0 + 1e-9


def test_one_style_alone_is_labelled_in_a_simulation_and_not_in_a_recording(other):
    """Where people are recorded, only the differences between them are known."""
    drivers = made(400, OTHER, 12)
    one_sided = drivers.features.astype(float)[drivers.codes < 3]
    one_sided[:, SCENE] = one_sided[0, SCENE]
    simulated, recorded = (
        answers(other, one_sided, traffic)[:, :3].sum(axis=1) for traffic in ("other", "recorded")
    )
    assert (simulated > 0.5).mean() > 0.8
    assert 0.1 < (recorded[np.abs(recorded - 0.5) > 0.3] > 0.5).mean() < 0.75


def test_a_saved_model_answers_as_before(other, tmp_path):
    shipped = load_model("graphrqi-plus")
    model = dataclasses.replace(shipped, other=other, adaptation=Adaptation(0.5, np.arange(6.0)))
    save_model(model, tmp_path / "model")
    again = load_model(tmp_path / "model")
    assert again.adaptation is not None
    assert again.adaptation.offset.tolist() == list(range(6))
    features = in_one_scene(made(100, OTHER, 10))
    for traffic in TRAFFIC:
        before = answers(other, features, traffic)
        assert np.allclose(answers(again.other, features, traffic), before, atol=1e-6)


def test_labels_move_an_offset_and_keep_the_order():
    rng = np.random.default_rng(0)
    aggressive = rng.random(200) < 0.3
    # The model ranks styles well and takes everybody for more aggressive than they are.
    odds = np.where(aggressive, 4.0, 1.0) + rng.normal(0.0, 0.7, 200)
    p = 1.0 / (1.0 + np.exp(-odds))
    answer = np.concatenate(
        [np.repeat(p[:, None] / 3, 3, 1), np.repeat((1 - p)[:, None] / 3, 3, 1)], 1
    )
    style = np.arange(6) < 3
    allowed = np.where(aggressive[:, None], style, ~style)
    few = from_labels(answer[:30], allowed[:30])
    before = ((answer[30:, :3].sum(axis=1) > 0.5) == aggressive[30:]).mean()
    moved = few.applied(answer[30:])[:, :3].sum(axis=1)
    assert before < 0.5
    assert ((moved > 0.5) == aggressive[30:]).mean() > 0.8
    assert (np.argsort(moved) == np.argsort(answer[30:, :3].sum(axis=1))).all()
