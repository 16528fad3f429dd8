"""Boosted trees and a perceptron, averaged.

Trees cut features at sharp values, networks pass smoothly through them; in traffic that neither was
trained on they err differently, and their average is right more often than each. The perceptron is
trained by PyTorch (`graphrqi.classify.mlp`) and answers in numpy: a stream needs no PyTorch.

References:
    Lakshminarayanan, Pritzel, Blundell (2017), Simple and scalable predictive uncertainty
    estimation using deep ensembles, NeurIPS.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.boosted import Boosted
from graphrqi.classify.checks import part_of, saved, saved_temperature
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import NEVER, softmax
from graphrqi.classify.standardisation import Standardisation

MOST_ROWS: Final = 20_000
"""Rows that are answered at once (the arrays between the layers then take 60 MB)."""

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class Averaged:
    """The mean of the probabilities of boosted trees and of a perceptron.

    Args:
        num_classes: C.
        trees: options of `graphrqi.classify.boosted.Boosted`.
        network: options of `graphrqi.classify.mlp.Mlp`; it has one member.
    """

    def __init__(
        self,
        num_classes: int,
        trees: Mapping[str, Any] | None = None,
        network: Mapping[str, Any] | None = None,
    ) -> None:
        self._num_classes = num_classes
        self._trees = Boosted(num_classes, **(trees or {}))
        self._network = dict(network or {})
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._layers: Layers = []
        self._temperature = 1.0

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        from graphrqi.classify.mlp import Mlp

        self._trees.fit(features, codes, validation, seed)
        perceptron = Mlp(self._num_classes, members=1, **self._network)
        perceptron.fit(features, codes, validation, seed)
        self._take(perceptron.arrays(), features.shape[1])

    def _take(self, arrays: Mapping[str, NDArray[Any]], num_features: int) -> None:
        """Keep the perceptron's arrays as layers."""
        named = {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}
        self._inputs = Standardisation.restored(named, num_features)
        self._temperature = saved_temperature(named)
        numbers = sorted({int(k.split(".")[1]) for k in named if k.startswith("member0.")})
        self._layers, width = [], num_features
        for number in numbers:
            weight = saved(named, f"member0.{number}.weight", (None, width))
            bias = saved(named, f"member0.{number}.bias", (len(weight),))
            self._layers.append((_single(weight.T), _single(bias)))
            width = len(weight)
        if width != self._num_classes:
            raise InputError(f"network: found {width} outputs, expected {self._num_classes}")

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        parts = range(0, max(1, len(features)), MOST_ROWS)
        return np.concatenate([self._posterior(features[at : at + MOST_ROWS]) for at in parts])

    def _posterior(self, features: FloatArray) -> FloatArray:
        values = _single(self._inputs.apply(features))
        for number, (weight, bias) in enumerate(self._layers):
            values = (np.maximum(values, 0.0) if number else values) @ weight + bias
        scores = np.where(self._trees.trained, values.astype(np.float64) / self._temperature, NEVER)
        return 0.5 * (self._trees.posterior(features) + softmax(scores))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The trees' arrays, and the perceptron's in single precision."""
        out = {f"trees.{name}": value for name, value in self._trees.arrays().items()}
        single = {**self._inputs.arrays(), "temperature": np.array([self._temperature])}
        for number, (weight, bias) in enumerate(self._layers):
            single[f"member0.{3 * number}.weight"] = weight.T
            single[f"member0.{3 * number}.bias"] = bias
        for name, value in single.items():
            out[f"network.{name}"] = np.ascontiguousarray(value, dtype=np.float32)
        return out

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._trees.restore(part_of(arrays, "trees"), num_features)
        self._take(part_of(arrays, "network"), num_features)


def _single(values: NDArray[Any]) -> NDArray[np.float32]:
    """In single precision, in which the network was trained and is twice as fast."""
    return np.ascontiguousarray(values, dtype=np.float32)
