"""The protocols of worlds and noise: what is left out is not learned, and answers are counted."""

import dataclasses

import numpy as np
import pytest

import experiments.benches.classification.worlds as protocol
from behaviors.labels import BEHAVIORS
from experiments.benches.classification.noise import disturbances
from experiments.benches.classification.streams import answer_rows, look
from experiments.benches.classification.worlds import AXES, NOISES_M, Learned, worlds_rows
from experiments.generate.configuration import RANDOM_WORLD, GenerateConfig
from experiments.generate.dataset import generate
from experiments.generate.worlds.world import draw_world
from graphrqi.posterior import Posterior
from graphrqi.samples import Samples
from sim.frames import Tracks
from sim.store.dataset import Dataset, open_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("worlds") / "data"
    config = GenerateConfig(scenarios=(RANDOM_WORLD,), episodes=5, seed=8, duration_s=15.0)
    generate(config, folder, jobs=1, quiet=True)
    return open_dataset(folder)


def samples_of(codes: list[int], episode: list[int]) -> Samples:
    n = len(codes)
    return Samples(
        features=np.empty((n, 0), dtype=np.float32), codes=np.array(codes, dtype=np.int8),
        episode=np.array(episode), agent=np.arange(n), time_s=np.zeros(n), seconds=np.ones(n),
        window_s=np.ones(n), moving=np.ones(n, dtype=bool),
    )  # fmt: skip


def test_every_world_belongs_to_a_group_of_every_axis():
    options = [draw_world(seed).options() for seed in range(200)]
    for axis, group_of in AXES.items():
        assert len({group_of(o) for o in options}) >= 3, axis
    assert AXES["noise"]({"noise_m": 0.1}) == "to .15 m"
    assert AXES["discipline"]({"keep_right": 0.2}) == "weak"
    assert {AXES["noise"](o) for o in options} == set(NOISES_M)


def test_answers_count_what_is_sure_and_how_much_of_it_is_right():
    sure_right = [0.95, 0.01, 0.01, 0.01, 0.01, 0.01]
    sure_wrong = [0.0, 0.0, 0.0, 0.95, 0.025, 0.025]
    unsure = [0.25, 0.2, 0.15, 0.2, 0.1, 0.1]
    samples = samples_of([0, 1, 2, 3], [0, 0, 1, 1])
    probability = np.array([sure_right, sure_wrong, unsure, sure_wrong])
    rows = {row["metric"]: row["value"] for row in answer_rows(samples, probability, {})}
    assert rows["share_answered"] == 0.75
    assert rows["accuracy_answered"] == pytest.approx(2 / 3)
    assert rows["style_accuracy"] == 0.75
    assert rows["majority_style_accuracy"] == 0.75
    assert rows["style_confidence"] == pytest.approx((0.97 + 1.0 + 0.6 + 1.0) / 4)
    assert rows["style_balanced_accuracy"] == pytest.approx((2 / 3 + 1.0) / 2)


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
        (int(agent), float(window)): (age, answer[0] * 1000)
        for agent, window, age, answer in zip(
            samples.agent, samples.window_s, samples.seconds, answers, strict=True
        )
    }
    assert found == {
        (4, 3.0): (pytest.approx(3.0), pytest.approx(31)),
        (4, 10.0): (pytest.approx(10.0), pytest.approx(101)),
        (4, np.inf): (pytest.approx(14.0), pytest.approx(141)),
        (5, 3.0): (pytest.approx(3.0), pytest.approx(31)),
        (5, np.inf): (pytest.approx(4.0), pytest.approx(41)),
    }
    assert samples.codes.tolist() == [0, 0, 0, 1, 1]


def test_what_is_left_out_is_not_learned(dataset: Dataset, monkeypatch: pytest.MonkeyPatch):
    seen: list[set[int]] = []
    real = protocol.train

    def spying(method, training, validation):
        seen.append(set(np.unique(training.episode).tolist()))
        return real(method, training, validation)

    monkeypatch.setattr(protocol, "train", spying)
    home = open_dataset(dataset.path)
    learned = Learned([home], dataset, "cheung", 1)
    learned.model()
    episodes = dataset.manifest.episodes
    training = [i for i, e in enumerate(episodes) if e.split == "train"]
    learned.model({episodes[training[0]].id})
    # Home's numbers come first; only worlds can be left out.
    assert seen[0] - seen[1] == {len(episodes) + training[0]}
    assert training[0] in seen[1]


def test_worlds_are_answered_by_models_that_did_not_know_their_group(dataset: Dataset):
    rows = worlds_rows([dataset], dataset, ("cheung",), jobs=1, axes=("noise",))
    groups = {AXES["noise"](e.options) for e in dataset.manifest.episodes}
    for group in groups:
        assert any(f"noise {group} left out" in str(r["variation"]) for r in rows)
    whole = [r for r in rows if r["variation"] == "noise left out" and r["window_s"] == 3.0]
    assert {"macro_f1", "ece", "share_answered", "majority_weighted_accuracy"} <= {
        str(r["metric"]) for r in whole
    }
    assert all(dataclasses.is_dataclass(d) for d in disturbances(1))
    assert [str(d) for d in disturbances(1)] == [
        "", "position noise 0.03 m", "correlated noise 0.03 m", "dropped frames 0.05 of all",
        "frame rate 25 Hz",
    ]  # fmt: skip
    assert len(BEHAVIORS) == 6
