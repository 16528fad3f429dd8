"""A perceptron that sees each driver among all drivers of its recording site.

One layer describes a driver, and a second one gives the numbers that are pooled. Their weighted
mean and deviation over the site's drivers join each driver's own description in a third layer. The
number and the order of the drivers do not matter. The network is trained by PyTorch
(`graphrqi.places.training`) and answers in numpy: a stream needs no PyTorch.

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
from graphrqi.arrays import FloatArray, SingleArray
from graphrqi.classify.contract import part_of, saved, softmax
from graphrqi.classify.standardisation import Standardisation
from graphrqi.places.drivers import PlaceDrivers

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

    @property
    def width(self) -> int:
        """How many numbers of a driver are pooled."""
        return int(self.biases[1].size)


class PlaceNetwork:
    """The mean answer of several networks to standardised features."""

    def __init__(self, inputs: Standardisation, members: tuple[Member, ...]) -> None:
        self._inputs, self._members = inputs, members

    @property
    def width(self) -> int:
        """How many numbers `observe` keeps of a driver."""
        return sum(member.width for member in self._members)

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
            part = slice(at, at + member.width)
            at += member.width
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
