"""The drivers of a recording site, compared with one another, and a perceptron that sees them all.

Recorded drivers are compared with one another, since the average of their site is unknown.

One layer of the perceptron describes a driver, and a second one gives the numbers that are pooled.
Their weighted mean and deviation over the site's drivers join each driver's own description in a
third layer. The number and the order of the drivers do not matter. The network is trained by
PyTorch (`graphrqi.places.training`) and answers in numpy: a stream needs no PyTorch.

References:
    Zaheer, Kottur, Ravanbakhsh, Poczos, Salakhutdinov, Smola (2017), Deep sets, NeurIPS.
    Lakshminarayanan, Pritzel, Blundell (2017), Simple and scalable predictive uncertainty
    estimation using deep ensembles, NeurIPS: the members.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray, IntArray, SingleArray, softmax
from graphrqi.classify.contract import Standardisation, part_of, saved

MEMORY_S: Final = 300.0
"""A driver counts for this time after it was last seen, s; scenes average over the same time."""

LEAST_WEIGHT_S, FULL_WEIGHT_S = 0.1, 20.0
"""A driver's weight is the time it was watched, between these, s."""


class PlaceDrivers:
    """The drivers of a recording site so far, with their last ``width`` numbers."""

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self._seconds: FloatArray = np.empty(0)
        self.values: FloatArray = np.empty((0, width))

    def observe(
        self, time_s: float, ids: IntArray, values: FloatArray, seconds: FloatArray
    ) -> None:
        """Add or update drivers: (n, width) numbers of each, and the time watched (n,), s."""
        kept = ~np.isin(self._ids, ids) & (self._seen_s >= time_s - MEMORY_S)
        self._ids = np.concatenate([self._ids[kept], ids])
        self._seen_s = np.concatenate([self._seen_s[kept], np.full(ids.size, time_s)])
        self._seconds = np.concatenate([self._seconds[kept], seconds])
        self.values = np.concatenate([self.values[kept], values])

    @property
    def weights(self) -> FloatArray:
        """(N,) how much each of the N drivers counts."""
        return weights_of(self._seconds)


def weights_of(seconds: FloatArray) -> FloatArray:
    """(n,) how much drivers count that were watched for so long (n,), s."""
    return np.asarray(np.clip(seconds, LEAST_WEIGHT_S, FULL_WEIGHT_S))


FARTHEST_ODDS: Final = 9.2
"""Log-odds are limited to this."""

USUAL_DEVIATION: Final = 3.5
"""Mean deviation of log-odds from the median on either side, where few drivers are known."""

LEAST_DEVIATION: Final = 1.0
"""Log-odds that lie closer together than this do not distinguish drivers."""

CONFIDENCE: Final = 1.75
"""Log-odds of a recorded driver one mean deviation from the median, watched for long (our choice).
About the outer third of the drivers gets a label."""

MOST_CONFIDENCE: Final = 3.0
"""Log-odds that the farthest driver approaches, a probability of 0.95."""

HALF_CONFIDENCE_S: Final = 2.0
"""Time watched at which half of that confidence is reached, s."""

HALF_CONFIDENCE_DRIVERS: Final = 5.0
"""Drivers seen at which half of the confidence is reached, and the site's own median and deviations
count half."""


def beside_others(log_odds: FloatArray, seconds: FloatArray, place: PlaceDrivers) -> FloatArray:
    """(n,) log-odds of the aggressive style relative to the other drivers of the site.

    The distance from the site's median is divided by the mean deviation on the driver's side of it.
    Where few drivers are known, median and deviation stay near their usual values.
    """
    known = place.values[:, 0]
    order = np.argsort(known, kind="stable")
    odds, weight = known[order], place.weights[order]
    share = np.cumsum(weight) / weight.sum()
    shown = level_shown(odds.size)
    median = odds[min(int(np.searchsorted(share, 0.5)), odds.size - 1)] * shown
    off, total = odds - median, weight.sum()
    above, below = (2.0 * (weight @ np.maximum(s * off, 0.0)) / total for s in (1.0, -1.0))
    far = log_odds - median
    scale = shown * np.where(far > 0.0, above, below) + (1.0 - shown) * USUAL_DEVIATION
    scale = np.maximum(scale, LEAST_DEVIATION)
    worth = MOST_CONFIDENCE * shown * seconds / (seconds + HALF_CONFIDENCE_S)
    return np.asarray(worth * np.tanh(CONFIDENCE / MOST_CONFIDENCE * far / scale))


def level_shown(drivers: int) -> float:
    """How far a number of drivers shows the average of their site, from 0 to 1."""
    return drivers / (drivers + HALF_CONFIDENCE_DRIVERS)


def log_odds_of(probability: FloatArray) -> FloatArray:
    """(...) log-odds of shares (...) of the aggressive style, at most `FARTHEST_ODDS`."""
    low = 1.0 / (1.0 + np.exp(FARTHEST_ODDS))
    held = np.clip(probability, low, 1.0 - low)
    return np.asarray(np.log(held / (1.0 - held)))


def restyled(
    probability: FloatArray, aggressive: FloatArray, style: NDArray[np.bool_]
) -> FloatArray:
    """(n, C) behaviours with another probability (n,) of the aggressive style (C,).

    The odds within each style stay.
    """
    share = np.where(style, aggressive[:, None], 1.0 - aggressive[:, None])
    held = np.maximum(probability, 1e-9)
    total = np.stack([held[:, ~style].sum(axis=1), held[:, style].sum(axis=1)], axis=1)
    return np.asarray(held / total[:, style.astype(np.int64)] * share)


CLIP: Final = 4.0
"""Standardised inputs are clipped at this value."""

LEAST_VARIANCE: Final = 1e-4
"""Added to a variance before its root is taken, so that the gradient is finite."""

LOG_DRIVERS: Final = 4.0
"""Divides the logarithm of the number of drivers, which is then about one."""

LAYERS: Final = ("own", "shown", "joint", "answer")
"""Layers: a driver's description, its pooled numbers, both together, and the class scores."""


@dataclass(frozen=True, slots=True)
class Member:
    """One network: weights (inputs, outputs) and biases (outputs,) of each of ``LAYERS``."""

    weights: tuple[SingleArray, ...]
    biases: tuple[SingleArray, ...]


class PlaceNetwork:
    """The mean answer of several networks to standardised features."""

    def __init__(self, inputs: Standardisation, members: tuple[Member, ...]) -> None:
        self._inputs, self._members = inputs, members

    @property
    def width(self) -> int:
        """How many numbers `observe` keeps of a driver."""
        return sum(member.biases[1].size for member in self._members)

    def described(self, features: FloatArray) -> list[SingleArray]:
        """Each member's own description (n, H) of drivers with features (n, F)."""
        x = np.clip(self._inputs.apply(features), -CLIP, CLIP).astype(np.float32)
        return [_rectified(x @ m.weights[0] + m.biases[0]) for m in self._members]

    def shown(self, described: list[SingleArray]) -> FloatArray:
        """(n, width) the numbers that are pooled, from `described`."""
        parts = [
            _rectified(own @ m.weights[1] + m.biases[1])
            for own, m in zip(described, self._members, strict=True)
        ]
        return np.concatenate(parts, axis=1).astype(np.float64)

    def among(self, described: list[SingleArray], place: PlaceDrivers) -> FloatArray:
        """(n, C) probabilities of `described` drivers among those of their site, these included."""
        share = place.weights / place.weights.sum()
        mean = share @ place.values
        variance = share @ (place.values - mean) ** 2
        crowd = np.log(len(place.values)) / LOG_DRIVERS
        return self._answer(described, mean[None], variance[None], crowd)

    def alone(self, described: list[SingleArray]) -> FloatArray:
        """(n, C) probabilities of drivers, from `described`, each as if alone at its site."""
        shown = self.shown(described)
        return self._answer(described, shown, np.zeros_like(shown), 0.0)

    def _answer(
        self, described: list[SingleArray], mean: FloatArray, variance: FloatArray, crowd: float
    ) -> FloatArray:
        """(n, C) probabilities; ``mean`` and ``variance`` have n rows or one."""
        out, at = np.zeros(1), 0
        for own, member in zip(described, self._members, strict=True):
            part = slice(at, at + member.biases[1].size)
            at = part.stop
            around = [mean[:, part], np.sqrt(variance[:, part] + LEAST_VARIANCE)]
            around.append(np.full((len(mean), 1), crowd))
            context = np.concatenate(around, axis=1).astype(np.float32)
            joint, weights = member.weights[2], own.shape[1]
            hidden = own @ joint[:weights] + (context @ joint[weights:] + member.biases[2])
            scores = _rectified(hidden) @ member.weights[3] + member.biases[3]
            out = out + softmax(scores.astype(np.float64))
        return np.asarray(out / len(self._members))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The learned arrays, to be saved."""
        out: dict[str, NDArray[Any]] = {
            name: value.astype(np.float32) for name, value in self._inputs.arrays().items()
        }
        for number, member in enumerate(self._members):
            for name, weight, bias in zip(LAYERS, member.weights, member.biases, strict=True):
                out[f"member{number}.{name}.weight"] = weight
                out[f"member{number}.{name}.bias"] = bias
        return out

    @classmethod
    def restored(
        cls, arrays: Mapping[str, NDArray[Any]], num_features: int, num_classes: int
    ) -> PlaceNetwork:
        """The network from its saved arrays; `InputError` if they are not those of `arrays`."""
        named = {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}
        members: list[Member] = []
        while f"member{len(members)}.own.weight" in named:
            one = part_of(named, f"member{len(members)}")
            biases = [saved(one, f"{layer}.bias", (None,)) for layer in LAYERS]
            own, shown, joint, answer = (bias.size for bias in biases)
            if answer != num_classes:
                raise InputError(f"answer: found {answer} outputs, expected {num_classes}")
            inputs = num_features, own, own + 2 * shown + 1, joint
            weights = [
                saved(one, f"{layer}.weight", (before, bias.size))
                for layer, before, bias in zip(LAYERS, inputs, biases, strict=True)
            ]
            members.append(
                Member(
                    tuple(np.ascontiguousarray(each, dtype=np.float32) for each in weights),
                    tuple(each.astype(np.float32) for each in biases),
                )
            )
        if not members:
            raise InputError("members: found none, expected at least one network")
        return cls(Standardisation.restored(named, num_features), tuple(members))


def _rectified(values: SingleArray) -> SingleArray:
    return np.maximum(values, 0.0)
