"""Which behaviours are common here: a classifier's answers corrected for the mix of the scene.

A classifier believes in the mix of drivers that it was trained on. Where most drivers are careful,
it takes too many of them for something else. The mix is estimated from the answers themselves,
without a label, by expectation maximisation, and the answers are corrected by Bayes' rule.

References:
    Saerens, Latinne, Decaestecker (2002), Adjusting the outputs of a classifier to new a priori
    probabilities: a simple procedure, Neural Computation 14, 21.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematics import FORGET_S

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TRUST_DRIVERS: Final = 60.0
"""So many drivers must be seen before what they are counts as much as the mix of the training data
(our choice, on validation episodes of odd and of equal mixes: it is the strength of a Dirichlet
prior, which the paper has not)."""

SETTLED: Final = 1e-4
"""Change of every share by which the estimate has settled (our choice)."""

MOST_ROUNDS: Final = 50
"""Of expectation and maximisation (our choice: from the last estimate two or three do)."""


class PriorShift:
    """How common each class is among all drivers that have been in sight.

    Assumes that drivers of a class drive as in the training data and that only their number
    differs. A driver counts once: with its present answer while it is in sight, with its last one
    after that.

    Args:
        trained: (C,) share of each class in the training data; one of share 0 stays impossible.

    Examples:
        Two classes, trained half and half. Of 80 drivers 70 look like the first, so one that looks
        like either belongs to the first more likely than not:

        >>> mix = PriorShift(np.array([0.5, 0.5]))
        >>> mix.observe(0.0, np.arange(80), np.repeat([[0.9, 0.1], [0.1, 0.9]], [70, 10], axis=0))
        >>> mix.corrected(np.array([[0.5, 0.5]])).round(2)
        array([[0.71, 0.29]])
    """

    def __init__(self, trained: FloatArray) -> None:
        self._trained = np.where(trained > 0.0, trained, 1.0)
        self._shares = trained
        self._counted = TRUST_DRIVERS * trained
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self._answers: FloatArray = np.empty((0, trained.size))

    def observe(self, time_s: float, ids: IntArray, probability: FloatArray) -> None:
        """Estimate the mix anew with everyone's answers at a moment.

        Args:
            time_s: not before that of the call before.
            ids: (n,) agents, each once.
            probability: (n, C) the classifier's answers, not corrected.
        """
        away = ~np.isin(self._ids, ids)
        gone = away & (self._seen_s < time_s - FORGET_S)
        self._counted = self._counted + self._answers[gone].sum(axis=0)
        hidden = away & ~gone
        counted = self._counted + self._answers[hidden].sum(axis=0)
        for _ in range(MOST_ROUNDS):
            answers, before = self.corrected(probability), self._shares
            shares = counted + answers.sum(axis=0)
            self._shares = shares / shares.sum()
            if np.abs(self._shares - before).max() < SETTLED:
                break
        self._ids = np.concatenate([self._ids[hidden], ids])
        self._seen_s = np.concatenate([self._seen_s[hidden], np.full(ids.size, time_s)])
        self._answers = np.concatenate([self._answers[hidden], answers])

    def corrected(self, probability: FloatArray) -> FloatArray:
        """(n, C) probabilities under the mix found so far, from a classifier's answers (n, C)."""
        answers = probability * (self._shares / self._trained)
        return np.asarray(answers / answers.sum(axis=1, keepdims=True))
