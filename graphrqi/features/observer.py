"""The contract of observers: positions in, a feature vector for every driver out, frame by frame.

Observers are plain-array classes, used alike on live frames and on recordings, so training and
streaming cannot differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Observation:
    """What is known of the drivers present now.

    Attributes:
        ids: (n,) ascending.
        seconds: (n,) time observed so far, s.
        sums: (n, S) additive evidence since each was first seen.
        instant: (n, I) what holds now only.
    """

    ids: IntArray
    seconds: FloatArray
    sums: FloatArray
    instant: FloatArray


class Observer(Protocol):
    """Follows traffic and describes each driver."""

    feature_names: tuple[str, ...]

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions.

        Args:
            time_s: later than at the call before.
            ids: (n,) ascending agent ids.
            xy: (n, 2) m.
            drives: (n,) whether each drives; the others are pedestrians.
        """
        ...

    def observation(self) -> Observation:
        """What is known now of the drivers present."""
        ...

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Turn evidence over any stretch of time into feature vectors (n, F)."""
        ...
