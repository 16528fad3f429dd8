"""The classification benchmark on a few short episodes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.benchmarks.classification import (
    OURS,
    PROTOCOLS,
    RIVAL,
    Data,
    across_scenarios,
    inductive,
    leak_probe,
    measure,
)
from experiments.benchmarks.classified import Recordings, drivers, look
from experiments.benchmarks.scores import difference_rows, score_rows
from experiments.data.windows import places_of
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from graphrqi.methods import METHODS
from graphrqi.posterior import Posterior
from graphrqi.samples import Samples
from sim.frames import Tracks
from sim.store.dataset import open_dataset

KEYS = {"protocol", "scenario", "method", "window_s", "variation", "metric", "value", "low",
        "high", "n"}  # fmt: skip


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Recordings:
    """Episodes of two scenarios."""
    folder = tmp_path_factory.mktemp("episodes") / "data"
    names = ("straight_road", "two_way_road")
    generate(GenerateConfig(scenarios=names, episodes=5, duration_s=30.0, seed=3), folder, 1, True)
    return Recordings(open_dataset(folder), jobs=1)


@pytest.fixture
def data(recordings, tmp_path, monkeypatch) -> Data:
    """The benchmark on those episodes, with a quick classifier."""
    few = dataclasses.replace(METHODS[OURS], options={"rounds": 10})
    monkeypatch.setitem(METHODS, OURS, few)
    return Data(tmp_path, (OURS, "majority"), 5, 30.0, 1, recordings.dataset.path)


# --- samples ------------------------------------------------------------------------------------


def samples(codes: np.ndarray, episodes: np.ndarray) -> Samples:
    n = codes.size
    return Samples(
        np.zeros((n, 1), np.float32), codes.astype(np.int8), episodes, np.arange(n) % 50,
        np.zeros(n), np.full(n, 10.0), np.full(n, 10.0), np.ones(n, dtype=bool),
    )  # fmt: skip


def test_a_method_differs_from_itself_by_nothing():
    rng = np.random.default_rng(0)
    some = samples(rng.integers(0, 6, 300), np.repeat(np.arange(6), 50))
    probability = rng.dirichlet(np.ones(6), 300)
    for row in difference_rows(some, probability, probability, {}):
        assert (row["value"], row["low"], row["high"]) == (0.0, 0.0, 0.0)


def test_the_majority_stands_beside_every_score():
    some = samples(np.array([0, 0, 0, 1] * 10), np.repeat(np.arange(4), 10))
    value = {r["metric"]: r["value"] for r in score_rows(some, np.eye(6)[some.codes], 0, {})}
    assert value["weighted_accuracy"] == 1.0
    assert value["majority_weighted_accuracy"] == 0.75


def test_no_episode_is_both_learned_and_scored(recordings):
    learned = set(recordings.training("majority").episode.tolist())
    scored = set(recordings.scored("majority", (10.0,)).episode.tolist())
    assert learned
    assert scored
    assert not learned & scored
    assert learned >= set(recordings.training_tracks.episode.tolist())


def test_whole_tracks_end_with_the_last_look_at_each_driver(recordings):
    found = recordings.scored("majority", (5.0, float("inf")))
    whole = found.where(np.isinf(found.window_s))
    assert np.unique(drivers(whole)).size == len(whole)
    short = found.where(np.isfinite(found.window_s))
    for driver, end in zip(drivers(whole)[:20], whole.time_s[:20], strict=True):
        own = drivers(short) == driver
        assert not own.any() or short.time_s[own].max() <= end


def test_places_name_the_engine_where_there_are_several(recordings, tmp_path):
    config = GenerateConfig(
        scenarios=("straight_road",), episodes=1, engine="sumo-idm", duration_s=5.0
    )
    generate(config, tmp_path / "idm", 1, quiet=True)
    other = open_dataset(tmp_path / "idm")
    assert places_of([other]) == ["straight_road"]
    together = places_of([recordings.dataset, other])
    assert set(together) == {
        *(f"{scenario}, sumo" for scenario in recordings.dataset.scenarios),
        "straight_road, sumo-idm",
    }
    assert together[-1] == "straight_road, sumo-idm"


class Aging:
    """A stream that answers with the number of frames so far."""

    def __init__(self) -> None:
        self._ids = np.empty(0, dtype=np.int64)
        self._frames = 0

    def push(self, frame) -> None:
        self._ids, self._frames = frame.ids, self._frames + 1

    def posterior(self) -> Posterior:
        share = self._frames / 1000.0
        row = np.array([share, 1.0 - share, 0.0, 0.0, 0.0, 0.0])
        return Posterior(self._ids, np.tile(row, (self._ids.size, 1)))


def test_drivers_are_looked_at_when_they_are_old_enough():
    t = 150
    valid = np.ones((3, t), dtype=bool)
    valid[1, 50:] = False  # seen for 4.9 s
    valid[2, 20:] = False  # seen for 1.9 s
    xy = np.where(valid[..., None], 0.0, np.nan) * np.ones((3, t, 2))
    tracks = Tracks(
        ids=np.array([4, 5, 6]), names=("a", "b", "c"), kind=np.zeros(3), length=np.ones(3),
        width=np.ones(3), time_s=np.arange(t) * 0.1, xy=xy, heading=xy[..., 0], speed=xy[..., 0],
        valid=valid, signals=np.zeros((0, t)), behavior=np.array([0, 1, 2]),
    )  # fmt: skip
    samples, answers = look(tracks, Aging(), 9)
    found = {
        (int(agent), float(window)): answer[0] * 1000
        for agent, window, answer in zip(samples.agent, samples.window_s, answers, strict=True)
    }
    assert found == {
        (4, 3.0): pytest.approx(31),
        (4, 10.0): pytest.approx(101),
        (4, np.inf): pytest.approx(141),
        (5, 3.0): pytest.approx(31),
        (5, np.inf): pytest.approx(41),
    }
    assert samples.codes.tolist() == [0, 0, 0, 1, 1]


# --- protocols ----------------------------------------------------------------------------------


def test_the_rival_and_the_ceiling_stand_beside_ours(data):
    rows = [row for part in inductive(data) for row in part]
    assert all(set(row) == KEYS for row in rows)
    whole = {r["method"] for r in rows if r["variation"] == "whole track"}
    assert whole == {OURS, "majority", RIVAL, "ceiling"}
    differences = {r["variation"] for r in rows if r["metric"] == "macro_f1_difference"}
    assert differences == {"whole track, minus nine-numbers", "whole track, minus majority",
                           "minus majority"}  # fmt: skip
    count = {
        (r["scenario"], r["method"]): r["n"]
        for r in rows
        if r["metric"] == "macro_f1" and r["variation"] == "whole track"
    }
    for scenario in data.base.dataset.scenarios:
        assert 0 < count[scenario, RIVAL] <= count[scenario, OURS]


def test_each_scenario_is_scored_with_what_was_learned_on_the_other(data):
    rows = [row for part in across_scenarios(data) for row in part]
    names = data.base.dataset.scenarios
    found = {(r["scenario"], r["variation"].removeprefix("whole track, ")) for r in rows}
    assert found == {(one, f"trained on {other}") for one, other in (names, names[::-1])}
    assert {r["method"] for r in rows} == {OURS, RIVAL}


def test_the_leak_probe_sees_no_driving(data):
    data.__dict__["many"] = data.base
    rows = [row for part in leak_probe(data) for row in part]
    assert {r["variation"] for r in rows} == {"", "first window"}
    score = [r for r in rows if r["metric"] == "weighted_accuracy" and r["variation"]]
    assert all(row["value"] < 0.6 for row in score)


def test_unknown_protocols_and_methods_are_refused():
    with pytest.raises(InputError, match="did you mean 'inductive'"):
        next(measure(["inductiv"]))
    with pytest.raises(InputError, match="unknown method"):
        next(measure(["inductive"], ["graphrqi-pluss"]))
    assert "shipped" in PROTOCOLS
