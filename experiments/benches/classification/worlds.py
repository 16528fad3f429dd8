"""Worlds that training did not know: each law, lane discipline, noise and road left out in turn.

A method is trained at home and on the worlds of all groups but one, and answers on all worlds of
that group, as its stream does: after 3 s, after 10 s, and at the end of each driver's life. Of the
method that ships, what answers elsewhere is trained anew; home's classifier never saw a world. The
model that ships was trained on other and more worlds, none of them left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np

from experiments.benches.classification.recordings import OURS, FloatArray
from experiments.benches.classification.rows import keys_of
from experiments.benches.classification.streams import answer_rows, by_age, stream_all
from experiments.data.windows import gather
from experiments.score.rows import Row
from experiments.training.classifier import TRAINING_EVERY_S, TRAINING_PER_MOMENT
from experiments.training.elsewhere import PARTS, gather_lessons, number_of
from graphrqi.elsewhere import FOREIGN
from graphrqi.elsewhere_training import train_elsewhere
from graphrqi.methods import Model, train
from graphrqi.model_files import load_model
from graphrqi.places.network import PlaceNetwork
from graphrqi.samples import WINDOWS_S, NoSamplesError, Samples
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry, Split

LAW_FAMILIES: Final[dict[str, tuple[str, ...]]] = {
    "Krauss": ("Krauss", "KraussOrig1", "KraussPS", "Daniel1"),
    "IDM": ("IDM", "IDMM", "EIDM"),
    "controllers": ("ACC", "CACC"),
    "Wiedemann": ("Wiedemann", "W99"),
    "Kerner": ("BKerner",),
    "highway-env": ("highway-env IDM", "highway-env Krauss"),
}
"""Laws that are left out together, because one is made of the other. Home drives by Krauss's law
and stays in training."""

NOISES_M: Final[dict[str, float]] = {
    "none": 0.0,
    "to .05 m": 0.05,
    "to .15 m": 0.15,
    "to .5 m": 0.5,
}
"""Upper bound of each group of noise, m."""


def law_of(options: Mapping[str, Any]) -> str:
    """The family of a world's car-following law."""
    return next(name for name, laws in LAW_FAMILIES.items() if options["law"] in laws)


def discipline_of(options: Mapping[str, Any]) -> str:
    """How strongly the drivers of a world keep right."""
    level = float(options["keep_right"])
    return "none" if level == 0 else "weak" if level < 1 else "strong"


def noise_of(options: Mapping[str, Any]) -> str:
    """The group of a world's noise."""
    return next(name for name, most in NOISES_M.items() if options["noise_m"] <= most)


AXES: Final[dict[str, Callable[[Mapping[str, Any]], str]]] = {
    "law": law_of,
    "discipline": discipline_of,
    "noise": noise_of,
    "road": lambda options: str(options["family"]),
}
"""What is left out, and the group that a world belongs to, from its episode's options."""


class LearnedElsewhere:
    """What the model that ships learns for traffic elsewhere, gathered once, learned on parts.

    Args:
        home: datasets of usual traffic.
        worlds: a dataset of worlds.
        jobs: processes; None for one per core.
    """

    def __init__(self, home: Sequence[Dataset], worlds: Dataset, jobs: int | None) -> None:
        self._shipped, self._worlds = load_model(OURS), worlds
        self._lessons = gather_lessons(home, [worlds], jobs=jobs)
        self._seen_badly: PlaceNetwork | None = None

    def model(self, left_out: Collection[str] = ()) -> Model:
        """The model that ships, elsewhere trained without the worlds of these ids."""
        entries = self._worlds.manifest.episodes
        numbers = [number_of(PARTS[FOREIGN], e) for e in entries if e.id in left_out]
        lessons = self._lessons.without(np.array(numbers, dtype=np.int64))
        learned = train_elsewhere(lessons, seen_badly=self._seen_badly)
        self._seen_badly = learned.seen_badly
        return dataclasses.replace(self._shipped, elsewhere=learned)


class Learned:
    """The training windows of home and of worlds, gathered once; models are trained on parts.

    Args:
        home: datasets of usual traffic.
        worlds: a dataset of worlds.
        method: a key of ``METHODS``.
        jobs: processes; None for one per core.
    """

    def __init__(
        self, home: Sequence[Dataset], worlds: Dataset, method: str, jobs: int | None
    ) -> None:
        self._method, self._jobs = method, jobs
        self._datasets = [*home, worlds]
        self._entries = [(d is worlds, e) for d in self._datasets for e in d.manifest.episodes]
        self._parts = {split: self._gathered(split) for split in ("train", "validation")}

    def _gathered(self, split: Split) -> Samples | None:
        if not any(dataset.episodes(split) for dataset in self._datasets):
            return None
        try:
            return gather(
                self._datasets, split, self._method, windows_s=WINDOWS_S,
                every_s=TRAINING_EVERY_S, per_moment=TRAINING_PER_MOMENT, jobs=self._jobs,
            )  # fmt: skip
        except NoSamplesError:
            return None

    def model(self, left_out: Collection[str] = ()) -> Model:
        """The method, trained at home and on the worlds whose ids are not left out."""
        kept = np.array([not world or e.id not in left_out for world, e in self._entries])
        training, validation = (
            None if part is None else part.where(kept[part.episode])
            for part in self._parts.values()
        )
        if training is None:
            raise NoSamplesError("worlds: found no training window, expected at least one")
        return train(self._method, training, validation)


def learn(
    home: Sequence[Dataset], worlds: Dataset, method: str, jobs: int | None
) -> Learned | LearnedElsewhere:
    """What a method learns at home and on worlds; arguments as of `Learned`."""
    if method == OURS:
        return LearnedElsewhere(home, worlds, jobs)
    return Learned(home, worlds, method, jobs)


def worlds_rows(
    home: Sequence[Dataset],
    worlds: Dataset,
    methods: Sequence[str],
    jobs: int | None = None,
    axes: Sequence[str] = tuple(AXES),
) -> list[Row]:
    """Rows of the protocol ``worlds``.

    Args:
        home: datasets of usual traffic to learn from.
        worlds: a dataset of worlds.
        methods: keys of ``METHODS``.
        jobs: processes; None for one per core.
        axes: what is left out; keys of ``AXES``.

    Returns:
        By age: of each group that was left out, and of all groups of an axis together (``law left
        out``); of the model that ships, on all worlds.
    """
    numbered = {e.id: i for i, e in enumerate(worlds.manifest.episodes)}

    def answers(model: Model, entries: Sequence[EpisodeEntry]) -> tuple[Samples, FloatArray]:
        calls = [(worlds.path, entry, numbered[entry.id]) for entry in entries]
        return stream_all(calls, model, jobs)

    rows: list[Row] = []
    for method in methods:
        learned = learn(home, worlds, method, jobs)
        for axis in axes:
            group_of = AXES[axis]
            groups: dict[str, list[EpisodeEntry]] = {}
            for entry in worlds.manifest.episodes:
                groups.setdefault(group_of(entry.options), []).append(entry)
            together = []
            for group, entries in sorted(groups.items()):
                out = {entry.id for entry in entries}
                model = learned.model(out)
                found = answers(model, entries)
                together.append(found)
                rows += _rows(found, method, f"{axis} {group} left out")
            whole = Samples.join([s for s, _ in together]), np.concatenate([p for _, p in together])
            rows += _rows(whole, method, f"{axis} left out")
    if OURS in methods:
        rows += _rows(answers(load_model(OURS), worlds.manifest.episodes), OURS, "shipped")
    return rows


def _rows(found: tuple[Samples, FloatArray], method: str, variation: str) -> list[Row]:
    rows: list[Row] = []
    for window_s, samples, probability in by_age(*found):
        keys = keys_of("worlds", "worlds", method, window_s, variation)
        rows += answer_rows(samples, probability, keys)
    return rows
