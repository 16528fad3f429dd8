"""Trajectory features of Cheung et al.: speeds, distances and jerk, and how much each varies.

Differs from the paper: positions do not show lanes. The deviation from the lane's centre is the
sideways displacement over the last second. One speed relative to all neighbours replaces those
relative to the left and the right one.

References:
    Cheung, Bera, Kubin, Gray, Manocha (2018), Identifying Driver Behaviors Using Trajectory
    Features for Vehicle Navigation, IROS, Table I.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.drivers import NEIGHBORS
from graphrqi.features.interaction import differences, interactions
from graphrqi.features.motion import RawMotion, align
from graphrqi.features.observer import Observer
from graphrqi.graph import TrafficGraph

QUANTITIES: Final = (
    "speed",
    "acceleration",
    "jerk",
    "speed over leader",
    "speed over follower",
    "speed over neighbours",
    "front distance",
    "rear distance",
    "sideways",
)
"""Quantities that are averaged over the time observed."""

MAX_JERK_MPS3: Final = 20.0
"""Larger jerks are clipped as measurement noise; emergency braking reaches about 15."""

_K: Final = len(QUANTITIES)


class TrajectoryObserver(Observer):
    """Mean and deviation of each quantity, and the share of the time for which it was defined.

    The solver is not used.
    """

    feature_names = tuple(
        f"{name}:{what}" for what in ("mean", "deviation", "share") for name in QUANTITIES
    )

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__(solver, 3 * _K)
        self._near = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._motion = RawMotion()
        self._last: tuple[float, IntArray, FloatArray] = (0.0, np.empty(0, np.int64), np.empty(0))

    def _moment(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> FloatArray:
        """(n, 3 K) whether each quantity is defined, its value and its square."""
        motion = self._motion.update(time_s, ids, xy, drives)
        self._near = self._near.observe(ids, xy)
        around = interactions(motion, drives, self._near)
        before_s, before_ids, before = self._last
        jerk = np.full(ids.size, np.nan)
        into, source = align(before_ids, ids)
        if into.size:
            jerk[into] = (motion.acceleration[into] - before[source]) / (time_s - before_s)
        self._last = (time_s, ids, motion.acceleration)
        value = np.stack(
            [
                motion.speed,
                motion.acceleration,
                np.clip(jerk, -MAX_JERK_MPS3, MAX_JERK_MPS3),
                motion.speed - around.leader_speed,
                motion.speed - around.rear_speed,
                differences(self._near, motion.speed, drives, scales=1)[:, 0],
                around.gap,
                around.rear_gap,
                np.abs(motion.sideways),
            ],
            axis=1,
        )
        known = ~np.isnan(value)
        value = np.where(known, value, 0.0)
        return np.concatenate([known, value, value**2], axis=1, dtype=np.float64)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, 27) means, deviations and shares of the time."""
        total = np.maximum(sums[:, :_K], 0.0)
        over = np.where(total > 1e-9, total, 1.0)
        mean = sums[:, _K : 2 * _K] / over
        variance = np.maximum(sums[:, 2 * _K :] / over - mean**2, 0.0)
        share = np.minimum(total / np.maximum(seconds, 1e-9)[:, None], 1.0)
        return np.concatenate([mean, np.sqrt(variance), share], axis=1)
