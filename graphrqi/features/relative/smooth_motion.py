"""Motion from noisy positions at any frame rate, a moment ago.

A position that is 10 cm wrong makes a velocity over .4 s wrong by .35 m/s and an acceleration by
1.2 m/s2: more than drivers differ by. `SmoothMotion` therefore looks back: it fits a parabola to
each agent's positions on both sides of a moment that lies a second or two in the past, and gives
position, velocity and acceleration at that moment. The fit is the same at 2 and at 25 frames a
second and bridges missing ones. What the fit leaves over sideways, where drivers hardly move within
a second, shows how noisy the positions are; the noisier, the longer the stretch that is fitted.

References:
    Savitzky, Golay (1964), Smoothing and differentiation of data by simplified least squares
    procedures, Analytical Chemistry 36, 1627: local polynomial fits.
    Fan, Gijbels (1996), Local polynomial modelling and its applications, section 3.2: the best
    length grows with a small power of the noise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematics import align

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LEAST_HALF_S: Final = 0.8
"""Half the stretch that is fitted where positions are exact, s: braking and pulling away build up
within this time."""

MOST_HALF_S: Final = 1.6
"""Half the stretch at and beyond `FULL_NOISE_M`, s: longer ones would hide how a driver follows."""

FULL_NOISE_M: Final = 0.2
"""Noise from which the longest stretch is fitted, m."""

NOISE_MEMORY_S: Final = 60.0
"""Time constant with which older estimates of the noise are forgotten, s (some hundred fits)."""

EXACT_M: Final = 0.001
"""Positions whose errors are smaller than this are exact, m: a tenth of the least noise that
simulated traffic is seen through in training."""

LEAST_FITS: Final = 20
"""Fitted stretches of drivers after which noise counts as found (our choice: a lane change of the
only driver has some ten)."""

LEAST_FRAMES: Final = 2.0
"""Fewest frames on either side of the moment: a parabola needs one more than three positions."""

LEAST_DIRECTION_MPS: Final = 1.0
"""Speed below which an agent keeps its last direction, m/s."""


@dataclass(frozen=True, slots=True)
class SmoothedMotion:
    """How agents moved at one moment of the recent past; NaN where it cannot be told.

    Attributes:
        time_s: the moment, s.
        ids: (n,) ascending ids of the agents that were seen before and after it.
        drives: (n,) whether each drives; the others are pedestrians.
        xy: (n, 2) fitted positions, m.
        velocity: (n, 2) m/s.
        direction: (n, 2) unit vectors of travel.
        speed: (n,) m/s along the direction.
        acceleration: (n,) m/s2 along the direction.
        sideways: (n,) m/s2 across the direction, to the left.
    """

    time_s: float
    ids: IntArray
    drives: BoolArray
    xy: FloatArray
    velocity: FloatArray
    direction: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    sideways: FloatArray


class SmoothMotion:
    """Fits the motion of every agent, frame by frame.

    Memory is bounded by the positions of the last ``2 MOST_HALF_S`` seconds.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[float, IntArray, FloatArray, BoolArray]] = deque()
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._direction: FloatArray = np.empty((0, 2))
        self._noise = 0.0
        self._weight = 0.0
        self._fitted_s = float("nan")
        self._fits = 0
        self._least_noise_m = float("nan")

    def push(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions.

        Args:
            time_s: later than at the call before.
            ids: (n,) ascending agent ids.
            xy: (n, 2) m.
            drives: (n,) whether each drives.
        """
        self._frames.append((time_s, ids, xy, drives))
        while self._frames[0][0] < time_s - 2.0 * MOST_HALF_S - 1e-6:
            self._frames.popleft()

    @property
    def noise_m(self) -> float:
        """Standard deviation of the positions' errors so far, m; NaN before any estimate."""
        return self._noise / self._weight if self._weight > 0.0 else float("nan")

    @property
    def is_noisy(self) -> bool:
        """Whether every moment so far showed noise, after `LEAST_FITS`; False before.

        What a curve or a lane change leaves over counts as noise, too. One moment on straight ways
        shows that positions are exact.
        """
        return self._fits >= LEAST_FITS and self._least_noise_m >= EXACT_M

    @property
    def half_s(self) -> float:
        """Half the stretch that is fitted now, s."""
        noise_m = self.noise_m if self._weight > 0.0 else 0.0
        share = float(np.sqrt(min(noise_m / FULL_NOISE_M, 1.0)))
        half_s = LEAST_HALF_S + (MOST_HALF_S - LEAST_HALF_S) * share
        span_s = self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0
        frame_s = span_s / max(len(self._frames) - 1, 1)
        return min(max(half_s, LEAST_FRAMES * frame_s), MOST_HALF_S)

    def fit(self) -> SmoothedMotion | None:
        """The motion ``half_s`` before the last frame; None before there are three frames."""
        from graphrqi.features.kernels import fit_parabolas

        if len(self._frames) < 3:
            return None
        now, half_s = self._frames[-1][0], self.half_s
        moment = now - half_s
        used = [f for f in self._frames if f[0] >= moment - half_s - 1e-6]
        ids = np.unique(np.concatenate([f[1] for f in used]))
        times = np.array([f[0] for f in used]) - moment
        trail = np.full((ids.size, times.size, 2), np.nan)
        drives = np.zeros(ids.size, dtype=bool)
        for column, (_, here, xy, driving) in enumerate(used):
            rows = np.searchsorted(ids, here)
            trail[rows, column] = xy
            drives[rows] = driving
        fitted = np.empty((ids.size, 8))
        fit_parabolas(trail, times, half_s, fitted)
        kept = np.flatnonzero(~np.isnan(fitted[:, 0]))
        ids, drives, fitted = ids[kept], drives[kept], fitted[kept]
        velocity = np.ascontiguousarray(fitted[:, 2:4])
        direction = self._directions(ids, velocity)
        speed = (velocity * direction).sum(axis=1)
        self._learn_noise(moment, fitted[drives, 6], speed[drives])
        return SmoothedMotion(
            time_s=moment,
            ids=ids,
            drives=drives,
            xy=np.ascontiguousarray(fitted[:, :2]),
            velocity=velocity,
            direction=direction,
            speed=speed,
            acceleration=(fitted[:, 4:6] * direction).sum(axis=1),
            sideways=direction[:, 0] * fitted[:, 5] - direction[:, 1] * fitted[:, 4],
        )

    def _directions(self, ids: IntArray, velocity: FloatArray) -> FloatArray:
        """(n, 2) unit vectors of travel, the last known ones of agents that hardly move."""
        direction = np.full((ids.size, 2), np.nan)
        into, source = align(self._ids, ids)
        direction[into] = self._direction[source]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        moves = speed > LEAST_DIRECTION_MPS
        direction[moves] = velocity[moves] / speed[moves, None]
        self._ids, self._direction = ids, direction
        return direction

    def _learn_noise(self, moment: float, residual: FloatArray, speed: FloatArray) -> None:
        """Add the residuals of the agents that move; their median ignores those that turn."""
        told = residual[(speed > LEAST_DIRECTION_MPS) & ~np.isnan(residual)]
        step_s = 0.0 if np.isnan(self._fitted_s) else moment - self._fitted_s
        self._fitted_s = moment
        kept = float(np.exp(-max(step_s, 0.0) / NOISE_MEMORY_S))
        self._noise, self._weight = kept * self._noise, kept * self._weight
        if told.size:
            median = float(np.median(told))
            self._noise += told.size * median
            self._weight += told.size
            self._fits += told.size
            self._least_noise_m = float(np.fmin(self._least_noise_m, median))
