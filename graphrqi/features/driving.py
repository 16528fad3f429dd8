"""The observer behind ``graphrqi-plus``: how drivers move, and how they treat their neighbours."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features import following_law
from graphrqi.features.evidence import Evidence
from graphrqi.features.graph_signal import differences
from graphrqi.features.graph_spectrum import SPECTRAL, GraphSpectrum, spectral_means
from graphrqi.features.interaction import Interaction, interactions
from graphrqi.features.kinematic import Motion, MotionEstimator
from graphrqi.features.observer import Observation
from graphrqi.features.pace import Pace
from graphrqi.features.spectral import INVARIANT_NAMES
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import TrafficGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

INTERACTION_NEIGHBORS: Final = 8
"""Nearest neighbours among which leaders are looked for (our choice: on a three-lane road the
four nearest are often all in the next lanes)."""

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

BLOCKS: Final[tuple[Block, ...]] = (
    Block("speed", _SPEED_MPS),
    Block("free speed", _SPEED_MPS),
    Block("speed over neighbours", _DIFFERENCE_MPS),
    Block("speed over wider neighbours", _DIFFERENCE_MPS),
    Block("acceleration", _ACCEL_MPS2),
    Block("acceleration when free", _ACCEL_MPS2),
    Block("acceleration while following", _ACCEL_MPS2),
    Block("pull-away", _POSITIVE_MPS2),
    Block("braking", _POSITIVE_MPS2),
    Block("headway while following", _HEADWAY_S),
    Block("headway", _HEADWAY_S),
    Block("steady headway", _HEADWAY_S),
    Block("standstill gap", _STANDSTILL_M),
    Block("leader's speed before starting", _SLOW_MPS),
    Block("closing", _DIFFERENCE_MPS),
    Block("inverse time to collision", _INVERSE_TTC),
    Block("rear headway", _HEADWAY_S),
    Block("sideways", _SIDEWAYS_M),
    Block("sideways over neighbours", _SIDEWAYS_M),
    Block("beside", (0.0, 1.0, 2.0, 4.0)),
    Block("speed near pedestrian", _SPEED_MPS),
    Block("acceleration near pedestrian", _ACCEL_MPS2),
    Block("free speed over pace", _OF_PACE),
    Block("speed over pace", _OF_PACE),
    Block("speed while turning", _SPEED_MPS),
    Block("braking when free", _POSITIVE_MPS2),
    Block("waiting first", (0.0, 1.0)),
    Block("pull-away when free", _POSITIVE_MPS2),
    Block("pull-away when slow", _POSITIVE_MPS2),
    Block("pull-away when fast", _POSITIVE_MPS2),
    Block("time to standing, free", _STANDING_S),
    Block("time to standing, slow", _STANDING_S),
    Block("time to standing, fast", _STANDING_S),
    Block("gap before starting", _GAP_M),
    Block("gap while starting", _GAP_M),
    Block("gap while creeping", _GAP_M),
    Block("law's headway, close", _LAW_S),
    Block("law's headway, distant", _LAW_S),
    Block("law's headway, held up", _LAW_S),
    Block("law's headway, closing", _LAW_S),
    Block("law's headway, opening", _LAW_S),
    Block("clear speed over pace", _OF_PACE),
    Block("pulling speed over pace", _OF_PACE),
    Block("acceleration near pace", _ACCEL_MPS2),
    Block("slowing near pace", _ACCEL_MPS2),
)
"""What the driving observer watches (our choice of quantities and scales)."""

_ASSUMED: Final = ((1.0, 5.0), (2.5, 2.5), (1.5, 3.5))
"""Standstill gap, m, and braking, m/s2, for the headways that the law implies: of a close, a
distant and a middle follower (our choice, about as far apart as drivers are)."""

_WATCHED: Final = sum(len(b.nodes) for b in BLOCKS)
"""Columns of evidence that belong to the blocks; the car-following and spectral ones follow."""

_LAW: Final = 2 * following_law.COLUMNS
"""Columns of evidence on the car-following law: in steady following, and in all of it."""


class DrivingObserver:
    """How each driver moves, differs from its neighbours, and treats those around it.

    Args:
        solver: a key of ``SOLVERS`` for the spectral part.
    """

    feature_names = (
        *describe_names(BLOCKS),
        *(f"{when}: {name}" for when in ("steady", "held up") for name in following_law.LAW_NAMES),
        *(f"spectrum_{name}" for name in INVARIANT_NAMES),
        "log_seconds",
    )

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = GraphSpectrum(solver)
        self._near = TrafficGraph.empty(neighbors=INTERACTION_NEIGHBORS, kind="instantaneous")
        self._motion = MotionEstimator()
        self._pace = Pace()
        self._evidence = Evidence(_WATCHED + _LAW + SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        motion = self._motion.update(time_s, ids, xy)
        self._near = self._near.observe(ids, xy)
        self._spectrum.observe(ids, xy)
        around = interactions(motion, drives, self._near)
        moment = np.zeros((ids.size, _WATCHED + _LAW + SPECTRAL))
        self._watch(time_s, motion, around, drives, moment)
        moment[:, _WATCHED + _LAW :] = self._spectrum.moment(time_s, ids)
        everyone = bool(drives.all())  # spares a copy
        self._evidence.add(time_s, ids[drives], moment if everyone else moment[drives])

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._evidence.observation()

    def _watch(
        self,
        time_s: float,
        motion: Motion,
        around: Interaction,
        drives: BoolArray,
        out: FloatArray,
    ) -> None:
        """Write this moment's weights of every block."""
        v, a = np.maximum(motion.speed, 0.0), motion.acceleration
        moving = v > 2.0
        gap, rear = around.gap, around.rear_gap
        has_leader, has_follower = around.leader >= 0, around.follower >= 0
        closing = v - around.leader_speed
        with np.errstate(divide="ignore", invalid="ignore"):
            headway = gap / v
            rear_headway = rear / np.maximum(around.rear_speed, 0.1)
            inverse_ttc = np.maximum(closing, 0.0) / np.maximum(gap, 0.3)
            to_standing = v / np.maximum(-a, 0.1)
        clear = ~has_leader | (gap > np.maximum(25.0, 4.0 * v))
        following = has_leader & moving & (headway < 5.0)
        speed_signal = differences(self._near, v, drives)
        sideways_signal = differences(self._near, motion.sideways, drives, scales=1)
        side = np.abs(motion.sideways)
        standing = has_leader & (v < 0.3) & (around.leader_speed < 0.3)
        walker = ~np.isnan(around.pedestrian_m)
        always = np.ones(v.size, dtype=bool)
        free = clear & (np.abs(a) < 0.5) & moving
        of_pace = v / self._pace.update(time_s, v, free & drives)
        pulling = (a > 0.2) & (v < 9.0)
        stopping = (a < -0.5) & (v > 1.0)
        unmoved = ~has_leader | (around.leader_speed < 0.5)
        starting = has_leader & (v < 0.3) & (around.leader_speed > 0.5)
        behind = has_leader & (v > 0.7)
        close, distant, middle = (
            following_law.implied_headway(v, around.leader_speed, gap, *assumed)
            for assumed in _ASSUMED
        )
        watched: tuple[tuple[FloatArray, BoolArray], ...] = (
            (v, always),
            (v, free),
            (speed_signal[:, 0], always),
            (speed_signal[:, 1], always),
            (a, v > 0.5),
            (a, clear & moving),
            (a, following),
            (a, pulling & (clear | (closing < 0.0))),
            (-a, a < -0.3),
            (headway, following),
            (headway, has_leader & moving),
            (headway, following & (np.abs(closing) < 0.7) & (np.abs(a) < 0.5)),
            (gap, standing),
            (around.leader_speed, starting),
            (closing, following),
            (inverse_ttc, has_leader & (closing > 0.2)),
            (rear_headway, has_follower & moving),
            (side, moving),
            (np.abs(sideways_signal[:, 0]), moving),
            (around.beside, moving),
            (v, walker),
            (a, walker),
            (of_pace, free),
            (of_pace, always),
            (v, (side > 0.8) & (v > 1.0)),
            (-a, clear & (a < -0.3)),
            (np.zeros(v.size), ~has_leader & (v < 0.3)),
            (a, pulling & clear),
            (a, (a > 0.2) & (v < 3.5)),
            (a, (a > 0.2) & (v >= 7.5) & (clear | (closing < 0.0))),
            (to_standing, stopping & clear),
            (to_standing, stopping & unmoved & (v < 6.0)),
            (to_standing, stopping & unmoved & (v >= 6.0)),
            (gap, starting),
            (gap, has_leader & (v > 0.3) & (v < 2.5) & (a > 0.3) & (closing < 0.0)),
            (gap, has_leader & (v > 0.15) & (v < 1.5) & (around.leader_speed < 0.3)),
            (close, behind & (close < 7.0)),
            (distant, behind & (distant < 7.0)),
            (middle, behind & (middle < 7.0) & (a < 1.0)),
            (middle, behind & (middle < 7.0) & (closing > 1.0)),
            (middle, behind & (middle < 7.0) & (closing < -0.5)),
            (of_pace, clear & moving),
            (of_pace, clear & (a > 0.3) & (v > 5.0)),
            (a, clear & (of_pace > 0.8)),
            (a, clear & (of_pace > 0.8) & (a < 0.2)),
        )
        shape = len(BLOCKS), v.size
        values = np.concatenate([value for value, _ in watched]).reshape(shape)
        counts = np.concatenate([condition for _, condition in watched]).reshape(shape)
        spread(values, counts, BLOCKS, out)

        steady = following & (np.abs(closing) < 0.7) & (np.abs(a) < 0.5)
        held_up = steady | (has_leader & (headway < 5.0) & (a < -0.2) & (closing > 0.2))
        for number, condition in enumerate((steady, held_up)):
            start = _WATCHED + number * following_law.COLUMNS
            out[:, start : start + following_law.COLUMNS] = following_law.products(
                v, around.leader_speed, gap, condition
            )

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Distributions of what was watched, mean spectral features, and the time observed."""
        law = sums[:, _WATCHED : _WATCHED + _LAW].reshape(-1, following_law.COLUMNS)
        return np.concatenate(
            [
                describe(sums, BLOCKS),
                following_law.infer(law).reshape(len(sums), 2 * len(following_law.LAW_NAMES)),
                spectral_means(sums[:, _WATCHED + _LAW :]),
                np.log1p(seconds)[:, None],
            ],
            axis=1,
        )
