"""Trains the networks for recordings, with torch.

The first future is trained on its mean distance, the others winner-takes-all. The scores name the
nearest of these. The spreads maximise the likelihood of the truth under the nearest future. Futures
along lanes are trained at the same time (`graphrqi.predict.training.recorded_loss`). Each example
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
from graphrqi.predict.networks.perceptron import Perceptron, standardized
from graphrqi.predict.recorded.along_lanes import join_lanes
from graphrqi.predict.recorded.features import scale_of
from graphrqi.predict.recorded.lanes_ahead import PATH_FEATURES, LanesAhead
from graphrqi.predict.recorded.network import (
    CLIP,
    EARNED,
    MODES,
    NOISY_M,
    PATH_OUTPUTS,
    PER_MODE,
    RecordedNetwork,
    TrainedRange,
    decode,
    kind_of,
    lane_answers,
)
from graphrqi.predict.training.fit import layers_of, silu_module, spread_factor, standardization
from graphrqi.predict.training.recorded_loss import (
    free_loss,
    futures_of,
    lane_loss,
    path_examples,
)

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
    mean, scale = standardization(training.features)
    free = silu_module((mean.size, *HIDDEN, MODES * PER_MODE), DROPOUT)  # starts as the base
    modules, moments = [free], [(mean, scale)]
    if training.ahead.exists.any():
        path_mean, path_scale = standardization(training.ahead.features[training.ahead.exists])
        moments.append((np.append(mean, path_mean), np.append(scale, path_scale)))
        modules.append(silu_module((moments[1][0].size, *HIDDEN, PATH_OUTPUTS), DROPOUT))
    _fit(modules, moments, training, epochs, seed, on_epoch)
    networks = [
        Perceptron(*moment, *layers_of(module), CLIP)
        for moment, module in zip(moments, modules, strict=True)
    ]
    network = RecordedNetwork(
        networks[0], 1.0, _range_of(training), networks[1] if len(networks) > 1 else None
    )
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
    raw = lane_answers(network.lanes, examples.features, examples.ahead)
    return join_lanes(raw, examples.ahead, futures, speed, sure, TIME_S)


def _fit(
    modules: list[torch.nn.Sequential], moments: list[tuple[FloatArray, FloatArray]],
    training: RecordedExamples, epochs: int, seed: int, on_epoch: Callable[[int], None],
) -> None:  # fmt: skip
    """Fit a module that maps features to outputs and, if there is one, that looks at paths."""
    import torch

    from graphrqi.networks.portable_torch import Descent

    features = torch.from_numpy(standardized(training.features, *moments[0], CLIP))
    base, truth = torch.from_numpy(training.base), torch.from_numpy(training.truth)
    speed = training.measured[:, 0]
    size = torch.from_numpy(scale_of(speed).astype(np.float32))
    counts = np.bincount(training.group)
    typical = np.bincount(training.group, training.steady) / np.maximum(counts, 1)
    weight = torch.from_numpy((1.0 / typical[training.group]).astype(np.float32))
    share = np.minimum(counts, MOST_EXAMPLES) ** EVENNESS / np.maximum(counts, 1)
    chance = share[training.group]
    chance /= chance.sum()
    batches = max(1, min(PER_EPOCH, len(training)) // BATCH)
    paths = None
    if len(modules) > 1:
        mean, scale = (one[-PATH_FEATURES:] for one in moments[1])
        paths = path_examples(training.ahead, training.truth, speed, mean, scale)
    descent = Descent(
        torch.nn.ModuleList(modules), batches * epochs + 1, LEARNING_RATE, WEIGHT_DECAY, 0.1, 1.0
    )
    rng = np.random.default_rng(seed)
    for epoch in range(epochs):
        drawn = rng.choice(len(training), size=(batches, BATCH), p=chance)
        for batch in torch.from_numpy(drawn):
            raw, happened = modules[0](features[batch]), (truth[batch], size[batch], weight[batch])
            own = futures_of(raw, base[batch], size[batch])
            loss = free_loss(raw, own, *happened)
            if paths is not None:
                loss = loss + lane_loss(
                    modules[1], features[batch], paths.of(batch), own[:, 0], *happened
                )
            descent.step(loss)
        on_epoch(epoch)


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
