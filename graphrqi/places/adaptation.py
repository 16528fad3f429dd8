"""Adapts a model's answers to a recording site, from a few labelled drivers.

The answers of a model in other traffic rank drivers well, but their probabilities are offset. An
`Adaptation` therefore keeps the ranking and moves the probabilities. It multiplies their logarithms
by a scale and adds an offset for each behaviour. Both are fitted by penalised likelihood, so that
few drivers move them little.

References:
    Guo, Pleiss, Sun, Weinberger (2017), On calibration of modern neural networks, ICML: vector
    scaling.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from graphrqi.arrays import BoolArray, FloatArray, softmax
from graphrqi.classify.contract import FLOOR

OFFSET_SD: Final = 1.0
"""Prior standard deviation of the offsets, in logarithms of odds."""

SCALE_SD: Final = 0.5
"""Prior standard deviation of the scale's logarithm."""


@dataclass(frozen=True, slots=True)
class Adaptation:
    """A correction of a model's probabilities at a recording site.

    Attributes:
        scale: factor of their logarithms; less than 1 makes answers less certain.
        offset: (6,) is added to the logarithm of each behaviour's.

    Examples:
        >>> Adaptation(1.0, np.log([3.0, 1, 1, 1, 1, 1])).applied(np.full((1, 6), 1 / 6)).round(3)
        array([[0.375, 0.125, 0.125, 0.125, 0.125, 0.125]])
    """

    scale: float
    offset: FloatArray

    def applied(self, probability: FloatArray) -> FloatArray:
        """(n, 6) probabilities at the site, from the model's (n, 6)."""
        return softmax(self.scale * np.log(np.maximum(probability, FLOOR)) + self.offset)


def from_labels(probability: FloatArray, allowed: BoolArray) -> Adaptation:
    """Fit scale and offsets to labelled drivers.

    Args:
        probability: (n, 6) the model's answer for each driver.
        allowed: (n, 6) the behaviours that a driver's label allows: one, or those of a style.

    Returns:
        The adaptation of the largest posterior probability.

    Examples:
        Nine of ten drivers that look like either style are conservative:

        >>> p, style = np.full((10, 6), 1 / 6), np.array([True] * 3 + [False] * 3)
        >>> allowed = np.where(np.arange(10)[:, None] == 0, style, ~style)
        >>> found = from_labels(p, allowed)
        >>> round(float(found.applied(p)[0, :3].sum()), 1)
        0.3
    """
    from scipy.optimize import minimize

    log_p = np.log(np.maximum(probability, FLOOR))

    def loss(numbers: FloatArray) -> float:
        answer = softmax(np.exp(numbers[0]) * log_p + numbers[1:])
        right = np.maximum((answer * allowed).sum(axis=1), 1e-12)
        prior = (numbers[0] / SCALE_SD) ** 2 + ((numbers[1:] / OFFSET_SD) ** 2).sum()
        return float(0.5 * prior - np.log(right).sum())

    found = minimize(loss, np.zeros(1 + len(BEHAVIORS)), method="BFGS").x
    return Adaptation(float(np.exp(found[0])), found[1:])
