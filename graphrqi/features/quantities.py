"""The drivers of one moment: values, conditions, and the quantities that features are made of.

Quantities of raw motion are absolute numbers, in metres and seconds. Those of smoothed motion are
ratios, and comparisons with the scene's averages, which differ less between roads, sensors and
traffic laws. Absolute speeds, turning and weaving are included, since they are comparable within
one site.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.features import following_law
from graphrqi.features.interaction import differences, interactions, neighbor_speed
from graphrqi.features.motion import Motion
from graphrqi.features.scene import FreeFlowSpeed, PlaceSpeeds, UsualValues
from graphrqi.features.smooth_motion import Courses
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


# Scales with few nodes, of smoothed motion, have names with FEW.
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


MOVING_OF_PACE, STANDING_MPS = 0.25, 0.5
"""In slow traffic drivers of smoothed motion move above the first number times the free-flow speed,
at least above the second, m/s."""

TURNING_RAD_PER_S: Final = 0.12
"""Turning faster than this counts as turning: a change of lanes stays below it at town speeds."""

LEAST_LEFT_OVER_M: Final = 0.003
"""Least residual of a course and least noise, m."""


class SmoothedMoment(Moment):
    """A moment of smoothed motion, beside the scene's averages."""

    STEADY_MPS2 = 0.6

    def __init__(
        self, time_s: float, motion: Motion, near: TrafficGraph, free_flow: FreeFlowSpeed,
        places: PlaceSpeeds, usual: UsualValues, courses: Courses,
    ) -> None:  # fmt: skip
        super().__init__(time_s, motion, near, free_flow, slowest_moving(free_flow.mean_mps))
        v, a, drives = self.v, self.a, motion.drives
        self.weaving, self.unrest = courses.update(motion.time_s, motion.ids, motion.xy)
        passed = places.update(time_s, motion.xy, motion.velocity, self.moving & drives)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.over_neighbors = v / neighbor_speed(motion, drives, near)
            self.over_place = v / passed
            self.closing_share = self.closing / v
        self.inverse_ttc = np.maximum(self.closing, 0.0) / np.maximum(self.gap, 0.5)
        self.pulling = (a > 0.2) & (self.over_pace < 0.7)
        self.turning = (v > 1.0) & (self.side > TURNING_RAD_PER_S * v)
        self.starting = self.has_leader & (v < 0.5) & (self.leader_speed > 0.7)
        self.law = self.behind(self.middle)
        measured = [values(self) for values in COMPARED.values()]
        self.holds = np.stack([condition for _, condition in measured])
        compared = np.stack([value for value, _ in measured])
        self.deviations = usual.update(time_s, compared, self.holds & drives)

    def is_steady(self) -> BoolArray:
        """See `Moment.is_steady`."""
        return (np.abs(self.closing) < 0.1 * self.v) & (np.abs(self.a) < self.STEADY_MPS2)


def slowest_moving(pace_mps: float) -> float:
    """Speed above which drivers move, m/s, at a free-flow speed, m/s, which may be NaN."""
    if np.isnan(pace_mps):
        return MOVING_MPS
    return min(MOVING_MPS, max(STANDING_MPS, MOVING_OF_PACE * pace_mps))


def _log(values: FloatArray, least: float = 0.05) -> FloatArray:
    return np.log(np.maximum(values, least))


# fmt: off
COMPARED: Final[dict[str, Values]] = {
    "headway": lambda m: (_log(m.headway), m.following),
    "law's headway": lambda m: (_log(m.middle), m.law),
    "speed over pace": lambda m: (m.over_pace, m.clear & m.moving),
    "speed over place": lambda m: (m.over_place, m.moving),
    "speed over neighbours": lambda m: (m.over_neighbors, m.moving),
    "acceleration": lambda m: (m.a, m.a > 0.2),
    "braking": lambda m: (-m.a, m.a < -0.2),
    "standstill gap": lambda m: (
        m.gap, m.has_leader & (m.v < 0.3) & (m.leader_speed < 0.3) & (m.gap < 10.0)),
    "gap while starting": lambda m: (
        m.gap, m.has_leader & (m.v > 0.3) & (m.v < 2.5) & (m.a > 0.3) & (m.closing < 0.0)
        & (m.gap < 10.0)),
    "weaving": lambda m: (_log(m.weaving, LEAST_LEFT_OVER_M), m.moving),
    "unrest": lambda m: (_log(m.unrest, LEAST_LEFT_OVER_M), m.moving),
}
"""Quantities of smoothed motion that are also compared with the scene's mean."""

LEAST_DEVIATION: Final = np.array([0.15, 0.15, 0.03, 0.03, 0.03, 0.15, 0.15, 0.3, 0.3, 0.2, 0.2])
"""Smallest standard deviation of each, well below the differences between drivers of one site."""

_FEW_HEADWAY_S = (0.2, 0.35, 0.5, 0.7, 0.9, 1.15, 1.4, 1.7, 2.1, 2.6, 3.2, 4.0, 5.0)
_FEW_ACCEL_MPS2 = (-5.0, -3.5, -2.5, -1.7, -1.1, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.0, 1.5, 2.1,
                   3.0)
_FEW_POSITIVE_MPS2 = (0.0, 0.3, 0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.1, 4.0, 5.5)
_RATIO = (0.0, 0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.94, 1.0, 1.06, 1.12, 1.2, 1.3, 1.45, 1.7, 2.2)
_DEVIATIONS = (-3.0, -2.0, -1.4, -1.0, -0.7, -0.4, -0.15, 0.15, 0.4, 0.7, 1.0, 1.4, 2.0, 3.0)
_CLOSING = (-0.6, -0.3, -0.15, -0.07, 0.0, 0.07, 0.15, 0.3, 0.6)
_FEW_LAW_S = (-1.0, 0.0, 0.3, 0.5, 0.7, 0.9, 1.1, 1.35, 1.6, 2.0, 2.5, 3.2, 4.2, 6.0)
_FEW_STANDSTILL_M = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.2, 4.0, 5.0, 7.0)
_FEW_INVERSE_TTC = (0.0, 0.03, 0.07, 0.12, 0.2, 0.3, 0.5, 0.8)
_FEW_STANDING_S = (0.5, 1.0, 1.5, 2.0, 2.6, 3.3, 4.2, 5.5, 8.0)
_FEW_SPEED_MPS = (0.0, 1.0, 3.0, 5.0, 6.5, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.5,
                  18.0, 20.0, 23.0, 27.0, 32.0, 38.0)
_SIDEWAYS_MPS2 = (0.0, 0.1, 0.2, 0.4, 0.7, 1.1, 1.6, 2.2, 3.0)
_FEW_SLOW_MPS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)
_FEW_GAP_M = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 14.0, 20.0, 30.0)
_LEFT_OVER_M = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2)

SMOOTHED: Final[Quantities] = (
    ("headway while following", _FEW_HEADWAY_S, lambda m: (m.headway, m.following)),
    ("steady headway", _FEW_HEADWAY_S, lambda m: (m.headway, m.steady)),
    ("law's headway, close", _FEW_LAW_S, lambda m: (m.close, m.law)),
    ("law's headway, distant", _FEW_LAW_S, lambda m: (m.distant, m.law)),
    ("law's headway, held up", _FEW_LAW_S, lambda m: (m.middle, m.law & (m.a < 1.0))),
    ("law's headway, closing", _FEW_LAW_S, lambda m: (m.middle, m.law & (m.closing_share > 0.08))),
    ("law's headway, opening", _FEW_LAW_S, lambda m: (m.middle, m.law & (m.closing_share < -0.04))),
    ("closing", _CLOSING, lambda m: (m.closing_share, m.following)),
    ("inverse time to collision", _FEW_INVERSE_TTC, lambda m: (
        m.inverse_ttc, m.has_leader & (m.closing > 0.2))),
    ("rear headway", _FEW_HEADWAY_S, lambda m: (m.rear_headway, m.has_follower & m.moving)),
    ("speed over neighbours", _RATIO, lambda m: (m.over_neighbors, m.moving)),
    ("speed over place", _RATIO, lambda m: (m.over_place, m.moving)),
    ("clear speed over place", _RATIO, lambda m: (m.over_place, m.moving & m.clear)),
    ("speed over pace", _RATIO, lambda m: (m.over_pace, m.always)),
    ("free speed over pace", _RATIO, lambda m: (m.over_pace, m.free)),
    ("clear speed over pace", _RATIO, lambda m: (m.over_pace, m.clear & m.moving)),
    ("acceleration", _FEW_ACCEL_MPS2, lambda m: (m.a, m.v > 0.5)),
    ("acceleration when free", _FEW_ACCEL_MPS2, lambda m: (m.a, m.clear & m.moving)),
    ("acceleration while following", _FEW_ACCEL_MPS2, lambda m: (m.a, m.following)),
    ("pull-away", _FEW_POSITIVE_MPS2, lambda m: (m.a, m.pulling & (m.clear | (m.closing < 0.0)))),
    ("pull-away when slow", _FEW_POSITIVE_MPS2, lambda m: (m.a, (m.a > 0.2) & (m.over_pace < 0.3))),
    ("braking", _FEW_POSITIVE_MPS2, lambda m: (-m.a, m.a < -0.3)),
    ("braking when free", _FEW_POSITIVE_MPS2, lambda m: (-m.a, m.clear & (m.a < -0.3))),
    ("time to standing, free", _FEW_STANDING_S, lambda m: (m.standing_s, m.stopping & m.clear)),
    ("standstill gap", _FEW_STANDSTILL_M, COMPARED["standstill gap"]),
    ("gap while starting", _FEW_STANDSTILL_M, COMPARED["gap while starting"]),
    ("speed", _FEW_SPEED_MPS, lambda m: (m.v, m.always)),
    ("free speed", _FEW_SPEED_MPS, lambda m: (m.v, m.free)),
    ("clear speed", _FEW_SPEED_MPS, lambda m: (m.v, m.clear & m.moving)),
    ("speed while turning", _FEW_SPEED_MPS, lambda m: (m.v, m.turning)),
    ("sideways acceleration", _SIDEWAYS_MPS2, lambda m: (m.side, m.moving)),
    ("weaving", _LEFT_OVER_M, lambda m: (m.weaving, m.moving)),
    ("unrest", _LEFT_OVER_M, lambda m: (m.unrest, m.moving)),
    ("headway", _FEW_HEADWAY_S, lambda m: (m.headway, m.has_leader & m.moving)),
    ("beside", (0.0, 1.0, 2.0, 4.0), lambda m: (m.around.beside, m.moving)),
    ("speed near pedestrian", _FEW_SPEED_MPS, lambda m: (m.v, m.near_pedestrian)),
    ("acceleration near pedestrian", _FEW_ACCEL_MPS2, lambda m: (m.a, m.near_pedestrian)),
    ("waiting first", (0.0, 1.0), lambda m: (np.zeros(m.v.size), ~m.has_leader & (m.v < 0.5))),
    ("leader's speed before starting", _FEW_SLOW_MPS, lambda m: (m.leader_speed, m.starting)),
    ("gap before starting", _FEW_GAP_M, lambda m: (m.gap, m.starting)),
    ("pulling speed over pace", _RATIO, lambda m: (
        m.over_pace, m.clear & (m.a > 0.3) & (m.over_pace > 0.4))),
    ("acceleration near pace", _FEW_ACCEL_MPS2, lambda m: (m.a, m.clear & (m.over_pace > 0.8))),
    *(
        (f"{name}, compared", _DEVIATIONS,
         lambda m, k=k: (m.deviations[k], m.holds[k] & ~np.isnan(m.deviations[k])))
        for k, name in enumerate(COMPARED)
    ),
)
# fmt: on
"""Quantities of smoothed motion, in the order of the features."""
