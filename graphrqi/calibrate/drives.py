"""From measured places along a lane to the rows that the filter takes.

Own places are averaged over half a second, so that what recordings smooth away or tremble by within
that time does not count; exact ones are shaken first, so that their error is the one that the
filter reckons with. The leader's motion is smoothed by local parabolas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OBSERVED_S: Final = 0.5
"""Time between the observations of a driver's place, s (our choice: two a second show every change
of acceleration that a driver makes, and hardly more than the laws describe)."""

FINEST_S: Final = 0.1
"""Longest step of the filter between observations, s, unless frames are farther apart (the usual
step of simulators; whose frames are rarer is taken to move by a step from one to the next)."""

LEAST_HALF_S, MOST_HALF_S = 0.1, 0.8
"""Half the stretch over which a motion is smoothed, s: for exact places, which three then tell, and
from `FULL_NOISE_M` on; in between it goes with the root of the noise."""

FULL_NOISE_M: Final = 0.1
"""Noise from which the longest stretch is smoothed, m."""

LASTS_S: Final = (0.2, 0.4, 0.8)
"""Times for which errors last that `trembling_of` finds, s (NGSIM's do: on US-101, speeds are level
for a second or two, and then change in steps)."""

BEYOND: Final = 1.5
"""So many times as large as independent errors they have to be (our choice: estimates of the same
errors differ by a tenth)."""

ROUGHEST_MPS2: Final = 0.57
"""They have to look like residual accelerations of this size, m/s2, as drivers have smaller ones:
three times the .19 of highD (our choice: I-80's tracks look like .2, US-101's like 1.3 to 1.8)."""

THIRD_PER_ACCEL: Final = 0.14
"""What `noise_of_lag` makes of an acceleration of 1 m/s2 that is autocorrelated, over the square of
the time, m (found: .12 to .17 where it lasts for .3 to 1.3 s)."""

LEAST_NOISE_M: Final = 0.01
"""Places count as no more exact, m (our choice: what cameras resolve at best). More exact ones get
random errors that bring them there."""

LEAST_S: Final = 4.0
"""Shorter stretches are left out, s (our choice: they show no reaction from beginning to end)."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Part of a drive without a break, behind one leader or behind none.

    Attributes:
        time_s: (n,) increasing, s.
        place: (n,) measured distance of the front bumper along the way, m.
        leader: (n,) the leader's rear bumper in the same measure, m; +inf without one.
    """

    time_s: FloatArray
    place: FloatArray
    leader: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What is known of one driver, ready for `filter.tell`.

    Attributes:
        rows: (5, T) observed place, m, standard deviation of its error, m (0: not observed), speed,
            m/s, rear of the leader, m (+inf: none), and the leader's speed, m/s.
        begins: (B + 1,) where in ``rows`` each stretch begins, and T.
        step_s: time between rows, s.
        frame_s: time between the frames that the rows were made of, s.
    """

    rows: FloatArray
    begins: IntArray
    step_s: float
    frame_s: float

    def steps(self, newer: float) -> FloatArray:
        """(3,) steps of `filter.tell`: a simulator's own is as long as a frame.

        Args:
            newer: with how much of its new speed a driver moves on.
        """
        return np.array([self.step_s, min(self.frame_s, self.step_s), newer])

    @property
    def seconds(self) -> float:
        """How long the driver is known, s."""
        return float((self.rows.shape[1] - self.begins.size + 1) * self.step_s)

    def part(self, first: int, last: int) -> Drive:
        """Its rows from one to before another, which are of one stretch."""
        rows = np.ascontiguousarray(self.rows[:, first:last])
        return Drive(rows, np.array([0, last - first]), self.step_s, self.frame_s)


def noise_of(values: FloatArray) -> float:
    """Standard deviation of the independent errors of a smooth series, from its third differences.

    Examples:
        >>> rng = np.random.default_rng(0)
        >>> bool(0.08 < noise_of(np.arange(400.0) ** 1.5 / 50 + rng.normal(0, 0.1, 400)) < 0.12)
        True
    """
    return noise_of_lag(values, 1) if values.size >= 8 else 0.0


def noise_of_lag(values: FloatArray, lag: int) -> float:
    """The same from differences between values that are so many apart."""
    third = values
    for _ in range(3):
        third = third[lag:] - third[:-lag]
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0))  # 1 + 9 + 9 + 1 variances


def trembling_of(values: FloatArray, frame_s: float) -> float:
    """Standard deviation of errors that last for `LASTS_S`, by third differences over these times.

    Those of a smooth motion are eight times as large over twice the time, those of errors are not.
    Where independent errors (see `noise_of`) or what drivers do beside any law account for it, it
    is 0.

    Examples:
        >>> t, rng = np.arange(0.0, 40.0, 0.1), np.random.default_rng(0)
        >>> smooth = 30.0 * np.sin(0.3 * t)
        >>> slow = np.interp(t, t[::2], rng.normal(0, 0.02, 200))
        >>> slower = np.interp(t, t[::8], rng.normal(0, 0.1, 50))
        >>> tracks = (smooth, smooth + slow, smooth + slower)
        >>> [round(trembling_of(one, 0.1), 3) for one in tracks]
        [0.0, 0.015, 0.071]
    """
    least_m, most_m = BEYOND * noise_of(values), 0.0
    for lag in sorted({max(1, round(lasts_s / frame_s)) for lasts_s in LASTS_S}):
        if values.size < 7 * lag:
            break
        once, twice = (noise_of_lag(values, every) for every in (lag, 2 * lag))
        found = float(np.sqrt(max(once**2 - (twice / 8.0) ** 2, 0.0) / (1.0 - 8.0**-2)))
        people_m = THIRD_PER_ACCEL * ROUGHEST_MPS2 * (lag * frame_s) ** 2
        if found > max(least_m, people_m):
            most_m = max(most_m, found)
    return most_m


def smoothed_half_s(noise_m: float, frame_s: float) -> float:
    """Half the stretch over which a motion is smoothed, s, by the noise and the time of a frame.

    Examples:
        >>> [round(smoothed_half_s(noise_m, 0.1), 2) for noise_m in (0.0, 0.05, 1.0)]
        [0.1, 0.59, 0.8]
    """
    share = float(np.sqrt(min(noise_m / FULL_NOISE_M, 1.0)))
    half_s = LEAST_HALF_S + (MOST_HALF_S - LEAST_HALF_S) * share
    return max(half_s, frame_s)


def make_drive(stretches: Sequence[Stretch]) -> Drive | None:
    """The rows of one driver.

    Args:
        stretches: its stretches, at one frame rate.

    Returns:
        What the filter takes; None if no stretch is `LEAST_S` long.

    Examples:
        >>> t = np.arange(0.0, 10.0, 0.1)
        >>> drive = make_drive([Stretch(t, 10.0 * t, 30.0 + 10.0 * t)])
        >>> drive.rows.shape, round(drive.seconds, 1), drive.rows[2:, 7].round(3).tolist()
        ((5, 96), 9.5, [10.0, 37.0, 10.0])
    """
    long = [one for one in stretches if one.time_s[-1] - one.time_s[0] >= LEAST_S]
    if not long:
        return None
    frame_s = float(np.median(np.concatenate([np.diff(one.time_s) for one in long])))
    every = max(1, round(OBSERVED_S / frame_s))
    steps = min(max(1, int(np.ceil(every * frame_s / FINEST_S - 1e-6))), every)
    parts = [_rows(one, frame_s, every, steps) for one in long]
    return Drive(
        rows=np.ascontiguousarray(np.concatenate(parts, axis=1)),
        begins=np.cumsum([0, *(part.shape[1] for part in parts)]),
        step_s=every * frame_s / steps,
        frame_s=frame_s,
    )


def _rows(one: Stretch, frame_s: float, every: int, steps: int) -> FloatArray:
    """(5, T) rows of one stretch, observed every so many frames, with so many steps in between."""
    from graphrqi.calibrate.kernels import local_parabolas

    watched_s = every * frame_s
    begin = float(one.time_s[0])
    count = int((one.time_s[-1] - begin) / watched_s + 1e-6)
    at = begin + watched_s / steps * np.arange(count * steps + 1)
    noise_m = noise_of(one.place)
    rows = np.zeros((5, at.size))
    place = _shaken(one.place, noise_m)
    own_noise_m = max(noise_m, LEAST_NOISE_M)
    own_trembles_m = trembling_of(one.place, frame_s)
    fitted = np.empty((4, at.size))
    if every > 2:
        own = np.empty((4, count + 1))
        local_parabolas(one.time_s, place, at[::steps], 0.5 * watched_s - 1e-6, own)
        rows[0, ::steps], rows[1, ::steps] = own[0], np.hypot(own[3] * own_noise_m, own_trembles_m)
    else:
        rows[0, ::steps] = np.interp(at[::steps], one.time_s, place)
        rows[1, ::steps] = np.hypot(own_noise_m, own_trembles_m)
    half_s = smoothed_half_s(max(noise_m, own_trembles_m), frame_s)
    local_parabolas(one.time_s, one.place, at, half_s, fitted)
    rows[2] = np.maximum(fitted[1], 0.0)
    rows[3] = np.inf
    if np.isfinite(one.leader).all():
        trembles_m = trembling_of(one.leader, frame_s)
        half_s = smoothed_half_s(max(noise_m, trembles_m), frame_s)
        local_parabolas(one.time_s, one.leader, at, half_s, fitted)
        rows[3], rows[4] = fitted[0], np.maximum(fitted[1], 0.0)
    return rows


def _shaken(place: FloatArray, noise_m: float) -> FloatArray:
    """Places whose error is `LEAST_NOISE_M` if it is smaller; the same ones for the same way."""
    if noise_m >= LEAST_NOISE_M:
        return place
    rng = np.random.default_rng(int(1e3 * abs(float(place[-1] - place[0]))))
    missing_m = (LEAST_NOISE_M**2 - noise_m**2) ** 0.5
    return np.asarray(place + missing_m * rng.standard_normal(place.size))
