"""Train what a model knows of traffic elsewhere: on home, on home seen badly, and on worlds."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.data.windows import measured
from experiments.data.worlds.sensor import seen_badly
from experiments.scoring.metrics import score
from experiments.scoring.models import majority_of
from experiments.training.recorded_scenes import read_scenes, scenes_of
from graphrqi.classify.contract import CodeArray
from graphrqi.elsewhere import FOREIGN, HOME, Elsewhere, Lessons, train_elsewhere
from graphrqi.features.relative.observer import SCENE_NAMES
from graphrqi.methods import make_observer
from graphrqi.samples import WINDOWS_S, NoSamplesError, Samples, collect
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

METHOD: Final = "graphrqi-relative"
"""The method whose features answer elsewhere."""

SEEN_THROUGH_SENSORS: Final = "home, seen badly"
"""The part of the training in which home is seen through sensors that are drawn at random."""

PARTS: Final = ("home", SEEN_THROUGH_SENSORS, "worlds")
"""The parts of the training, in the order of the kinds of traffic that they show."""

EVERY_S: Final = 4.0
"""Time between the ends of training windows of one driver, s."""

MORE_SENSORS: Final = 2
"""Further sensors through which the gate sees each training episode at home: with one alone, it
takes some noises for foreign traffic."""

PER_MOMENT: Final = 2
"""Window lengths drawn for each driver and moment."""

MOST_SAMPLES: Final = {"home": 25_000, "home, seen badly": 45_000, "worlds": 110_000}
"""Most samples of each part: worlds are most of the training, and home stays known. Twice as many
would double the time of training for less than .005 of style accuracy."""


def train_on_worlds(
    home: Sequence[Dataset],
    worlds: Sequence[Dataset],
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
) -> Elsewhere:
    """Train the classifiers of traffic that is not as at home, and the gate.

    Home episodes are used twice: as they are, and through a sensor that is drawn at random.

    Args:
        home: datasets of usual traffic, with train and validation episodes.
        worlds: datasets of worlds, with train and validation episodes.
        seed: the same seed and data give the same answers.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        What was learned, with the data in its card.
    """
    found: dict[Split, list[tuple[str, Samples]]] = {"train": [], "validation": []}
    lives: list[Samples] = []
    for split, parts in found.items():
        for part, datasets in zip(PARTS, (home, home, worlds), strict=True):
            samples = _gathered(datasets, split, part, seed, jobs, quiet)
            parts.append((part, _thinned(samples, MOST_SAMPLES[part], seed)))
            if split == "validation" and part == PARTS[FOREIGN]:
                lives.append(samples.where(np.isinf(samples.window_s)))
    if any(dataset.episodes("test") for dataset in worlds):
        test = _gathered(worlds, "test", PARTS[FOREIGN], seed, jobs, quiet)
        lives.append(test.where(np.isinf(test.window_s)))
    card: dict[str, Any] = {
        "data": {
            kind: [dict(dataset.header.configuration) for dataset in datasets]
            for kind, datasets in (("home", home), ("worlds", worlds))
        },
        "training_windows": {part: len(samples) for part, samples in found["train"]},
    }
    training, kinds = _joined(found["train"])
    held = _joined(found["validation"])
    sensed = _sensed(home, seed, jobs, quiet)
    lessons = Lessons(training, kinds, *held, Samples.join(lives), sensed, read_scenes())
    learned = train_elsewhere(lessons, seed, card)
    if len(lives) < 2:
        return learned
    scores = _scores(learned, lives[1], majority_of(training))
    return dataclasses.replace(learned, card={**card, "scores": scores})


def _joined(parts: Sequence[tuple[str, Samples]]) -> tuple[Samples, CodeArray]:
    """All samples, and the kind of traffic of each."""
    kinds = [np.full(len(s), PARTS.index(part), dtype=np.int8) for part, s in parts]
    return Samples.join([samples for _, samples in parts]), np.concatenate(kinds)


def _scores(learned: Elsewhere, life: Samples, majority: int) -> dict[str, Any]:
    """Scores on drivers of worlds that were not trained on, each seen since it appeared."""
    features = life.features.astype(np.float64)
    kinds = learned.kinds(features)
    kinds[:, FOREIGN] += kinds[:, HOME]  # what home's own classifier would answer
    kinds[:, HOME] = 0.0
    answer = learned.answers(features, kinds)
    found = score(life.codes, answer, life.episode, majority, "test")
    return {name: value.as_dict() for name, value in found.items()}


def _gathered(
    datasets: Sequence[Dataset], split: Split, part: str, seed: int, jobs: int | None, quiet: bool
) -> Samples:
    """Samples of the episodes of a split; no two datasets' or parts' episodes share a number."""
    arguments = [
        (dataset.path, entry, part, seed)
        for dataset in datasets
        for entry in dataset.episodes(split)
    ]
    parts: list[Samples] = []
    with Progress(f"{part}: observing {split} episodes", len(arguments), quiet) as progress:
        for samples in in_parallel(_observed, arguments, jobs):
            if samples is not None:
                parts.append(samples)
            progress.advance()
    return Samples.join(parts)


def _observed(folder: Path, entry: EpisodeEntry, part: str, seed: int) -> Samples | None:
    """Samples of one episode; None where nobody is seen for long enough."""
    number = zlib.crc32(f"{part} {entry.id}".encode())
    rng = np.random.default_rng([seed, number])
    tracks = measured(open_dataset(folder).read(entry))
    if part == SEEN_THROUGH_SENSORS:
        tracks = seen_badly(tracks, rng)
    try:
        return collect(
            tracks, make_observer(METHOD), number, WINDOWS_S, EVERY_S, PER_MOMENT, seed + number
        )
    except NoSamplesError:
        return None


def _sensed(
    datasets: Sequence[Dataset], seed: int, jobs: int | None, quiet: bool
) -> NDArray[np.float64]:
    """(k, S) numbers of the scenes of training episodes, seen through further sensors."""
    arguments = [
        (dataset.path, entry, seed, sensor)
        for dataset in datasets
        for entry in dataset.episodes("train")
        for sensor in range(MORE_SENSORS)
    ]
    parts: list[NDArray[np.float64]] = [np.zeros((0, len(SCENE_NAMES)))]
    with Progress("home: more sensors", len(arguments), quiet) as progress:
        for scenes in in_parallel(_scenes_seen_badly, arguments, jobs):
            parts.append(scenes)
            progress.advance()
    return np.concatenate(parts)


def _scenes_seen_badly(
    folder: Path, entry: EpisodeEntry, seed: int, sensor: int
) -> NDArray[np.float64]:
    """(k, S) numbers of the scenes of one episode, seen through one sensor."""
    rng = np.random.default_rng([seed, sensor, zlib.crc32(entry.id.encode())])
    tracks = seen_badly(measured(open_dataset(folder).read(entry)), rng)
    return np.array(list(scenes_of(tracks))).reshape(-1, len(SCENE_NAMES))


def _thinned(samples: Samples, most: int, seed: int) -> Samples:
    """At most so many samples, drawn so that long and crowded episodes do not outweigh others."""
    if len(samples) <= most:
        return samples
    _, episode, count = np.unique(samples.episode, return_inverse=True, return_counts=True)
    share: NDArray[np.float64] = 1.0 / np.sqrt(count[episode])
    kept = np.zeros(len(samples), dtype=bool)
    rng = np.random.default_rng(seed)
    kept[rng.choice(len(samples), most, replace=False, p=share / share.sum())] = True
    return samples.where(kept)
