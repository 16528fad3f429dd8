"""Train what a model knows of traffic elsewhere: on home, on home seen badly, and on worlds."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.data.parallel import all_in_parallel
from experiments.data.windows import measured
from experiments.generate.worlds.sensor import seen_badly
from experiments.score.answers import Answers, score_answers
from experiments.score.rows import Row
from experiments.training.recorded_scenes import read_scenes, scene_rows
from graphrqi.elsewhere import FOREIGN, Elsewhere
from graphrqi.elsewhere_training import Lessons, train_elsewhere
from graphrqi.features.observer import Observation
from graphrqi.features.relative.observer import SCENE_NAMES
from graphrqi.methods import make_observer
from graphrqi.samples import NoSamplesError, Samples, collect
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

METHOD: Final = "graphrqi-relative"
"""The method whose features answer elsewhere."""

SEEN_THROUGH_SENSORS: Final = "home, seen badly"
"""The part of the training in which home is seen through sensors that are drawn at random."""

PARTS: Final = ("home", SEEN_THROUGH_SENSORS, "worlds")
"""The parts of the training, in the order of the kinds of traffic that they show."""

EVERY_S: Final = 4.0
"""Time between the moments at which every driver of a training episode is sampled, s. A moment of
each place is drawn in each pass of the training. At the first one nobody's course is known yet."""

LIFE_S: Final = (float("inf"),)
"""Drivers are seen since they appeared, as in a stream."""

LEARNED: Final[tuple[Split, ...]] = ("train", "validation")
"""Splits that are learned from: nothing is chosen on validation episodes."""

MORE_SENSORS: Final = 2
"""Further sensors through which the gate sees each training episode at home: with one alone, it
takes some noises for foreign traffic."""


def train_on_worlds(
    home: Sequence[Dataset],
    worlds: Sequence[Dataset],
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
    roads: Sequence[Dataset] = (),
) -> Elsewhere:
    """Train the networks for traffic that is not as at home, and the gate.

    Home episodes are used twice: as they are, and through a sensor that is drawn at random.

    Args:
        home: datasets of usual traffic, with train and validation episodes.
        worlds: datasets of worlds, with train and validation episodes.
        seed: the same seed and data give the same answers.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.
        roads: datasets of usual traffic on other roads, which the gate is to take for home, too.

    Returns:
        What was learned, with the data in its card.
    """
    lessons = gather_lessons(home, worlds, seed, jobs, quiet, roads)
    counts = np.bincount(lessons.kinds, minlength=len(PARTS)).tolist()
    card: dict[str, Any] = {
        "data": {
            kind: [dict(dataset.header.configuration) for dataset in datasets]
            for kind, datasets in (("home", home), ("roads", roads), ("worlds", worlds))
        },
        "training_samples": dict(zip(PARTS, counts, strict=True)),
    }
    learned = train_elsewhere(lessons, seed, card)
    if not any(dataset.episodes("test") for dataset in worlds):
        return learned
    test = _gathered(worlds, "test", PARTS[FOREIGN], seed, jobs, quiet)
    scores = _scores(learned, test)
    return dataclasses.replace(learned, card={**card, "scores": scores})


def gather_lessons(
    home: Sequence[Dataset],
    worlds: Sequence[Dataset],
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
    roads: Sequence[Dataset] = (),
) -> Lessons:
    """What `train_on_worlds` learns from; see there."""
    parts = [
        (part, _gathered(datasets, split, part, seed, jobs, quiet))
        for split in LEARNED
        for part, datasets in zip(PARTS, (home, home, worlds), strict=True)
        if any(dataset.episodes(split) for dataset in datasets)
    ]
    kinds = [np.full(len(s), PARTS.index(part), dtype=np.int8) for part, s in parts]
    training = Samples.join([samples for _, samples in parts])
    usual = [(dataset.path, entry) for dataset in roads for entry in dataset.episodes("train")]
    on_roads = _scenes(_usual, usual, "home: other roads", jobs, quiet)
    sensed = [
        (dataset.path, entry, seed, sensor)
        for dataset in (*home, *roads)
        for entry in dataset.episodes("train")
        for sensor in range(MORE_SENSORS)
    ]
    through = _scenes(_seen_badly, sensed, "home: more sensors", jobs, quiet)
    return Lessons(training, np.concatenate(kinds), on_roads, through, read_scenes())


def number_of(part: str, entry: EpisodeEntry) -> int:
    """The number that the samples of an episode have as a part of the training."""
    return zlib.crc32(f"{part} {entry.id}".encode())


def _scores(learned: Elsewhere, life: Samples) -> list[Row]:
    """Scores on drivers of worlds that were not trained on, each seen since it appeared."""
    foreign = np.eye(len(PARTS) + 1)[FOREIGN]  # whatever the gate says
    answer = np.zeros((len(life), len(BEHAVIORS)))
    for episode in np.unique(life.episode):
        here, place = np.flatnonzero(life.episode == episode), learned.empty_place()
        for time_s in np.unique(life.time_s[here]):
            rows = here[life.time_s[here] == time_s]
            none = np.zeros((rows.size, 0))
            seen = Observation(life.agent[rows], life.seconds[rows], none, none)
            features = life.features[rows].astype(np.float64)
            answer[rows] = learned.answers_among(features, foreign, seen, float(time_s), place)
    return score_answers(Answers.known(answer, life.codes, life.episode), {"split": "test"})


def _gathered(
    datasets: Sequence[Dataset], split: Split, part: str, seed: int, jobs: int | None, quiet: bool
) -> Samples:
    """Samples of the episodes of a split; no two datasets' or parts' episodes share a number."""
    arguments = [
        (dataset.path, entry, part, seed)
        for dataset in datasets
        for entry in dataset.episodes(split)
    ]
    found = all_in_parallel(
        _observed, arguments, jobs, f"{part}: observing {split} episodes", quiet
    )
    return Samples.join([samples for samples in found if samples is not None])


def _observed(folder: Path, entry: EpisodeEntry, part: str, seed: int) -> Samples | None:
    """Samples of one episode; None where nobody is seen for long enough."""
    number = number_of(part, entry)
    rng = np.random.default_rng([seed, number])
    tracks = measured(open_dataset(folder).read(entry))
    if part == SEEN_THROUGH_SENSORS:
        tracks = seen_badly(tracks, rng)
    try:
        return collect(tracks, make_observer(METHOD), number, LIFE_S, EVERY_S)
    except NoSamplesError:
        return None


def _scenes(
    observed: Callable[..., NDArray[np.float64]],
    arguments: Sequence[tuple[Any, ...]],
    what: str,
    jobs: int | None,
    quiet: bool,
) -> NDArray[np.float64]:
    """(k, S) numbers of the scenes of some episodes, as a function of one episode gives them."""
    none = np.zeros((0, len(SCENE_NAMES)))
    return np.concatenate([none, *all_in_parallel(observed, arguments, jobs, what, quiet)])


def _usual(folder: Path, entry: EpisodeEntry) -> NDArray[np.float64]:
    """(k, S) numbers of the scenes of one episode."""
    return scene_rows(measured(open_dataset(folder).read(entry)))


def _seen_badly(folder: Path, entry: EpisodeEntry, seed: int, sensor: int) -> NDArray[np.float64]:
    """(k, S) numbers of the scenes of one episode, seen through one sensor."""
    rng = np.random.default_rng([seed, sensor, zlib.crc32(entry.id.encode())])
    return scene_rows(seen_badly(measured(open_dataset(folder).read(entry)), rng))
