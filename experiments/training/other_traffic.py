"""Train the networks for other traffic: on simulated traffic, on the same with noise, on worlds."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.data.parallel import in_parallel
from experiments.data.windows import measured
from experiments.generate import RANDOM_WORLD
from experiments.generate.worlds import seen_badly
from experiments.score.answers import known_answers, score_answers
from experiments.score.rows import Cell, Row
from graphrqi.features.drivers import DriverObserver
from graphrqi.features.observer import Observation
from graphrqi.places.other_traffic import OtherTraffic
from graphrqi.samples import NoSamplesError, Samples, collect
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

EXACT, NOISY, OTHER = range(3)
PARTS: Final = ("home", "home, seen badly", "worlds")
"""Names of the parts of the training. They draw the sensors, so other names are other sensors."""

EVERY_S, WHOLE_TRACK_S = 4.0, (float("inf"),)
"""Time between the moments at which every driver of a training episode is sampled, s; drivers are
seen since they appeared, as in a stream."""

LEARNED: Final[tuple[Split, ...]] = ("train", "validation")
"""Splits that are learned from: nothing is chosen on validation episodes."""


def train_on_worlds(
    simulated: Sequence[Dataset], worlds: Sequence[Dataset], jobs: int | None, quiet: bool
) -> tuple[OtherTraffic, dict[str, Any]]:
    """Train the networks for traffic in which the classifier does not hold.

    Simulated episodes are used twice: as they are, and through a sensor that is drawn at random.
    For the model's card, the data come as ``networks``, and ``scores`` on unseen worlds.
    """
    from graphrqi.places.training import train_other_traffic

    parts = [
        (part, _gathered(datasets, split, part, jobs, quiet))
        for split in LEARNED
        for part, datasets in enumerate((simulated, simulated, worlds))  # EXACT, NOISY, OTHER
        if any(dataset.episodes(split) for dataset in datasets)
    ]
    training = Samples.join([samples for _, samples in parts])
    part = np.concatenate([np.full(len(samples), part, dtype=np.int8) for part, samples in parts])
    counts = np.bincount(part, minlength=len(PARTS)).tolist()
    about: dict[str, Any] = {
        "data": {
            kind: [dict(dataset.header.configuration) for dataset in datasets]
            for kind, datasets in (("simulated", simulated), ("worlds", worlds))
        },
        "training_samples": dict(zip(("exact", "noisy", "worlds"), counts, strict=True)),
    }
    learned = train_other_traffic(training, part)
    scores: list[Row] = []
    if any(dataset.episodes("test") for dataset in worlds):
        scores = _scores(learned, _gathered(worlds, "test", OTHER, jobs, quiet))
    return learned, {"networks": about, "scores": scores}


def _scores(learned: OtherTraffic, tracks: Samples) -> list[Row]:
    """Scores on drivers of worlds that were not trained on, each seen since it appeared."""
    answer = np.zeros((len(tracks), len(BEHAVIORS)))
    for episode in np.unique(tracks.episode):
        here = np.flatnonzero(tracks.episode == episode)
        place = learned.empty_place("other")
        for time_s in np.unique(tracks.time_s[here]):
            rows = here[tracks.time_s[here] == time_s]
            none = np.zeros((rows.size, 0))
            seen = Observation(tracks.agent[rows], tracks.seconds[rows], none, none)
            features = tracks.features[rows].astype(np.float64)
            answer[rows] = learned.among(features, "other", seen, float(time_s), place)
    keys: dict[str, Cell] = {"model": "networks", "scenario": RANDOM_WORLD, "split": "test"}
    return score_answers(known_answers(answer, tracks.codes, tracks.episode), keys)


def _gathered(
    datasets: Sequence[Dataset], split: Split, part: int, jobs: int | None, quiet: bool
) -> Samples:
    """Samples of the episodes of a split; no two datasets' or parts' episodes share a number."""
    arguments = [(each.path, e, part) for each in datasets for e in each.episodes(split)]
    what = f"{PARTS[part]}: observing {split} episodes"
    found = list(in_parallel(_observed, arguments, jobs, what, quiet))
    return Samples.join([samples for samples in found if samples is not None])


def _observed(folder: Path, entry: EpisodeEntry, part: int) -> Samples | None:
    """Samples of one episode; None if no agent is seen for long enough."""
    number = zlib.crc32(f"{PARTS[part]} {entry.id}".encode())
    tracks = measured(open_dataset(folder).read(entry))
    if part == NOISY:
        tracks = seen_badly(tracks, np.random.default_rng([0, number]))
    try:
        return collect(tracks, DriverObserver("smoothed"), number, WHOLE_TRACK_S, EVERY_S)
    except NoSamplesError:
        return None
