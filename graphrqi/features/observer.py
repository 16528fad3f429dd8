"""Observers: positions in, a feature vector for every driver out, frame by frame.

`SpectrumObserver` sees nothing but the traffic graph; `DrivingObserver` adds how drivers move and
how they treat those that the graph joins them to. Both are plain-array classes with one contract,
used alike on live frames and on recordings, so training and streaming cannot differ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from graphrqi.features import following_law
from graphrqi.features.graph_signal import differences
from graphrqi.features.interaction import Interaction, interactions
from graphrqi.features.kinematic import FORGET_S, Motion, MotionEstimator, align
from graphrqi.features.spectral import INVARIANT_NAMES, NUM_PAIRS, eigenvector_rows, invariant
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NEIGHBORS: Final = 4
"""Nearest neighbours joined by an edge (the paper)."""

RESET: Final = 100
"""Steps after which the accumulated graph starts anew (the paper)."""

INTERACTION_NEIGHBORS: Final = 8
"""Nearest neighbours among which leaders are looked for (our choice: on a three-lane road the
four nearest are often all in the next lanes)."""

SPECTRUM_EVERY_S: Final = 0.5
"""How often averages of spectral features look at the spectrum (our choice: a graph changes by a
few per cent of its edges per tenth of a second)."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What is known of the drivers present now.

    Attributes:
        ids: (n,) ascending.
        seconds: (n,) time observed so far, s.
        sums: (n, S) additive evidence since each was first seen.
        instant: (n, I) what holds now only.
    """

    ids: IntArray
    seconds: FloatArray
    sums: FloatArray
    instant: FloatArray


class Observer(Protocol):
    """Follows traffic and describes each driver."""

    feature_names: tuple[str, ...]

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions.

        Args:
            time_s: later than at the call before.
            ids: (n,) ascending agent ids.
            xy: (n, 2) m.
            drives: (n,) whether each drives; the others are pedestrians.
        """
        ...

    def observation(self) -> Observation:
        """What is known now of the drivers present."""
        ...

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Turn evidence over any stretch of time into feature vectors (n, F)."""
        ...


class _Evidence:
    """Running sums per driver, kept while it is in sight (and a little longer)."""

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._sums: FloatArray = np.zeros((0, width))
        self._seconds: FloatArray = np.zeros(0)
        self._seen_s: FloatArray = np.zeros(0)
        self._time_s: float | None = None

    def add(self, time_s: float, ids: IntArray, moment: FloatArray) -> None:
        """Add one moment (n, S) of each driver, for as long as the time since the last."""
        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        merged = np.union1d(self._ids[self._seen_s >= time_s - FORGET_S], ids)
        sums = np.zeros((merged.size, self._sums.shape[1]))
        seconds = np.zeros(merged.size)
        seen = np.full(merged.size, time_s)
        into, source = align(self._ids, merged)
        sums[into], seconds[into] = self._sums[source], self._seconds[source]
        seen[into] = self._seen_s[source]
        rows = np.searchsorted(merged, ids)
        fresh = np.ones(merged.size, dtype=bool)
        fresh[into] = False
        sums[rows] += moment * step_s
        seconds[rows] += np.where(fresh[rows], 0.0, step_s)
        seen[rows] = time_s
        self._ids, self._sums, self._seconds, self._seen_s = merged, sums, seconds, seen

    def observation(self, instant: FloatArray | None = None) -> Observation:
        """The evidence on those seen at the last moment."""
        here = self._seen_s == (np.inf if self._time_s is None else self._time_s)
        ids = self._ids[here]
        if instant is None:
            instant = np.zeros((ids.size, 0))
        return Observation(ids, self._seconds[here], self._sums[here], instant)


class _GraphSpectrum:
    """The paper's accumulated graph and its largest eigenpairs, warm-started step by step."""

    def __init__(self, solver: str) -> None:
        self._solve: Callable[..., Spectrum] = SOLVERS[solver]
        self._graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
        self._previous: Spectrum | None = None
        self._looked_s = -np.inf

    def observe(self, ids: IntArray, xy: FloatArray) -> None:
        """Take the next positions into the graph."""
        self._graph = self._graph.observe(ids, xy)

    def solve(self, ids: IntArray) -> tuple[Spectrum, IntArray, FloatArray]:
        """The spectrum now, the rows of the given agents in it, and all degrees."""
        self._previous = self._solve(
            self._graph, num_pairs=NUM_PAIRS + 1, end="largest", previous=self._previous
        )
        order = np.argsort(self._graph.ids)  # the graph's rows are in order of first sight
        rows = order[np.searchsorted(self._graph.ids, ids, sorter=order)]
        return self._previous, rows, self._graph.degree

    def moment(self, time_s: float, ids: IntArray) -> FloatArray:
        """(n, F + 1) invariant features of the agents and a one, or zeros until it is due again."""
        if time_s - self._looked_s < SPECTRUM_EVERY_S - 1e-6:
            return np.zeros((ids.size, _SPECTRAL))
        self._looked_s = time_s
        spectrum, rows, degrees = self.solve(ids)
        values = invariant(
            np.asarray(spectrum.eigenvalues), np.asarray(spectrum.eigenvectors), degrees
        )
        return np.concatenate([values[rows], np.ones((ids.size, 1))], axis=1)


_SPECTRAL: Final = len(INVARIANT_NAMES) + 1
"""Columns of spectral evidence: the features, and how often they were taken."""


def _spectral_means(sums: FloatArray) -> FloatArray:
    total = sums[:, -1:]
    return np.asarray(sums[:, :-1] / np.where(total > 1e-9, total, 1.0))


class BlindObserver:
    """Counts the seconds and sees nothing else.

    Args:
        solver: not used; every observer takes one.
    """

    feature_names: tuple[str, ...] = ()

    def __init__(self, solver: str = "graphrqi") -> None:
        self._evidence = _Evidence(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        drivers = ids[drives]
        self._evidence.add(time_s, drivers, np.zeros((drivers.size, 0)))

    def observation(self) -> Observation:
        """Who is present, and for how long."""
        return self._evidence.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """No columns."""
        return np.zeros((seconds.size, 0))


class EigenvectorObserver:
    """What the paper feeds its classifier: rows of the largest-end eigenvector matrix, now.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"u_{k + 1}" for k in range(NUM_PAIRS))

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = _GraphSpectrum(solver)
        self._evidence = _Evidence(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        self._spectrum.observe(ids, xy)
        drivers = ids[drives]
        self._evidence.add(time_s, drivers, np.zeros((drivers.size, 0)))

    def observation(self) -> Observation:
        """The rows of the drivers present, of the graph's spectrum now."""
        present = self._evidence.observation()
        spectrum, rows, _ = self._spectrum.solve(present.ids)
        return dataclasses.replace(
            present, instant=eigenvector_rows(np.asarray(spectrum.eigenvectors))[rows]
        )

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """The rows as they are."""
        return instant


class SpectrumObserver:
    """Invariant spectral features of each driver, averaged over the time observed.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"spectrum_{name}" for name in INVARIANT_NAMES)

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = _GraphSpectrum(solver)
        self._evidence = _Evidence(_SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        self._spectrum.observe(ids, xy)
        self._evidence.add(time_s, ids[drives], self._spectrum.moment(time_s, ids)[drives])

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._evidence.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Means over the time observed."""
        return _spectral_means(sums)


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
    Block("leader's speed while standing", _SLOW_MPS),
    Block("closing", _DIFFERENCE_MPS),
    Block("inverse time to collision", _INVERSE_TTC),
    Block("rear headway", _HEADWAY_S),
    Block("rear headway after moving over", _HEADWAY_S),
    Block("sideways", _SIDEWAYS_M),
    Block("sideways over neighbours", _SIDEWAYS_M),
    Block("beside", (0.0, 1.0, 2.0, 4.0)),
    Block("speed near pedestrian", _SPEED_MPS),
    Block("acceleration near pedestrian", _ACCEL_MPS2),
)
"""What the driving observer watches (our choice of quantities and scales)."""

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
        self._spectrum = _GraphSpectrum(solver)
        self._near = TrafficGraph.empty(neighbors=INTERACTION_NEIGHBORS, kind="instantaneous")
        self._motion = MotionEstimator()
        self._evidence = _Evidence(_WATCHED + _LAW + _SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        motion = self._motion.update(time_s, ids, xy)
        self._near = self._near.observe(ids, xy)
        self._spectrum.observe(ids, xy)
        around = interactions(motion, drives, self._near.adjacency)
        moment = np.zeros((ids.size, _WATCHED + _LAW + _SPECTRAL))
        self._watch(motion, around, drives, moment)
        moment[:, _WATCHED + _LAW :] = self._spectrum.moment(time_s, ids)
        self._evidence.add(time_s, ids[drives], moment[drives])

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._evidence.observation()

    def _watch(
        self, motion: Motion, around: Interaction, drives: BoolArray, out: FloatArray
    ) -> None:
        """Write this moment's weights of every block."""
        adjacency = self._near.adjacency
        v, a = np.maximum(motion.speed, 0.0), motion.acceleration
        moving = v > 2.0
        gap, rear = around.gap, around.rear_gap
        has_leader, has_follower = around.leader >= 0, around.follower >= 0
        closing = v - around.leader_speed
        with np.errstate(divide="ignore", invalid="ignore"):
            headway = gap / v
            rear_headway = rear / np.maximum(around.rear_speed, 0.1)
            inverse_ttc = np.maximum(closing, 0.0) / np.maximum(gap, 0.3)
        clear = ~has_leader | (gap > np.maximum(25.0, 4.0 * v))
        following = has_leader & moving & (headway < 5.0)
        speed_signal = differences(adjacency, v, drives)
        sideways_signal = differences(adjacency, motion.sideways, drives, scales=1)
        side = np.abs(motion.sideways)
        standing = has_leader & (v < 0.3) & (around.leader_speed < 0.3)
        walker = ~np.isnan(around.pedestrian_m)
        always = np.ones(v.size, dtype=bool)
        watched: tuple[tuple[FloatArray, BoolArray], ...] = (
            (v, always),
            (v, clear & (np.abs(a) < 0.5) & moving),
            (speed_signal[:, 0], always),
            (speed_signal[:, 1], always),
            (a, v > 0.5),
            (a, clear & moving),
            (a, following),
            (a, (a > 0.2) & (v < 9.0) & (clear | (closing < 0.0))),
            (-a, a < -0.3),
            (headway, following),
            (headway, has_leader & moving),
            (headway, following & (np.abs(closing) < 0.7) & (np.abs(a) < 0.5)),
            (gap, standing),
            (around.leader_speed, has_leader & (v < 0.3)),
            (closing, following),
            (inverse_ttc, has_leader & (closing > 0.2)),
            (rear_headway, has_follower & moving),
            (rear_headway, has_follower & moving & (side > 1.2)),
            (side, moving),
            (np.abs(sideways_signal[:, 0]), moving),
            (around.beside, moving),
            (v, walker),
            (a, walker),
        )
        values = np.stack([value for value, _ in watched])
        counts = np.stack([condition for _, condition in watched])
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
        return np.concatenate(
            [
                describe(sums[:, :_WATCHED], BLOCKS),
                *(
                    following_law.infer(sums[:, start : start + following_law.COLUMNS])
                    for start in (_WATCHED, _WATCHED + following_law.COLUMNS)
                ),
                _spectral_means(sums[:, _WATCHED + _LAW :]),
                np.log1p(seconds)[:, None],
            ],
            axis=1,
        )
