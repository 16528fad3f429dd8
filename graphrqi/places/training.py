"""Trains `graphrqi.places.network.PlaceNetwork` on sites whose drivers' behaviours are known.

An example is a site at one moment, with the last sample of each driver so far. Every pass draws one
moment of each site and leaves some of its drivers out. The network thus learns from few drivers as
well as many. Classes and styles both count in the loss.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.arrays import CodeArray, FloatArray, IntArray
from graphrqi.classify.contract import Standardisation
from graphrqi.features.drivers import SCENE_NAMES, UNKNOWN_SCENE
from graphrqi.networks.portable_torch import Descent, one_thread, root
from graphrqi.places.network import (
    CLIP,
    LAYERS,
    LEAST_VARIANCE,
    LOG_DRIVERS,
    Member,
    PlaceNetwork,
    weights_of,
)
from graphrqi.places.other_traffic import OtherTraffic, scene_of
from graphrqi.posterior import AGGRESSIVE
from graphrqi.samples import Samples

KEPT: Final = (0.4, 1.0)
"""Least and largest share of a site's drivers that an example has."""

MOST_DRIVERS: Final = 150
"""Most drivers of an example."""

SAME_TIME_S: Final = 1e-6
"""Times that differ by less are the same, s."""


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """How large the networks are, and how they are trained.

    Attributes:
        members: networks that are averaged.
        own: width of a driver's description.
        shown: width of the pooled numbers.
        joint: width of both together.
        dropout: share of numbers silenced while training.
        passes: examples of each site.
        places_a_step: examples of one step.
        learning_rate: peak of a one-cycle schedule (Smith 2018) for AdamW.
        weight_decay: AdamW's.
    """

    members: int = 2
    own: int = 160
    shown: int = 48
    joint: int = 96
    dropout: float = 0.3
    passes: int = 160
    places_a_step: int = 16
    learning_rate: float = 4e-3
    weight_decay: float = 1e-2


EXACT, NOISY, OTHER = range(3)
"""Parts of the training: exact simulated traffic, the same with noise, and random simulations."""

RANGE: Final = 0.002
"""Share of the training scenes beyond an end of a number's range."""


class Examples:
    """Sites at all moments that were sampled.

    The samples are of drivers that are each seen since they appeared; several moments of each.
    """

    def __init__(self, samples: Samples) -> None:
        if not (samples.codes >= 0).any():
            raise InputError("samples: found no labelled driver, expected at least one")
        order = np.lexsort((samples.time_s, samples.agent, samples.episode))
        features = samples.features[order]
        self.inputs = Standardisation.of(features)
        features -= self.inputs.mean.astype(np.float32)  # in place: they take gigabytes
        features /= self.inputs.scale.astype(np.float32)
        self.x = torch.from_numpy(np.clip(features, -CLIP, CLIP, out=features))
        self.codes = torch.from_numpy(samples.codes[order].astype(np.int64))
        self.weights = torch.from_numpy(weights_of(samples.seconds[order]).astype(np.float32))
        self._agent, self._time_s = samples.agent[order], samples.time_s[order]
        episode = samples.episode[order]
        starts = np.flatnonzero(np.r_[True, episode[1:] != episode[:-1], True])
        self.places = [(int(a), int(b)) for a, b in itertools.pairwise(starts)]

    def moments(self, place: tuple[int, int]) -> FloatArray:
        """(M,) the times at which drivers of the site were sampled, s."""
        return np.unique(self._time_s[slice(*place)])

    def latest(self, place: tuple[int, int], time_s: float) -> IntArray:
        """(n,) rows of the last sample, at a time, of each driver of the site so far."""
        here = slice(*place)
        known = self._time_s[here] <= time_s + SAME_TIME_S
        agent = self._agent[here]
        older = np.zeros(known.size, dtype=bool)
        older[:-1] = (agent[:-1] == agent[1:]) & known[1:]
        return place[0] + np.flatnonzero(known & ~older)

    def drawn(self, rng: np.random.Generator, at_once: int) -> Iterator[tuple[IntArray, IntArray]]:
        """One moment of every site, several sites at a time, in random order.

        Yields:
            Rows (n,) of drivers, and the number of the site of each, from 0 on without gaps.
        """
        order = rng.permutation(len(self.places))
        for at in range(0, len(order), at_once):
            rows: list[IntArray] = []
            for number in order[at : at + at_once]:
                place = self.places[number]
                known = self.latest(place, float(rng.choice(self.moments(place))))
                kept = known[rng.random(known.size) < rng.uniform(*KEPT)]
                if kept.size > MOST_DRIVERS:
                    kept = rng.choice(kept, MOST_DRIVERS, replace=False)
                rows.append(kept if kept.size else known[:1])
            yield np.concatenate(rows), np.repeat(np.arange(len(rows)), [r.size for r in rows])


class _Network(nn.Module):
    """As `graphrqi.places.network.Member`, to be trained."""

    def __init__(self, inputs: int, options: NetworkOptions) -> None:
        super().__init__()
        self.own = nn.Linear(inputs, options.own)
        self.shown = nn.Linear(options.own, options.shown)
        self.joint = nn.Linear(options.own + 2 * options.shown + 1, options.joint)
        self.answer = nn.Linear(options.joint, len(BEHAVIORS))
        self.dropout = nn.Dropout(options.dropout)

    def forward(self, x: Tensor, weights: Tensor, place: Tensor) -> Tensor:
        """(n, C) scores of drivers (n, F) with weights (n,) at sites (n,)."""
        own = self.dropout(torch.relu(self.own(x)))
        shown = torch.relu(self.shown(own))
        count = int(place[-1]) + 1

        def summed(values: Tensor) -> Tensor:
            return torch.zeros(count, values.shape[1]).index_add(0, place, values)

        total = summed(weights[:, None])
        mean = summed(weights[:, None] * shown) / total
        variance = summed(weights[:, None] * (shown - mean[place]) ** 2) / total
        crowd = torch.log(summed(torch.ones_like(weights)[:, None])) / LOG_DRIVERS
        around = torch.cat([mean, root(variance + LEAST_VARIANCE), crowd], dim=1)
        joint = torch.relu(self.joint(torch.cat([own, around[place]], dim=1)))
        return torch.as_tensor(self.answer(self.dropout(joint)))

    def member(self) -> Member:
        """The trained weights, for numpy."""
        layers = [getattr(self, name) for name in LAYERS]
        return Member(
            tuple(np.ascontiguousarray(layer.weight.detach().numpy().T) for layer in layers),
            tuple(layer.bias.detach().numpy().copy() for layer in layers),
        )


def train_place_network(
    training: Samples, seed: int = 0, options: NetworkOptions | None = None
) -> PlaceNetwork:
    """Train a network on samples at several moments of each driver.

    Unlabelled drivers are only context; `InputError` if none is labelled.
    """
    options = options or NetworkOptions()
    examples = Examples(training)
    with torch.random.fork_rng(devices=[]), one_thread():
        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        members = [_trained(examples, rng, options).member() for _ in range(options.members)]
    return PlaceNetwork(examples.inputs, tuple(members))


def _trained(examples: Examples, rng: np.random.Generator, options: NetworkOptions) -> _Network:
    """One network."""
    network = _Network(examples.x.shape[1], options)
    steps = options.passes * -(-len(examples.places) // options.places_a_step)
    descent = Descent(network, steps, options.learning_rate, options.weight_decay)
    for _ in range(options.passes):
        for rows, place in examples.drawn(rng, options.places_a_step):
            descent.step(_loss(network, examples, rows, place))
    return network.eval()


def _loss(network: _Network, examples: Examples, rows: IntArray, place: IntArray) -> Tensor:
    """Cross entropy of classes and of styles; a site counts as the root of its drivers."""
    at = torch.from_numpy(place)
    scores = network(examples.x[rows], examples.weights[rows], at)
    codes = examples.codes[rows]
    known, true = codes >= 0, codes.clamp(min=0)
    worth = known / root(torch.bincount(at).float())[at]
    aggressive = torch.from_numpy(AGGRESSIVE)
    style = scores[:, aggressive].logsumexp(dim=1) - scores[:, ~aggressive].logsumexp(dim=1)
    losses = nn.functional.cross_entropy(scores, true, reduction="none")
    losses = losses + nn.functional.binary_cross_entropy_with_logits(
        style, aggressive[true].float(), reduction="none"
    )
    return (losses * worth).sum() / worth.sum().clamp(min=1e-9)


def train_other_traffic(
    training: Samples, parts: CodeArray, seed: int = 0, options: NetworkOptions | None = None
) -> OtherTraffic:
    """Train on exact simulated traffic, on the same with noise, and on random simulations.

    Args:
        training: samples of smoothed motion at several moments of each driver.
        parts: (n,) the part of each sample; all must occur.
        seed: of the randomness.
        options: of the networks.

    Returns:
        The networks, and the range of the scenes.

    Raises:
        InputError: if a part is missing.
    """
    found = set(parts.tolist())
    if found != {EXACT, NOISY, OTHER}:
        raise InputError(f"parts: found {sorted(found)}, expected samples of each of 0, 1, 2")
    noisy = train_place_network(training.where(parts != OTHER), seed, options)
    other = train_place_network(training, seed, options)
    scenes = scene_of(training.features)
    interval, seconds = map(SCENE_NAMES.index, ("frame interval", "seconds"))
    high = np.quantile(scenes, 1.0 - RANGE, axis=0)
    low = np.full(high.size, UNKNOWN_SCENE)  # a number that is unknown is not unlike the training
    low[interval], low[seconds] = np.quantile(scenes[:, interval], RANGE), 0.0
    return OtherTraffic(noisy, other, low, high)
