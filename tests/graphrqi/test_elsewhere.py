"""Answers elsewhere: the gate, the range, and what is saved."""

import dataclasses
import json

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.adaptation import Adaptation, from_agreement, from_labels
from graphrqi.elsewhere import (
    FAST,
    FOREIGN,
    HOME,
    PEOPLE_AT_FIRST,
    RECORDED,
    SEEN_BADLY,
    UNSEEN,
)
from graphrqi.elsewhere_training import Lessons, train_elsewhere
from graphrqi.features.observer import Observation
from graphrqi.features.relative.observer import (
    LEAST_LEFT_OVER_M,
    SCENE_NAMES,
    UNKNOWN_SCENE,
    RelativeObserver,
)
from graphrqi.methods import Model
from graphrqi.model_files import load_model, save_model
from graphrqi.samples import Samples

F = len(RelativeObserver.feature_names)
SCENE = slice(-1 - len(SCENE_NAMES), -1)
HEADWAY = SCENE.start + SCENE_NAMES.index("mean headway")
DRIVERS = 4
"""Drivers of one place."""
SMALL = {"members": 1, "own": 24, "shown": 8, "joint": 16, "dropout": 0.3, "passes": 40}


def made(n: int, kind: int, seed: int) -> Samples:
    """Samples whose first feature tells the class, and whose scenes tell their kind."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 6, n).astype(np.int8)
    features = rng.normal(0.0, 1.0, (n, F)).astype(np.float32)
    features[:, 0] = codes + rng.normal(0.0, 0.3, n)
    features[:, SCENE] = rng.normal(5.0 * kind, 1.0, (n, len(SCENE_NAMES)))
    features[:, HEADWAY] = np.abs(features[:, HEADWAY])  # a second and more: drivers follow
    places = np.arange(n) // DRIVERS
    return Samples(
        features=features, codes=codes, episode=1000 * seed + places, agent=np.arange(n),
        time_s=places.astype(float), seconds=np.full(n, 10.0), window_s=np.full(n, np.inf),
        moving=np.ones(n, dtype=bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def elsewhere():
    training = Samples.join([made(1200, kind, kind) for kind in range(3)])
    lessons = Lessons(
        training, np.arange(3, dtype=np.int8).repeat(1200),
        made(100, HOME, 18).features[:, SCENE].astype(float),
        made(100, SEEN_BADLY, 19).features[:, SCENE].astype(float),
        made(400, RECORDED, 20).features[:, SCENE].astype(float),
    )  # fmt: skip
    return train_elsewhere(lessons, options=SMALL)


@pytest.mark.parametrize("kind", range(4))
def test_the_gate_tells_the_kind_of_traffic(elsewhere, kind):
    found = elsewhere.kinds(made(200, kind, 4 + kind).features.astype(float))
    assert np.allclose(found.sum(axis=1), 1.0)
    assert (found.argmax(axis=1) == kind).mean() > 0.95


def test_where_nobody_follows_it_is_no_simulation(elsewhere):
    scenes = made(200, FOREIGN, 8).features.astype(float)
    assert (elsewhere.kinds(scenes).argmax(axis=1) == FOREIGN).mean() > 0.95
    scenes[:, HEADWAY] = np.log(0.25)
    assert (elsewhere.kinds(scenes)[:, RECORDED] > 0.9).mean() > 0.95


@pytest.mark.parametrize(
    ("weaving", "recorded"),
    [(np.log(LEAST_LEFT_OVER_M), 0.0), (UNKNOWN_SCENE, PEOPLE_AT_FIRST)],
    ids=["on a line", "not known yet"],
)
def test_restlessness_that_cannot_be_seen_makes_no_people(elsewhere, weaving, recorded):
    scenes = made(200, RECORDED, 9).features.astype(float)
    assert np.median(elsewhere.kinds(scenes)[:, RECORDED]) > 0.9
    scenes[:, SCENE.start + SCENE_NAMES.index("mean weaving")] = weaving
    low, high = np.full_like(elsewhere.low, -100.0), np.full_like(elsewhere.high, 100.0)
    found = dataclasses.replace(elsewhere, low=low, high=high).kinds(scenes)
    assert np.median(found[:, RECORDED]) == pytest.approx(recorded, abs=0.02)


@pytest.mark.parametrize("kind", [SEEN_BADLY, FOREIGN, RECORDED])
def test_it_answers_as_far_as_the_traffic_is_not_as_at_home(elsewhere, kind):
    away = made(200, kind, 6)
    features = away.features.astype(float)
    kinds = elsewhere.kinds(features)
    answer = elsewhere.answers(features, kinds)
    assert np.allclose(answer.sum(axis=1), 1.0 - kinds[:, 0])
    assert (answer.argmax(axis=1) == away.codes).mean() > 0.6


def test_far_outside_the_training_nothing_is_known(elsewhere):
    far = made(50, FOREIGN, 7).features.astype(float)
    far[:, SCENE] += 100.0
    kinds = elsewhere.kinds(far)
    assert np.allclose(kinds[:, [FOREIGN, RECORDED]].sum(axis=1), 1.0)
    assert np.allclose(elsewhere.answers(far, kinds), 1.0 / len(BEHAVIORS))


@pytest.mark.parametrize(("seconds", "known"), [(0.8, 0.0), (1.5, 0.5), (2.0, 1.0), (30.0, 1.0)])
def test_a_scene_is_watched_for_two_seconds_before_the_gate_is_believed(elsewhere, seconds, known):
    features = made(50, FOREIGN, 7).features.astype(float)
    features[:, SCENE.start + SCENE_NAMES.index("seconds")] = np.log1p(seconds)
    later = features.copy()
    later[:, SCENE.start + SCENE_NAMES.index("seconds")] = np.log1p(2.0)
    expected = known * elsewhere.kinds(later if known < 1.0 else features) + (1.0 - known) * UNSEEN
    assert np.allclose(elsewhere.kinds(features), expected, atol=0.1)
    foreign = np.tile(np.eye(4)[FOREIGN], (50, 1))
    assert elsewhere.answers(features, foreign).max() <= known + (1.0 - known) / 6.0 + 1e-9


@pytest.mark.parametrize(("kind", "share"), [(HOME, UNSEEN[HOME]), (FOREIGN, 0.0)])
def test_until_courses_are_known_home_is_not_likelier_than_at_first(elsewhere, kind, share):
    features = made(50, kind, 7).features.astype(float)
    features[:, SCENE.start + SCENE_NAMES.index("seconds")] = np.log1p(30.0)
    known = elsewhere.kinds(features)
    features[:, SCENE.start + SCENE_NAMES.index("mean weaving")] = UNKNOWN_SCENE
    wide = dataclasses.replace(elsewhere, low=np.minimum(elsewhere.low, UNKNOWN_SCENE))
    open_ = wide.kinds(features)
    assert np.allclose(open_.sum(axis=1), 1.0)
    assert np.median(known[:, kind]) > 0.9
    assert open_[:, HOME].max() <= UNSEEN[HOME] + 0.02
    assert np.median(open_[:, HOME]) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("noise_m", "step_s", "kind"),
    [(0.0, 0.1, HOME), (0.0, 0.4, HOME), (0.05, 0.1, SEEN_BADLY), (0.0, 0.04, SEEN_BADLY)],
)
def test_home_that_is_seen_exactly_is_home_however_many_frames_are_lost(
    elsewhere, noise_m, step_s, kind
):
    features = made(50, SEEN_BADLY, 7).features.astype(float)
    features[:, SCENE.start + SCENE_NAMES.index("noise")] = noise_m
    features[:, SCENE.start + SCENE_NAMES.index("frame interval")] = step_s
    assert (elsewhere.kinds(features).argmax(axis=1) == kind).all()


def test_every_kind_of_traffic_is_needed():
    with pytest.raises(InputError, match="kinds: found \\[2\\]"):
        train_elsewhere(
            Lessons(made(100, FOREIGN, 8), np.full(100, FOREIGN, np.int8),
                    *np.zeros((3, 1, len(SCENE_NAMES))))
        )  # fmt: skip


def among(elsewhere, features, kind, seconds=20.0):
    """(n,) probability of the aggressive style of drivers who are seen together."""
    n = len(features)
    kinds = np.eye(4)[kind]
    seen = Observation(np.arange(n), np.full(n, seconds), np.zeros((n, 0)), np.zeros((n, 0)))
    answer = elsewhere.answers_among(features, kinds, seen, 0.0, elsewhere.empty_place())
    assert np.allclose(answer.sum(axis=1), 1.0)
    return answer[:, :3].sum(axis=1)


def test_one_style_alone_is_told_in_a_simulation_and_not_in_a_recording(elsewhere):
    """Where people are recorded, only the differences between them are known."""
    drivers = made(400, RECORDED, 12)
    one_sided = drivers.features.astype(float)[drivers.codes < 3]
    one_sided[:, SCENE] = one_sided[0, SCENE]
    simulated = among(elsewhere, one_sided, FOREIGN)
    recorded = among(elsewhere, one_sided, RECORDED)
    assert (simulated > 0.5).mean() > 0.8
    assert 0.1 < (recorded[np.abs(recorded - 0.5) > 0.3] > 0.5).mean() < 0.75


def test_both_styles_are_told_apart_in_a_recording(elsewhere):
    drivers = made(400, RECORDED, 13)
    features = drivers.features.astype(float)
    features[:, SCENE] = features[0, SCENE]
    style = among(elsewhere, features, RECORDED)
    assert ((style > 0.5) == (drivers.codes < 3)).mean() > 0.8
    shortly = among(elsewhere, features, RECORDED, seconds=1.0)
    assert np.abs(shortly - 0.5).mean() < np.abs(style - 0.5).mean()


@pytest.mark.parametrize(("headway_s", "rests_on"), [(0.25, "speeds"), (1.5, "network")])
def test_where_nobody_follows_only_speeds_count(elsewhere, headway_s, rests_on):
    """Two-wheelers side by side have no leaders; a network that reads headways says nothing."""
    drivers = made(400, RECORDED, 14)
    features = drivers.features.astype(float)
    features[:, SCENE] = features[0, SCENE]
    features[:, HEADWAY] = np.log(headway_s)
    fast = np.random.default_rng(0).normal(size=len(drivers))
    for name in FAST:
        for part, value in (("mean", fast), ("evidence", 1.0)):
            column = RelativeObserver.feature_names.index(f"{name}, compared:{part}")
            features[:, column] = value
    style = among(elsewhere, features, RECORDED)
    by_speeds = np.corrcoef(style, fast)[0, 1]
    by_network = np.corrcoef(style, drivers.codes < 3)[0, 1]
    assert (by_speeds > by_network) == (rests_on == "speeds")


def test_lessons_without_some_episodes():
    none = np.zeros((0, len(SCENE_NAMES)))
    lessons = Lessons(made(60, FOREIGN, 1), np.full(60, FOREIGN, np.int8), none, none, none)
    fewer = lessons.without(np.array([1001, 2001]))
    assert np.unique(fewer.training.episode).tolist() == [1000, *range(1002, 1015)]
    assert len(fewer.kinds) == len(fewer.training) == 56


def test_a_saved_model_answers_as_before(elsewhere, tmp_path):
    home = load_model("graphrqi-plus")
    model = dataclasses.replace(
        home, elsewhere=elsewhere, adaptation=Adaptation(0.5, np.arange(6.0))
    )
    save_model(model, tmp_path / "model")
    again: Model = load_model(tmp_path / "model")
    width = len(again.observer().feature_names)
    features = np.zeros((400, width))
    features[:, -F:] = np.concatenate([made(200, 0, 9).features, made(200, 2, 10).features])
    assert np.allclose(again.posterior(features), model.posterior(features), atol=1e-6)
    assert again.adaptation is not None
    assert np.allclose(again.answer(features)[1], model.answer(features)[1])


def test_a_saved_model_keeps_nothing_of_the_one_it_replaces(elsewhere, tmp_path):
    home = dataclasses.replace(load_model("graphrqi-plus"), elsewhere=None)
    whole = dataclasses.replace(home, elsewhere=elsewhere, adaptation=Adaptation(1.0, np.zeros(6)))
    save_model(whole, tmp_path / "model")
    (tmp_path / "model" / "notes.txt").write_text("mine")
    save_model(home, tmp_path / "model")
    again = load_model(tmp_path / "model")
    assert again.elsewhere is None
    assert again.adaptation is None
    assert (tmp_path / "model" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("elsewhere/elsewhere.json", {"features": ["speed"]}, "another version"),
        ("elsewhere/elsewhere.json", {"more": 1}, "more"),
        ("adaptation.json", {"scale": -1.0}, "scale: found -1"),
        ("adaptation.json", {"offset": [0.0]}, "expected 6 finite numbers"),
    ],
)
def test_a_changed_file_is_refused_by_name(elsewhere, tmp_path, file, change, said):
    home = load_model("graphrqi-plus")
    model = dataclasses.replace(home, elsewhere=elsewhere, adaptation=Adaptation(1.0, np.zeros(6)))
    save_model(model, tmp_path / "model")
    path = tmp_path / "model" / file
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=said) as error:
        load_model(tmp_path / "model")
    assert str(path) in str(error.value)


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


def test_answers_that_disagree_become_less_certain():
    rng = np.random.default_rng(0)
    sure = np.where(rng.random((300, 1)) < 0.5, 0.97, 0.03)
    other = np.where(rng.random((300, 1)) < 0.5, 0.97, 0.03)
    spread = [np.concatenate([np.repeat(p / 3, 3, 1), np.repeat((1 - p) / 3, 3, 1)], 1)
              for p in (sure, other)]  # fmt: skip
    assert from_agreement(spread[0], spread[1]).scale < 0.3
    assert from_agreement(spread[0], spread[0]).scale >= 1.0
    with pytest.raises(InputError, match="expected at least 10"):
        from_agreement(spread[0][:3], spread[1][:3])
