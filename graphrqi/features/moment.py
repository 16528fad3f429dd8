"""The drivers of one moment: the values and conditions that the features are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.features import following_law
from graphrqi.features.interaction import interactions
from graphrqi.features.motion import Motion
from graphrqi.features.scene import FreeFlowSpeed
from graphrqi.graph import TrafficGraph

_CLOSE, _DISTANT, _MIDDLE = (1.0, 5.0), (2.5, 2.5), (1.5, 3.5)
"""Assumed standstill gap, m, and braking, m/s2, of a close, a distant and a middle follower."""

Values = Callable[[Any], tuple[FloatArray, BoolArray]]
"""Gives (n,) numbers of a moment, and (n,) whether the condition holds."""

Quantities = tuple[tuple[str, tuple[float, ...], Values], ...]
"""Name, scale and values of each quantity."""


class Moment:
    """The drivers of one moment: the values and conditions that quantities are made of.

    Values are arrays (n,) in SI units, NaN where unknown: speed ``v``, acceleration ``a``, ``gap``
    to the leader and so on. Conditions are arrays (n,) of truth values.
    """

    STEADY_MPS2: float = 0.5
    """Largest acceleration of steady and of free driving."""

    def __init__(
        self, time_s: float, motion: Motion, near: TrafficGraph, free_flow: FreeFlowSpeed,
        slowest_mps: float,
    ) -> None:  # fmt: skip
        v, a = np.maximum(motion.speed, 0.0), motion.acceleration
        self.v, self.a, self.around = v, a, interactions(motion, motion.drives, near)
        self.gap, self.leader_speed = self.around.gap, self.around.leader_speed
        self.side = np.abs(motion.sideways)
        self.has_leader = has_leader = self.around.leader >= 0
        self.has_follower = self.around.follower >= 0
        self.always = np.ones(v.size, dtype=bool)
        self.moving = v > slowest_mps
        self.closing = v - self.leader_speed
        with np.errstate(divide="ignore", invalid="ignore"):
            self.headway = self.gap / v
        self.rear_headway = self.around.rear_gap / np.maximum(self.around.rear_speed, 0.1)
        self.clear = ~has_leader | (self.gap > np.maximum(25.0, 4.0 * v))
        self.following = has_leader & self.moving & (self.headway < 5.0)
        self.steady = self.following & self.is_steady()
        self.free = self.clear & (np.abs(a) < self.STEADY_MPS2) & self.moving & motion.drives
        self.over_pace = v / free_flow.update(time_s, v, self.free)
        self.near_pedestrian = ~np.isnan(self.around.pedestrian_m)
        self.stopping = (a < -0.5) & (v > 1.0)
        self.standing_s = v / np.maximum(-a, 0.1)
        self.close, self.distant, self.middle = (
            following_law.implied_headway(v, self.leader_speed, self.gap, *assumed)
            for assumed in (_CLOSE, _DISTANT, _MIDDLE)
        )

    def is_steady(self) -> BoolArray:
        """(n,) whether a driver keeps its speed and that of its leader."""
        raise NotImplementedError

    def behind(self, law_headway: FloatArray) -> BoolArray:
        """(n,) whether a driver moves behind a leader at a gap that the law's headway explains."""
        return self.has_leader & (self.v > 0.7) & (law_headway < 7.0)
