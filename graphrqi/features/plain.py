"""The driving observer's motion and interaction alone: no graph signal, spectrum or inferred law.

What the plain rivals see, so that a difference to them is due to what was left out.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.driving import BLOCKS, DrivingObserver
from graphrqi.features.observer import Observation
from graphrqi.features.statistics import describe_names

FloatArray = NDArray[np.float64]

GRAPH_SIGNALS: Final = (
    "speed over neighbours",
    "speed over wider neighbours",
    "sideways over neighbours",
)
"""Blocks that compare a driver with its neighbourhood in the graph."""

INFERRED: Final = tuple(b.name for b in BLOCKS if b.name.startswith("law's headway"))
"""Blocks that look at the gap through the car-following law."""

OF_PACE: Final = tuple(b.name for b in BLOCKS if b.name.endswith("pace"))
"""Blocks that need the pace of the place."""

_NAMES: Final = (
    *describe_names(tuple(b for b in BLOCKS if b.name not in GRAPH_SIGNALS + INFERRED)),
    "log_seconds",
)


class PlainObserver:
    """Distributions of how each driver moves and keeps its distance.

    Args:
        solver: a key of ``SOLVERS``; what it finds is not used.
    """

    feature_names = tuple(name for name in DrivingObserver.feature_names if name in _NAMES)

    _COLUMNS: Final = np.flatnonzero([name in _NAMES for name in DrivingObserver.feature_names])

    def __init__(self, solver: str = "graphrqi") -> None:
        self._everything = DrivingObserver(solver)

    def update(
        self,
        time_s: float,
        ids: NDArray[np.int64],
        xy: FloatArray,
        drives: NDArray[np.bool_],
    ) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._everything.update(time_s, ids, xy, drives)

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._everything.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """The columns that are left."""
        return self._everything.features(seconds, sums, instant)[:, self._COLUMNS]
