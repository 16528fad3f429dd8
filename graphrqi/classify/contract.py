"""The one contract of all classifiers."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
CodeArray = NDArray[np.int8]


class Classifier(Protocol):
    """Learns from feature vectors and tells the probability of each class."""

    def fit(
        self,
        features: FloatArray,
        codes: CodeArray,
        validation: tuple[FloatArray, CodeArray] | None,
        seed: int,
    ) -> None:
        """Learn.

        Args:
            features: (n, F) training vectors.
            codes: (n,) classes, 0 to C - 1.
            validation: vectors and classes of other episodes, to stop and to calibrate by; rows of
                classes that are not learned are left out.
            seed: same seed, same classifier.
        """
        ...

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities; rows sum to 1 and do not depend on one another."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        ...

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """Take what was saved; the next `posterior` is the same as before saving.

        Args:
            arrays: as from `arrays`.
            num_features: F.

        Raises:
            InputError: if the arrays are not of such a classifier.
        """
        ...
