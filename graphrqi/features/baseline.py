"""The features of the baseline methods: motion and interaction of the driving observer alone.

They lack graph signals, the spectrum and the inferred car-following law, so that a difference to
``graphrqi-plus`` is due to these.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.driving import BLOCKS, DrivingObserver
from graphrqi.features.statistics import describe_names

FloatArray = NDArray[np.float64]

GRAPH_SIGNALS: Final = (
    "speed over neighbours",
    "speed over wider neighbours",
    "sideways over neighbours",
)
"""Blocks that compare a driver with its neighbourhood in the graph."""

LAW_HEADWAYS: Final = tuple(b.name for b in BLOCKS if b.name.startswith("law's headway"))
"""Blocks that interpret the gap by the car-following law."""

FREE_FLOW: Final = tuple(b.name for b in BLOCKS if b.name.endswith("pace"))
"""Blocks that need the free-flow speed of the place."""

_NAMES: Final = (
    *describe_names(tuple(b for b in BLOCKS if b.name not in GRAPH_SIGNALS + LAW_HEADWAYS)),
    "log_seconds",
)


class BaselineObserver(DrivingObserver):
    """Distributions of how each driver moves and keeps its distance.

    Args:
        solver: a key of ``SOLVERS``; the spectrum is computed but not used.
    """

    feature_names = tuple(name for name in DrivingObserver.feature_names if name in _NAMES)

    _COLUMNS: Final = np.flatnonzero([name in _NAMES for name in DrivingObserver.feature_names])

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) the columns of the driving observer that are left."""
        return super().features(seconds, sums, instant)[:, self._COLUMNS]
