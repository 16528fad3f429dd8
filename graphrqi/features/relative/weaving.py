"""How restlessly drivers move: what some seconds of motion leave over beside a steady course.

A parabola through four seconds of smoothed positions is a steady course: a constant acceleration
along the road, a constant curvature across it. What is left over across it is weaving within a lane
or changing lanes, what is left over along it is unrest of the speed. Simulated cars keep to lines;
people sway.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematics import align
from graphrqi.features.relative.smooth_motion import SmoothedMotion

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STRETCH_S: Final = 4.0
"""Length of a course, s (our choice: a lane change takes about as long)."""

LEAST_MOMENTS: Final = 6
"""Fewest moments that make a course: a parabola passes through three."""

LEAST_SHARE: Final = 0.8
"""Share of the stretch that the moments of a course have to span."""


class Courses:
    """The last seconds of smoothed motion of every agent.

    Examples:
        A car that sways by 20 cm while it drives east:

        >>> courses = Courses()
        >>> for step in range(12):
        ...     east, north = 4.0 * step, 0.2 * (-1.0) ** (step // 2)
        ...     one = np.ones((1, 2))
        ...     moment = SmoothedMotion(
        ...         time_s=0.4 * step, ids=np.array([7]), drives=np.array([True]),
        ...         xy=np.array([[east, north]]), velocity=10.0 * one, direction=one * [1.0, 0.0],
        ...         speed=np.array([10.0]), acceleration=np.zeros(1), sideways=np.zeros(1))
        ...     across, along = courses.update(moment)
        >>> across.round(2), along.round(2)
        (array([0.23]), array([0.]))
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque()
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._trail: FloatArray = np.empty((0, 0, 2))

    def update(self, motion: SmoothedMotion) -> tuple[FloatArray, FloatArray]:
        """Add one moment.

        Args:
            motion: later than at the call before.

        Returns:
            (n,) root mean squares across and along the course of those that moved, m; NaN where an
            agent was not seen at every moment of it.
        """
        n = motion.ids.size
        drop = sum(time_s < motion.time_s - STRETCH_S - 1e-6 for time_s in self._times)
        for _ in range(drop):
            self._times.popleft()
        self._times.append(motion.time_s)
        trail = np.full((n, len(self._times), 2), np.nan)
        into, source = align(self._ids, motion.ids)
        trail[into, :-1] = self._trail[source, drop:]
        trail[:, -1] = motion.xy
        self._ids, self._trail = motion.ids, trail
        times = np.array(self._times) - motion.time_s
        if times.size < LEAST_MOMENTS or -times[0] < LEAST_SHARE * STRETCH_S:
            return np.full(n, np.nan), np.full(n, np.nan)
        left = trail - trail[:, :1]
        basis = np.linalg.qr(np.stack([np.ones_like(times), times, times * times], axis=1))[0]
        left = left - basis @ (basis.T @ left)
        chord = trail[:, -1] - trail[:, 0]
        length = np.hypot(chord[:, 0], chord[:, 1])
        with np.errstate(invalid="ignore", divide="ignore"):
            unit = np.where(length > 1.0, 1.0, np.nan)[:, None] * chord / length[:, None]
        spare = times.size - basis.shape[1]
        along = (left * unit[:, None]).sum(axis=2)
        across = left[..., 1] * unit[:, None, 0] - left[..., 0] * unit[:, None, 1]
        return tuple(np.sqrt((part * part).sum(axis=1) / spare) for part in (across, along))
