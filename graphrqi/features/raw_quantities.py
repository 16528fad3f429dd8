"""Quantities of raw motion: absolute numbers, in metres and seconds."""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray
from graphrqi.features.interaction import differences
from graphrqi.features.moment import Moment, Quantities
from graphrqi.features.motion import Motion
from graphrqi.features.scene import FreeFlowSpeed
from graphrqi.graph import TrafficGraph

MOVING_MPS: Final = 2.0
"""Speed above which a driver moves, m/s."""


class RawMoment(Moment):
    """A moment of raw motion, with signals on the graph."""

    def __init__(
        self, time_s: float, motion: Motion, near: TrafficGraph, free_flow: FreeFlowSpeed
    ) -> None:
        super().__init__(time_s, motion, near, free_flow, MOVING_MPS)
        v, a, drives = self.v, self.a, motion.drives
        self.speed_signal = differences(near, v, drives)
        self.side_signal = np.abs(differences(near, motion.sideways, drives, scales=1)[:, 0])
        self.inverse_ttc = np.maximum(self.closing, 0.0) / np.maximum(self.gap, 0.3)
        self.pulling = (a > 0.2) & (v < 9.0)
        self.halting = self.stopping & (~self.has_leader | (self.leader_speed < 0.5))
        self.starting = self.has_leader & (v < 0.3) & (self.leader_speed > 0.5)

    def is_steady(self) -> BoolArray:
        """See `Moment.is_steady`."""
        return (np.abs(self.closing) < 0.7) & (np.abs(self.a) < self.STEADY_MPS2)

    @property
    def held_up(self) -> BoolArray:
        """(n,) whether a driver follows steadily, or brakes for its leader."""
        braking = (self.headway < 5.0) & (self.a < -0.2) & (self.closing > 0.2)
        return self.steady | (self.has_leader & braking)


_HEADWAY_S = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9, 1.1, 1.3, 1.55, 1.85, 2.2, 2.6, 3.1, 3.8, 5.0)
_SPEED_MPS = (0.0, 0.5, 2.0, 4.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0,
              17.0, 18.0, 20.0, 22.0, 24.0, 30.0)  # fmt: skip
_ACCEL_MPS2 = (-7.0, -5.0, -3.5, -2.5, -1.7, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 0.8, 1.1, 1.4, 1.7,
               2.1, 2.6, 3.2, 4.0, 5.0)  # fmt: skip
_POSITIVE_MPS2 = (0.0, 0.3, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.1, 2.4, 2.7, 3.0, 3.4, 3.8, 4.3,
                  5.0, 6.5, 8.0)  # fmt: skip
_DIFFERENCE_MPS = (-10.0, -6.0, -4.0, -2.5, -1.5, -0.8, -0.3, 0.0, 0.3, 0.8, 1.5, 2.5, 4.0, 6.0,
                   10.0)  # fmt: skip
_STANDSTILL_M = (0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 8.0)
_SIDEWAYS_M = (0.0, 0.2, 0.5, 1.0, 1.8, 3.0, 4.5)
_INVERSE_TTC = (0.0, 0.03, 0.07, 0.12, 0.2, 0.3, 0.5, 0.8, 1.5)
_SLOW_MPS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
_STANDING_S = (0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.5, 3.0, 3.6, 4.3, 5.2, 6.5, 8.5, 12.0)
_GAP_M = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.5, 9.0, 12.0, 16.0, 22.0, 30.0)
_LAW_S = (-1.0, -0.3, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.5, 1.8, 2.2, 2.6, 3.1, 3.8, 5.0, 7.0)
_OF_PACE = tuple(round(0.3 + 0.06 * k, 2) for k in range(26))

# fmt: off
RAW: Final[Quantities] = (
    ("speed", _SPEED_MPS, lambda m: (m.v, m.always)),
    ("free speed", _SPEED_MPS, lambda m: (m.v, m.free)),
    ("speed over neighbours", _DIFFERENCE_MPS, lambda m: (m.speed_signal[:, 0], m.always)),
    ("speed over wider neighbours", _DIFFERENCE_MPS, lambda m: (m.speed_signal[:, 1], m.always)),
    ("acceleration", _ACCEL_MPS2, lambda m: (m.a, m.v > 0.5)),
    ("acceleration when free", _ACCEL_MPS2, lambda m: (m.a, m.clear & m.moving)),
    ("acceleration while following", _ACCEL_MPS2, lambda m: (m.a, m.following)),
    ("pull-away", _POSITIVE_MPS2, lambda m: (m.a, m.pulling & (m.clear | (m.closing < 0.0)))),
    ("braking", _POSITIVE_MPS2, lambda m: (-m.a, m.a < -0.3)),
    ("headway while following", _HEADWAY_S, lambda m: (m.headway, m.following)),
    ("headway", _HEADWAY_S, lambda m: (m.headway, m.has_leader & m.moving)),
    ("steady headway", _HEADWAY_S, lambda m: (m.headway, m.steady)),
    ("standstill gap", _STANDSTILL_M, lambda m: (
        m.gap, m.has_leader & (m.v < 0.3) & (m.leader_speed < 0.3))),
    ("leader's speed before starting", _SLOW_MPS, lambda m: (m.leader_speed, m.starting)),
    ("closing", _DIFFERENCE_MPS, lambda m: (m.closing, m.following)),
    ("inverse time to collision", _INVERSE_TTC, lambda m: (
        m.inverse_ttc, m.has_leader & (m.closing > 0.2))),
    ("rear headway", _HEADWAY_S, lambda m: (m.rear_headway, m.has_follower & m.moving)),
    ("sideways", _SIDEWAYS_M, lambda m: (m.side, m.moving)),
    ("sideways over neighbours", _SIDEWAYS_M, lambda m: (m.side_signal, m.moving)),
    ("beside", (0.0, 1.0, 2.0, 4.0), lambda m: (m.around.beside, m.moving)),
    ("speed near pedestrian", _SPEED_MPS, lambda m: (m.v, m.near_pedestrian)),
    ("acceleration near pedestrian", _ACCEL_MPS2, lambda m: (m.a, m.near_pedestrian)),
    ("free speed over pace", _OF_PACE, lambda m: (m.over_pace, m.free)),
    ("speed over pace", _OF_PACE, lambda m: (m.over_pace, m.always)),
    ("speed while turning", _SPEED_MPS, lambda m: (m.v, (m.side > 0.8) & (m.v > 1.0))),
    ("braking when free", _POSITIVE_MPS2, lambda m: (-m.a, m.clear & (m.a < -0.3))),
    ("waiting first", (0.0, 1.0), lambda m: (np.zeros(m.v.size), ~m.has_leader & (m.v < 0.3))),
    ("pull-away when free", _POSITIVE_MPS2, lambda m: (m.a, m.pulling & m.clear)),
    ("pull-away when slow", _POSITIVE_MPS2, lambda m: (m.a, (m.a > 0.2) & (m.v < 3.5))),
    ("pull-away when fast", _POSITIVE_MPS2, lambda m: (
        m.a, (m.a > 0.2) & (m.v >= 7.5) & (m.clear | (m.closing < 0.0)))),
    ("time to standing, free", _STANDING_S, lambda m: (m.standing_s, m.stopping & m.clear)),
    ("time to standing, slow", _STANDING_S, lambda m: (m.standing_s, m.halting & (m.v < 6.0))),
    ("time to standing, fast", _STANDING_S, lambda m: (m.standing_s, m.halting & (m.v >= 6.0))),
    ("gap before starting", _GAP_M, lambda m: (m.gap, m.starting)),
    ("gap while starting", _GAP_M, lambda m: (
        m.gap, m.has_leader & (m.v > 0.3) & (m.v < 2.5) & (m.a > 0.3) & (m.closing < 0.0))),
    ("gap while creeping", _GAP_M, lambda m: (
        m.gap, m.has_leader & (m.v > 0.15) & (m.v < 1.5) & (m.leader_speed < 0.3))),
    ("law's headway, close", _LAW_S, lambda m: (m.close, m.behind(m.close))),
    ("law's headway, distant", _LAW_S, lambda m: (m.distant, m.behind(m.distant))),
    ("law's headway, held up", _LAW_S, lambda m: (m.middle, m.behind(m.middle) & (m.a < 1.0))),
    ("law's headway, closing", _LAW_S, lambda m: (
        m.middle, m.behind(m.middle) & (m.closing > 1.0))),
    ("law's headway, opening", _LAW_S, lambda m: (
        m.middle, m.behind(m.middle) & (m.closing < -0.5))),
    ("clear speed over pace", _OF_PACE, lambda m: (m.over_pace, m.clear & m.moving)),
    ("pulling speed over pace", _OF_PACE, lambda m: (
        m.over_pace, m.clear & (m.a > 0.3) & (m.v > 5.0))),
    ("acceleration near pace", _ACCEL_MPS2, lambda m: (m.a, m.clear & (m.over_pace > 0.8))),
    ("slowing near pace", _ACCEL_MPS2, lambda m: (
        m.a, m.clear & (m.over_pace > 0.8) & (m.a < 0.2))),
)
# fmt: on
"""Quantities of raw motion, in the order of the features."""

_SIGNALS: Final = (
    "speed over neighbours", "speed over wider neighbours", "sideways over neighbours",
)  # fmt: skip

PLAIN: Final[Quantities] = tuple(
    row for row in RAW if row[0] not in _SIGNALS and not row[0].startswith("law's headway")
)
"""Those that need neither signals on the graph nor the law of following."""
