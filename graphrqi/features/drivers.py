"""The observer of drivers: how they move, and how they treat their neighbours.

Raw motion serves simulated traffic and is measured in every frame. Smoothed motion serves all other
traffic. It is measured several times a second, each driver relative to its scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, Literal

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features import following_law
from graphrqi.features.motion import Motion, RawMotion
from graphrqi.features.observer import Observation, RunningSums
from graphrqi.features.raw_quantities import PARTS, RAW, RawMoment, part_of
from graphrqi.features.scene import FreeFlowSpeed, PlaceSpeeds, UsualValues
from graphrqi.features.smooth_motion import Courses, SmoothMotion
from graphrqi.features.smoothed_quantities import (
    COMPARED,
    LEAST_DEVIATION,
    LEAST_LEFT_OVER_M,
    SMOOTHED,
    SmoothedMoment,
)
from graphrqi.features.spectral import INVARIANT_NAMES, SPECTRAL, GraphSpectrum, spectral_means
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import Sighting, TrafficGraph

MotionKind = Literal["raw", "smoothed"]

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


@cache
def _layout(kind: MotionKind, parts: tuple[str, ...]) -> tuple[tuple[Block, ...], tuple[Any, ...]]:
    """The blocks that are measured, and the functions that give their values."""
    table: tuple[Any, ...] = SMOOTHED if kind == "smoothed" else RAW
    chosen = [q for q in table if kind == "smoothed" or part_of(q[0]) in parts]
    blocks = tuple(Block(name, nodes) for name, nodes, _ in chosen)
    return blocks, tuple(values for _, _, values in chosen)


class DriverObserver:
    """Describes drivers by distributions of what they do.

    Args:
        motion: ``raw`` for exact positions; ``smoothed`` for any.
        solver: a key of ``SOLVERS`` for raw motion's spectrum.
        parts: of raw motion's features, from ``PARTS``.

    Examples:
        >>> observer = DriverObserver(parts=("motion",))
        >>> observer.feature_names[:2], len(observer.feature_names)
        (('speed:5%', 'speed:25%'), 43)
    """

    def __init__(
        self,
        motion: MotionKind = "raw",
        solver: str = "graphrqi",
        parts: Sequence[str] = PARTS,
    ) -> None:
        self._kind = motion
        self._blocks, self._values = _layout(motion, tuple(parts))
        self._laws: tuple[str, ...] = ()
        if motion == "smoothed":
            self._laws = ("steady",)
        elif "law" in parts:
            self._laws = ("steady", "held up")
        self._spectrum = None
        if motion == "raw" and "spectrum" in parts:
            self._spectrum = GraphSpectrum(solver)
        self._motion: RawMotion | SmoothMotion
        self._motion = RawMotion() if motion == "raw" else SmoothMotion()
        self._near = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._free_flow, self._places, self._courses = FreeFlowSpeed(), PlaceSpeeds(), Courses()
        self._usual = UsualValues(LEAST_DEVIATION)
        self._measured = sum(len(block.nodes) for block in self._blocks)
        self._law_end = self._measured + len(self._laws) * following_law.COLUMNS
        self._sums = RunningSums(self._law_end + SPECTRAL * (self._spectrum is not None))
        self._presence = RunningSums(0)
        self._first_s = self._last_s = self.frame_s = float("nan")
        self._shares = np.full(3, np.nan)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the columns of `features`."""
        law = [f"{when}: {name}" for when in self._laws for name in following_law.LAW_NAMES]
        further = [f"spectrum_{name}" for name in INVARIANT_NAMES if self._spectrum is not None]
        if self._kind == "smoothed":
            further = [f"scene: {name}" for name in SCENE_NAMES]
        return (*describe_names(self._blocks), *law, *further, "log_seconds")

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> bool:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._follow_frames(time_s)
        drivers = ids[drives]
        self._presence.add(time_s, drivers, np.zeros((drivers.size, 0)))
        motion = self._motion.update(time_s, ids, xy, drives)
        if motion is None:
            return False
        seen = Sighting.of(motion.ids, motion.xy)
        self._near = self._near.extended(seen)
        moment = self._moment(time_s, motion)
        measured = [values(moment) for values in self._values]
        values = np.stack([value for value, _ in measured])
        counts = np.stack([condition for _, condition in measured])
        further = self._further(moment, seen, time_s)
        if not motion.drives.all():
            chosen = motion.drives
            values, counts, further = values[:, chosen], counts[:, chosen], further[chosen]
        sums, rows, step_s = self._sums.advance(time_s, motion.ids[motion.drives])
        spread(values, counts, self._blocks, step_s, rows, sums)
        sums[rows, self._measured :] += further * step_s
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

    def _moment(self, time_s: float, motion: Motion) -> RawMoment | SmoothedMoment:
        """The values and conditions of a moment."""
        if self._kind == "raw":
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

    def _further(self, moment: RawMoment | SmoothedMoment, seen: Sighting, time_s: float) -> Any:
        """(n, E) evidence beside the blocks: on the law of following, and on the spectrum."""
        parts = [np.zeros((moment.v.size, 0))]
        if self._laws:
            products = following_law.products(moment.v, moment.leader_speed, moment.gap)
            conditions = {"steady": moment.steady}
            if isinstance(moment, RawMoment):
                conditions["held up"] = moment.held_up
            parts += [np.where(conditions[when][:, None], products, 0.0) for when in self._laws]
        if self._spectrum is not None:
            self._spectrum.observe(seen)
            parts.append(self._spectrum.moment(time_s, seen.ids))
        return np.concatenate(parts, axis=1)

    @property
    def is_noisy(self) -> bool:
        """Whether every moment so far showed noise; False before it can be known."""
        return self._motion.is_noisy

    def scene(self) -> FloatArray:
        """(S,) the numbers of the scene so far, named by ``SCENE_NAMES``; NaN where unknown."""
        mean, deviation = self._usual.moments
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
        return self._presence.observation()

    def observation(self) -> Observation:
        """Evidence on the drivers present; the scene's numbers hold for all of them."""
        present = self.present()
        instant = np.zeros((present.ids.size, 0))
        if self._kind == "smoothed":
            known = np.nan_to_num(self.scene(), nan=UNKNOWN_SCENE)
            instant = np.broadcast_to(known, (present.ids.size, len(SCENE_NAMES)))
        return Observation(present.ids, present.seconds, self._sums.of(present.ids), instant)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) distributions, law, mean spectrum or scene, and time; see ``feature_names``."""
        law = sums[:, self._measured : self._law_end].reshape(-1, following_law.COLUMNS)
        inferred = len(self._laws) * len(following_law.LAW_NAMES)
        parts = [following_law.infer(law).reshape(len(sums), inferred), instant]
        if self._spectrum is not None:
            parts.append(spectral_means(sums[:, self._law_end :]))
        parts.append(np.log1p(seconds)[:, None])
        described = describe(sums, self._blocks)
        return np.concatenate([described, *parts], axis=1)
