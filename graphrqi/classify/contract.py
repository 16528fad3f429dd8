"""The contract of all classifiers."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
CodeArray = NDArray[np.int8]
HeldOut = tuple[FloatArray, CodeArray] | None
"""Feature vectors and classes of episodes that are not trained on, if there are any."""


class Classifier(Protocol):
    """Learns from feature vectors and gives the probability of each class.

    It is made from the number of classes C and keyword options.
    """

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn from labelled feature vectors; validation rows of other classes are ignored.

        Args:
            features: (n, F) training vectors.
            codes: (n,) classes, 0 to C - 1.
            validation: for early stopping and calibration.
            seed: of the randomness.
        """
        ...

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities; rows sum to 1 and do not depend on one another."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The learned arrays, to be saved."""
        ...

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """Restore what was saved; `posterior` then answers as before saving.

        Args:
            arrays: as from `arrays`.
            num_features: F, against which the arrays are checked.

        Raises:
            InputError: if the arrays are not those of such a classifier.
        """
        ...
