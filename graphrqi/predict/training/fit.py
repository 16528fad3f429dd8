"""Trains the learned predictors with torch.

The single best guess is trained on its mean distance, which makes it a median of the possible
trajectories. The other futures are trained winner-takes-all, and the scores name the nearest
future. The spreads maximise the likelihood of the true trajectory under the nearest one. The epoch
that does best on validation episodes is kept; there the spreads are also scaled to their nominal
coverage.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray
from graphrqi.networks.portable_torch import Descent, root
from graphrqi.predict.learned.lstm import Recurrent, TrajectoryLstm
from graphrqi.predict.metrics import covered
from graphrqi.predict.networks import (
    ANCHORS,
    KNOT_S,
    KNOTS,
    MODES,
    PER_MODE,
    FuturesNetwork,
    Layers,
    Perceptron,
    PredictorInputs,
    decode,
    standardized,
)

Module = TypeVar("Module", bound=torch.nn.Module)

HIDDEN: Final = (256, 256, 256)
"""Widths of the hidden layers (as in the first study)."""

BATCH: Final = 1024
LEARNING_RATE: Final = 2e-3
WEIGHT_DECAY: Final = 1e-3
"""AdamW's settings (chosen on validation episodes)."""

RELAXATION: Final = 0.05
"""Share of the loss that also pulls on futures that did not win (Rupprecht et al.)."""

CHECKED: Final = 1000
"""Validation examples at most from which the spreads' scale is found."""

SCORE_WEIGHT, SPREAD_WEIGHT = 0.2, 0.1
"""Weights of the scores' and the spreads' losses against displacement in metres."""


class Examples(NamedTuple):
    """Inputs of drivers, and where they went.

    Attributes:
        features: (m, F) float32.
        anchors: (m, ANCHORS, KNOTS, 2) float32, m.
        truth: (m, KNOTS, 2) float32, where they went, in their own frame, m.
    """

    features: NDArray[np.float32]
    anchors: NDArray[np.float32]
    truth: NDArray[np.float32]

    @classmethod
    def join(cls, parts: list[Examples]) -> Examples:
        """One after the other."""
        if not parts:
            raise InputError("examples: found none, expected at least one episode")
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def displacement_loss(
    raw: torch.Tensor, anchors: torch.Tensor, truth: torch.Tensor
) -> torch.Tensor:
    """The loss of a batch: (m, K PER_MODE) outputs, (m, ANCHORS, KNOTS, 2), (m, KNOTS, 2)."""
    n, b = raw.shape[0], ANCHORS
    each = raw.view(n, MODES, PER_MODE)
    time_s = torch.arange(1, KNOTS + 1) * KNOT_S
    weight = torch.softmax(each[..., :b], dim=-1)
    residual = each[..., b : b + 2 * KNOTS].reshape(n, MODES, KNOTS, 2) * time_s[:, None]
    own = torch.einsum("nkb,nbtc->nktc", weight, anchors) + residual
    gap = root(((own - truth[:, None]) ** 2).sum(-1) + 1e-4)
    mean_gap = gap.mean(-1)
    guess = mean_gap[:, 0].mean()
    others = mean_gap[:, 1:]
    winner = (1 - RELAXATION) * others.min(dim=1).values.mean() + RELAXATION * others.mean()
    nearest = mean_gap.argmin(dim=1)
    score = torch.nn.functional.cross_entropy(each[..., -1], nearest)
    log_scale = each[..., b + 2 * KNOTS : b + 3 * KNOTS].clamp(-6.0, 4.0) + torch.log(time_s)
    row = torch.arange(n)
    log_scale = log_scale[row, nearest]
    squared = gap.detach()[row, nearest] ** 2
    spread = (2 * log_scale + 0.5 * squared * torch.exp(-2 * log_scale)).mean()
    return guess + 0.5 * winner + SCORE_WEIGHT * score + SPREAD_WEIGHT * spread


def validation_ade(module: torch.nn.Module, examples: Examples) -> float:
    """Mean distance of the best guess, m."""
    module.eval()
    with torch.no_grad():
        raw = module(torch.from_numpy(examples.features)).numpy().astype(np.float64)
    own = decode(raw, examples.anchors.astype(np.float64), 1.0).own[:, 0]
    return float(np.linalg.norm(own - examples.truth, axis=-1).mean())


def standardization(features: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
    """(F,) means and (F,) standard deviations; constant features are left as they are."""
    mean = features.mean(axis=0, dtype=np.float64)
    scale = features.std(axis=0, dtype=np.float64)
    return mean, np.where(scale > 1e-4, scale, 1.0)


def train_perceptron(
    training: Examples | Callable[[int], Examples],
    validation: Examples,
    *,
    epochs: int = 30,
    seed: int = 0,
    on_epoch: Callable[[int, float], None] = lambda epoch, ade: None,
) -> FuturesNetwork:
    """Train the network of `graphrqi.predict.networks`.

    Examples may be drawn anew for each epoch. Those of validation episodes choose the epoch and
    scale the spreads. ``on_epoch`` is called with each epoch and its validation ADE, m.
    """

    def made(features: int) -> torch.nn.Sequential:
        module = silu_module((features, *HIDDEN, MODES * PER_MODE))
        with torch.no_grad():  # start as the likeliest rollout
            *_, last_bias = module.parameters()
            last_bias.view(MODES, PER_MODE)[:, 0] = 2.0
        return module

    module, mean, scale = _trained(made, training, validation, epochs, seed, on_epoch)
    return _scaled(Perceptron(mean, scale, *layers_of(module)), validation)


def train_lstm(
    training: Examples,
    validation: Examples,
    *,
    epochs: int = 30,
    seed: int = 0,
    on_epoch: Callable[[int, float], None] = lambda epoch, ade: None,
) -> FuturesNetwork:
    """Train the network of `graphrqi.predict.learned.lstm`; see `train_perceptron`."""
    found = _trained(Recurrent, training, validation, epochs, seed, on_epoch)
    return _scaled(TrajectoryLstm(*found), validation)


def _trained(
    make: Callable[[int], Module],
    training: Examples | Callable[[int], Examples],
    validation: Examples,
    epochs: int,
    seed: int,
    on_epoch: Callable[[int, float], None],
) -> tuple[Module, FloatArray, FloatArray]:
    """A module in its best epoch on validation, and the standardisation of its features."""
    torch.manual_seed(seed)
    draw = training if callable(training) else lambda epoch: training
    drawn = draw(0)
    mean, scale = standardization(drawn.features)
    module = make(mean.size)
    checked = validation._replace(features=standardized(validation.features, mean, scale))
    steps = max(1, len(drawn.features) // BATCH) * epochs
    descent = Descent(module, steps + 1, LEARNING_RATE, WEIGHT_DECAY, 0.1, 5.0)
    generator = torch.Generator().manual_seed(seed)
    best, kept = float("inf"), {k: v.clone() for k, v in module.state_dict().items()}
    for epoch in range(epochs):
        module.train()
        if epoch == 0 or callable(training):
            now = draw(epoch)
            features = torch.from_numpy(standardized(now.features, mean, scale))
            anchors, truth = torch.from_numpy(now.anchors), torch.from_numpy(now.truth)
        order = torch.randperm(len(features), generator=generator)
        whole = max(1, len(order) // BATCH) * BATCH
        for batch in torch.split(order[:whole], BATCH):
            guesses = module(features[batch])
            descent.step(displacement_loss(guesses, anchors[batch], truth[batch]))
        ade = validation_ade(module, checked)
        on_epoch(epoch, ade)
        if ade < best:
            best, kept = ade, {k: v.clone() for k, v in module.state_dict().items()}
    module.load_state_dict(kept)
    return module, mean, scale


def _scaled(network: Perceptron | TrajectoryLstm, validation: Examples) -> FuturesNetwork:
    """The network with the spreads' scale that is right on validation examples."""
    data = PredictorInputs(validation.features.astype(float), validation.anchors.astype(float))
    futures = FuturesNetwork(network, 1.0)(data)
    every = max(1, len(validation.truth) // CHECKED)
    own, spread = futures.own[::every, :, -1], futures.spread[::every, :, -1]
    ended = validation.truth[::every, -1].astype(np.float64)
    return FuturesNetwork(network, spread_factor(own, spread, futures.probability[::every], ended))


def silu_module(sizes: Sequence[int], dropout: float = 0.0) -> torch.nn.Sequential:
    """Fully connected layers of these widths with SiLU between them; the last one starts near 0.

    ``dropout`` is the share of each hidden layer's answers that are left out while it is trained.
    """
    linears = [torch.nn.Linear(inside, outside) for inside, outside in itertools.pairwise(sizes)]
    with torch.no_grad():
        linears[-1].weight.mul_(0.05)
        linears[-1].bias.zero_()
    after = [torch.nn.SiLU(), *([torch.nn.Dropout(dropout)] if dropout else [])]
    layers = [layer for linear in linears for layer in (linear, *after)]
    return torch.nn.Sequential(*layers[: -len(after)])


def layers_of(module: torch.nn.Sequential) -> tuple[Layers, Layers]:
    """The weights and the biases of a module's linear layers, as networks in numpy keep them."""
    linears = [m for m in module if isinstance(m, torch.nn.Linear)]
    return (
        tuple(np.ascontiguousarray(m.weight.detach().numpy().T) for m in linears),
        tuple(m.bias.detach().numpy() for m in linears),
    )


def spread_factor(
    own: FloatArray, spread: FloatArray, probability: FloatArray, ended: FloatArray
) -> float:
    """Factor for the spreads (m, MODES) with which nominal 90 % sets cover 90 %.

    The futures (m, MODES, 2) are those at one time, ``ended`` (m, 2) is where everyone was, m.
    """
    low, high = 0.1, 10.0
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        inside = covered(own, spread * middle, probability, ended)
        low, high = (middle, high) if inside.mean() < 0.9 else (low, middle)
    return float(np.sqrt(low * high))
