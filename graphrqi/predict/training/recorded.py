"""Trains the network that corrects the base on recordings, with torch.

The first future is trained on its mean distance, the others winner-takes-all, the scores to name
the nearest of these, and the spreads on the likelihood of what happened under the nearest future.
Each example counts by what constant velocity errs in its dataset, and small datasets are drawn more
often, so that fast traffic and long recordings do not decide everything. Spreads are scaled on
recordings apart to their nominal coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.networks.perceptron import standardized
from graphrqi.predict.recorded.features import scale_of
from graphrqi.predict.recorded.network import (
    CLIP,
    HORIZON_S,
    MODES,
    PER_MODE,
    POWERS,
    RecordedNetwork,
    TrainedRange,
    decode,
    powers,
)
from graphrqi.predict.training.fit import layers_of, silu_module, spread_factor

if TYPE_CHECKING:
    import torch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Float32Array = NDArray[np.float32]

HIDDEN: Final = (128, 128)
"""Widths of the hidden layers (our choice)."""

BATCH: Final = 512
LEARNING_RATE: Final = 2e-3
WEIGHT_DECAY: Final = 1e-2
"""AdamW's settings (our choice on datasets left out)."""

PER_EPOCH: Final = 60_000
"""Examples drawn in an epoch at most."""

EVENNESS: Final = 0.8
"""Datasets are drawn from by their size to this power (our choice on datasets left out: at .15,
where small recordings weigh most, AV2 left out has .79 of constant velocity, at .5 .76, at .8
.75)."""

RELAXATION: Final = 0.05
"""Share of the loss that also pulls on futures that did not win."""

WINNER_WEIGHT, SCORE_WEIGHT, SPREAD_WEIGHT = 0.5, 0.1, 0.03
"""Weights of the losses against the best guess's error over constant velocity's (our choice)."""

CHECKED: Final = 2000
"""Examples at most from which the spreads' scale is found (our choice)."""

RANGE_QUANTILE: Final = 0.998
"""Quantile of the training examples at which the trained range ends (our choice: outliers are no
range)."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedExamples:
    """Agents of recordings, and where they went.

    Attributes:
        features: (m, F) float32.
        base: (m, KNOTS, 2) what the base says, in the agent's own frame, m.
        truth: (m, KNOTS, 2) where they went, likewise.
        measured: (m, 4) speed, m/s, noise of positions, m, and of velocities, m/s, and time
            between frames, s.
        steady: (m,) mean error of constant velocity, m.
        group: (m,) which dataset each is from.
    """

    features: Float32Array
    base: Float32Array
    truth: Float32Array
    measured: Float32Array
    steady: Float32Array
    group: IntArray

    @classmethod
    def join(cls, parts: Sequence[RecordedExamples]) -> RecordedExamples:
        """One after the other."""
        if not parts:
            raise InputError("examples: found none, expected moving agents seen for 8 s")
        names = cls.__slots__
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def rows(self, which: NDArray[Any]) -> RecordedExamples:
        """Some of them."""
        return RecordedExamples(*(getattr(self, name)[which] for name in self.__slots__))

    def __len__(self) -> int:
        """How many there are."""
        return len(self.features)


def train_recorded(
    training: RecordedExamples,
    validation: RecordedExamples,
    *,
    epochs: int = 16,
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
    mean = training.features.mean(axis=0, dtype=np.float64)
    scale = training.features.std(axis=0, dtype=np.float64)
    scale = np.where(scale > 1e-3, scale, 1.0)
    sizes = (mean.size, *HIDDEN, MODES * PER_MODE)
    module = silu_module(sizes)  # starts as the base
    _fit(module, training, mean, scale, epochs, seed, on_epoch)
    network = RecordedNetwork(mean, scale, *layers_of(module), 1.0, _range_of(training))
    return replace(network, spread_scale=right_spread(network, validation))


def guesses(network: RecordedNetwork, examples: RecordedExamples) -> FloatArray:
    """(m, KNOTS, 2) the likeliest futures in the agents' frames, m."""
    return _decoded(network, examples)[0][:, 0]


def _decoded(
    network: RecordedNetwork, examples: RecordedExamples
) -> tuple[FloatArray, FloatArray, FloatArray]:
    speed = examples.measured[:, 0].astype(np.float64)
    return decode(
        network(examples.features), examples.base.astype(np.float64), speed, np.ones_like(speed),
        network.spread_scale, TIME_S,
    )  # fmt: skip


def _fit(
    module: torch.nn.Module, training: RecordedExamples, mean: FloatArray, scale: FloatArray,
    epochs: int, seed: int, on_epoch: Callable[[int], None],
) -> None:  # fmt: skip
    """Fit a module that maps features to outputs."""
    import torch

    features = torch.from_numpy(standardized(training.features, mean, scale, CLIP))
    base, truth = torch.from_numpy(training.base), torch.from_numpy(training.truth)
    size = torch.from_numpy(scale_of(training.measured[:, 0]).astype(np.float32))
    counts = np.bincount(training.group)
    typical = np.bincount(training.group, training.steady) / np.maximum(counts, 1)
    weight = torch.from_numpy((1.0 / typical[training.group]).astype(np.float32))
    chance = counts[training.group].astype(np.float64) ** (EVENNESS - 1.0)
    chance /= chance.sum()
    batches = max(1, min(PER_EPOCH, len(training)) // BATCH)
    optimizer = torch.optim.AdamW(module.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, max_lr=LEARNING_RATE, total_steps=batches * epochs + 1, pct_start=0.1
    )
    rng = np.random.default_rng(seed)
    for epoch in range(epochs):
        drawn = rng.choice(len(training), size=(batches, BATCH), p=chance)
        for batch in torch.from_numpy(drawn):
            loss = recorded_loss(
                module(features[batch]), base[batch], truth[batch], size[batch], weight[batch]
            )
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(module.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        on_epoch(epoch)
    module.eval()


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
    import torch

    n = raw.shape[0]
    each = raw.view(n, MODES, PER_MODE)
    bend = each[..., : 2 * POWERS].reshape(n, MODES, POWERS, 2)
    ways = torch.from_numpy(powers(TIME_S).astype(np.float32))
    own = base[:, None] + size[:, None, None, None] * torch.einsum("nkpc,pt->nktc", bend, ways)
    apart = torch.sqrt(((own - truth[:, None]) ** 2).sum(-1) + 1e-3)
    mean = apart.mean(-1)
    others = mean[:, 1:]
    winner = (1 - RELAXATION) * others.min(dim=1).values + RELAXATION * others.mean(dim=1)
    score = torch.nn.functional.cross_entropy(each[:, 1:, -1], others.argmin(dim=1))
    row, nearest = torch.arange(n), mean.argmin(dim=1)
    log_time = torch.log(torch.from_numpy(TIME_S.astype(np.float32)) / HORIZON_S)
    slope = (1.2 + each[row, nearest, -2]).clamp(0.3, 3.0)[:, None]
    log_spread = each[row, nearest, -3].clamp(-4.0, 4.0)[:, None] + slope * log_time
    log_spread = log_spread + torch.log(size)[:, None]
    squared = apart.detach()[row, nearest] ** 2
    spread = (2 * log_spread + 0.5 * squared * torch.exp(-2 * log_spread)).mean()
    guess = (weight * (mean[:, 0] + WINNER_WEIGHT * winner)).mean()
    return guess + SCORE_WEIGHT * score + SPREAD_WEIGHT * spread


def _range_of(examples: RecordedExamples) -> TrainedRange:
    """The range of speed, noise and rate of the examples."""
    most = np.quantile(examples.measured.astype(np.float64), RANGE_QUANTILE, axis=0)
    return TrainedRange(*(float(np.round(value, 4)) for value in most))


def right_spread(network: RecordedNetwork, examples: RecordedExamples) -> float:
    """Factor for the spreads with which nominal 90 % sets cover 90 % at the last knot."""
    every = max(1, len(examples) // CHECKED)
    some = examples.rows(np.arange(0, len(examples), every))
    own, spread, probability = _decoded(network, some)
    ended = some.truth[:, -1].astype(np.float64)
    return spread_factor(own[:, :, -1], spread[:, :, -1], probability, ended)
