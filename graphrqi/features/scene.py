"""Averages of a scene: its free-flow speed, the speeds at its positions, means and deviations.

Limits, traffic laws, weather and sensors change all drivers' numbers at a site. A driver is
therefore also compared with the averages around it. All means forget exponentially, with the time
constant `MEMORY_S`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray

MEMORY_S: Final = 300.0
"""Time constant of the exponential forgetting, s; many drivers pass meanwhile."""

LEAST_FREE_S: Final = 5.0
"""Seconds of free driving, summed over drivers, before a free-flow speed is given."""

LEAST_DRIVER_S: Final = 20.0
"""Seconds of observation, summed over drivers, before an average is given."""

CELL_M: Final = 15.0
"""Side of the squares in which speeds are averaged: three car lengths."""

SECTORS: Final = 8
"""Directions of travel that are kept apart in a square."""

TABLE: Final = 1 << 14
"""Cells that are remembered; two cells that share an entry by chance are averaged."""

LEAST_PLACE_S: Final = 2.0
"""Seconds of observation of a cell before its mean speed is given."""


class FadingSums:
    """Sums over time that forget exponentially."""

    def __init__(self, shape: tuple[int, ...], memory_s: float = MEMORY_S) -> None:
        self.values, self._memory_s = np.zeros(shape), memory_s
        self._time_s: float | None = None

    def fade(self, time_s: float) -> float:
        """Forget up to a time; returns the seconds since the last call, 0 at the first one."""
        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        self.values *= np.exp(-max(step_s, 0.0) / self._memory_s)
        return step_s


class FreeFlowSpeed:
    """Running mean of the speed of drivers with a free road; feature names call it the pace.

    Positions do not show the speed limit, so a driver's speed is compared with this mean instead.

    Example:
        >>> free_flow = FreeFlowSpeed()
        >>> for step in range(61):
        ...     mean = free_flow.update(step / 10, np.array([10.0, 14.0]), np.array([True, True]))
        >>> round(mean, 6)
        12.0
    """

    def __init__(self) -> None:
        self._sums = FadingSums((2,))

    def update(self, time_s: float, speed: FloatArray, free: BoolArray) -> float:
        """Add one moment's speeds, m/s, of drivers whose road is free; see `mean_mps`."""
        step_s = self._sums.fade(time_s)
        self._sums.values += step_s * np.array([free.sum(), speed[free].sum()])
        return self.mean_mps

    @property
    def mean_mps(self) -> float:
        """The free-flow speed so far, m/s; NaN until enough free driving was observed."""
        seconds, metres = self._sums.values.tolist()
        return metres / seconds if seconds >= LEAST_FREE_S else float("nan")


class UsualValues:
    """Running mean and standard deviation over all drivers of Q quantities.

    Their standard deviations count as no smaller than given ones (Q,).

    Examples:
        >>> usual = UsualValues(np.array([0.1]))
        >>> values, holds = np.array([[1.0, 3.0]]), np.array([[True, True]])
        >>> for step in range(60):
        ...     standardised = usual.update(step * 0.5, values, holds)
        >>> standardised.round(2)
        array([[-1.,  1.]])
    """

    def __init__(self, least_deviation: FloatArray) -> None:
        self._least = least_deviation
        self._sums = FadingSums((3, least_deviation.size))

    def update(self, time_s: float, values: FloatArray, holds: BoolArray) -> FloatArray:
        """Add one moment's values (Q, n) that hold (Q, n), and compare each with the averages.

        Returns:
            (Q, n) distances from the mean in standard deviations, clipped at 4; NaN until enough
            was observed.
        """
        step_s = self._sums.fade(time_s)
        counted = holds & ~np.isnan(values)
        known = np.where(counted, values, 0.0)
        self._sums.values += step_s * np.stack(
            [counted.sum(axis=1), known.sum(axis=1), (known * known).sum(axis=1)]
        )
        mean, deviation = self.moments
        return np.clip((values - mean[:, None]) / deviation[:, None], -4.0, 4.0)

    @property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """(Q,) means and (Q,) standard deviations; NaN until enough was observed."""
        total, first, second = self._sums.values
        seconds = np.where(total >= LEAST_DRIVER_S, total, np.nan)
        mean = first / seconds
        variance = np.maximum(second / seconds - mean * mean, 0.0)
        return mean, np.maximum(np.sqrt(variance), self._least)


class PlaceSpeeds:
    """Running mean of the speed of vehicles that pass a cell in one direction.

    Examples:
        >>> places = PlaceSpeeds()
        >>> xy, velocity = np.zeros((2, 2)), np.array([[10.0, 0.0], [14.0, 0.0]])
        >>> for step in range(9):
        ...     usual = places.update(step * 0.5, xy, velocity, np.ones(2, dtype=bool))
        >>> usual.round(6)
        array([12., 12.])
    """

    def __init__(self) -> None:
        self._sums = FadingSums((2, TABLE))

    def update(
        self, time_s: float, xy: FloatArray, velocity: FloatArray, counts: BoolArray
    ) -> FloatArray:
        """(n,) mean speed at each position before this moment, m/s; then the moment is added.

        It is NaN where the cell was observed too briefly. Only vehicles that count add to the
        means.
        """
        step_s = self._sums.fade(time_s)
        at = _entries(xy, velocity)
        seconds, metres = self._sums.values[:, at]
        with np.errstate(divide="ignore", invalid="ignore"):
            usual = np.where(seconds >= LEAST_PLACE_S, metres / seconds, np.nan)
        passed = at[counts]
        np.add.at(self._sums.values[0], passed, step_s)
        np.add.at(self._sums.values[1], passed, step_s * np.hypot(*velocity[counts].T))
        return usual


def _entries(xy: FloatArray, velocity: FloatArray) -> IntArray:
    """(n,) entries of the table for positions and directions of travel."""
    cell = np.floor(xy / CELL_M).astype(np.int64)
    angle = np.arctan2(velocity[:, 1], velocity[:, 0])
    sector = np.floor(angle / (2.0 * np.pi) * SECTORS + 0.5).astype(np.int64) % SECTORS
    # Large odd factors spread neighbouring squares over the table (multiplicative hashing).
    mixed = cell[:, 0] * 73856093 ^ cell[:, 1] * 19349663 ^ sector * 83492791
    return np.asarray(mixed % TABLE)
