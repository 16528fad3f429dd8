"""From scores to probabilities: softmax, multinomial regression and temperature scaling."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.contract import CodeArray, FloatArray

BoolArray = NDArray[np.bool_]

NEVER: Final = -1e3
"""Score of a class without training rows; its probability is exactly zero."""

FLOOR: Final = 1e-4
"""Probabilities below this count as this when a temperature is fitted: the average of a hundred
trees can be exactly zero for a class that is only rare."""

MAX_ITERATIONS: Final = 500
"""Iterations of the quasi-Newton solver; standardised features converge in fewer."""


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

    References:
        Guo, Pleiss, Sun, Weinberger (2017), On Calibration of Modern Neural Networks, ICML.
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


def multinomial(
    inputs: FloatArray, codes: CodeArray, num_classes: int, inverse_penalty: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Multinomial logistic regression with an L2 penalty, by scikit-learn.

    Args:
        inputs: (n, F) of about unit size.
        codes: (n,) classes.
        num_classes: C; classes that do not occur get probability zero.
        inverse_penalty: larger fits closer.

    Returns:
        (F, C) weights and (C,) biases of the scores whose `softmax` are the probabilities.

    Raises:
        InputError: if all samples are of one class.
    """
    from sklearn.linear_model import LogisticRegression

    present = np.unique(codes)
    if present.size < 2:
        raise InputError(f"codes: found class {present.tolist()} only, expected at least two")
    learned = LogisticRegression(C=inverse_penalty, max_iter=MAX_ITERATIONS).fit(inputs, codes)
    weights, bias = np.zeros((inputs.shape[1], num_classes)), np.full(num_classes, NEVER)
    bias[present] = 0.0
    shown = present[1:] if present.size == 2 else present  # two classes share one column
    weights[:, shown], bias[shown] = learned.coef_.T, learned.intercept_
    return weights, bias
