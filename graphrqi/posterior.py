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
        """Check shapes and make the arrays read-only."""
        ids = np.asarray(self.ids, dtype=np.int64)
        probability = np.asarray(self.probability, dtype=np.float64)
        expected = (ids.size, len(BEHAVIORS))
        if probability.shape != expected:
            raise InputError(
                f"Posterior.probability: found shape {probability.shape}, expected {expected}"
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
