"""Trains the networks for recordings, with torch.

The first future is trained on its mean distance, the others winner-takes-all. The scores name the
nearest of these. The spreads maximise the likelihood of the truth under the nearest future. Futures
along lanes are trained at the same time (`graphrqi.predict.training.recorded_lanes`). Each example
is weighed by the error of constant velocity in its dataset. Small datasets are drawn more often.
Spreads are scaled on recordings apart to their nominal coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.networks.futures import TIME_S, Futures
from graphrqi.predict.networks.perceptron import standardized
from graphrqi.predict.recorded.along_lanes import join_lanes
from graphrqi.predict.recorded.features import scale_of
from graphrqi.predict.recorded.lanes_ahead import LanesAhead
from graphrqi.predict.recorded.network import (
    CLIP,
    EARNED,
    MODES,
    NOISY_M,
    PER_MODE,
    RecordedNetwork,
    TrainedRange,
    decode,
    kind_of,
)
from graphrqi.predict.training.fit import layers_of, silu_module, spread_factor
from graphrqi.predict.training.recorded_lanes import LaneTraining
from graphrqi.predict.training.recorded_loss import covering_loss, distances, futures_of

if TYPE_CHECKING:
    import torch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Float32Array = NDArray[np.float32]

HIDDEN: Final = (128, 128)
"""Widths of the hidden layers."""

BATCH: Final = 512
LEARNING_RATE: Final = 2e-3
WEIGHT_DECAY: Final = 1e-2
"""AdamW's settings (chosen on datasets left out)."""

EPOCHS: Final = 4
"""Draws of `PER_EPOCH` examples (chosen on datasets left out)."""

PER_EPOCH: Final = 60_000
"""Examples drawn in an epoch at most."""

EVENNESS: Final = 0.8
"""Datasets are drawn from by their size to this power (chosen on datasets left out)."""

MOST_EXAMPLES: Final = 12_000
"""Datasets with more examples than this are drawn from as if they had this many (chosen on datasets
left out)."""

DROPOUT: Final = 0.1
"""Share of each hidden layer's answers left out in training (chosen on datasets left out; what
is left out of the inputs, too, costs .04 on noisy pasts)."""

CHECKED: Final = 2000
"""Examples at most from which the spreads' scale is found."""

AT_ONCE: Final = 2_000
"""Examples that are answered at once: along the lanes of a map, the arrays of their futures take
some 250 kB each."""

RANGE_QUANTILE: Final = 0.998
"""Quantile of the training examples at which the trained range ends (outliers are no range)."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedExamples:
    """Agents of recordings, and where they went.

    Attributes:
        features: (m, F) float32.
        base: (m, KNOTS, 2) what the base says, in the agent's own frame, m.
        truth: (m, KNOTS, 2) where they went, likewise.
        measured: (m, 4) speed, m/s, noise of positions, m, and of velocities, m/s, and time
            between frames, s.
        stands: (m,) whether each stands.
        steady: (m,) mean error of constant velocity, m.
        group: (m,) which dataset each is from.
        ahead: the paths along lanes, in single precision; none where there is no map.
    """

    features: Float32Array
    base: Float32Array
    truth: Float32Array
    measured: Float32Array
    stands: NDArray[np.bool_]
    steady: Float32Array
    group: IntArray
    ahead: LanesAhead

    @classmethod
    def join(cls, parts: Sequence[RecordedExamples]) -> RecordedExamples:
        """One after the other."""
        if not parts:
            raise InputError("examples: found none, expected moving agents seen for 8 s")
        names = cls.__slots__[:-1]
        arrays = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
        return cls(**arrays, ahead=LanesAhead.join([one.ahead for one in parts]))

    def rows(self, which: NDArray[Any]) -> RecordedExamples:
        """Some of them."""
        arrays = {name: getattr(self, name)[which] for name in self.__slots__[:-1]}
        return RecordedExamples(**arrays, ahead=self.ahead.of(which))

    def __len__(self) -> int:
        """How many there are."""
        return len(self.features)


def train_recorded(
    training: RecordedExamples,
    validation: RecordedExamples,
    *,
    epochs: int = EPOCHS,
    seed: int = 0,
    on_epoch: Callable[[int], None] = lambda epoch: None,
) -> RecordedNetwork:
    """Train the network of `graphrqi.predict.recorded.network`.

    Args:
        training: examples of training recordings.
        validation: examples of other recordings, to scale the spreads.
        epochs: draws of `PER_EPOCH` examples.
        seed: of weights and order.
        on_epoch: called with each epoch that ended.

    Returns:
        The trained network.
    """
    import torch

    torch.manual_seed(seed)
    mean, scale = _moments(training.features)
    module = silu_module((mean.size, *HIDDEN, MODES * PER_MODE), DROPOUT)  # starts as the base
    lanes = None
    if training.ahead.exists.any():
        path_mean, path_scale = _moments(training.ahead.features[training.ahead.exists])
        lanes = LaneTraining(
            np.concatenate([mean, path_mean]), np.concatenate([scale, path_scale]), HIDDEN,
            DROPOUT,
        )  # fmt: skip
    _fit(module, lanes, training, (mean, scale), epochs, seed, on_epoch)
    network = RecordedNetwork(
        mean, scale, *layers_of(module), 1.0, _range_of(training),
        None if lanes is None else lanes.network(),
    )  # fmt: skip
    return replace(network, spread_scale=right_spread(network, validation))


SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of a correction that are tried."""

LEAST_CASES, MOST_LOST = 100, 1.02
"""A dataset is heard on a class of cases with so many; nowhere may a share cost more, over the
base's error."""


def errors_by_share(network: RecordedNetwork, examples: RecordedExamples) -> FloatArray:
    """(SHARES + 1, 2, EARNED[1:]) sums of errors of left-out examples by share, and their number.

    Args:
        network: one that was not trained on them.
        examples: of one dataset.
    """
    bins = kind_of(examples.measured[:, 0], examples.stands)
    noisy = (examples.measured[:, 1] > NOISY_M).astype(np.int64)
    found = np.zeros((len(SHARES) + 1, *EARNED))
    guessed = (guesses(replace(network, lanes=None), examples), guesses(network, examples))
    mapped = examples.ahead.exists.any(axis=1)
    for way, guess in enumerate(guessed):
        who = mapped if way else np.ones(len(examples), bool)
        at: Any = (way, bins[who], noisy[who])
        for row, share in enumerate(SHARES):
            told = examples.base + share * (guess - examples.base)
            np.add.at(found[row], at, np.linalg.norm(told - examples.truth, axis=-1)[who])
        np.add.at(found[-1], at, 1.0)
    return found


def earned_shares(errors: Sequence[FloatArray]) -> FloatArray:
    """`EARNED` shares that are best on datasets left out, and cost little on any of them.

    Args:
        errors: of each dataset, from `errors_by_share`.
    """
    sums, heard = np.stack([one[:-1] for one in errors]), np.stack([one[-1] for one in errors])
    over = np.log((sums + 1e-6) / (sums[:, :1] + 1e-6))
    over = np.where((heard >= LEAST_CASES)[:, None], over, 0.0)
    mean = np.where(over.max(axis=0) <= np.log(MOST_LOST), over.mean(axis=0), 0.0)
    return np.asarray(np.asarray(SHARES)[mean.argmin(axis=0)])


def _moments(values: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of each column; 1 for nearly constant ones."""
    scale = values.std(axis=0, dtype=np.float64)
    return values.mean(axis=0, dtype=np.float64), np.where(scale > 1e-3, scale, 1.0)


def guesses(network: RecordedNetwork, examples: RecordedExamples) -> FloatArray:
    """(m, KNOTS, 2) the likeliest futures in the agents' frames, m."""
    parts = np.split(np.arange(len(examples)), range(AT_ONCE, len(examples), AT_ONCE))
    return np.concatenate([_decoded(network, examples.rows(part)).own[:, 0] for part in parts])


def _decoded(network: RecordedNetwork, examples: RecordedExamples) -> Futures:
    """Their futures; spreads are not scaled yet."""
    speed = examples.measured[:, 0].astype(np.float64)
    sure = np.ones_like(speed)
    base = examples.base.astype(np.float64)
    futures = decode(network(examples.features), base, speed, sure, TIME_S)
    if network.lanes is None:
        return futures
    raw, ahead = network.lanes(examples.features, examples.ahead), examples.ahead
    return join_lanes(raw, ahead, futures, speed, sure, TIME_S)


def _fit(
    module: torch.nn.Module, lanes: LaneTraining | None, training: RecordedExamples,
    moments: tuple[FloatArray, FloatArray], epochs: int, seed: int,
    on_epoch: Callable[[int], None],
) -> None:  # fmt: skip
    """Fit a module that maps features to outputs, and the one that looks at paths."""
    import torch

    from graphrqi.networks.portable_torch import adamw

    features = torch.from_numpy(standardized(training.features, *moments, CLIP))
    base, truth = torch.from_numpy(training.base), torch.from_numpy(training.truth)
    size = torch.from_numpy(scale_of(training.measured[:, 0]).astype(np.float32))
    counts = np.bincount(training.group)
    typical = np.bincount(training.group, training.steady) / np.maximum(counts, 1)
    weight = torch.from_numpy((1.0 / typical[training.group]).astype(np.float32))
    share = np.minimum(counts, MOST_EXAMPLES) ** EVENNESS / np.maximum(counts, 1)
    chance = share[training.group]
    chance /= chance.sum()
    batches = max(1, min(PER_EPOCH, len(training)) // BATCH)
    fitted = [*module.parameters(), *(() if lanes is None else lanes.module.parameters())]
    paths = (
        None
        if lanes is None
        else lanes.examples(training.ahead, training.truth, training.measured[:, 0])
    )
    optimizer = adamw(fitted, LEARNING_RATE, WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, max_lr=LEARNING_RATE, total_steps=batches * epochs + 1, pct_start=0.1
    )
    rng = np.random.default_rng(seed)
    for epoch in range(epochs):
        drawn = rng.choice(len(training), size=(batches, BATCH), p=chance)
        for batch in torch.from_numpy(drawn):
            raw, happened = module(features[batch]), (truth[batch], size[batch], weight[batch])
            loss = recorded_loss(raw, base[batch], *happened)
            if lanes is not None and paths is not None:
                guess = futures_of(raw, base[batch], size[batch])[:, 0]
                loss = loss + lanes.loss(features[batch], paths.of(batch), guess, *happened)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(fitted, 1.0)
            optimizer.step()
            schedule.step()
        on_epoch(epoch)


def recorded_loss(
    raw: torch.Tensor, base: torch.Tensor, truth: torch.Tensor, size: torch.Tensor,
    weight: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """The loss of a batch.

    Args:
        raw: (m, MODES PER_MODE) outputs.
        base: (m, KNOTS, 2) m.
        truth: (m, KNOTS, 2) m.
        size: (m,) `scale_of` the speeds, m.
        weight: (m,) by which each counts, 1/m.
    """
    apart = distances(futures_of(raw, base, size), truth)
    each, mean = raw.view(len(raw), MODES, PER_MODE), apart.mean(-1)
    return covering_loss(each, apart, size, weight) + (weight * mean[:, 0]).mean()


def _range_of(examples: RecordedExamples) -> TrainedRange:
    """The range of speed, noise and rate of the examples."""
    most = np.quantile(examples.measured.astype(np.float64), RANGE_QUANTILE, axis=0)
    return TrainedRange(*(float(np.round(value, 4)) for value in most))


def right_spread(network: RecordedNetwork, examples: RecordedExamples) -> float:
    """Factor for the spreads with which nominal 90 % sets cover 90 % at the last knot."""
    every = max(1, len(examples) // CHECKED)
    some = examples.rows(np.arange(0, len(examples), every))
    futures, ended = _decoded(network, some), some.truth[:, -1].astype(np.float64)
    return spread_factor(
        futures.own[:, :, -1], futures.spread[:, :, -1], futures.probability, ended
    )
