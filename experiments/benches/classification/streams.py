"""Answers as a stream gives them: of each driver after 3 s, after 10 s, and at its last look."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recordings import UNDISTURBED, Disturbed, FloatArray
from experiments.benches.classification.rows import score_rows
from experiments.benches.statistics import majority_of
from experiments.data.parallel import in_parallel
from experiments.data.windows import measured
from experiments.score.metrics import (
    bootstrap,
    calibration_error,
    confusion,
    ratio,
    reliability,
    summed,
    weighted_accuracy,
)
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.methods import Model
from graphrqi.posterior import AGGRESSIVE, aggressive_share
from graphrqi.samples import Samples
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

LOOKS_S: Final = (3.0, 10.0, float("inf"))
"""Ages at which every driver is looked at, s; the last is the end of its life."""

SURE: Final = 0.9
"""An answer of a style counts as given from this confidence on."""

ANSWERED_EVERY_S: Final = 1.0
"""The stream takes every frame, and is asked this often, s."""


def streamed(
    folder: Path, entry: EpisodeEntry, number: int, model: Model, disturbed: Disturbed
) -> tuple[Samples, FloatArray]:
    """A stream's answers on one episode.

    Args:
        folder: of the dataset.
        entry: which episode.
        number: to put on the answers, and the seed of the disturbance.
        model: a trained model.
        disturbed: what happens to the recording.

    Returns:
        Samples without features, one for each labelled driver and age of ``LOOKS_S`` that it
        reaches, and (n, 6) the answers. The life of a driver is scored if it lasts ``LOOKS_S[0]``,
        so that all ages are scored on the same drivers or fewer.
    """
    tracks = disturbed.applied(measured(open_dataset(folder).read(entry)), number)
    return look(tracks, BehaviorStream(model), number)


def look(tracks: Tracks, stream: BehaviorStream, number: int) -> tuple[Samples, FloatArray]:
    """A stream's answers on tracks; see `streamed`."""
    n = tracks.ids.size
    behavior = np.full(n, -1, dtype=np.int8) if tracks.behavior is None else tracks.behavior
    first_s = np.full(n, np.nan)
    taken = np.zeros((n, len(LOOKS_S)), dtype=bool)
    at_s, age_s = np.zeros((n, len(LOOKS_S))), np.zeros((n, len(LOOKS_S)))
    found = np.zeros((n, len(LOOKS_S), len(BEHAVIORS)))
    asked_s = -np.inf
    for frame in tracks.frames():
        stream.push(frame)
        rows = np.searchsorted(tracks.ids, frame.ids)
        fresh = rows[np.isnan(first_s[rows])]
        first_s[fresh] = frame.time_s
        if frame.time_s < asked_s + ANSWERED_EVERY_S - 1e-6:
            continue
        asked_s = frame.time_s
        answer = stream.posterior()
        rows = np.searchsorted(tracks.ids, answer.ids)
        age = frame.time_s - first_s[rows]
        for column, wanted_s in enumerate(LOOKS_S):
            last = not np.isfinite(wanted_s)
            due = age >= (LOOKS_S[0] if last else wanted_s) - 1e-6
            if not last:
                due &= ~taken[rows, column]
            here = rows[due]
            taken[here, column] = True
            at_s[here, column], age_s[here, column] = frame.time_s, age[due]
            found[here, column] = answer.probability[due]
    row, looked = np.nonzero(taken & (behavior >= 0)[:, None])
    samples = Samples(
        features=np.empty((row.size, 0), dtype=np.float32),
        codes=behavior[row],
        episode=np.full(row.size, number, dtype=np.int64),
        agent=tracks.ids[row],
        time_s=at_s[row, looked],
        seconds=age_s[row, looked],
        window_s=np.array(LOOKS_S)[looked],
        moving=np.ones(row.size, dtype=bool),
    )
    return samples, found[row, looked]


def stream_all(
    arguments: Sequence[tuple[Path, EpisodeEntry, int]],
    model: Model,
    jobs: int | None,
    disturbed: Disturbed = UNDISTURBED,
) -> tuple[Samples, FloatArray]:
    """Answers of `streamed` on several episodes.

    Args:
        arguments: the folder, the entry and the number of each episode.
        model: a trained model.
        jobs: processes; None for one per core.
        disturbed: what happens to every recording.
    """
    calls = [(*one, model, disturbed) for one in arguments]
    parts = list(in_parallel(streamed, calls, jobs))
    return Samples.join([samples for samples, _ in parts]), np.concatenate([p for _, p in parts])


def answer_rows(samples: Samples, probability: FloatArray, keys: Mapping[str, Cell]) -> list[Row]:
    """Rows of what is answered: classes, styles, confidence, and what is left unanswered.

    Args:
        samples: n, with the truth.
        probability: (n, 6) the answers.
        keys: what was measured.

    Returns:
        Rows of every metric. ``style_confidence``: mean probability of the likelier style;
        ``share_answered``: of answers whose style has a confidence above ``SURE``;
        ``accuracy_answered``: how many of those are right. Majorities are those of the truth
        itself, which no model can know better.
    """
    truth = AGGRESSIVE[samples.codes]
    aggressive = aggressive_share(probability)
    style = np.stack([1.0 - aggressive, aggressive], axis=1)
    confidence = style.max(axis=1)
    right = (aggressive > 0.5) == truth
    sure = confidence > SURE
    values = {
        "style_accuracy": _mean(right, samples),
        "style_ece": bootstrap(
            calibration_error, reliability(truth.astype(np.int8), style, samples.episode)
        ),
        "style_confidence": _mean(confidence, samples),
        "share_answered": _mean(sure, samples),
        "accuracy_answered": _mean(right & sure, samples, sure),
        "majority_style_accuracy": _majority_style(truth, samples),
    }
    rows = score_rows(samples, probability, majority_of(samples), keys)
    count = {name: len(samples) for name in values} | {"accuracy_answered": int(sure.sum())}
    return [*rows, *(tidy_row(keys, name, *values[name], n) for name, n in count.items())]


def _majority_style(truth: NDArray[np.bool_], samples: Samples) -> tuple[float, float, float]:
    constant = np.full(truth.size, int(truth.mean() > 0.5))
    return bootstrap(
        weighted_accuracy, confusion(truth.astype(np.int8), constant, samples.episode, 2)
    )


def _mean(
    values: NDArray[np.bool_] | FloatArray, samples: Samples, of: NDArray[np.bool_] | None = None
) -> tuple[float, float, float]:
    """Mean of values (over those ``of`` which it is), with its interval over episodes."""
    counted = np.ones(len(samples)) if of is None else of
    return bootstrap(ratio, summed(samples.episode, values, counted))


def by_age(samples: Samples, probability: FloatArray) -> list[tuple[float, Samples, FloatArray]]:
    """The answers at each age that any driver reaches."""
    parts = []
    for window_s in LOOKS_S:
        here = np.asarray(samples.window_s == window_s)
        if here.any():
            parts.append((window_s, samples.where(here), probability[here]))
    return parts
