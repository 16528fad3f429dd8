"""Makes what the predictors ship with: calibrated driver numbers and trained networks."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.score.labels import beliefs
from experiments.score.predictions import (
    HISTORY_S,
    HORIZONS_S,
    LEAST_SEEN_S,
    future,
    instants,
)
from graphrqi.model_files import load_model
from graphrqi.predict.learned.inputs import predictor_inputs, unlabelled_inputs
from graphrqi.predict.networks import KNOT_S, KNOTS, Futures, PredictorInputs
from graphrqi.predict.rollout.driver_table import DriverTable, load_table, save_table
from graphrqi.predict.rollout.following import shuffled_posterior
from graphrqi.predict.scene.scene import LEARNED_S, Scene, make_scene
from graphrqi.predict.training.calibrate import Sample, by_behavior, calibrate, without_behavior
from graphrqi.predict.training.fit import Examples, train_lstm, train_perceptron
from sim.frames import PEDESTRIAN, BoolArray, CodeArray, FloatArray, IntArray, Tracks
from sim.geometry import to_own_frame
from sim.road import Road
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry, Split

CALIBRATE_EVERY_S, EXAMPLES_EVERY_S = 6.0, 1.5
"""Time between scenes used for calibration, and between instants of training networks, s."""

EPOCHS, SEED = 24, 0
"""Passes over the training examples; seed of searches, weights, order and drawn beliefs."""

UNKNOWN_SHARE, SHUFFLED_SHARE = 0.1, 0.2
"""Shares of instants in an epoch with all beliefs removed, and with beliefs permuted between
drivers."""


def _cases(
    tracks: Tracks, road: Road, stops: Iterable[int], ahead_s: float, time_s: FloatArray | None
) -> Iterator[tuple[int, Scene, FloatArray, BoolArray]]:
    """Instants with vehicles to learn from: index, scene, (n, H, 2) future, m, and (n,) who counts.

    Vehicles count that are seen for `LEAST_SEEN_S` and have a known future.
    """
    for stop in stops:
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        scene = make_scene(history, road, ahead_s)
        at_s = scene.time_s if time_s is None else time_s
        truth = future(tracks, np.searchsorted(tracks.ids, history.ids), stop, at_s)
        known = np.isfinite(truth).all(axis=(1, 2)) & (history.kind != PEDESTRIAN)
        counts = known & (history.valid.sum(axis=1) * history.step_s > LEAST_SEEN_S - 1e-6)
        if counts.any():
            yield stop, scene, truth, counts


def samples_of(folder: Path, entry: EpisodeEntry, every_s: float) -> list[Sample]:
    """Scenes of one episode with what happened next, for calibration and training."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    if road is None or tracks.behavior is None:
        raise InputError(f"{folder}: episode {entry.id}: found no road or no labels, expected both")
    ahead_s = max(HORIZONS_S)
    found = _cases(tracks, road, instants(tracks, ahead_s, every_s), ahead_s, None)
    return [
        Sample(scene, truth, counts, cast("CodeArray", scene.history.behavior).astype(np.int64))
        for _, scene, truth, counts in found
    ]


def calibrate_drivers(
    source: Path, out: Path, *, iterations: int = 80, quiet: bool = False
) -> DriverTable:
    """Calibrate the car-following numbers on a dataset's training episodes, and save them."""
    dataset = open_dataset(source)
    splits: dict[str, list[Sample]] = {}
    for split in ("train", "validation"):
        arguments = [(source, entry, CALIBRATE_EVERY_S) for entry in dataset.episodes(split)]
        found = in_parallel(samples_of, arguments, 1, f"reading {split} scenes", quiet)
        splits[split] = list(itertools.chain.from_iterable(found))
    if not splits["train"]:
        raise InputError(f"{source}: found no training scene, expected at least 1")
    table = calibrate(splits["train"], iterations, SEED)
    scores = {
        split: {
            "behavior_known_ade_m": dict(
                zip(map(str, BEHAVIORS), by_behavior(samples, table).round(3).tolist(), strict=True)
            ),
            "behavior_unknown_ade_m": round(without_behavior(samples, table), 3),
            "scenes": len(samples),
        }
        for split, samples in splits.items()
        if samples
    }
    card = {
        "data": dict(dataset.header.configuration), "split": "train", "iterations": iterations,
        "seed": SEED, "scores": scores,
    }  # fmt: skip
    save_table(out, table, card)
    return table


@dataclass(frozen=True, slots=True, eq=False)
class BeliefExamples:
    """The same examples with the classifier's posteriors, with none, and with other drivers'.

    They are drawn for every epoch, so that a network learns how far to trust beliefs. ``instant``
    (m,) numbers their instants.
    """

    instant: IntArray
    believed: Examples
    unknown: Examples
    shuffled: Examples

    @classmethod
    def join(cls, parts: list[BeliefExamples]) -> BeliefExamples:
        """One after the other."""
        names = ("believed", "unknown", "shuffled")
        joined = [Examples.join([getattr(part, name) for part in parts]) for name in names]
        first = np.cumsum([0, *(part.instant.max() + 1 for part in parts[:-1])])
        instant = [part.instant + begin for part, begin in zip(parts, first, strict=True)]
        return cls(np.concatenate(instant), *joined)

    def draw(self, epoch: int) -> Examples:
        """One of the three for each instant, by the shares above."""
        chance = np.random.default_rng((SEED, epoch)).random(int(self.instant.max()) + 1)
        chance = chance[self.instant]
        unknown = chance < UNKNOWN_SHARE
        shuffled = ~unknown & (chance < UNKNOWN_SHARE + SHUFFLED_SHARE)
        inputs, bases = self.believed.features.copy(), self.believed.anchors.copy()
        for rows, other in ((unknown, self.unknown), (shuffled, self.shuffled)):
            inputs[rows], bases[rows] = other.features[rows], other.anchors[rows]
        return Examples(inputs, bases, self.believed.truth)


def examples_of(
    folder: Path, entry: EpisodeEntry, model: str, every_s: float
) -> tuple[BeliefExamples, Examples]:
    """Training examples from one episode: with the classifier's beliefs, and without labels."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    if road is None:
        raise InputError(f"{folder}: episode {entry.id}: found no road, expected one to train on")
    table = load_table()
    believed = beliefs(tracks, load_model(model), list(instants(tracks, LEARNED_S, every_s)))
    by_belief: list[list[Examples]] = [[], [], []]
    label_free, sample = [], np.arange(1, KNOTS + 1, dtype=np.float64) * KNOT_S
    for stop, scene, truth, counts in _cases(tracks, road, believed, LEARNED_S, sample):
        probability = believed[stop].of(scene.history.ids)
        unknown = np.full_like(probability, 1.0 / probability.shape[1])
        own = to_own_frame(truth, scene.xy, scene.heading)
        others = shuffled_posterior(scene.history, believed[stop]).probability
        for found, belief in zip(by_belief, (probability, unknown, others), strict=True):
            found.append(_examples(predictor_inputs(scene, belief, table), own, counts))
        label_free.append(_examples(unlabelled_inputs(scene), own, counts))
    instant = np.repeat(np.arange(len(label_free)), [len(one.features) for one in label_free])
    return BeliefExamples(instant, *map(Examples.join, by_belief)), Examples.join(label_free)


def _examples(data: PredictorInputs, truth: FloatArray, counts: BoolArray) -> Examples:
    return Examples(
        data.features[counts].astype(np.float32),
        data.anchors[counts].astype(np.float32),
        truth[counts].astype(np.float32),
    )


def train_predictors(source: Path, model: str, out: Path) -> dict[str, float]:
    """Train the learned predictors on a dataset's training episodes, and save them in a folder.

    The classifier ``model`` should not have been trained on these episodes, where its posteriors
    are too certain. Returned is each network's ADE on the validation episodes, m.
    """
    dataset = open_dataset(source)
    parts: dict[Split, tuple[BeliefExamples, Examples]] = {}
    splits: tuple[Split, ...] = ("train", "validation")
    for split in splits:
        entries = dataset.episodes(split)
        if not entries:
            raise InputError(f"{source}: found no {split} episode, expected at least 1")
        arguments = [(source, entry, model, EXAMPLES_EVERY_S) for entry in entries]
        what = f"predictors: observing {split} episodes"
        found = list(in_parallel(examples_of, arguments, None, what, quiet=False))
        informed, label_free = (list(same) for same in zip(*found, strict=True))
        parts[split] = BeliefExamples.join(informed), Examples.join(label_free)
    card: dict[str, Any] = {
        "data": dict(dataset.header.configuration), "split": "train", "epochs": EPOCHS,
        "examples": len(parts["train"][1].features), "seed": SEED,
    }  # fmt: skip
    (trained, train_free), (checked, check_free) = parts["train"], parts["validation"]
    check = checked.draw(0)
    with Progress("predictors: training epochs", 2 * EPOCHS) as progress:

        def advance(epoch: int, ade_m: float) -> None:
            progress.advance()

        network = train_perceptron(trained.draw, check, epochs=EPOCHS, seed=SEED, on_epoch=advance)
        rival = train_lstm(train_free, check_free, epochs=EPOCHS, seed=SEED, on_epoch=advance)
    scores = {
        "graphrqi-predict": _guess_ade_m(network, check), "lstm": _guess_ade_m(rival, check_free)
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    for name, save in (("graphrqi-predict", network.save), ("lstm", rival.save)):
        save(out / f"{name}.safetensors", card | {"validation_ade_m": round(scores[name], 4)})
    return scores


def _guess_ade_m(network: Callable[[PredictorInputs], Futures], examples: Examples) -> float:
    """Mean distance of a network's likeliest futures, m."""
    data = PredictorInputs(
        examples.features.astype(np.float64), examples.anchors.astype(np.float64)
    )
    return float(np.linalg.norm(network(data).own[:, 0] - examples.truth, axis=-1).mean())
