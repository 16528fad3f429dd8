"""Motion from noisy positions at any frame rate, a moment ago.

Differenced noisy positions give velocities whose errors exceed the differences between drivers.
`SmoothMotion` therefore fits a parabola to each agent's positions around a moment in the recent
past. Its lateral residuals show the noise, since drivers move little sideways within a second. More
noise lengthens the fitted stretch. `Courses` fits the last seconds of smoothed motion; its
residuals show how steadily a driver drives.

References:
    Savitzky, Golay (1964), Smoothing and differentiation of data by simplified least squares
    procedures, Analytical Chemistry 36, 1627: local polynomial fits.
    Fan, Gijbels (1996), Local polynomial modelling and its applications, section 3.2: the best
    length grows with a small power of the noise.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.motion import Motion, align, along, leftward
from graphrqi.features.scene import FadingSums

EVERY_S: Final = 0.4
"""Time between moments that are measured, s; half the shortest stretch that is smoothed."""

LEAST_HALF_S: Final = 0.8
"""Half the stretch that is fitted where positions are exact, s: braking and pulling away build up
within this time."""

MOST_HALF_S: Final = 1.6
"""Half the stretch at and beyond `FULL_NOISE_M`, s; longer ones hide car following."""

FULL_NOISE_M: Final = 0.2
"""Noise from which the longest stretch is fitted, m."""

NOISE_MEMORY_S: Final = 60.0
"""Time constant with which older estimates of the noise are forgotten, s."""

EXACT_M: Final = 0.001
"""Positions with smaller errors are exact, m: a tenth of the least noise in training."""

LEAST_FITS: Final = 20
"""Fitted stretches after which noise counts as found."""

LEAST_FRAMES: Final = 2.0
"""Fewest frames on either side of the moment: a parabola needs one more than three positions."""

LEAST_DIRECTION_MPS: Final = 1.0
"""Speed below which an agent keeps its last direction, m/s."""

COURSE_S: Final = 4.0
"""Length of a course, s: a lane change takes about as long."""

LEAST_MOMENTS: Final = 6
"""Fewest moments that make a course: a parabola passes through three."""

LEAST_SHARE: Final = 0.8
"""Share of `COURSE_S` that the moments of a course have to span."""


def parabolas(trail: FloatArray, times: FloatArray, straight: BoolArray) -> FloatArray:
    """(n, 3, 2) least-squares parabolas of positions (n, T, 2), NaN where unknown, at times (T,).

    They are coefficients of ascending powers of time. They are NaN where positions do not determine
    them, and for the square of those that get a straight line instead.

    Examples:
        >>> times = np.array([-1.0, 0.0, 1.0, 2.0])
        >>> trail = np.stack([3.0 + times**2, 5.0 * times], axis=1)[None]
        >>> parabolas(trail, times, np.array([False])).round(6) + 0.0
        array([[[3., 0.],
                [0., 5.],
                [1., 0.]]])
    """
    known = ~np.isnan(trail[..., 0])
    origin = trail[np.arange(len(trail)), known.argmax(axis=1)]
    away = np.where(known[..., None], trail - origin[:, None], 0.0)
    powers = times[:, None] ** np.arange(5)
    moments = known.astype(np.float64) @ powers
    targets = np.einsum("ntd,tp->npd", away, powers[:, :3])
    matrix = moments[:, np.add.outer(np.arange(3), np.arange(3))]
    matrix[straight, 2, :], matrix[straight, :, 2] = (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)
    found = np.full((len(trail), 3, 2), np.nan)
    solvable = np.linalg.det(matrix) > 1e-12
    found[solvable] = np.linalg.solve(matrix[solvable], targets[solvable])
    found[:, 0] += origin
    found[straight, 2] = np.nan
    return found


def left_over(trail: FloatArray, times: FloatArray, found: FloatArray) -> FloatArray:
    """(n, T, 2) residuals of positions from fitted `parabolas`, m."""
    return np.asarray(trail - np.einsum("tp,npd->ntd", times[:, None] ** np.arange(3), found))


class SmoothMotion:
    """Fits the motion of every agent several times a second.

    Memory is bounded by the positions of the last ``2 MOST_HALF_S`` seconds.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[float, IntArray, FloatArray, BoolArray]] = deque()
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._direction: FloatArray = np.empty((0, 2))
        self._measured_s = -np.inf
        self._noise = FadingSums((2,), NOISE_MEMORY_S)
        self._fits = 0
        self._least_noise_m = float("nan")

    def update(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> Motion | None:
        """Take the next positions; see `graphrqi.features.motion.RawMotion.update`.

        Returns:
            Motion a moment ago, of the agents seen before and after it. It is None until `EVERY_S`
            has passed since the last one, and where there are no such agents.
        """
        self._frames.append((time_s, ids, xy, drives))
        while self._frames[0][0] < time_s - 2.0 * MOST_HALF_S - 1e-6:
            self._frames.popleft()
        if time_s < self._measured_s + EVERY_S - 1e-6:
            return None
        self._measured_s = time_s
        motion = self._fitted() if len(self._frames) >= 3 else None
        return motion if motion is not None and motion.ids.size else None

    @property
    def noise_m(self) -> float:
        """Standard deviation of the positions' errors so far, m; NaN before any estimate."""
        noise, weight = self._noise.values.tolist()
        return noise / weight if weight > 0.0 else float("nan")

    @property
    def is_noisy(self) -> bool:
        """Whether every moment so far showed noise, after `LEAST_FITS`; False before.

        Residuals of curves and lane changes count as noise, too. One moment on straight paths shows
        that positions are exact.
        """
        return self._fits >= LEAST_FITS and self._least_noise_m >= EXACT_M

    @property
    def is_exact(self) -> bool:
        """Whether a moment showed no noise, so that `is_noisy` stays False."""
        return self._least_noise_m < EXACT_M

    def _half_s(self) -> float:
        """Half the stretch that is fitted now, s."""
        share = float(np.sqrt(min(np.nan_to_num(self.noise_m) / FULL_NOISE_M, 1.0)))
        half_s = LEAST_HALF_S + (MOST_HALF_S - LEAST_HALF_S) * share
        frame_s = (self._frames[-1][0] - self._frames[0][0]) / (len(self._frames) - 1)
        return min(max(half_s, LEAST_FRAMES * frame_s), MOST_HALF_S)

    def _fitted(self) -> Motion:
        """The motion `_half_s` before the last frame."""
        half_s = self._half_s()
        moment = self._frames[-1][0] - half_s
        used = [f for f in self._frames if f[0] >= moment - half_s - 1e-6]
        ids = np.unique(np.concatenate([f[1] for f in used]))
        times = np.array([f[0] for f in used]) - moment
        trail = np.full((ids.size, times.size, 2), np.nan)
        drives = np.zeros(ids.size, dtype=bool)
        for column, (_, here, xy, driving) in enumerate(used):
            rows = np.searchsorted(ids, here)
            trail[rows, column] = xy
            drives[rows] = driving
        seen = ~np.isnan(trail[..., 0])
        first, last = times[seen.argmax(axis=1)], times[-1 - seen[:, ::-1].argmax(axis=1)]
        around = (first <= 1e-6) & (last >= -1e-6) & (last - first >= 0.5 * half_s)
        around &= seen.sum(axis=1) >= 2
        curved = (np.minimum(-first, last) >= 0.5 * half_s) & (seen.sum(axis=1) >= 4)
        ids, drives, trail, curved = ids[around], drives[around], trail[around], curved[around]
        fitted = parabolas(trail, times, ~curved)
        velocity = np.ascontiguousarray(fitted[:, 1])
        direction = self._directions(ids, velocity)
        speed = along(direction, velocity)
        self._learn_noise(moment, trail[drives], times, fitted[drives])
        return Motion(
            time_s=moment,
            ids=ids,
            drives=drives,
            xy=np.ascontiguousarray(fitted[:, 0]),
            velocity=velocity,
            direction=direction,
            speed=speed,
            acceleration=along(direction, 2.0 * fitted[:, 2]),
            sideways=leftward(direction, 2.0 * fitted[:, 2]),
        )

    def _directions(self, ids: IntArray, velocity: FloatArray) -> FloatArray:
        """(n, 2) unit vectors of travel; slow agents keep their last ones."""
        direction = np.full((ids.size, 2), np.nan)
        into, source = align(self._ids, ids)
        direction[into] = self._direction[source]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        moves = speed > LEAST_DIRECTION_MPS
        direction[moves] = velocity[moves] / speed[moves, None]
        self._ids, self._direction = ids, direction
        return direction

    def _learn_noise(
        self, moment: float, trail: FloatArray, times: FloatArray, fitted: FloatArray
    ) -> None:
        """Add lateral residuals of the fits; the median ignores agents that turn."""
        speed = np.hypot(fitted[:, 1, 0], fitted[:, 1, 1])
        count = (~np.isnan(trail[..., 0])).sum(axis=1)
        told = (speed > LEAST_DIRECTION_MPS) & (count >= 5) & ~np.isnan(fitted[:, 2, 0])
        self._noise.fade(moment)
        if not told.any():
            return
        left = left_over(trail[told], times, fitted[told])
        unit = fitted[told, 1] / speed[told, None]
        across = unit[:, None, 0] * left[..., 1] - unit[:, None, 1] * left[..., 0]
        residual = np.sqrt(np.nansum(across**2, axis=1) / (count[told] - 3))
        median = float(np.median(residual))
        self._noise.values += residual.size * np.array([median, 1.0])
        self._fits += residual.size
        self._least_noise_m = float(np.fmin(self._least_noise_m, median))


class Courses:
    """The last seconds of smoothed motion of every agent, and how steady they are.

    A parabola is a steady course: a constant acceleration along the road, a constant curvature
    across it.
    """

    def __init__(self) -> None:
        self._times: list[float] = []
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._trail: FloatArray = np.empty((0, 0, 2))

    def update(self, time_s: float, ids: IntArray, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) root mean squares across and along the courses that end here, m.

        They are NaN for agents that did not move, or were not seen at every moment.
        """
        drop = sum(time < time_s - COURSE_S - 1e-6 for time in self._times)
        self._times = [*self._times[drop:], time_s]
        trail = np.full((ids.size, len(self._times), 2), np.nan)
        into, source = align(self._ids, ids)
        trail[into, :-1] = self._trail[source, drop:]
        trail[:, -1] = xy
        self._ids, self._trail = ids, trail
        times = np.array(self._times) - time_s
        across, along_course = np.full((2, ids.size), np.nan)
        chord = trail[:, -1] - trail[:, 0]
        length = np.hypot(chord[:, 0], chord[:, 1])
        rows = np.flatnonzero(~np.isnan(trail[..., 0]).any(axis=1) & (length > 1.0))
        if times.size < LEAST_MOMENTS or -times[0] < LEAST_SHARE * COURSE_S:
            return across, along_course
        found = parabolas(trail[rows], times, np.zeros(rows.size, dtype=bool))
        left = left_over(trail[rows], times, found)
        unit = (chord[rows] / length[rows, None])[:, None]
        spare = times.size - 3
        across[rows] = np.sqrt(
            ((left[..., 1] * unit[..., 0] - left[..., 0] * unit[..., 1]) ** 2).sum(axis=1) / spare
        )
        along_course[rows] = np.sqrt(((left * unit).sum(axis=2) ** 2).sum(axis=1) / spare)
        return across, along_course
