"""Quantities of smoothed motion: ratios, and comparisons with the scene's averages.

They differ less between roads, sensors and traffic laws than absolute numbers do. Absolute speeds,
turning and weaving are included, since they are comparable within one site.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.features.interaction import neighbor_speed
from graphrqi.features.moment import Moment, Quantities, Values
from graphrqi.features.motion import Motion
from graphrqi.features.scene import FreeFlowSpeed, PlaceSpeeds, UsualValues
from graphrqi.features.smooth_motion import Courses
from graphrqi.graph import TrafficGraph

MOVING_MPS, MOVING_OF_PACE, STANDING_MPS = 2.0, 0.25, 0.5
"""Speed above which drivers move, m/s. In slow traffic it is the second number times the free-flow
speed, at least the third, m/s."""

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
    """Speed above which drivers move, m/s, where the free-flow speed is this; it may be NaN.

    Examples:
        >>> slowest_moving(14.0), slowest_moving(4.0), slowest_moving(float("nan"))
        (2.0, 1.0, 2.0)
    """
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

_HEADWAY_S = (0.2, 0.35, 0.5, 0.7, 0.9, 1.15, 1.4, 1.7, 2.1, 2.6, 3.2, 4.0, 5.0)
_ACCEL_MPS2 = (-5.0, -3.5, -2.5, -1.7, -1.1, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.0, 1.5, 2.1, 3.0)
_POSITIVE_MPS2 = (0.0, 0.3, 0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.1, 4.0, 5.5)
_RATIO = (0.0, 0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.94, 1.0, 1.06, 1.12, 1.2, 1.3, 1.45, 1.7, 2.2)
_DEVIATIONS = (-3.0, -2.0, -1.4, -1.0, -0.7, -0.4, -0.15, 0.15, 0.4, 0.7, 1.0, 1.4, 2.0, 3.0)
_CLOSING = (-0.6, -0.3, -0.15, -0.07, 0.0, 0.07, 0.15, 0.3, 0.6)
_LAW_S = (-1.0, 0.0, 0.3, 0.5, 0.7, 0.9, 1.1, 1.35, 1.6, 2.0, 2.5, 3.2, 4.2, 6.0)
_STANDSTILL_M = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.2, 4.0, 5.0, 7.0)
_INVERSE_TTC = (0.0, 0.03, 0.07, 0.12, 0.2, 0.3, 0.5, 0.8)
_STANDING_S = (0.5, 1.0, 1.5, 2.0, 2.6, 3.3, 4.2, 5.5, 8.0)
_SPEED_MPS = (0.0, 1.0, 3.0, 5.0, 6.5, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.5, 18.0,
              20.0, 23.0, 27.0, 32.0, 38.0)
_SIDEWAYS_MPS2 = (0.0, 0.1, 0.2, 0.4, 0.7, 1.1, 1.6, 2.2, 3.0)
_SLOW_MPS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)
_GAP_M = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 14.0, 20.0, 30.0)
_LEFT_OVER_M = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2)

SMOOTHED: Final[Quantities] = (
    ("headway while following", _HEADWAY_S, lambda m: (m.headway, m.following)),
    ("steady headway", _HEADWAY_S, lambda m: (m.headway, m.steady)),
    ("law's headway, close", _LAW_S, lambda m: (m.close, m.law)),
    ("law's headway, distant", _LAW_S, lambda m: (m.distant, m.law)),
    ("law's headway, held up", _LAW_S, lambda m: (m.middle, m.law & (m.a < 1.0))),
    ("law's headway, closing", _LAW_S, lambda m: (m.middle, m.law & (m.closing_share > 0.08))),
    ("law's headway, opening", _LAW_S, lambda m: (m.middle, m.law & (m.closing_share < -0.04))),
    ("closing", _CLOSING, lambda m: (m.closing_share, m.following)),
    ("inverse time to collision", _INVERSE_TTC, lambda m: (
        m.inverse_ttc, m.has_leader & (m.closing > 0.2))),
    ("rear headway", _HEADWAY_S, lambda m: (m.rear_headway, m.has_follower & m.moving)),
    ("speed over neighbours", _RATIO, lambda m: (m.over_neighbors, m.moving)),
    ("speed over place", _RATIO, lambda m: (m.over_place, m.moving)),
    ("clear speed over place", _RATIO, lambda m: (m.over_place, m.moving & m.clear)),
    ("speed over pace", _RATIO, lambda m: (m.over_pace, m.always)),
    ("free speed over pace", _RATIO, lambda m: (m.over_pace, m.free)),
    ("clear speed over pace", _RATIO, lambda m: (m.over_pace, m.clear & m.moving)),
    ("acceleration", _ACCEL_MPS2, lambda m: (m.a, m.v > 0.5)),
    ("acceleration when free", _ACCEL_MPS2, lambda m: (m.a, m.clear & m.moving)),
    ("acceleration while following", _ACCEL_MPS2, lambda m: (m.a, m.following)),
    ("pull-away", _POSITIVE_MPS2, lambda m: (m.a, m.pulling & (m.clear | (m.closing < 0.0)))),
    ("pull-away when slow", _POSITIVE_MPS2, lambda m: (m.a, (m.a > 0.2) & (m.over_pace < 0.3))),
    ("braking", _POSITIVE_MPS2, lambda m: (-m.a, m.a < -0.3)),
    ("braking when free", _POSITIVE_MPS2, lambda m: (-m.a, m.clear & (m.a < -0.3))),
    ("time to standing, free", _STANDING_S, lambda m: (m.standing_s, m.stopping & m.clear)),
    ("standstill gap", _STANDSTILL_M, COMPARED["standstill gap"]),
    ("gap while starting", _STANDSTILL_M, COMPARED["gap while starting"]),
    ("speed", _SPEED_MPS, lambda m: (m.v, m.always)),
    ("free speed", _SPEED_MPS, lambda m: (m.v, m.free)),
    ("clear speed", _SPEED_MPS, lambda m: (m.v, m.clear & m.moving)),
    ("speed while turning", _SPEED_MPS, lambda m: (m.v, m.turning)),
    ("sideways acceleration", _SIDEWAYS_MPS2, lambda m: (m.side, m.moving)),
    ("weaving", _LEFT_OVER_M, lambda m: (m.weaving, m.moving)),
    ("unrest", _LEFT_OVER_M, lambda m: (m.unrest, m.moving)),
    ("headway", _HEADWAY_S, lambda m: (m.headway, m.has_leader & m.moving)),
    ("beside", (0.0, 1.0, 2.0, 4.0), lambda m: (m.around.beside, m.moving)),
    ("speed near pedestrian", _SPEED_MPS, lambda m: (m.v, m.near_pedestrian)),
    ("acceleration near pedestrian", _ACCEL_MPS2, lambda m: (m.a, m.near_pedestrian)),
    ("waiting first", (0.0, 1.0), lambda m: (np.zeros(m.v.size), ~m.has_leader & (m.v < 0.5))),
    ("leader's speed before starting", _SLOW_MPS, lambda m: (m.leader_speed, m.starting)),
    ("gap before starting", _GAP_M, lambda m: (m.gap, m.starting)),
    ("pulling speed over pace", _RATIO, lambda m: (
        m.over_pace, m.clear & (m.a > 0.3) & (m.over_pace > 0.4))),
    ("acceleration near pace", _ACCEL_MPS2, lambda m: (m.a, m.clear & (m.over_pace > 0.8))),
    *(
        (f"{name}, compared", _DEVIATIONS,
         lambda m, k=k: (m.deviations[k], m.holds[k] & ~np.isnan(m.deviations[k])))
        for k, name in enumerate(COMPARED)
    ),
)
# fmt: on
"""Quantities of smoothed motion, in the order of the features."""
