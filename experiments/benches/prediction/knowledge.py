"""Whether knowledge of drivers improves predictions of recordings: beliefs, or their own numbers.

The error of the predictor for recordings along each vehicle's heading is explained by what was
known of the driver: by what the classifier believed of it, or by what it had done itself, both
from its past alone. A linear correction is fitted on all other datasets and
applied to the one left out. It is compared with a correction without any knowledge (which removes
only the predictor's mean error), and with a placebo, in which each driver has the knowledge of
another driver of the same dataset, in the fit and in the test.

Knowledge helps where its error over the predictor's and over the placebo's lie below one, beyond
the intervals, and below that of nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.benches.prediction.recordings import scored_every_s
from experiments.benches.second_half import MEASURES, SPAN_S, Doings
from experiments.score.metrics import bootstrap, ratio, summed
from experiments.score.rows import Row, tidy_row
from experiments.training.recordings import (
    RecordedPlace,
    happened,
    history_of,
    moving,
    read_sources,
    recorded_instants,
)
from graphrqi.methods import Model
from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.recorded.predictor import predict_recorded
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream, load_stream
from sim.frames import FloatArray, IntArray

NOTHING, BELIEFS, NUMBERS = "nothing", "beliefs", "numbers"
WIDTH: Final = {BELIEFS: len(BEHAVIORS), NUMBERS: len(MEASURES)}
"""How many columns each kind of knowledge has."""

PENALTIES: Final = (0.01, 0.1, 1.0, 10.0)
"""Ridge penalties to choose among, for columns of unit spread and datasets of unit weight."""

MOST_M: Final = 20.0
"""Larger residuals count as this one: a few vehicles that stop or turn would rule the fit."""

SPEED_MPS: Final = 10.0
"""Corrections may grow with speed; this is the unit of speed."""

PLACEBOS: Final = 5
"""Permutations over which the placebo's errors are averaged."""

_AT: Final[IntArray] = np.round(TIME_S / STEP_S).astype(np.int64) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What the predictor leaves of one dataset's vehicles, and what was known of them.

    Attributes:
        along: (m, KNOTS) by how much each came farther than predicted along its heading, m.
        across: (m, KNOTS) the same across it, m.
        speed: (m,) m/s at the present.
        vehicle: (m,) number of the vehicle.
        known: (m, WIDTH) of each kind of knowledge; NaN where something is not known.
    """

    along: FloatArray
    across: FloatArray
    speed: FloatArray
    vehicle: IntArray
    known: Mapping[str, FloatArray]


def measure_knowledge(data: Path, seed: int) -> Iterator[list[Row]]:
    """Score what is known of drivers as a correction of predictions, each dataset left out in turn.

    Args:
        data: a folder of at least two datasets of recordings.
        seed: of the placebo's permutations.

    Yields:
        The rows of each dataset.

    Raises:
        InputError: if fewer than two datasets have vehicles to score.
    """
    parts: dict[str, list[RecordedPlace]] = {}
    for one in read_sources([data]):
        parts.setdefault(one.dataset, []).append(one)
    model = load_stream(DEFAULT_MODEL).model
    left = {name: found for name in sorted(parts) if (found := residuals_of(parts[name], model))}
    if len(left) < 2:
        raise InputError(f"{data}: found {len(left)} datasets with vehicles to score, expected two")
    for name, held in left.items():
        others = [found for other, found in left.items() if other != name]
        keys: dict[str, str | float] = {
            "dataset": name, "family": parts[name][0].family, "horizon_s": float(TIME_S[-1]),
        }  # fmt: skip
        yield list(_rows(keys, others, held, seed))


def residuals_of(places: Sequence[RecordedPlace], model: Model) -> Left | None:
    """Predict a dataset's vehicles, and gather what was known of them; None if nobody moves."""
    every_s = scored_every_s(places)
    found: list[tuple[FloatArray, ...]] = []
    vehicle: list[IntArray] = []
    first = 0
    for one in places:
        stops = recorded_instants(one.tracks, every_s)
        if not stops:
            continue
        doings, stream, frames = Doings.of(one.tracks), BehaviorStream(model), one.tracks.frames()
        late = max(1, round(SPAN_S / one.tracks.step_s))
        for before, stop in pairwise([0, *stops]):
            for frame in islice(frames, stop - before):
                stream.push(frame)
            history = history_of(one.tracks, stop)
            truth = happened(one.tracks, history, stop)
            rows = np.flatnonzero(moving(history) & np.isfinite(truth).all(axis=(1, 2)))
            if not rows.size:
                continue
            predicted = predict_recorded(history, int(_AT[-1]) + 1, road=one.road)
            away = truth[rows] - predicted.best[rows][:, _AT]
            ahead = np.stack([np.cos(history.heading[rows, -1]), np.sin(history.heading[rows, -1])])
            posterior = stream.posterior()
            beliefs = posterior.of(history.ids[rows])
            beliefs[~np.isin(history.ids[rows], posterior.ids)] = np.nan
            who = np.searchsorted(one.tracks.ids, history.ids[rows])
            begun = one.tracks.valid[who].argmax(axis=1)
            numbers = [
                doings.measures(row, start, stop - late)
                for row, start in zip(who.tolist(), begun.tolist(), strict=True)
            ]
            found.append((
                np.einsum("mkd,dm->mk", away, ahead),
                away[..., 1] * ahead[0][:, None] - away[..., 0] * ahead[1][:, None],
                history.speed[rows, -1], beliefs, np.array(numbers),
            ))  # fmt: skip
            vehicle.append(first + who)
        first += one.tracks.ids.size
    if not found:
        return None
    joined = [np.concatenate(part) for part in zip(*found, strict=True)]
    known = {BELIEFS: joined[3], NUMBERS: joined[4]}
    return Left(joined[0], joined[1], joined[2], np.concatenate(vehicle), known)


def _rows(
    keys: Mapping[str, str | float], others: Sequence[Left], held: Left, seed: int
) -> Iterator[Row]:
    """Ratios of each correction's error to that of the predictor alone."""
    alone = np.hypot(held.along, held.across).mean(axis=1)
    for kind in (NOTHING, BELIEFS, NUMBERS):
        columns = {**keys, "predictor": "graphrqi-predict", "knowledge": kind}
        own = _errors(others, held, kind)
        compared = {"ratio_to_uncorrected": (own, alone)}
        if kind != NOTHING:
            rngs = [np.random.default_rng((seed, number)) for number in range(PLACEBOS)]
            placebo = np.mean([_errors(others, held, kind, rng) for rng in rngs], axis=0)
            compared["placebo_ratio_to_uncorrected"] = (placebo, alone)
            compared["ratio_to_placebo"] = (own, placebo)
        for metric, (above, below) in compared.items():
            found = bootstrap(ratio, summed(held.vehicle, above, below))
            yield tidy_row(columns, metric, *found, alone.size)


def _errors(
    others: Sequence[Left], held: Left, kind: str, rng: np.random.Generator | None = None
) -> FloatArray:
    """(m,) mean distance of the corrected predictions, m."""
    missed = held.along - fitted(others, held, kind, rng)
    return np.asarray(np.hypot(missed, held.across).mean(axis=1))


def fitted(
    others: Sequence[Left], held: Left, kind: str, rng: np.random.Generator | None = None
) -> FloatArray:
    """(m, KNOTS) by how much each vehicle of the dataset left out is moved along its heading, m.

    The penalty is chosen by leaving each of the other datasets out in turn.

    Args:
        others: datasets to fit on.
        held: the one left out.
        kind: of knowledge: ``nothing``, ``beliefs`` or ``numbers``.
        rng: gives each driver the knowledge of another one; None leaves it its own.
    """
    known = [_known(one, kind, rng) for one in others]
    targets = [np.clip(one.along, -MOST_M, MOST_M) for one in others]
    speeds = [one.speed for one in others]
    errors = np.zeros(len(PENALTIES))
    for out in range(len(others) if len(others) > 1 else 0):
        rest = [number for number in range(len(others)) if number != out]
        for number, penalty in enumerate(PENALTIES):
            weights = _ridge(
                [known[r] for r in rest], [speeds[r] for r in rest], [targets[r] for r in rest],
                penalty,
            )  # fmt: skip
            missed = targets[out] - weights.at(known[out], speeds[out])
            errors[number] += np.abs(missed).mean()
    penalty = PENALTIES[int(errors.argmin())] if errors.any() else PENALTIES[-1]
    return _ridge(known, speeds, targets, penalty).at(_known(held, kind, rng), held.speed)


def _known(one: Left, kind: str, rng: np.random.Generator | None) -> FloatArray:
    """(m, WIDTH) what is known of the vehicles; (m, 0) for nothing."""
    if kind == NOTHING:
        return np.empty((one.speed.size, 0))
    if rng is None:
        return one.known[kind]
    # All rows of a driver go to one other driver, so that the placebo is as steady as the truth.
    names, number = np.unique(one.vehicle, return_inverse=True)
    first = np.searchsorted(np.sort(number), np.arange(names.size))
    order = np.argsort(number, kind="stable")
    return one.known[kind][order[first[rng.permutation(names.size)[number]]]]


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """A fitted correction."""

    mean: FloatArray
    spread: FloatArray
    weights: FloatArray

    def at(self, known: FloatArray, speed: FloatArray) -> FloatArray:
        """(m, KNOTS) the correction, m."""
        return self.columns(known, speed) @ self.weights

    def columns(self, known: FloatArray, speed: FloatArray) -> FloatArray:
        """The regression's columns: 1 and the knowledge, and both times the speed."""
        scaled = np.nan_to_num((known - self.mean) / self.spread)
        plain = np.concatenate([np.ones((speed.size, 1)), scaled], axis=1)
        return np.concatenate([plain, plain * (speed / SPEED_MPS)[:, None]], axis=1)


def _ridge(
    known: Sequence[FloatArray], speeds: Sequence[FloatArray], targets: Sequence[FloatArray],
    penalty: float,
) -> _Weights:  # fmt: skip
    """Ridge regression in which each dataset weighs the same, and unknown values are the mean."""
    together = np.concatenate(known)
    seen = np.isfinite(together)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, together, 0.0).sum(axis=0) / count
    spread = np.asarray(np.sqrt(np.where(seen, (together - mean) ** 2, 0.0).sum(axis=0) / count))
    scale = _Weights(mean, spread + 1e-9, np.empty(0))
    width = 2 * (1 + together.shape[1])
    gram, moment = penalty * np.eye(width), np.zeros((width, targets[0].shape[1]))
    for each, speed, target in zip(known, speeds, targets, strict=True):
        columns = scale.columns(each, speed)
        gram += columns.T @ columns / speed.size
        moment += columns.T @ target / speed.size
    return _Weights(scale.mean, scale.spread, np.asarray(np.linalg.solve(gram, moment)))
