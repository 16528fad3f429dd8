"""Adapt a model to a place, and say what that gained (``graphrqi train --from``)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.data.windows import measured
from experiments.guard import guarded_call
from experiments.score.rows import Row, tidy_row
from graphrqi.places.adaptation import LEAST_PAIRS, from_agreement, from_labels
from graphrqi.methods import Model
from graphrqi.model_files import check_model_folder, load_model, save_model
from graphrqi.posterior import AGGRESSIVE, aggressive_share
from graphrqi.samples import NoSamplesError, Samples, collect
from sim.formats.common.label_file import DriverLabel, DriverLabels, read_driver_labels
from sim.store.dataset import Dataset, open_dataset

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PAIR_S: Final = 10.0
"""Length of the two stretches of a track whose answers are compared, s."""

LABELLED: Final = (10, 30, 100)
"""Numbers of labelled drivers that are reported."""

SPLITS: Final = 20
"""Random choices of the labelled drivers that are averaged."""

SCORED: Final = ("style_balanced_accuracy", "style_auc", "style_log_loss")
"""What is scored of labelled drivers that were left out."""

LEAST_SCORED: Final = 10
"""Fewest drivers beside the labelled ones on which a number is reported."""


@dataclass(frozen=True, slots=True)
class Drivers:
    """Every driver of some recordings, at its last look.

    Attributes:
        labels: (n,) of each, where one is given.
        features: (n, F) of its whole track.
        pairs: (2, m, F) of two stretches of the tracks that are long enough.
    """

    labels: tuple[DriverLabel | None, ...]
    features: FloatArray
    pairs: FloatArray


def drivers_of(
    dataset: Dataset, model: Model, given: DriverLabels | None = None, quiet: bool = True
) -> Drivers:
    """Observe every driver of a dataset.

    Args:
        dataset: what is observed.
        model: whose features are taken.
        given: labels of some drivers.
        quiet: whether to show no progress.

    Raises:
        InputError: if nobody is seen for long enough, or labels are of nobody.
    """
    labels: list[DriverLabel | None] = []
    features, firsts, lasts = [], [], []
    episodes = dataset.manifest.episodes
    with Progress("observing drivers", len(episodes), quiet) as progress:
        for entry in episodes:
            tracks = measured(dataset.read(entry))
            known: list[DriverLabel | None] = [None] * len(tracks.names)
            if given is not None:
                known = given.of(tracks.names, entry.name, entry.file, entry.id)
            unlabelled = np.zeros(tracks.ids.size, dtype=np.int8)  # any label: none is used
            try:
                found = collect(
                    dataclasses.replace(tracks, behavior=unlabelled), model.observer("recorded"),
                    windows_s=(PAIR_S, float("inf")),
                )  # fmt: skip
            except NoSamplesError:
                found = None
            if found is not None:
                life = found.where(np.isinf(found.window_s))
                ids, last = _ends(life, latest=True)
                rows = np.searchsorted(tracks.ids, ids)
                labels += [known[row] for row in rows]
                features.append(life.features[last])
                first, second = _apart(found.where(found.window_s == PAIR_S))
                firsts.append(first)
                lasts.append(second)
            progress.advance()
    if not labels:
        raise InputError(f"{dataset.path}: found no driver seen for 1 s, expected at least one")
    if given is not None:
        given.check()
    pairs = np.stack([np.concatenate(firsts), np.concatenate(lasts)])
    return Drivers(
        tuple(labels), np.concatenate(features).astype(np.float64), pairs.astype(np.float64)
    )


def _ends(samples: Samples, latest: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Agents, ascending, and the row of each one's earliest or latest sample."""
    order = np.lexsort((samples.time_s if not latest else -samples.time_s, samples.agent))
    agents, first = np.unique(samples.agent[order], return_index=True)
    return agents, order[first]


def _apart(windows: Samples) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Features of each driver's first and last window, where these do not overlap."""
    _, first = _ends(windows, latest=False)
    _, last = _ends(windows, latest=True)
    apart = windows.time_s[last] - windows.time_s[first] >= PAIR_S - 1e-6
    return windows.features[first[apart]], windows.features[last[apart]]


def adapt(
    model: str | Path, recordings: Path, out: Path, labels: Path | None = None, quiet: bool = False
) -> list[Row]:
    """Adapt a model to the place of some recordings.

    Args:
        model: a shipped model's name or a folder.
        recordings: folder of a dataset.
        out: folder of the adapted model.
        labels: labels of some drivers, see `sim.formats.common.label_file`; None to use none.
        quiet: whether to show no progress.

    Returns:
        Rows on what was found; with labels, how well other labelled drivers are told before and
        after, and by a model that is trained on as many drivers from nothing.

    Raises:
        InputError: if too few drivers are seen or labelled, or ``out`` is not a model's folder.
    """
    trained = load_model(model)
    check_model_folder(out)
    given = None if labels is None else guarded_call(labels, read_driver_labels, labels)
    drivers = drivers_of(open_dataset(recordings), trained, given, quiet)
    rows: list[Row] = [tidy_row({}, "drivers", len(drivers.labels))]
    if given is None:
        if len(drivers.pairs[0]) < LEAST_PAIRS:
            raise InputError(
                f"{recordings}: found {len(drivers.pairs[0])} drivers that are seen for "
                f"{2 * PAIR_S:g} s or longer, expected at least {LEAST_PAIRS}, or labels of some"
            )
        first, second = (trained.posterior(part, "recorded") for part in drivers.pairs)
        adaptation = from_agreement(first, second)
        rows.append(tidy_row({}, "drivers_with_two_answers", len(first)))
    else:
        features, allowed = _labelled(drivers, labels)
        adaptation = from_labels(trained.posterior(features, "recorded"), allowed)
        rows.append(tidy_row({}, "labelled_drivers", len(features)))
        rows += _gains(trained, features, allowed)
    rows.append(tidy_row({}, "scale", adaptation.scale))
    rows += [
        tidy_row({"behavior": behavior.value}, "offset", float(offset))
        for behavior, offset in zip(BEHAVIORS, adaptation.offset, strict=True)
        if offset
    ]
    card = {**trained.card, "adapted": {"drivers": len(drivers.labels),
            "labelled": 0 if given is None else len(features)}}  # fmt: skip
    save_model(dataclasses.replace(trained, adaptation=adaptation, card=card), out)
    return rows


def _labelled(drivers: Drivers, path: Path | None) -> tuple[FloatArray, BoolArray]:
    """Features and allowed behaviours of the drivers that have a label."""
    chosen = [row for row, label in enumerate(drivers.labels) if label is not None]
    if not chosen:
        raise InputError(f"{path}: found no label of a driver seen for 1 s, expected at least one")
    allowed = [label.allowed for label in drivers.labels if label is not None]
    return drivers.features[chosen], np.array(allowed)


def _gains(model: Model, features: FloatArray, allowed: BoolArray) -> list[Row]:
    """Scores on labelled drivers that were left out of a random choice of so many."""
    known = model.posterior(features, "recorded")
    # Styles alone are compared: every label tells one, whether it names a behaviour or a style.
    style: BoolArray = np.asarray(allowed[:, AGGRESSIVE].any(axis=1))
    rows: list[Row] = []
    for count in LABELLED:
        if len(features) < count + LEAST_SCORED:
            continue
        scores: dict[str, list[tuple[float, float, float]]] = {}
        for split in range(SPLITS):
            order = np.random.default_rng(split).permutation(len(features))
            learned, scored = order[:count], order[count:]
            if len(set(style[learned])) < 2 or len(set(style[scored])) < 2:
                continue
            adapted = from_labels(known[learned], allowed[learned]).applied(known[scored])
            answers = {
                "as it was": aggressive_share(known[scored]),
                "adapted": aggressive_share(adapted),
                "trained from nothing": _from_nothing(features, style, learned, scored),
            }
            for name, probability in answers.items():
                scores.setdefault(name, []).append(_scored(probability, style[scored]))
        for name, found in scores.items():
            keys = {"labelled": count, "model": name}
            figures = zip(SCORED, np.mean(found, axis=0).tolist(), strict=True)
            rows += [tidy_row(keys, metric, value, n=len(found)) for metric, value in figures]
    return rows


def _scored(probability: FloatArray, style: BoolArray) -> tuple[float, float, float]:
    """The figures `SCORED`."""
    from sklearn.metrics import roc_auc_score

    right = (probability > 0.5) == style
    likelihood = np.clip(np.where(style, probability, 1.0 - probability), 1e-6, 1.0)
    return (
        0.5 * float(right[style].mean() + right[~style].mean()),
        float(roc_auc_score(style, probability)),
        float(-np.log(likelihood).mean()),
    )


def _from_nothing(
    features: FloatArray, style: BoolArray, learned: NDArray[np.int64], scored: NDArray[np.int64]
) -> FloatArray:
    """A logistic regression on the model's own features that sees the labelled drivers alone."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    regression = make_pipeline(StandardScaler(), LogisticRegression(C=0.01, max_iter=500))
    regression.fit(features[learned], style[learned])
    return np.asarray(regression.predict_proba(features[scored])[:, 1])
