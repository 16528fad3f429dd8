"""The samples of a dataset's episodes, made once for all methods that observe alike."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from experiments.benches.statistics import majority_of
from experiments.data.disturbances import DISTURBANCES
from experiments.data.parallel import in_parallel
from experiments.training.classifier import TRAINING_EVERY_S, TRAINING_PER_MOMENT
from graphrqi.methods import METHODS, Model, make_observer, train
from graphrqi.samples import WINDOWS_S, Samples, collect
from sim.frames import Tracks
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

FloatArray = NDArray[np.float64]


IntArray = NDArray[np.int64]


OURS: Final = "graphrqi-plus"
"""The method that the others are compared with."""


SCORED_S: Final = (1.0, 2.0, 3.0, 5.0, 10.0, 15.0, float("inf"))
"""Lengths of observation scored; the last is a driver's whole life."""


MAIN_S: Final = 10.0
"""Length of observation at which everything but the window is compared."""


SCORED_EVERY_S: Final = 2.0
"""Time between the ends of scored windows of one driver."""


@dataclasses.dataclass(frozen=True, slots=True)
class Disturbed:
    """A disturbance at a level; the empty name leaves recordings as they are."""

    name: str = ""
    level: float = 0.0

    def __str__(self) -> str:
        """For the ``variation`` column."""
        return f"{self.name} {self.level:g} {DISTURBANCES[self.name][2]}" if self.name else ""

    def applied(self, tracks: Tracks, seed: int) -> Tracks:
        """The tracks as a sensor would see them."""
        if not self.name:
            return tracks
        return DISTURBANCES[self.name][0](tracks, self.level, np.random.default_rng(seed))


UNDISTURBED: Final = Disturbed()


def disturbed_samples(
    folder: Path,
    entry: EpisodeEntry,
    number: int,
    method: str,
    disturbed: Disturbed,
    windows_s: Sequence[float],
    every_s: float,
    per_moment: int | None,
    elsewhere: bool = False,
) -> Samples:
    """Samples of one episode; of lives that are scored only the last look at each driver.

    Args:
        folder: of the dataset.
        entry: which episode.
        number: to put on the samples, and the seed of what is drawn.
        method: whose observer looks.
        disturbed: what happens to the recording.
        windows_s: lengths of observation.
        every_s: time between the ends of windows.
        per_moment: how many lengths to draw per driver and moment; None for all.
        elsewhere: whether to add the features that answer on foreign traffic.

    Returns:
        The samples.
    """
    tracks = disturbed.applied(open_dataset(folder).read(entry).tracks, number)
    observer = make_observer(method, elsewhere=elsewhere)
    if per_moment is not None:
        return collect(tracks, observer, number, windows_s, every_s, per_moment, number)
    samples = collect(tracks, observer, number, windows_s, every_s, None, number)
    chosen = np.isfinite(samples.window_s)
    lives = np.flatnonzero(~chosen)[::-1]  # latest first
    chosen[lives[np.unique(samples.agent[lives], return_index=True)[1]]] = True
    return samples.where(chosen)


class Recordings:
    """Samples of a dataset's episodes, made once for all methods that look alike.

    Args:
        dataset: where from.
        jobs: processes; None for one per core.
    """

    def __init__(self, dataset: Dataset, jobs: int | None = None) -> None:
        self.dataset = dataset
        self._jobs = jobs
        self._number = {e.id: i for i, e in enumerate(dataset.manifest.episodes)}
        self.scenario = np.array([e.scenario for e in dataset.manifest.episodes])
        self._kept: dict[
            tuple[tuple[object, ...], tuple[float, ...], tuple[str, ...]], Samples
        ] = {}
        self._fitted: dict[tuple[str, str | None, Disturbed], tuple[Model, int]] = {}

    def _gather(
        self,
        split: Split | None,
        method: str,
        disturbed: Disturbed,
        windows_s: Sequence[float],
        every_s: float,
        per_moment: int | None,
    ) -> Samples:
        names = METHODS[method].observer("graphrqi").feature_names
        what = (split, disturbed, every_s, per_moment)
        for (looked, lengths, found), samples in self._kept.items():
            enough = lengths == tuple(windows_s) or (
                per_moment is None and set(windows_s) <= set(lengths)
            )
            if looked == what and enough and set(names) <= set(found):
                # A column of one name is the same, and so is a window of one length.
                wanted = samples.where(np.isin(samples.window_s, windows_s))
                columns = [found.index(name) for name in names]
                return dataclasses.replace(wanted, features=wanted.features[:, columns])
        arguments = [
            (self.dataset.path, entry, self._number[entry.id], method, disturbed,
             tuple(windows_s), every_s, per_moment)
            for entry in self.dataset.episodes(split)
        ]  # fmt: skip
        samples = Samples.join(list(in_parallel(disturbed_samples, arguments, self._jobs)))
        self._kept[what, tuple(windows_s), names] = samples
        return samples

    def training(self, method: str, disturbed: Disturbed = UNDISTURBED) -> Samples:
        """Windows of all lengths of the training episodes."""
        return self._gather(
            "train", method, disturbed, WINDOWS_S, TRAINING_EVERY_S, TRAINING_PER_MOMENT
        )

    def validation(self, method: str, disturbed: Disturbed = UNDISTURBED) -> Samples | None:
        """The same of the validation episodes; None if there are none."""
        if not self.dataset.episodes("validation"):
            return None
        return self._gather(
            "validation", method, disturbed, WINDOWS_S, TRAINING_EVERY_S, TRAINING_PER_MOMENT
        )

    def windows_for(self, model: Model, windows_s: Sequence[float]) -> Samples:
        """Windows of all episodes, with all features that a model answers on."""
        arguments = [
            (self.dataset.path, entry, self._number[entry.id], model.method.name, UNDISTURBED,
             tuple(windows_s), SCORED_EVERY_S, None, model.elsewhere is not None)
            for entry in self.dataset.episodes(None)
        ]  # fmt: skip
        return Samples.join(list(in_parallel(disturbed_samples, arguments, self._jobs)))

    def scored(
        self,
        method: str,
        windows_s: Sequence[float] = (MAIN_S,),
        disturbed: Disturbed = UNDISTURBED,
        split: Split | None = "test",
    ) -> Samples:
        """Windows of the test episodes (or of all, where ``split`` is None)."""
        return self._gather(split, method, disturbed, windows_s, SCORED_EVERY_S, None)

    def of(self, scenario: str, samples: Samples) -> Samples:
        """The samples of one scenario."""
        return samples.where(self.scenario[samples.episode] == scenario)

    def fitted(
        self, method: str, scenario: str | None = None, disturbed: Disturbed = UNDISTURBED
    ) -> tuple[Model, int]:
        """A method trained on the training episodes (of one scenario), and their majority class."""
        key = (method, scenario, disturbed)
        if key not in self._fitted:
            training = self.training(method, disturbed)
            validation = self.validation(method, disturbed)
            if scenario is not None:
                training = self.of(scenario, training)
                validation = None if validation is None else self.of(scenario, validation)
            self._fitted[key] = train(method, training, validation), majority_of(training)
        return self._fitted[key]


def fitted_together(sources: Sequence[Recordings], method: str) -> tuple[Model, int]:
    """A method trained on the training episodes of all datasets, and their majority class."""
    if len(sources) == 1:
        return sources[0].fitted(method)
    training = Samples.join([source.training(method) for source in sources])
    held = [samples for source in sources if (samples := source.validation(method)) is not None]
    return train(method, training, Samples.join(held) if held else None), majority_of(training)
