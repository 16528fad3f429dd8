"""The observer for traffic of unknown kind: what drivers do, relative to their scene.

It measures smoothed motion (`graphrqi.features.relative.smooth_motion`) some times a second, and
describes each driver by ratios: its headways, its speed over that of its neighbours, of its place
and of free drivers, its accelerations, and all of these again in standard deviations from the
scene's mean. Absolute speeds, turning and weaving stand beside them: they differ more between roads
and rules of driving than between drivers, and say something about a driver only beside the same
numbers of others at its place. `SCENE_NAMES` are numbers of the whole scene.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features import following_law
from graphrqi.features.free_flow import FreeFlowSpeed
from graphrqi.features.interaction import Interaction, interactions
from graphrqi.features.observer import Observation, RunningSums
from graphrqi.features.relative.scene_statistics import PlaceSpeeds, UsualValues
from graphrqi.features.relative.smooth_motion import SmoothedMotion, SmoothMotion
from graphrqi.features.relative.weaving import Courses
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import TrafficGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

EVERY_S: Final = 0.4
"""Time between moments that are measured, s; half the shortest stretch that is smoothed."""

NEIGHBORS: Final = 8
"""Nearest neighbours among which leaders are searched, as at home."""

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
              20.0, 23.0, 27.0, 32.0, 38.0)  # fmt: skip
_SIDEWAYS_MPS2 = (0.0, 0.1, 0.2, 0.4, 0.7, 1.1, 1.6, 2.2, 3.0)
_SLOW_MPS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)
_GAP_M = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 14.0, 20.0, 30.0)
_LEFT_OVER_M = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2)


MOVING_MPS, MOVING_OF_PACE, STANDING_MPS = 2.0, 0.25, 0.5
"""Drivers move who are faster than 2 m/s or, where traffic is slow or its scale is only estimated,
than this share of the scene's pace, but not slower than a walk (our choices)."""

TURNING_RAD_PER_S: Final = 0.12
"""Turning faster than this counts as turning: a change of lanes stays below it at town speeds."""


class _Moment:
    """What one moment shows of every driver; arrays (n,), NaN where unknown."""

    def __init__(
        self,
        motion: SmoothedMotion,
        around: Interaction,
        near: TrafficGraph,
        free_flow: Callable[[FloatArray, BoolArray], float],
        places: Callable[[FloatArray, FloatArray, BoolArray], FloatArray],
        usual: Callable[[FloatArray, BoolArray], FloatArray],
        course: tuple[FloatArray, FloatArray],
        slowest_mps: float,
    ) -> None:
        drives = motion.drives
        self.weaving, self.unrest = course
        self.side = np.abs(motion.sideways)
        v, a = np.maximum(motion.speed, 0.0), motion.acceleration
        self.v, self.a, self.around = v, a, around
        self.gap, self.leader_speed = around.gap, around.leader_speed
        self.always = np.ones(v.size, dtype=bool)
        self.has_leader = has_leader = around.leader >= 0
        self.moving = moving = v > slowest_mps
        self.closing = v - self.leader_speed
        with np.errstate(divide="ignore", invalid="ignore"):
            self.headway = self.gap / v
            self.clear = ~has_leader | (self.gap > np.maximum(25.0, 4.0 * v))
            self.following = has_leader & moving & (self.headway < 5.0)
            self.steady = self.following & (np.abs(self.closing) < 0.1 * v) & (np.abs(a) < 0.6)
            self.free = self.clear & (np.abs(a) < 0.6) & moving & drives
            self.pace = free_flow(v, self.free)
            self.over_pace = v / self.pace
            self.over_neighbors = v / neighbor_speed(
                near, motion.velocity, motion.direction, drives
            )
            self.over_place = v / places(motion.xy, motion.velocity, moving & drives)
            self.closing_share = self.closing / v
            self.inverse_ttc = np.maximum(self.closing, 0.0) / np.maximum(self.gap, 0.5)
            self.pulling = (a > 0.2) & (self.over_pace < 0.7)
            self.stopping = (a < -0.5) & (v > 1.0)
            self.standing_s = v / np.maximum(-a, 0.1)
            self.close, self.distant, self.middle = (
                following_law.implied_headway(v, self.leader_speed, self.gap, *assumed)
                for assumed in ((1.0, 5.0), (2.5, 2.5), (1.5, 3.5))
            )
            self.rear_headway = around.rear_gap / np.maximum(around.rear_speed, 0.1)
        self.turning = (v > 1.0) & (self.side > TURNING_RAD_PER_S * v)
        self.starting = has_leader & (v < 0.5) & (self.leader_speed > 0.7)
        self.near_pedestrian = ~np.isnan(around.pedestrian_m)
        self.behind = has_leader & (v > 0.7) & (self.middle < 7.0)
        compared = np.stack([one(self)[0] for one in COMPARED.values()])
        holds = np.stack([one(self)[1] for one in COMPARED.values()])
        self.holds = holds
        self.deviations = usual(compared, holds & drives)


Values = Callable[[_Moment], tuple[FloatArray, BoolArray]]
"""Gives (n,) numbers and (n,) whether the condition holds."""


LEAST_LEFT_OVER_M: Final = 0.003
"""What a course leaves over, and noise, counts as at least this, m: simulated cars without noise
leave nothing."""


def _log(values: FloatArray, least: float = 0.05) -> FloatArray:
    return np.log(np.maximum(values, least))


# fmt: off
COMPARED: Final[dict[str, Values]] = {
    "headway": lambda m: (_log(m.headway), m.following),
    "law's headway": lambda m: (_log(m.middle), m.behind),
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
"""Quantities that are also compared with the scene's mean."""

LEAST_DEVIATION: Final = np.array([0.15, 0.15, 0.03, 0.03, 0.03, 0.15, 0.15, 0.3, 0.3, 0.2, 0.2])
"""Smallest standard deviation of each, well below what drivers of one place differ by."""

QUANTITIES: Final[tuple[tuple[str, tuple[float, ...], Values], ...]] = (
    ("headway while following", _HEADWAY_S, lambda m: (m.headway, m.following)),
    ("steady headway", _HEADWAY_S, lambda m: (m.headway, m.steady)),
    ("law's headway, close", _LAW_S, lambda m: (m.close, m.behind)),
    ("law's headway, distant", _LAW_S, lambda m: (m.distant, m.behind)),
    ("law's headway, held up", _LAW_S, lambda m: (m.middle, m.behind & (m.a < 1.0))),
    ("law's headway, closing", _LAW_S, lambda m: (m.middle, m.behind & (m.closing_share > 0.08))),
    ("law's headway, opening", _LAW_S, lambda m: (m.middle, m.behind & (m.closing_share < -0.04))),
    ("closing", _CLOSING, lambda m: (m.closing_share, m.following)),
    ("inverse time to collision", _INVERSE_TTC, lambda m: (
        m.inverse_ttc, m.has_leader & (m.closing > 0.2))),
    ("rear headway", _HEADWAY_S, lambda m: (
        m.rear_headway, (m.around.follower >= 0) & m.moving)),
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
"""Everything whose distribution is measured: name, scale, values."""

BLOCKS: Final = tuple(Block(name, nodes) for name, nodes, _ in QUANTITIES)
"""The distributions of the quantities."""

_MEASURED: Final = sum(len(block.nodes) for block in BLOCKS)
_LAW: Final = following_law.COLUMNS

LEFT_OVER: Final = ("weaving", "unrest")
"""What courses leave over. People are restless on a scale that no sensor's noise explains: beside a
noise of 1 to 3 cm, their median is 3 to 20 cm along the road; that of simulated drivers is below
the noise."""

SCENE_NAMES: Final = (
    "noise", "frame interval", "pace", "drivers", "share following", "share moving", "seconds",
    *(f"mean {name}" for name in COMPARED),
    *(f"deviation of {name}" for name in COMPARED),
    *(f"{name} over noise" for name in LEFT_OVER),
)  # fmt: skip
"""Numbers of the whole scene: standard deviation of the positions' errors, m; time between frames,
s; free-flow speed, m/s; drivers at once; shares of them; log(1 + seconds watched, at most
`LONGEST_S`); what is usual of ``COMPARED``; and logarithms of what courses leave over, relative to
the noise."""

MOST_AT_ONCE: Final = 10_000
"""Drivers whose features are computed at once (our choice: their evidence takes 30 MB)."""

LONGEST_S: Final = 60.0
"""Time watched beyond which a scene's numbers hardly change any more, s."""


UNKNOWN_SCENE: Final = -10.0
"""Stands for a number of the scene that is not known yet; below all of them, so that trees can
split it off."""


SHARE_GAIN: Final = 0.05
"""Weight of a moment in the running shares: they follow within some ten seconds."""


class RelativeObserver:
    """How each driver behaves relative to its scene.

    Args:
        solver: not used; every observer takes one.
    """

    feature_names = (
        *describe_names(BLOCKS),
        *following_law.LAW_NAMES,
        *(f"scene: {name}" for name in SCENE_NAMES),
        "log_seconds",
    )

    def __init__(self, solver: str = "graphrqi") -> None:
        self._motion = SmoothMotion()
        self._near = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._free_flow = FreeFlowSpeed()
        self._places = PlaceSpeeds()
        self._usual = UsualValues(LEAST_DEVIATION)
        self._courses = Courses()
        self._presence = RunningSums(0)
        self._sums = RunningSums(_MEASURED + _LAW)
        self._measured_s = -np.inf
        self._frozen: tuple[IntArray, FloatArray, FloatArray] | None = None
        self._first_s: float | None = None
        self._frame_s = float("nan")
        self._last_s = float("nan")
        self._shares = np.full(3, np.nan)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._first_s = time_s if self._first_s is None else self._first_s
        self._motion.push(time_s, ids, xy, drives)
        drivers = ids[drives]
        self._presence.add(time_s, drivers, np.zeros((drivers.size, 0)))
        step_s = time_s - self._last_s
        if step_s > 0.0:
            change = 0.0 if np.isnan(self._frame_s) else 0.1 * (step_s - self._frame_s)
            self._frame_s = step_s if np.isnan(self._frame_s) else self._frame_s + change
        self._last_s = time_s
        if time_s < self._measured_s + EVERY_S - 1e-6:
            return
        self._measured_s = time_s
        motion = self._motion.fit()
        if motion is not None and motion.ids.size:
            self._measure(time_s, motion)
        known = self._presence.remembered()
        self._frozen = known.ids, known.seconds, self.scene()

    def _measure(self, time_s: float, motion: SmoothedMotion) -> None:
        """Add what one moment shows."""
        drives = motion.drives
        self._near = self._near.observe(motion.ids, motion.xy)
        moment = _Moment(
            motion,
            interactions(motion, drives, self._near),
            self._near,
            partial(self._free_flow.update, time_s),
            partial(self._places.update, time_s),
            partial(self._usual.update, time_s),
            self._courses.update(motion),
            slowest_moving(self._free_flow.mean_mps),
        )
        self._count(drives, moment)
        measured = [values(moment) for _, _, values in QUANTITIES]
        values = np.stack([value for value, _ in measured])[:, drives]
        counts = np.stack([condition for _, condition in measured])[:, drives]
        products = following_law.products(moment.v, moment.leader_speed, moment.gap)
        products[~moment.steady] = 0.0
        sums, rows, step_s = self._sums.advance(time_s, motion.ids[drives])
        values, counts = np.ascontiguousarray(values), np.ascontiguousarray(counts)
        spread(values, counts, BLOCKS, step_s, rows, sums)
        sums[rows, _MEASURED:] += products[drives] * step_s

    def _count(self, drives: BoolArray, moment: _Moment) -> None:
        """Follow the number of drivers, and the shares of them that follow and that move."""
        if not drives.any():
            return
        now = np.array(
            [drives.sum(), moment.following[drives].mean(), moment.moving[drives].mean()]
        )
        first = np.isnan(self._shares)
        self._shares = np.where(first, now, self._shares + SHARE_GAIN * (now - self._shares))

    def scene(self) -> FloatArray:
        """(S,) the numbers of the scene so far, named by ``SCENE_NAMES``; NaN where unknown."""
        mean, deviation = self._usual.moments
        noise = np.log(max(self._motion.noise_m, LEAST_LEFT_OVER_M))
        left_over = [mean[list(COMPARED).index(name)] - noise for name in LEFT_OVER]
        watched_s = 0.0 if self._first_s is None else self._last_s - self._first_s
        return np.concatenate(
            [
                [self._motion.noise_m, self._frame_s, self._free_flow.mean_mps],
                self._shares,
                [np.log1p(min(watched_s, LONGEST_S))],
                mean,
                np.where(np.isnan(mean), np.nan, deviation),
                left_over,
            ]
        )

    def observation(self) -> Observation:
        """Evidence on the drivers present; the scene's numbers hold for all of them."""
        present = self.present()
        return self._with_evidence(present.ids, present.seconds, self.scene())

    def present(self) -> Observation:
        """The drivers present and for how long, without evidence."""
        return self._presence.observation()

    @property
    def is_noisy(self) -> bool:
        """Whether every moment so far showed noise; False before it can be known."""
        return self._motion.is_noisy

    @property
    def frame_s(self) -> float:
        """Usual time between frames, s; NaN before the second one."""
        return self._frame_s

    @property
    def measured_s(self) -> float:
        """Time of the last frame at which motion was measured, s; minus infinity before."""
        return self._measured_s

    def measured(self, most: int | None = None) -> Observation:
        """Evidence as of that frame, on the drivers that were present shortly before it.

        It stays the same until motion is measured again.

        Args:
            most: how many drivers; None for all. The scene's numbers are the same for each.
        """
        if self._frozen is None:
            return self._with_evidence(np.empty(0, dtype=np.int64), np.empty(0), self.scene())
        ids, seconds, scene = self._frozen
        return self._with_evidence(ids[:most], seconds[:most], scene)

    def described(self) -> tuple[Observation, FloatArray]:
        """What `measured` has, without the evidence, and the features that follow from it.

        They are computed for some drivers at a time: a crowd's evidence takes 3 kB for each.
        """
        nobody = np.empty(0, dtype=np.int64), np.empty(0), self.scene()
        ids, seconds, scene = self._frozen or nobody
        features = np.empty((ids.size, len(RelativeObserver.feature_names)))
        for at in range(0, ids.size, MOST_AT_ONCE):
            some = slice(at, at + MOST_AT_ONCE)
            part = self._with_evidence(ids[some], seconds[some], scene)
            features[some] = self.features(part.seconds, part.sums, part.instant)
        return Observation(ids, seconds, np.zeros((ids.size, 0)), np.zeros((ids.size, 0))), features

    def _with_evidence(self, ids: IntArray, seconds: FloatArray, scene: FloatArray) -> Observation:
        known = np.nan_to_num(scene, nan=UNKNOWN_SCENE)
        everywhere = np.broadcast_to(known, (ids.size, len(SCENE_NAMES)))
        return Observation(ids, seconds, self._sums.of(ids), everywhere)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) distributions of the quantities, the law, the scene, and the time."""
        out = np.empty((len(sums), len(RelativeObserver.feature_names)))
        describe(sums, BLOCKS, out)
        first = 7 * len(BLOCKS)
        law = first + len(following_law.LAW_NAMES)
        out[:, first:law] = following_law.infer(np.ascontiguousarray(sums[:, _MEASURED:]))
        out[:, law:-1] = instant
        out[:, -1] = np.log1p(seconds)
        return out


def slowest_moving(pace_mps: float) -> float:
    """Speed above which drivers move, m/s, where the pace is this; it may be NaN.

    Examples:
        >>> slowest_moving(14.0), slowest_moving(4.0), slowest_moving(float("nan"))
        (2.0, 1.0, 2.0)
    """
    if np.isnan(pace_mps):
        return MOVING_MPS
    return min(MOVING_MPS, max(STANDING_MPS, MOVING_OF_PACE * pace_mps))


def neighbor_speed(
    near: TrafficGraph, velocity: FloatArray, direction: FloatArray, drives: BoolArray
) -> FloatArray:
    """(n,) mean speed of the neighbours that drive the same way, m/s; NaN without one."""
    from graphrqi.features.kernels import speed_of_neighbors

    out = np.empty(drives.size)
    speed_of_neighbors(near.indptr, near.indices, velocity, direction, drives, out)
    return out
