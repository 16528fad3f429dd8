"""What a classifier believes: a probability for each behaviour of each agent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS


@dataclass(frozen=True, slots=True)
class Posterior:
    """Belief about the drivers seen long enough.

    Attributes:
        ids: (n,) agent ids, ascending.
        probability: (n, 6) in the order of ``behaviors.BEHAVIORS``; rows sum to 1.

    Examples:
        >>> p = Posterior(ids=[7], probability=[[0.1, 0.5, 0.1, 0.1, 0.1, 0.1]])
        >>> p.most_likely.tolist()
        [1]
    """

    ids: NDArray[np.int64]
    probability: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check ids and probabilities, and make the arrays read-only.

        Raises:
            InputError: if ids are not whole numbers that ascend, or rows are no probabilities.
        """
        ids = np.asarray(self.ids)
        if ids.size and ids.dtype.kind not in "iu":
            raise InputError(f"Posterior.ids: found {ids.dtype} values, expected whole numbers")
        ids = ids.astype(np.int64, copy=False)
        if ids.ndim != 1 or not (ids[1:] > ids[:-1]).all():
            raise InputError("Posterior.ids: found ids that do not ascend, expected each once")
        probability = np.asarray(self.probability, dtype=np.float64)
        expected = (ids.size, len(BEHAVIORS))
        if probability.shape != expected:
            raise InputError(
                f"Posterior.probability: found shape {probability.shape}, expected {expected}"
            )
        possible = (probability >= 0.0).all(axis=1) & (abs(probability.sum(axis=1) - 1.0) <= 1e-5)
        if not possible.all():
            row = int(np.flatnonzero(~possible)[0])
            raise InputError(
                f"Posterior.probability: found {probability[row].tolist()} for agent {ids[row]}, "
                "expected numbers that are not negative and sum to 1"
            )
        for name, array in (("ids", ids), ("probability", probability)):
            view = array.view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @property
    def most_likely(self) -> NDArray[np.int64]:
        """(n,) code of each agent's most likely behaviour."""
        return np.asarray(self.probability.argmax(axis=1), dtype=np.int64)

    def of(self, ids: NDArray[np.int64]) -> NDArray[np.float64]:
        """(m, 6) probabilities of the given agents; uniform for those not known yet."""
        out = np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        if self.ids.size:
            at = np.clip(np.searchsorted(self.ids, ids), 0, self.ids.size - 1)
            known = self.ids[at] == ids
            out[known] = self.probability[at[known]]
        return out
