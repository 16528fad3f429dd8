"""A dataset as the classification benchmark sees it: windows, whole tracks, streams' answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.data.disturbances import DISTURBANCES
from experiments.data.parallel import in_parallel
from experiments.data.windows import gather, measured
from experiments.rival import whole_tracks
from experiments.score.rows import Cell
from experiments.training.classifier import TRAINING_EVERY_S, TRAINING_PER_MOMENT
from graphrqi.methods import METHODS, Model, train
from graphrqi.samples import WINDOWS_S, Samples
from graphrqi.stream import BehaviorStream
from sim.frames import FloatArray, Tracks
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

SCORED_EVERY_S: Final = 2.0
"""Time between the ends of scored windows of one driver, s."""

AGES_S: Final = (3.0, 10.0, float("inf"))
"""Ages at which a stream is asked about every driver, s; the last is the end of its track."""

ASKED_EVERY_S: Final = 1.0
"""A stream takes every frame, and is asked this often, s."""

Disturbance = tuple[str, float] | None
"""A key of ``DISTURBANCES`` and a level; None leaves recordings as they are."""


def keys_of(
    protocol: str, scenario: str, method: str, window_s: float | None, variation: str = ""
) -> dict[str, Cell]:
    """Keys of a row; an infinite window is a driver's whole track.

    Examples:
        >>> keys_of("inductive", "city", "svm", float("inf"))["variation"]
        'whole track'
    """
    if window_s is not None and not np.isfinite(window_s):
        window_s, variation = None, ", ".join(filter(None, ("whole track", variation)))
    return {
        "protocol": protocol, "scenario": scenario, "method": method, "window_s": window_s,
        "variation": variation,
    }  # fmt: skip


def majority_of(samples: Samples) -> int:
    """The most frequent class among samples (of the training episodes, to be a fair rival)."""
    return int(np.bincount(samples.codes, minlength=len(BEHAVIORS)).argmax())


class Recordings:
    """Samples of a dataset's episodes, made once for all methods that observe alike.

    Args:
        dataset: where from.
        jobs: processes; None for one per core.
    """

    def __init__(self, dataset: Dataset, jobs: int | None = None) -> None:
        self.dataset, self._jobs = dataset, jobs
        self.scenario = np.array([e.scenario for e in dataset.manifest.episodes])
        self._kept: list[tuple[tuple[object, ...], tuple[str, ...], Samples]] = []
        self._fitted: dict[tuple[str, str | None], tuple[Model, int]] = {}

    def _gather(
        self, split: Split, method: str, windows_s: Sequence[float], scored: bool
    ) -> Samples:
        """Windows of a split; those of another method that has the same columns are taken again."""
        names = METHODS[method].observer("graphrqi").feature_names
        what = (split, tuple(windows_s), scored)
        for kept, found, samples in self._kept:
            if kept == what and set(names) <= set(found):
                columns = [found.index(name) for name in names]
                return dataclasses.replace(samples, features=samples.features[:, columns])
        samples = gather(
            [self.dataset], split, method, windows_s=windows_s, jobs=self._jobs,
            every_s=SCORED_EVERY_S if scored else TRAINING_EVERY_S,
            per_moment=None if scored else TRAINING_PER_MOMENT,
        )  # fmt: skip
        if scored:  # of whole tracks only the last look at each driver
            chosen = np.isfinite(samples.window_s)
            lives = np.flatnonzero(~chosen)[::-1]
            driver = drivers(samples)[lives]
            chosen[lives[np.unique(driver, return_index=True)[1]]] = True
            samples = samples.where(chosen)
        self._kept.append((what, names, samples))
        return samples

    def training(self, method: str) -> Samples:
        """Windows of all lengths of the training episodes."""
        return self._gather("train", method, WINDOWS_S, scored=False)

    def validation(self, method: str) -> Samples | None:
        """The same of the validation episodes; None if there are none."""
        if not self.dataset.episodes("validation"):
            return None
        return self._gather("validation", method, WINDOWS_S, scored=False)

    def scored(self, method: str, windows_s: Sequence[float], everything: bool = False) -> Samples:
        """Windows of the test episodes, or of all."""
        splits: list[Split] = ["train", "validation", "test"] if everything else ["test"]
        there = [split for split in splits if self.dataset.episodes(split)]
        return Samples.join([self._gather(s, method, windows_s, scored=True) for s in there])

    @cached_property
    def all_tracks(self) -> Samples:
        """The rival's nine numbers of every driver, in order of `drivers`."""
        return whole_tracks(self.dataset, None, self._jobs)

    @property
    def training_tracks(self) -> Samples:
        """Those of the drivers of the training episodes."""
        split = np.array([e.split for e in self.dataset.manifest.episodes])
        return self.all_tracks.where(split[self.all_tracks.episode] == "train")

    def of(self, scenario: str, samples: Samples) -> Samples:
        """The samples of one scenario, driver by driver."""
        here = samples.where(self.scenario[samples.episode] == scenario)
        order = np.argsort(drivers(here), kind="stable")
        return dataclasses.replace(
            here, **{f.name: getattr(here, f.name)[order] for f in dataclasses.fields(here)}
        )

    def fitted(self, method: str, scenario: str | None = None) -> tuple[Model, int]:
        """A method trained on the training episodes (of one scenario), and their majority class."""
        if (method, scenario) not in self._fitted:
            training, validation = self.training(method), self.validation(method)
            if scenario is not None:
                training = self.of(scenario, training)
                validation = None if validation is None else self.of(scenario, validation)
            model = train(method, training, validation)
            self._fitted[method, scenario] = model, majority_of(training)
        return self._fitted[method, scenario]

    def streamed(self, model: Model, disturbance: Disturbance = None) -> tuple[Samples, FloatArray]:
        """A stream's answers about the drivers of all episodes."""
        entries = self.dataset.manifest.episodes
        calls = [(self.dataset.path, e, i, model, disturbance) for i, e in enumerate(entries)]
        parts = list(in_parallel(_streamed, calls, self._jobs))
        return Samples.join([samples for samples, _ in parts]), np.concatenate(
            [probability for _, probability in parts]
        )


def drivers(samples: Samples) -> FloatArray:
    """(n,) a number for each driver, which differs between episodes, too."""
    return np.asarray(samples.episode * 1e9 + samples.agent)


def _streamed(
    folder: Path, entry: EpisodeEntry, number: int, model: Model, disturbance: Disturbance
) -> tuple[Samples, FloatArray]:
    """A stream's answers on one episode, which is seen with a disturbance."""
    tracks = measured(open_dataset(folder).read(entry))
    if disturbance is not None:
        name, level = disturbance
        tracks = DISTURBANCES[name](tracks, level, np.random.default_rng(number))
    return _looked(tracks, BehaviorStream(model), number)


def _looked(tracks: Tracks, stream: BehaviorStream, number: int) -> tuple[Samples, FloatArray]:
    """Samples without features for each labelled driver and reached age, and the answers."""
    n = tracks.ids.size
    codes = np.full(n, -1, dtype=np.int8) if tracks.behavior is None else tracks.behavior
    first_s = np.full(n, np.nan)
    taken = np.zeros((n, len(AGES_S)), dtype=bool)
    at_s = np.zeros((n, len(AGES_S)))
    found = np.zeros((n, len(AGES_S), len(BEHAVIORS)))
    asked_s = -np.inf
    for frame in tracks.frames():
        stream.push(frame)
        rows = np.searchsorted(tracks.ids, frame.ids)
        first_s[rows[np.isnan(first_s[rows])]] = frame.time_s
        if frame.time_s < asked_s + ASKED_EVERY_S - 1e-6:
            continue
        asked_s = frame.time_s
        answer = stream.posterior()
        rows = np.searchsorted(tracks.ids, answer.ids)
        age_s = frame.time_s - first_s[rows]
        for column, wanted_s in enumerate(AGES_S):
            last = not np.isfinite(wanted_s)
            due = age_s >= (AGES_S[0] if last else wanted_s) - 1e-6
            due &= last | ~taken[rows, column]
            taken[rows[due], column] = True
            at_s[rows[due], column] = frame.time_s
            found[rows[due], column] = answer.probability[due]
    row, at = np.nonzero(taken & (codes >= 0)[:, None])
    window_s = np.array(AGES_S)[at]
    samples = Samples(
        np.empty((row.size, 0), dtype=np.float32), codes[row], np.full(row.size, number),
        tracks.ids[row], at_s[row, at], window_s, window_s, np.ones(row.size, dtype=bool),
    )  # fmt: skip
    return samples, found[row, at]
