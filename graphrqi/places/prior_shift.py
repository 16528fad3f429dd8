"""Prior shift: answers corrected for the shares of behaviours in the traffic at hand.

A classifier assumes the shares of classes that it was trained on. Where most drivers are careful,
it therefore misclassifies too many of them. The actual shares are estimated from the answers
themselves, without labels, by expectation maximisation; Bayes' rule then corrects the answers.

References:
    Saerens, Latinne, Decaestecker (2002), Adjusting the outputs of a classifier to new a priori
    probabilities: a simple procedure, Neural Computation 14, 21.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import FloatArray, IntArray
from graphrqi.features.motion import FORGET_S

PRIOR_DRIVERS: Final = 60.0
"""Strength of a Dirichlet prior at the training shares, in drivers (chosen on validation episodes;
the paper has no prior)."""

CONVERGED: Final = 1e-4
"""The estimate has converged when no share changes by more than this."""

MOST_ROUNDS: Final = 50
"""Largest number of rounds; two or three suffice from the last estimate."""


class PriorShift:
    """Estimates the share of each class among all drivers observed so far.

    It assumes that drivers of a class drive as in the training data and that only the shares
    differ. Each driver counts once: with its present answer while it is present, with its last
    answer afterwards. A class of training share 0 keeps probability 0.
    """

    def __init__(self, trained: FloatArray) -> None:
        self._trained = np.where(trained > 0.0, trained, 1.0)
        self._shares = trained
        self._counted = PRIOR_DRIVERS * trained
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self._answers: FloatArray = np.empty((0, trained.size))

    def observe(self, time_s: float, ids: IntArray, probability: FloatArray) -> None:
        """Update the estimate with the classifier's uncorrected answers (n, C) of one moment."""
        absent = ~np.isin(self._ids, ids)
        gone = absent & (self._seen_s < time_s - FORGET_S)
        self._counted = self._counted + self._answers[gone].sum(axis=0)
        hidden = absent & ~gone
        counted = self._counted + self._answers[hidden].sum(axis=0)
        for _ in range(MOST_ROUNDS):
            answers, before = self.corrected(probability), self._shares
            shares = counted + answers.sum(axis=0)
            self._shares = shares / shares.sum()
            if np.abs(self._shares - before).max() < CONVERGED:
                break
        self._ids = np.concatenate([self._ids[hidden], ids])
        self._seen_s = np.concatenate([self._seen_s[hidden], np.full(ids.size, time_s)])
        self._answers = np.concatenate([self._answers[hidden], answers])

    def corrected(self, probability: FloatArray) -> FloatArray:
        """(n, C) probabilities under the estimated shares, from a classifier's answers (n, C)."""
        answers = probability * (self._shares / self._trained)
        return np.asarray(answers / answers.sum(axis=1, keepdims=True))
