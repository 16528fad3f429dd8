"""Calibrates the driver parameters of the predictors and trains the learned predictors."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.scoring.prediction_errors import (
    HISTORY_S,
    HORIZONS_S,
    LEAST_SEEN_S,
    beliefs,
    future,
    instants,
)
from graphrqi.methods import load_model
from graphrqi.predict.learned.anchors import (
    KNOT_S,
    KNOTS,
    PredictorInputs,
    known,
    to_own_frame,
    unlabelled,
)
from graphrqi.predict.learned.networks import FuturesModel, save_network
from graphrqi.predict.map_free.predictor import map_free_inputs
from graphrqi.predict.rollout.driver_table import DriverTable, default_table, table_to_json
from graphrqi.predict.rollout.following import shuffled_posterior
from graphrqi.predict.scene.scene import LEARNED_S, make_scene
from graphrqi.predict.training.calibrate import Sample, by_behavior, calibrate, without_behavior
from graphrqi.predict.training.fit import Examples, train_lstm, train_perceptron
from sim.frames import PEDESTRIAN, BoolArray, CodeArray, FloatArray, IntArray, Tracks
from sim.store.atomic import write_whole
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry, Split

CALIBRATE_EVERY_S: Final = 6.0
"""Time between scenes used for calibration, s."""

EXAMPLES_EVERY_S: Final = 1.5
"""Time between the instants that networks are trained on, s."""

UNKNOWN_SHARE, SHUFFLED_SHARE = 0.1, 0.2
"""Shares of the instants of an epoch at which all posteriors are uniform, and at which drivers get
each other's posteriors; chosen on episodes that are used for nothing else."""

ALONE_SHARE: Final = 0.3
"""Share of the training instants at which the map-free network gets no neighbours."""


def samples_of(folder: Path, entry: EpisodeEntry, every_s: float) -> list[Sample]:
    """Scenes of one episode with their true futures, for calibration."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    if road is None or tracks.behavior is None:
        raise InputError(f"{folder}: episode {entry.id}: found no road or no labels, expected both")
    horizon_s = max(HORIZONS_S)
    found = []
    for stop in instants(tracks, horizon_s, every_s):
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        scene = make_scene(history, road, horizon_s)
        truth = future(tracks, np.searchsorted(tracks.ids, history.ids), stop, scene.time_s)
        counts = _counts(history, truth, tracks.step_s)
        if counts.any():
            behavior = cast("CodeArray", history.behavior).astype(np.int64)
            found.append(Sample(scene, truth, counts, behavior))
    return found


def _counts(history: Tracks, truth: FloatArray, step_s: float) -> BoolArray:
    """(n,) drivers with a whole future (n, T, 2) that were observed for long enough."""
    observed_s = history.valid.sum(axis=1) * step_s
    whole = np.isfinite(truth).all(axis=(1, 2))
    return np.asarray((history.kind != PEDESTRIAN) & whole & (observed_s > LEAST_SEEN_S - 1e-6))


def calibrate_drivers(
    source: Path,
    out: Path,
    *,
    every_s: float = CALIBRATE_EVERY_S,
    iterations: int = 80,
    seed: int = 0,
    quiet: bool = False,
) -> DriverTable:
    """Calibrate the driver parameters on a dataset's training episodes and save them.

    Args:
        source: a dataset.
        out: the file to write; it gets a card of data, split and scores.
        every_s: time between the scenes of an episode, s.
        iterations: perturbations tried.
        seed: of the search.
        quiet: whether to show no progress.

    Returns:
        The driver parameters.

    Raises:
        InputError: if there is no training episode, or one without road or labels.
    """
    dataset = open_dataset(source)
    splits: dict[str, list[Sample]] = {}
    for split in ("train", "validation"):
        entries = dataset.episodes(split)
        with Progress(f"reading {split} scenes", len(entries), quiet) as progress:
            for entry in entries:
                splits.setdefault(split, []).extend(samples_of(source, entry, every_s))
                progress.advance()
    if not splits.get("train"):
        raise InputError(f"{source}: found no training scene, expected at least 1")
    table = calibrate(splits["train"], iterations, seed)
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
        "data": dict(dataset.manifest.configuration),
        "split": "train",
        "iterations": iterations,
        "seed": seed,
        "scores": scores,
    }
    write_whole(out, table_to_json(table, card).encode())
    return table


@dataclass(frozen=True, slots=True, eq=False)
class BeliefVariants:
    """The same examples with the classifier's posteriors, with uniform and with exchanged ones.

    Every epoch draws among them, so that a network learns how reliable posteriors are.

    Attributes:
        believed: with the classifier's own posteriors.
        unknown: with uniform posteriors.
        shuffled: with posteriors of other drivers.
        instant: (m,) number of the instant of each example, from 0 on.
    """

    believed: Examples
    unknown: Examples
    shuffled: Examples
    instant: IntArray

    @classmethod
    def join(cls, parts: list[BeliefVariants]) -> BeliefVariants:
        """The examples of several episodes."""
        ends = np.cumsum([part.instant.max() + 1 for part in parts])
        return cls(
            Examples.join([part.believed for part in parts]),
            Examples.join([part.unknown for part in parts]),
            Examples.join([part.shuffled for part in parts]),
            np.concatenate(
                [part.instant + first for part, first in zip(parts, [0, *ends], strict=False)]
            ),
        )

    def draw(self, seed: int, epoch: int) -> Examples:
        """One of the three variants for each instant, with the shares above."""
        chance = np.random.default_rng((seed, epoch)).random(int(self.instant.max()) + 1)
        chance = chance[self.instant]
        unknown = chance < UNKNOWN_SHARE
        shuffled = ~unknown & (chance < UNKNOWN_SHARE + SHUFFLED_SHARE)
        inputs, bases = self.believed.inputs.copy(), self.believed.bases.copy()
        for rows, other in ((unknown, self.unknown), (shuffled, self.shuffled)):
            inputs[rows], bases[rows] = other.inputs[rows], other.bases[rows]
        return Examples(inputs, bases, self.believed.truth)


@dataclass(frozen=True, slots=True, eq=False)
class TrainingExamples:
    """Examples for each kind of learned predictor, of the same drivers and instants.

    Attributes:
        labelled: with posteriors.
        unlabelled: without posteriors.
        map_free: without posteriors and road.
    """

    labelled: BeliefVariants
    unlabelled: Examples
    map_free: Examples

    @classmethod
    def join(cls, parts: list[TrainingExamples]) -> TrainingExamples:
        """The examples of several episodes."""
        return cls(
            BeliefVariants.join([part.labelled for part in parts]),
            Examples.join([part.unlabelled for part in parts]),
            Examples.join([part.map_free for part in parts]),
        )


def examples_of(
    folder: Path, entry: EpisodeEntry, model: str, every_s: float, seed: int
) -> TrainingExamples:
    """Training examples of one episode, with the posteriors of a classifier."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    if road is None:
        raise InputError(f"{folder}: episode {entry.id}: found no road, expected one to train on")
    rng = np.random.default_rng((seed, entry.seed))
    table = default_table()
    stops = list(instants(tracks, LEARNED_S, every_s))
    variants: list[list[Examples]] = [[], [], []]
    without_labels, without_map = [], []
    for stop, posterior in beliefs(tracks, load_model(model), stops).items():
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        scene = make_scene(history, road, LEARNED_S)
        rows = np.searchsorted(tracks.ids, history.ids)
        sample = np.arange(1, KNOTS + 1, dtype=np.float64) * KNOT_S
        truth = future(tracks, rows, stop, sample)
        counts = _counts(history, truth, tracks.step_s)
        if not counts.any():
            continue
        probability = posterior.of(history.ids)
        unknown = np.full_like(probability, 1.0 / probability.shape[1])
        own = to_own_frame(scene, truth)
        others = shuffled_posterior(scene, posterior).probability
        for found, belief in zip(variants, (probability, unknown, others), strict=True):
            found.append(_examples(known(scene, belief, table), own, counts))
        without_labels.append(_examples(unlabelled(scene), own, counts))
        sees = bool(rng.random() >= ALONE_SHARE)
        without_map.append(_examples(map_free_inputs(history, sees), own, counts))
    instant = np.repeat(np.arange(len(variants[0])), [len(one.inputs) for one in variants[0]])
    believed, uniform, shuffled = (Examples.join(found) for found in variants)
    return TrainingExamples(
        BeliefVariants(believed, uniform, shuffled, instant),
        Examples.join(without_labels),
        Examples.join(without_map),
    )


def _examples(data: PredictorInputs, truth: FloatArray, counts: BoolArray) -> Examples:
    return Examples(
        data.inputs[counts].astype(np.float32),
        data.bases[counts].astype(np.float32),
        truth[counts].astype(np.float32),
    )


def train_predictors(
    source: Path,
    model: str,
    out: Path,
    *,
    every_s: float = EXAMPLES_EVERY_S,
    epochs: int = 24,
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = False,
) -> dict[str, float]:
    """Train the learned predictors on a dataset's training episodes and save them.

    The classifier should not have been trained on these episodes: it is too certain about drivers
    that it was trained on.

    Args:
        source: a dataset.
        model: the classifier whose posteriors are used: the name of a shipped model or a folder.
        out: the folder to write into.
        every_s: time between the instants of an episode, s.
        epochs: passes over the training examples.
        seed: of weights, order, and the draw of uniform or exchanged posteriors.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        ADE of each network on the validation episodes, m.

    Raises:
        InputError: if a split has no episode, or the model cannot be read.
    """
    dataset = open_dataset(source)
    load_model(model)
    train = _observed(source, "train", model, every_s, seed, jobs, quiet)
    validation = _observed(source, "validation", model, every_s, seed, jobs, quiet)
    draw = functools.partial(train.labelled.draw, seed)
    check = validation.labelled.draw(seed, 0)
    with Progress("predictors: training epochs", 4 * epochs, quiet) as progress:

        def on_epoch(epoch: int, ade_m: float) -> None:
            progress.advance()

        fit: dict[str, Any] = {"epochs": epochs, "seed": seed, "tell": on_epoch}
        network = train_perceptron(draw, check, **fit)
        lstm = train_lstm(train.unlabelled, validation.unlabelled, **fit)
        mlp = train_perceptron(train.unlabelled, validation.unlabelled, **fit)
        map_free = train_perceptron(train.map_free, validation.map_free, **fit)
    scores = {
        "graphrqi-predict": guess_ade_m(network, check),
        "lstm": guess_ade_m(lstm, validation.unlabelled),
        "mlp": guess_ade_m(mlp, validation.unlabelled),
        "mapless": guess_ade_m(map_free, validation.map_free),
    }
    card: dict[str, Any] = {
        "data": dict(dataset.manifest.configuration), "split": "train", "epochs": epochs,
        "examples": len(train.unlabelled.inputs), "seed": seed,
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    for name, save in (
        ("graphrqi-predict", functools.partial(save_network, network)),
        ("lstm", lstm.save),
        ("mlp", functools.partial(save_network, mlp)),
        ("mapless", functools.partial(save_network, map_free)),
    ):
        save(out / f"{name}.safetensors", card | {"validation_ade_m": round(scores[name], 4)})
    return scores


def _observed(
    source: Path,
    split: Split,
    model: str,
    every_s: float,
    seed: int,
    jobs: int | None,
    quiet: bool,
) -> TrainingExamples:
    """The examples of all episodes of a split."""
    entries = open_dataset(source).episodes(split)
    if not entries:
        raise InputError(f"{source}: found no {split} episode, expected at least 1")
    arguments = [(source, entry, model, every_s, seed) for entry in entries]
    found: list[TrainingExamples] = []
    with Progress(f"predictors: observing {split} episodes", len(entries), quiet) as progress:
        for one in in_parallel(examples_of, arguments, jobs):
            found.append(one)
            progress.advance()
    return TrainingExamples.join(found)


def guess_ade_m(network: FuturesModel, examples: Examples) -> float:
    """Mean distance of a network's most likely futures from the true ones, m."""
    data = PredictorInputs(examples.inputs.astype(np.float64), examples.bases.astype(np.float64))
    return float(np.linalg.norm(network(data).own[:, 0] - examples.truth, axis=-1).mean())
