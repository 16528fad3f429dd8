"""The observer behind ``graphrqi-plus``: how drivers move, and how they treat their neighbours.

``QUANTITIES`` is the list of what is measured: each entry names a quantity, its scale, its values
and the condition under which it counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features import following_law
from graphrqi.features.free_flow import FreeFlowSpeed
from graphrqi.features.interaction import Interaction, differences, interactions
from graphrqi.features.kinematics import Kinematics, MotionEstimator
from graphrqi.features.observer import Observation, RunningSums
from graphrqi.features.spectral import INVARIANT_NAMES, SPECTRAL, GraphSpectrum, spectral_means
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import Sighting, TrafficGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

INTERACTION_NEIGHBORS: Final = 8
"""Nearest neighbours among which leaders are searched: on a three-lane road the four nearest are
often all in the next lanes."""

_CLOSE, _DISTANT, _MIDDLE = (1.0, 5.0), (2.5, 2.5), (1.5, 3.5)
"""Standstill gap, m, and braking, m/s2, that are assumed of a close, a distant and a middle
follower to compute the law's headway."""

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
_RELATIVE = tuple(round(0.3 + 0.06 * k, 2) for k in range(26))


class _Moment:
    """The drivers of one frame: the values and conditions that quantities are made of.

    Values are arrays (n,) in SI units: speed ``v``, acceleration ``a``, ``gap`` and others to the
    leader, NaN without one; ``relative`` is the speed over the free-flow speed of the place.
    Conditions are flags (n,).
    """

    def __init__(
        self,
        motion: Kinematics,
        around: Interaction,
        near: TrafficGraph,
        drives: BoolArray,
        free_flow: Callable[[FloatArray, BoolArray], float],
    ) -> None:
        v, a = np.maximum(motion.speed, 0.0), motion.acceleration
        gap, leader_speed = around.gap, around.leader_speed
        self.v, self.a, self.gap, self.leader_speed = v, a, gap, leader_speed
        self.around = around
        self.has_leader = has_leader = around.leader >= 0
        self.always = np.ones(v.size, dtype=bool)
        self.moving = moving = v > 2.0
        self.closing = v - leader_speed
        with np.errstate(divide="ignore", invalid="ignore"):
            self.headway = gap / v
        self.clear = ~has_leader | (gap > np.maximum(25.0, 4.0 * v))
        self.following = has_leader & moving & (self.headway < 5.0)
        self.steady = self.following & (np.abs(self.closing) < 0.7) & (np.abs(a) < 0.5)
        self.speed_signal = differences(near, v, drives)
        self.side = np.abs(motion.sideways)
        self.side_signal = np.abs(differences(near, motion.sideways, drives, scales=1)[:, 0])
        self.near_pedestrian = ~np.isnan(around.pedestrian_m)
        self.free = self.clear & (np.abs(a) < 0.5) & moving
        self.relative = v / free_flow(v, self.free & drives)
        self.pulling = (a > 0.2) & (v < 9.0)
        self.stopping = (a < -0.5) & (v > 1.0)
        self.halting = self.stopping & (~has_leader | (leader_speed < 0.5))
        self.starting = has_leader & (v < 0.3) & (leader_speed > 0.5)
        self.standing_s = v / np.maximum(-a, 0.1)
        self.close, self.distant, self.middle = (
            following_law.implied_headway(v, leader_speed, gap, *assumed)
            for assumed in (_CLOSE, _DISTANT, _MIDDLE)
        )

    def behind(self, law_headway: FloatArray) -> BoolArray:
        """(n,) whether a driver moves behind a leader at a gap that the law's headway explains."""
        return self.has_leader & (self.v > 0.7) & (law_headway < 7.0)


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of a driver under one condition.

    Attributes:
        name: its block's name, with which the feature names begin.
        nodes: the scale of its distribution, ascending.
        values: gives (n,) numbers and (n,) whether the condition holds, from a moment.
    """

    name: str
    nodes: tuple[float, ...]
    values: Callable[[_Moment], tuple[FloatArray, BoolArray]]


# fmt: off
QUANTITIES: Final[tuple[Quantity, ...]] = (
    Quantity("speed", _SPEED_MPS, lambda m: (m.v, m.always)),
    Quantity("free speed", _SPEED_MPS, lambda m: (m.v, m.free)),
    Quantity("speed over neighbours", _DIFFERENCE_MPS, lambda m: (m.speed_signal[:, 0], m.always)),
    Quantity("speed over wider neighbours", _DIFFERENCE_MPS, lambda m: (
        m.speed_signal[:, 1], m.always)),
    Quantity("acceleration", _ACCEL_MPS2, lambda m: (m.a, m.v > 0.5)),
    Quantity("acceleration when free", _ACCEL_MPS2, lambda m: (m.a, m.clear & m.moving)),
    Quantity("acceleration while following", _ACCEL_MPS2, lambda m: (m.a, m.following)),
    Quantity("pull-away", _POSITIVE_MPS2, lambda m: (
        m.a, m.pulling & (m.clear | (m.closing < 0.0)))),
    Quantity("braking", _POSITIVE_MPS2, lambda m: (-m.a, m.a < -0.3)),
    Quantity("headway while following", _HEADWAY_S, lambda m: (m.headway, m.following)),
    Quantity("headway", _HEADWAY_S, lambda m: (m.headway, m.has_leader & m.moving)),
    Quantity("steady headway", _HEADWAY_S, lambda m: (m.headway, m.steady)),
    Quantity("standstill gap", _STANDSTILL_M, lambda m: (
        m.gap, m.has_leader & (m.v < 0.3) & (m.leader_speed < 0.3))),
    Quantity("leader's speed before starting", _SLOW_MPS, lambda m: (m.leader_speed, m.starting)),
    Quantity("closing", _DIFFERENCE_MPS, lambda m: (m.closing, m.following)),
    Quantity("inverse time to collision", _INVERSE_TTC, lambda m: (
        np.maximum(m.closing, 0.0) / np.maximum(m.gap, 0.3), m.has_leader & (m.closing > 0.2))),
    Quantity("rear headway", _HEADWAY_S, lambda m: (
        m.around.rear_gap / np.maximum(m.around.rear_speed, 0.1),
        (m.around.follower >= 0) & m.moving)),
    Quantity("sideways", _SIDEWAYS_M, lambda m: (m.side, m.moving)),
    Quantity("sideways over neighbours", _SIDEWAYS_M, lambda m: (m.side_signal, m.moving)),
    Quantity("beside", (0.0, 1.0, 2.0, 4.0), lambda m: (m.around.beside, m.moving)),
    Quantity("speed near pedestrian", _SPEED_MPS, lambda m: (m.v, m.near_pedestrian)),
    Quantity("acceleration near pedestrian", _ACCEL_MPS2, lambda m: (m.a, m.near_pedestrian)),
    Quantity("free speed over pace", _RELATIVE, lambda m: (m.relative, m.free)),
    Quantity("speed over pace", _RELATIVE, lambda m: (m.relative, m.always)),
    Quantity("speed while turning", _SPEED_MPS, lambda m: (m.v, (m.side > 0.8) & (m.v > 1.0))),
    Quantity("braking when free", _POSITIVE_MPS2, lambda m: (-m.a, m.clear & (m.a < -0.3))),
    Quantity("waiting first", (0.0, 1.0), lambda m: (
        np.zeros(m.v.size), ~m.has_leader & (m.v < 0.3))),
    Quantity("pull-away when free", _POSITIVE_MPS2, lambda m: (m.a, m.pulling & m.clear)),
    Quantity("pull-away when slow", _POSITIVE_MPS2, lambda m: (m.a, (m.a > 0.2) & (m.v < 3.5))),
    Quantity("pull-away when fast", _POSITIVE_MPS2, lambda m: (
        m.a, (m.a > 0.2) & (m.v >= 7.5) & (m.clear | (m.closing < 0.0)))),
    Quantity("time to standing, free", _STANDING_S, lambda m: (m.standing_s, m.stopping & m.clear)),
    Quantity("time to standing, slow", _STANDING_S, lambda m: (
        m.standing_s, m.halting & (m.v < 6.0))),
    Quantity("time to standing, fast", _STANDING_S, lambda m: (
        m.standing_s, m.halting & (m.v >= 6.0))),
    Quantity("gap before starting", _GAP_M, lambda m: (m.gap, m.starting)),
    Quantity("gap while starting", _GAP_M, lambda m: (
        m.gap, m.has_leader & (m.v > 0.3) & (m.v < 2.5) & (m.a > 0.3) & (m.closing < 0.0))),
    Quantity("gap while creeping", _GAP_M, lambda m: (
        m.gap, m.has_leader & (m.v > 0.15) & (m.v < 1.5) & (m.leader_speed < 0.3))),
    Quantity("law's headway, close", _LAW_S, lambda m: (m.close, m.behind(m.close))),
    Quantity("law's headway, distant", _LAW_S, lambda m: (m.distant, m.behind(m.distant))),
    Quantity("law's headway, held up", _LAW_S, lambda m: (
        m.middle, m.behind(m.middle) & (m.a < 1.0))),
    Quantity("law's headway, closing", _LAW_S, lambda m: (
        m.middle, m.behind(m.middle) & (m.closing > 1.0))),
    Quantity("law's headway, opening", _LAW_S, lambda m: (
        m.middle, m.behind(m.middle) & (m.closing < -0.5))),
    Quantity("clear speed over pace", _RELATIVE, lambda m: (m.relative, m.clear & m.moving)),
    Quantity("pulling speed over pace", _RELATIVE, lambda m: (
        m.relative, m.clear & (m.a > 0.3) & (m.v > 5.0))),
    Quantity("acceleration near pace", _ACCEL_MPS2, lambda m: (m.a, m.clear & (m.relative > 0.8))),
    Quantity("slowing near pace", _ACCEL_MPS2, lambda m: (
        m.a, m.clear & (m.relative > 0.8) & (m.a < 0.2))),
)
# fmt: on
"""Everything whose distribution the driving observer measures, in the order of the features."""

BLOCKS: Final = tuple(Block(quantity.name, quantity.nodes) for quantity in QUANTITIES)
"""The distributions of the quantities."""

_MEASURED: Final = sum(len(block.nodes) for block in BLOCKS)
"""Columns of evidence that belong to the blocks; the car-following and spectral ones follow."""

_LAW: Final = 2 * following_law.COLUMNS
"""Columns of evidence on the car-following law: in steady following, and in all of it."""


_DISTRIBUTIONS: Final = describe_names(BLOCKS)
"""Features of the blocks; those of the law, of the spectrum and the time follow."""


class DrivingObserver:
    """How each driver moves, differs from its neighbours, and treats those around it.

    Args:
        solver: a key of ``SOLVERS`` for the spectral part.
    """

    feature_names = (
        *_DISTRIBUTIONS,
        *(f"{when}: {name}" for when in ("steady", "held up") for name in following_law.LAW_NAMES),
        *(f"spectrum_{name}" for name in INVARIANT_NAMES),
        "log_seconds",
    )

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = GraphSpectrum(solver)
        self._near = TrafficGraph.empty(neighbors=INTERACTION_NEIGHBORS, kind="instantaneous")
        self._motion = MotionEstimator()
        self._free_flow = FreeFlowSpeed()
        self._sums = RunningSums(_MEASURED + _LAW + SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        motion = self._motion.update(time_s, ids, xy)
        seen = Sighting.of(ids, xy)
        self._near = self._near.extended(seen)
        self._spectrum.observe(seen)
        around = interactions(motion, drives, self._near)
        moment = _Moment(
            motion, around, self._near, drives, partial(self._free_flow.update, time_s)
        )
        measured = [quantity.values(moment) for quantity in QUANTITIES]
        shape = len(BLOCKS), ids.size
        values = np.concatenate([value for value, _ in measured]).reshape(shape)
        counts = np.concatenate([condition for _, condition in measured]).reshape(shape)
        further = np.concatenate(
            [_law_evidence(moment), self._spectrum.moment(time_s, ids)], axis=1
        )
        if not drives.all():
            values, counts, further = values[:, drives], counts[:, drives], further[drives]
        sums, rows, step_s = self._sums.advance(time_s, ids[drives])
        spread(values, counts, BLOCKS, step_s, rows, sums)
        sums[rows, _MEASURED:] += further * step_s

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._sums.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) distributions of the quantities, the law, the mean spectrum, and the time."""
        law = sums[:, _MEASURED : _MEASURED + _LAW].reshape(-1, following_law.COLUMNS)
        out = np.empty((len(sums), len(DrivingObserver.feature_names)))
        describe(sums, BLOCKS, out)
        first, names = len(_DISTRIBUTIONS), 2 * len(following_law.LAW_NAMES)
        out[:, first : first + names] = following_law.infer(law).reshape(-1, names)
        out[:, first + names : -1] = spectral_means(sums[:, _MEASURED + _LAW :])
        out[:, -1] = np.log1p(seconds)
        return out


def _law_evidence(m: _Moment) -> FloatArray:
    """(n, 2 COLUMNS) products of the car-following law in steady following and in all of it."""
    held_up = m.steady | (m.has_leader & (m.headway < 5.0) & (m.a < -0.2) & (m.closing > 0.2))
    products = following_law.products(m.v, m.leader_speed, m.gap)
    out = np.zeros((m.v.size, 2, following_law.COLUMNS))
    out[m.steady, 0] = products[m.steady]
    out[held_up, 1] = products[held_up]
    return out.reshape(-1, _LAW)
