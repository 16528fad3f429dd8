"""Trains the networks for recordings, with torch.

The first future is trained on its mean distance, the others winner-takes-all. The scores name the
nearest of these. The spreads maximise the likelihood of the truth under the nearest future.

Where there are paths along lanes, the path that a vehicle stayed nearest to is the true one, unless
it was farther than `OFF_PATH_M` from all of them: then it left them. The scores name the true path,
and its futures are trained as those without a map. The weighted mean of all best guesses is trained
on its distance to the truth.

Each example is weighed by the error of constant velocity in its dataset. Small datasets are drawn
more often. Spreads are scaled on recordings apart to their nominal coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray, IntArray
from graphrqi.networks.portable_torch import Descent, root
from graphrqi.predict.networks import MODES, TIME_S, Futures, Perceptron, standardized
from graphrqi.predict.recorded.features import scale_of
from graphrqi.predict.recorded.lanes_ahead import HORIZON_S, MOST, PATH_FEATURES, LanesAhead
from graphrqi.predict.recorded.network import (
    CLIP,
    EARNED,
    NOISY_M,
    PATH_OUTPUTS,
    PER_MODE,
    PER_PATH,
    POWERS,
    RecordedNetwork,
    TrainedRange,
    decode,
    kind_of,
    lane_answers,
    lane_inputs,
    powers,
)
from graphrqi.predict.recorded.predictor import beginnings, join_lanes
from graphrqi.predict.training.fit import layers_of, silu_module, spread_factor, standardization

RELAXATION: Final = 0.05
"""Share of the loss that also pulls on futures that did not win."""

WINNER_WEIGHT, SCORE_WEIGHT, SPREAD_WEIGHT = 0.5, 0.1, 0.03
"""Weights of the losses against the best guess's error over constant velocity's."""


OFF_PATH_M: Final = 1.75
"""A vehicle that is farther than this from every path, on average over the second half of the
horizon, follows none, m (half a lane's width)."""

PATH_WEIGHT, MEAN_WEIGHT = 0.5, 1.0
"""Weights of the scores of the paths and of the mean's error over constant velocity's (chosen on
datasets left out)."""

CHUNK: Final = 2_000
"""Examples whose true paths are found at once."""


class PathExamples(NamedTuple):
    """Paths of m examples as tensors.

    Attributes:
        inputs: (m, MOST + 1, PATH_FEATURES) standardised, without the agent's own.
        exists: (m, MOST) which there are.
        points: (m, MOST, POINTS, 2) m.
        spacing: (m,) m.
        kept: (m, MOST) distance to the left that is kept, m.
        fading: (m, MOST, KNOTS, 2) how vehicles come to their paths, m.
        true: (m,) the path that was followed, MOST for none.
    """

    inputs: torch.Tensor
    exists: torch.Tensor
    points: torch.Tensor
    spacing: torch.Tensor
    kept: torch.Tensor
    fading: torch.Tensor
    true: torch.Tensor

    def of(self, batch: torch.Tensor) -> PathExamples:
        """Some of them."""
        return PathExamples(*(column[batch] for column in self))


def bends(raw: torch.Tensor) -> torch.Tensor:
    """(..., KNOTS, 2) corrections over their size, from a network's numbers (..., PER_MODE)."""
    ways = torch.from_numpy(powers(TIME_S).astype(np.float32))
    bend = raw[..., : 2 * POWERS].reshape(*raw.shape[:-1], POWERS, 2)
    return torch.einsum("...pc,pt->...tc", bend, ways)


def futures_of(raw: torch.Tensor, base: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """(m, MODES, KNOTS, 2) futures, m, of outputs (m, MODES PER_MODE)."""
    each = raw.view(len(raw), MODES, PER_MODE)
    return base[:, None] + size[:, None, None, None] * bends(each)


def free_loss(
    raw: torch.Tensor, own: torch.Tensor, truth: torch.Tensor, size: torch.Tensor,
    weight: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """The loss of a batch of the network without a map.

    Outputs are (m, MODES PER_MODE), their futures (m, MODES, KNOTS, 2) and the truth (m, KNOTS, 2),
    m. ``size`` (m,) is `scale_of` the speeds, m; each counts by ``weight`` (m,), 1/m.
    """
    apart = distances(own, truth)
    covering = covering_loss(raw.view(len(raw), MODES, PER_MODE), apart, size, weight)
    return covering + (weight * apart[:, 0].mean(-1)).mean()


def distances(own: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """(m, K, KNOTS) from futures (m, K, KNOTS, 2) to what happened (m, KNOTS, 2), m."""
    return root(((own - truth[:, None]) ** 2).sum(-1) + 1e-3)


def covering_loss(
    each: torch.Tensor, apart: torch.Tensor, size: torch.Tensor, weight: torch.Tensor
) -> torch.Tensor:
    """The loss of all futures but the first, of the scores, and of the spreads.

    ``each`` are a network's numbers (m, K, PER_MODE), ``apart`` distances to what happened (m, K,
    KNOTS), m.
    """
    if not len(each):
        return each.sum()
    mean = apart.mean(-1)
    others = mean[:, 1:]
    winner = (1 - RELAXATION) * others.min(dim=1).values + RELAXATION * others.mean(dim=1)
    score = torch.nn.functional.cross_entropy(each[:, 1:, -1], others.argmin(dim=1))
    row, nearest = torch.arange(len(each)), mean.argmin(dim=1)
    log_time = torch.log(torch.from_numpy(TIME_S.astype(np.float32)) / HORIZON_S)
    slope = (1.2 + each[row, nearest, -2]).clamp(0.3, 3.0)[:, None]
    log_spread = each[row, nearest, -3].clamp(-4.0, 4.0)[:, None] + slope * log_time
    log_spread = log_spread + torch.log(size)[:, None]
    squared = apart.detach()[row, nearest] ** 2
    spread = (2 * log_spread + 0.5 * squared * torch.exp(-2 * log_spread)).mean()
    return WINNER_WEIGHT * (weight * winner).mean() + SCORE_WEIGHT * score + SPREAD_WEIGHT * spread


def path_examples(
    ahead: LanesAhead, truth: NDArray[np.floating], speed: NDArray[np.floating],
    mean: FloatArray, scale: FloatArray,
) -> PathExamples:  # fmt: skip
    """The paths of training examples, who went to ``truth`` (m, KNOTS, 2), m."""
    arrays = (
        lane_inputs(np.empty((len(truth), 0)), ahead, mean, scale), ahead.exists, ahead.points,
        ahead.spacing_m, *beginnings(ahead, speed, TIME_S.astype(np.float32)),
        true_paths(ahead, truth),
    )  # fmt: skip
    return PathExamples(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


def lane_loss(
    module: torch.nn.Module, features: torch.Tensor, paths: PathExamples, guess: torch.Tensor,
    truth: torch.Tensor, size: torch.Tensor, weight: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """The loss of a batch of the network that looks at paths.

    Features (m, F) are standardised; ``guess`` (m, KNOTS, 2) is the best one without a map, m. The
    others are those of `free_loss`.
    """
    some = torch.nonzero(paths.exists.any(dim=1))[:, 0]
    if not len(some):
        return guess.sum() * 0.0
    features, paths, guess = features[some], paths.of(some), guess[some]
    truth, size, weight = truth[some], size[some], weight[some]
    agent = features[:, None].expand(-1, MOST + 1, -1)
    raw = module(torch.cat([agent, paths.inputs], dim=2))
    each = raw[:, :-1, :-1].reshape(len(some), MOST, PER_PATH, PER_MODE)
    own = along_paths(each, paths, guess.detach(), size)
    there = torch.cat([paths.exists, torch.ones_like(paths.exists[:, :1])], dim=1)
    score = raw[..., -1].masked_fill(~there, -1e4)
    named = torch.nn.functional.cross_entropy(score, paths.true)
    chance = torch.softmax(score, dim=1)[..., None, None]
    mean = (chance[:, :-1] * own[:, :, 0]).sum(1) + chance[:, -1] * guess
    off_mean = (weight * distances(mean[:, None], truth).mean((1, 2))).sum()
    on = torch.nonzero(paths.true < MOST)[:, 0]
    true = paths.true[on]
    apart = distances(own[on, true], truth[on])
    first = (weight[on] * apart[:, 0].mean(-1)).sum()
    followed = covering_loss(each[on, true], apart, size[on], weight[on]) * len(on)
    total = MEAN_WEIGHT * off_mean + first + followed + PATH_WEIGHT * named * len(some)
    return total / len(some)


def along_paths(
    each: torch.Tensor, paths: PathExamples, guess: torch.Tensor, size: torch.Tensor
) -> torch.Tensor:
    """(m, MOST, PER_PATH, KNOTS, 2) futures along paths, m, as `beside_paths` gives them.

    ``guess`` (m, KNOTS, 2), the best one without a map, says how far the agent gets.
    """
    before = torch.cat([torch.zeros_like(guess[:, :1]), guess[:, :-1]], dim=1)
    gone = torch.cumsum((guess - before).norm(dim=-1), dim=1)
    moved = size[:, None, None, None, None] * bends(each)
    along = (gone[:, None, None] + moved[..., 0]).clamp(min=0.0)
    along = along / paths.spacing[:, None, None, None]
    piece = along.detach().long().clamp(max=paths.points.shape[2] - 2)
    m, most, futures, knots = piece.shape
    index = piece.reshape(m, most, futures * knots, 1).expand(-1, -1, -1, 2)
    begin, end = (
        torch.gather(paths.points, 2, at).reshape(m, most, futures, knots, 2)
        for at in (index, index + 1)
    )
    step = end - begin
    unit = step / step.norm(dim=-1, keepdim=True).clamp(min=1e-3)
    aside = paths.kept[:, :, None, None] + moved[..., 1]
    left = torch.stack([-unit[..., 1], unit[..., 0]], dim=-1)
    along_lane = begin + (along - piece)[..., None] * step + aside[..., None] * left
    return along_lane + paths.fading[:, :, None]


def true_paths(ahead: LanesAhead, truth: NDArray[np.floating]) -> IntArray:
    """(m,) the path that each vehicle stayed nearest to, MOST where it left them all."""
    late = truth[:, truth.shape[1] // 2 :].astype(np.float64)
    found = np.full(len(truth), MOST)
    for begin in range(0, len(truth), CHUNK):
        rows = slice(begin, begin + CHUNK)
        points = ahead.points[rows].astype(np.float64)
        start, step = points[:, :, :-1], np.diff(points, axis=2)
        size = np.maximum((step**2).sum(axis=-1), 1e-9)
        apart = late[rows][:, None, :, None] - start[:, :, None]
        along = np.clip((apart * step[:, :, None]).sum(axis=-1) / size[:, :, None], 0.0, 1.0)
        off = np.linalg.norm(apart - along[..., None] * step[:, :, None], axis=-1).min(axis=-1)
        mean = np.where(ahead.exists[rows], off.mean(axis=-1), np.inf)
        nearest = mean.argmin(axis=1)
        followed = mean[np.arange(len(mean)), nearest] < OFF_PATH_M
        found[rows] = np.where(followed, nearest, MOST)
    return found


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
"""Share of each hidden layer's answers left out in training (chosen on datasets left out)."""

CHECKED: Final = 2000
"""Examples at most from which the spreads' scale is found."""

AT_ONCE: Final = 2_000
"""Examples that are answered at once, to limit memory."""

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

    Examples of other recordings scale the spreads. An epoch is a draw of `PER_EPOCH` examples.
    """
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
    """(SHARES + 1, 2, EARNED[1:]) sums of errors of left-out examples by share, and counts."""
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
    """`EARNED` shares that are best on datasets left out, and cost little on any of them."""
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
