"""The observer of smoothed motion: what it must not see, and what it must."""

import numpy as np
import pytest

from graphrqi.features.drivers import SCENE_NAMES, DriverObserver
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.scenario import sample_agents

NAMES = DriverObserver("smoothed").feature_names


@pytest.fixture(scope="module")
def frames():
    scenario = SCENARIOS["straight_road"](duration_s=30.0, flow="dense")
    return list(get_engine("sumo")(scenario, sample_agents(scenario, 0), 0))


def watched(frames, moved=lambda xy: xy, factor=1.0, named=lambda ids: ids):
    observer = DriverObserver("smoothed")
    for frame in frames:
        ids = named(frame.ids)
        order = np.argsort(ids)
        observer.update(
            factor * frame.time_s, ids[order], moved(frame.xy)[order], frame.driving[order]
        )
    seen = observer.observation()
    return observer, seen, observer.features(seen.seconds, seen.sums, seen.instant)


def test_features_do_not_depend_on_place_and_heading(frames):
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    _, seen, found = watched(frames)
    _, moved, turned = watched(frames, lambda xy: (xy - 1500.0) @ turn)
    assert moved.ids.tolist() == seen.ids.tolist()
    # The squares in which speeds are averaged lie elsewhere, and equal distances round otherwise.
    same = [i for i, n in enumerate(NAMES) if "place" not in n]
    assert np.isclose(found[:, same], turned[:, same], atol=1e-6).mean() > 0.98
    assert np.abs(found - turned)[:, same].mean() < 0.01


def test_noise_shows_in_the_scene_and_hardly_in_the_features(frames):
    rng = np.random.default_rng(0)
    clean, seen, found = watched(frames)
    noisy, _, shaken = watched(frames, lambda xy: xy + rng.normal(0.0, 0.1, xy.shape))
    at = SCENE_NAMES.index("noise")
    assert clean.scene()[at] < 0.03
    assert noisy.scene()[at] == pytest.approx(0.1, rel=0.2)
    column = NAMES.index("headway while following:mean")
    long_seen = (seen.seconds > 10.0) & (found[:, column] > 0.0) & (shaken[:, column] > 0.0)
    assert long_seen.sum() > 10
    assert np.abs(found - shaken)[long_seen, column].mean() < 0.1


def test_windows_are_differences_of_evidence(frames):
    observer = DriverObserver("smoothed")
    for frame in frames[:200]:
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
    before = observer.observation()
    for frame in frames[200:]:
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
    after = observer.observation()
    both = np.isin(after.ids, before.ids)
    grown = after.sums[both] - before.sums[np.isin(before.ids, after.ids)]
    durations = slice(0, 13)  # the first block's nodes
    assert (grown[:, durations] >= -1e-9).all()
