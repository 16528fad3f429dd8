"""The free-flow speed of a place: the mean speed of its drivers when nothing holds them up.

Positions do not show the speed limit, so a driver's speed is compared with this mean instead.
Feature names call it the pace.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MEMORY_S: Final = 300.0
"""Time constant of the exponential forgetting; many drivers pass meanwhile."""

LEAST_DRIVER_S: Final = 5.0
"""Seconds of free driving, summed over drivers, before a mean is given."""


class FreeFlowSpeed:
    """Running mean of the speed of drivers with a free road.

    Example:
        >>> free_flow = FreeFlowSpeed()
        >>> for step in range(61):
        ...     mean = free_flow.update(step / 10, np.array([10.0, 14.0]), np.array([True, True]))
        >>> round(mean, 6)
        12.0
    """

    def __init__(self) -> None:
        self._time_s: float | None = None
        self._seconds = 0.0
        self._metres = 0.0

    def update(self, time_s: float, speed: FloatArray, free: BoolArray) -> float:
        """Add one moment to the mean.

        Args:
            time_s: later than at the call before.
            speed: (n,) m/s.
            free: (n,) whether each driver's road is free.

        Returns:
            The free-flow speed, m/s; NaN until enough free driving was observed.
        """
        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        kept = float(np.exp(-step_s / MEMORY_S))
        self._seconds = kept * self._seconds + step_s * float(free.sum())
        self._metres = kept * self._metres + step_s * float(speed[free].sum())
        return self.mean_mps

    @property
    def mean_mps(self) -> float:
        """The free-flow speed so far, m/s; NaN until enough free driving was observed."""
        return self._metres / self._seconds if self._seconds >= LEAST_DRIVER_S else float("nan")
