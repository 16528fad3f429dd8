"""Probabilities with the temperature that fits held-out data best.

References:
    Guo, Pleiss, Sun, Weinberger (2017), On Calibration of Modern Neural Networks, ICML.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, CodeArray, FloatArray
from graphrqi.classify.contract import HeldOut, saved

NEVER: Final = -1e3
"""Score of a class without training rows; its probability is exactly zero."""

FLOOR: Final = 1e-4
"""Probabilities below this count as this when a temperature is fitted: the average of a hundred
trees can be exactly zero for a class that is only rare."""

LEAST_TEMPERATURE, LARGEST_TEMPERATURE = 1e-3, 1e3
"""Temperatures that a model may have; training tries 0.25 to 4."""


def softmax(scores: FloatArray) -> FloatArray:
    """(n, C) probabilities in proportion to the exponentials of scores (n, C).

    Examples:
        >>> softmax(np.array([[0.0, np.log(3.0)]]))
        array([[0.25, 0.75]])
    """
    raised = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True))


def best_temperature(probability: FloatArray, codes: CodeArray, trained: BoolArray) -> float:
    """The temperature with the largest likelihood on held-out data.

    Args:
        probability: (n, C) of a classifier.
        codes: (n,) true classes; all of them were trained.
        trained: (C,) whether the class has training rows.

    Returns:
        T, for probabilities proportional to p^(1/T).
    """
    log_p = _log(probability, trained)
    rows = np.arange(codes.size)
    grid = np.geomspace(0.25, 4.0, 81)
    losses = [-np.log(softmax(log_p / t)[rows, codes]).mean() for t in grid]
    return float(grid[int(np.argmin(losses))])


def tempered(probability: FloatArray, temperature: float, trained: BoolArray) -> FloatArray:
    """Probabilities (n, C) in proportion to p^(1/T); classes not ``trained`` keep zero."""
    if temperature == 1.0:
        return probability
    return softmax(_log(probability, trained) / temperature)


def _log(probability: FloatArray, trained: BoolArray) -> FloatArray:
    return np.where(trained, np.log(np.maximum(probability, FLOOR)), -np.inf)


class Calibrated:
    """A classifier that divides its logits by a temperature, which is fitted on held-out data.

    Args:
        num_classes: C.
    """

    tempers = True
    """Whether a temperature is fitted at all."""

    _temperature = 1.0

    def __init__(self, num_classes: int) -> None:
        self._num_classes = num_classes

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        held = None
        if validation is not None and (known := np.isin(validation[1], codes)).any():
            held = validation if known.all() else (validation[0][known], validation[1][known])
        self._learn(features, codes, held, seed)
        self._temperature = 1.0
        if held is not None and self.tempers:
            found = self._untempered(held[0])
            self._temperature = best_temperature(found, held[1], self._trained)

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        """Learn from rows; those held out are of trained classes."""
        raise NotImplementedError

    def _untempered(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities without temperature."""
        raise NotImplementedError

    @property
    def _trained(self) -> BoolArray:
        """(C,) whether each class may have occurred in training."""
        return np.ones(self._num_classes, dtype=bool)

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return tempered(self._untempered(features), self._temperature, self._trained)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The temperature."""
        return {"temperature": np.array([self._temperature])}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        found = float(saved(arrays, "temperature", (1,))[0])
        if not LEAST_TEMPERATURE <= found <= LARGEST_TEMPERATURE:
            raise InputError(
                f"temperature: found {found:g}, expected a number from {LEAST_TEMPERATURE:g} to "
                f"{LARGEST_TEMPERATURE:g}"
            )
        self._temperature = found
