"""What accuracy is compared with: leaks that are made on purpose, and the best that is possible.

- ``random-rows``: windows of the same drivers are learned and scored, as one must not do.
- ``leak-probe``: a forest that is given an agent's number and the time and nothing else; it has to
  stay at chance, and its interval has to hold chance.
- ``ceiling``: a forest that is given the numbers that the drivers were made from.
- ``largest-eigenvector``: the paper's reading of the largest eigenvector's entries.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from experiments.benches.classification.recordings import MAIN_S, FloatArray, IntArray, Recordings
from experiments.benches.classification.rows import keys_of, posterior, score_rows
from experiments.benches.statistics import majority_of, pairs_won
from experiments.score.metrics import bootstrap, ratio
from experiments.score.rows import Row, tidy_row
from graphrqi.classify import make_classifier
from graphrqi.methods import train
from graphrqi.posterior import AGGRESSIVE
from graphrqi.samples import Samples
from sim.store.dataset import Dataset
from sim.store.schema import Split

CEILING_DRIVERS: Final = 600
"""Training drivers that the ceiling learns from at most (about those of one scenario in the bench's
own data): the more it sees, the nearer it comes to where draws are cut off, so ceilings of datasets
of other sizes could not be compared."""


def random_rows(recordings: Recordings, methods: Sequence[str]) -> list[Row]:
    """Half of all windows learned and the other half scored, drivers and all: a leak, measured."""
    rows: list[Row] = []
    for method in (*methods, "leak-probe"):
        samples = recordings.scored("majority" if method == "leak-probe" else method)
        learned = np.random.default_rng(0).random(len(samples)) < 0.5
        training, asked = samples.where(learned), samples.where(~learned)
        if method == "leak-probe":
            training, asked = _who_and_when(training), _who_and_when(asked)
            probe = make_classifier("forest", len(BEHAVIORS), feature_share=1.0)
            probe.fit(training.features.astype(np.float64), training.codes, None, 0)
            probability = posterior(probe, asked)
        else:
            probability = posterior(train(method, training), asked)
        for scenario in recordings.dataset.scenarios:
            chosen = recordings.scenario[asked.episode] == scenario
            keys = keys_of("random-rows", scenario, method, MAIN_S)
            majority = majority_of(training)
            rows += score_rows(asked.where(chosen), probability[chosen], majority, keys)
    return rows


def _who_and_when(samples: Samples) -> Samples:
    features = np.stack([samples.episode, samples.agent, samples.time_s], axis=1)
    return dataclasses.replace(samples, features=features.astype(np.float32))


def leak_probe(recordings: Recordings) -> list[Row]:
    """A forest that sees who and when: on everyone's windows, and on each driver's first.

    A number and a time together tell how long a driver has been in sight, and slow ones stay
    longer. When its first window ends, each has been in sight for as long.
    """
    parts = [
        dataclasses.replace(
            samples, features=np.stack([samples.agent, samples.time_s], axis=1).astype(np.float32)
        )
        for samples in (recordings.training("majority"), recordings.scored("majority"))
    ]
    forest = make_classifier("forest", len(BEHAVIORS), feature_share=1.0)
    forest.fit(parts[0].features.astype(np.float64), parts[0].codes, None, 0)
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, parts[1])
        driver = here.episode * 10**9 + here.agent
        first = np.zeros(len(here), dtype=bool)
        first[np.unique(driver, return_index=True)[1]] = True  # of an episode's, in order of time
        for variation, samples in (("", here), ("first window", here.where(first))):
            keys = keys_of("leak-probe", scenario, "leak-probe", MAIN_S, variation)
            rows += score_rows(samples, posterior(forest, samples), majority_of(parts[0]), keys)
    return rows


def _drivers(dataset: Dataset, split: Split) -> tuple[FloatArray, NDArray[np.int8], IntArray]:
    """Realised profile numbers, codes and episode of every driver of a split."""
    numbers, codes, episodes = [], [], []
    index = {e.id: i for i, e in enumerate(dataset.manifest.episodes)}
    for entry in dataset.episodes(split):
        for agent in dataset.read(entry).agents:
            if agent.behavior is not None and agent.profile is not None:
                numbers.append([getattr(agent.profile, name) for name in PROFILE_FIELDS[:5]])
                codes.append(agent.behavior.code)
                episodes.append(index[entry.id])
    return np.array(numbers), np.array(codes, dtype=np.int8), np.array(episodes)


def ceiling(recordings: Recordings) -> list[Row]:
    """A forest on the numbers that drivers were made from: nobody can do much better.

    Desired speed, headway, gap, acceleration and braking; not the rates and probabilities, which
    tell the class at once and show in hardly any window.
    """
    numbers, codes, _ = _drivers(recordings.dataset, "train")
    chosen = np.random.default_rng(0).permutation(codes.size)[:CEILING_DRIVERS]
    numbers, codes = numbers[chosen], codes[chosen]
    forest = make_classifier("forest", len(BEHAVIORS), trees=200, min_leaf=3, feature_share=0.4)
    forest.fit(numbers, codes, None, 0)
    numbers, truth, episode = _drivers(recordings.dataset, "test")
    nothing, whole = np.zeros(truth.size), np.full(truth.size, np.inf)
    samples = Samples(
        numbers.astype(np.float32), truth, episode, np.arange(truth.size), nothing, whole, whole,
        np.ones(truth.size, dtype=bool),
    )  # fmt: skip
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, samples)
        keys = keys_of("inductive", scenario, "ceiling", float("inf"))
        majority = int(np.bincount(codes).argmax())
        rows += score_rows(here, posterior(forest, here), majority, keys)
    return rows


def interpretability(recordings: Recordings) -> list[Row]:
    """AUC of |w_j|, w = L u of the largest eigenvector, for aggressive against conservative.

    The paper reads a large entry as an aggressive driver. L u = lambda u, so |w_j| orders the
    drivers of one graph as |u_j| does; only drivers of the same graph are compared.
    """
    samples = recordings.scored("graphrqi")
    size = np.abs(samples.features[:, 0].astype(np.float64))
    aggressive = AGGRESSIVE[samples.codes]
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        chosen = np.flatnonzero(recordings.scenario[samples.episode] == scenario)
        counts = []
        for episode in np.unique(samples.episode[chosen]):
            won = pairs = 0.0
            here = chosen[samples.episode[chosen] == episode]
            for moment in np.unique(samples.time_s[here]):
                now = here[samples.time_s[here] == moment]
                up, down = size[now][aggressive[now]], size[now][~aggressive[now]]
                won += float(pairs_won(up, down).sum())
                pairs += up.size * down.size
            counts.append([won, pairs])
        value = bootstrap(ratio, np.array(counts))
        keys = keys_of("inductive", scenario, "largest-eigenvector", None)
        rows.append(tidy_row(keys, "auc", *value, int(chosen.size)))
    return rows
