"""The observer of drivers: how they move, and how they treat their neighbours.

Raw motion serves simulated traffic and is measured in every frame. Smoothed motion serves all other
traffic. It is measured several times a second, each driver relative to its scene.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features import following_law
from graphrqi.features.motion import Motion, RawMotion
from graphrqi.features.observer import Observation, Observer, RunningSums
from graphrqi.features.quantities import (
    COMPARED,
    LEAST_DEVIATION,
    LEAST_LEFT_OVER_M,
    PLAIN,
    RAW,
    SMOOTHED,
    Quantities,
    RawMoment,
    SmoothedMoment,
)
from graphrqi.features.scene import FreeFlowSpeed, PlaceSpeeds, UsualValues
from graphrqi.features.smooth_motion import Courses, SmoothMotion
from graphrqi.features.spectral import INVARIANT_NAMES, SPECTRAL, GraphSpectrum, spectral_means
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import TrafficGraph, find_nearest

Kind = Literal["raw", "plain", "smoothed"]

NEIGHBORS: Final = 8
"""Nearest neighbours among which leaders are searched; the nearest few are often all in the next
lanes."""

LONGEST_S: Final = 60.0
"""Longest time watched that is distinguished, s; the scene's numbers are stable by then."""

SHARE_GAIN: Final = 0.05
"""Weight of a moment in the scene's shares: they follow within some ten seconds."""

UNKNOWN_SCENE: Final = -10.0
"""Stands for a number of the scene that is not known yet; below all of them, so that trees can
split it off."""

LEFT_OVER: Final = ("weaving", "unrest")
"""Residuals of courses: human driving varies by more than sensor noise explains."""

SCENE_NAMES: Final = (
    "noise", "frame interval", "pace", "drivers", "share following", "share moving", "seconds",
    *(f"mean {name}" for name in COMPARED),
    *(f"deviation of {name}" for name in COMPARED),
    *(f"{name} over noise" for name in LEFT_OVER),
)  # fmt: skip
"""Numbers of the whole scene: position noise, m; frame time, s; free-flow speed, m/s; drivers at
once and their shares. Further ones are log(1 + seconds watched), means of ``COMPARED``, and
logarithms of course residuals over the noise."""

_TABLES: Final[dict[Kind, Quantities]] = {"raw": RAW, "plain": PLAIN, "smoothed": SMOOTHED}
_BLOCKS: Final = {
    kind: tuple(Block(name, nodes) for name, nodes, _ in table) for kind, table in _TABLES.items()
}
_LAWS: Final[dict[Kind, tuple[str, ...]]] = {
    "raw": ("steady", "held up"), "plain": (), "smoothed": ("steady",),
}  # fmt: skip


class DriverObserver(Observer):
    """Describes drivers by distributions of what they do.

    Args:
        kind: ``raw`` for exact positions; ``plain`` for the same without the graph's spectrum and
            signals, and without the law of following; ``smoothed`` for any positions.
        solver: a key of ``SOLVERS`` for the spectrum.

    Examples:
        >>> observer = DriverObserver("plain")
        >>> observer.feature_names[:2]
        ('speed:5%', 'speed:25%')
    """

    def __init__(self, kind: Kind = "raw", solver: str = "graphrqi") -> None:
        super().__init__()
        self._kind, self._blocks, self._laws = kind, _BLOCKS[kind], _LAWS[kind]
        self._spectrum = GraphSpectrum(solver) if kind == "raw" else None
        self._motion: RawMotion | SmoothMotion
        self._motion = SmoothMotion() if kind == "smoothed" else RawMotion()
        self._near = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._free_flow, self._places, self._courses = FreeFlowSpeed(), PlaceSpeeds(), Courses()
        self._usual = UsualValues(LEAST_DEVIATION)
        self._measured = sum(len(block.nodes) for block in self._blocks)
        self._law_end = self._measured + len(self._laws) * following_law.COLUMNS
        self._evidence = RunningSums(self._law_end + SPECTRAL * (kind == "raw"))
        self._first_s = self._last_s = self.frame_s = float("nan")
        self._shares = np.full(3, np.nan)
        further = [f"{when}: {name}" for when in self._laws for name in following_law.LAW_NAMES]
        if kind == "raw":
            further += [f"spectrum_{name}" for name in INVARIANT_NAMES]
        if kind == "smoothed":
            further += [f"scene: {name}" for name in SCENE_NAMES]
        self.feature_names = (*describe_names(self._blocks), *further, "log_seconds")

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> bool:
        """Take the next positions; see `Observer.update`."""
        super().update(time_s, ids, xy, drives)
        self._follow_frames(time_s)
        motion = self._motion.update(time_s, ids, xy, drives)
        if motion is None:
            return False
        nearest = find_nearest(motion.ids, motion.xy, NEIGHBORS)
        self._near = self._near.observe(motion.ids, motion.xy, nearest)
        if self._spectrum is not None:
            self._spectrum.observe(motion.ids, motion.xy, nearest)
        moment = self._look(time_s, motion)
        measured = [values(moment) for _, _, values in _TABLES[self._kind]]
        further = self._further(moment, motion.ids, time_s)
        drivers = motion.drives
        values, counts = (np.stack(part)[:, drivers] for part in zip(*measured, strict=True))
        sums, rows, step_s = self._evidence.advance(time_s, motion.ids[drivers])
        spread(values, counts, self._blocks, step_s, rows, sums)
        sums[rows, self._measured :] += further[drivers] * step_s
        return True

    def _follow_frames(self, time_s: float) -> None:
        """Follow the time between frames."""
        step_s = time_s - self._last_s
        if np.isnan(self._first_s):
            self._first_s = time_s
        elif np.isnan(self.frame_s):
            self.frame_s = step_s
        else:
            self.frame_s += 0.1 * (step_s - self.frame_s)
        self._last_s = time_s

    def _look(self, time_s: float, motion: Motion) -> RawMoment | SmoothedMoment:
        """The values and conditions of a moment."""
        if self._kind != "smoothed":
            return RawMoment(time_s, motion, self._near, self._free_flow)
        moment = SmoothedMoment(
            time_s, motion, self._near, self._free_flow, self._places, self._usual, self._courses
        )
        if motion.drives.any():
            shares = [condition[motion.drives].mean() for condition in
                      (moment.following, moment.moving)]  # fmt: skip
            now = np.array([motion.drives.sum(), *shares])
            change = SHARE_GAIN * (now - self._shares)
            self._shares = np.where(np.isnan(self._shares), now, self._shares + change)
        return moment

    def _further(
        self, moment: RawMoment | SmoothedMoment, ids: IntArray, time_s: float
    ) -> FloatArray:
        """(n, E) evidence beside the blocks: on the law of following, and on the spectrum."""
        parts = [np.zeros((moment.v.size, 0))]
        if self._laws:
            products = following_law.products(moment.v, moment.leader_speed, moment.gap)
            held_up = (moment.held_up,) if isinstance(moment, RawMoment) else ()
            parts += [np.where(c[:, None], products, 0.0) for c in (moment.steady, *held_up)]
        if self._spectrum is not None:
            parts.append(self._spectrum.moment(time_s, ids))
        return np.concatenate(parts, axis=1)

    @property
    def is_noisy(self) -> bool:
        """Whether every moment of smoothed motion showed noise; False before it can be known."""
        return isinstance(self._motion, SmoothMotion) and self._motion.is_noisy

    @property
    def is_exact(self) -> bool:
        """Whether a moment of smoothed motion showed no noise, so that `is_noisy` stays False."""
        return isinstance(self._motion, SmoothMotion) and self._motion.is_exact

    def scene(self) -> FloatArray:
        """(S,) numbers of a scene of smoothed motion, named by ``SCENE_NAMES``; NaN if unknown."""
        mean, deviation = self._usual.moments
        assert isinstance(self._motion, SmoothMotion)
        noise_m = self._motion.noise_m
        noise = np.log(max(noise_m, LEAST_LEFT_OVER_M))
        left_over = [mean[list(COMPARED).index(name)] - noise for name in LEFT_OVER]
        watched_s = np.nan_to_num(self._last_s - self._first_s)
        return np.concatenate(
            [
                [noise_m, self.frame_s, self._free_flow.mean_mps],
                self._shares,
                [np.log1p(min(watched_s, LONGEST_S))],
                mean,
                np.where(np.isnan(mean), np.nan, deviation),
                left_over,
            ]
        )

    def present(self) -> Observation:
        """The drivers present and for how long, without evidence."""
        return super().observation()

    def observation(self) -> Observation:
        """Evidence on the drivers present; the scene's numbers hold for all of them."""
        present = self.present()
        instant = present.instant
        if self._kind == "smoothed":
            known = np.nan_to_num(self.scene(), nan=UNKNOWN_SCENE)
            instant = np.broadcast_to(known, (present.ids.size, len(SCENE_NAMES)))
        return Observation(present.ids, present.seconds, self._evidence.of(present.ids), instant)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) distributions, law, mean spectrum or scene, and time; see ``feature_names``."""
        law = sums[:, self._measured : self._law_end].reshape(-1, following_law.COLUMNS)
        inferred = len(self._laws) * len(following_law.LAW_NAMES)
        parts = [following_law.infer(law).reshape(len(sums), inferred), instant]
        if self._spectrum is not None:
            parts.append(spectral_means(sums[:, self._law_end :]))
        described = describe(sums, self._blocks)
        return np.concatenate([described, *parts, np.log1p(seconds)[:, None]], axis=1)
