"""How each agent of a recording moves now, estimated from its own past however noisy that is.

Positions and recorded velocities are fitted together by uniformly accelerated motion. Each counts
by its noise, which is measured on the history itself: differences of the positions and of the
velocities that no vehicle could drive are noise. On clean recordings the present's recorded
velocity decides; on shaken ones the fit averages over the last seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SLOPE_S, SLOPE_SHARE, SLOPE_FADE_S = 2.2, 0.7, 1.5
"""The acceleration is the slope of the speed over this past, s; this share of it counts and falls
to 1/e in this time, s (measured on recordings of twelve families)."""

YAW_S, YAW_SHARE, YAW_FADE_S = 1.2, 0.5, 1.0
"""The same for the yaw rate."""

LEAST_NOISE_M, LEAST_NOISE_MPS = 0.01, 0.05
"""The noise of a recording is taken to be at least this (video and lidar tracks are not)."""

USUAL_TURN_MPS2: Final = 0.7
"""The same across the direction of travel (comfortable turns)."""

JERK_MPS3: Final = 1.5
"""By how much accelerations wander, m/s3: how soon older samples lose their weight for the present
speed (people brake at up to 2 to 3 m/s3)."""

USUAL_ACCEL_MPS2: Final = 1.0
"""Standard deviation of accelerations before anything is seen, m/s2."""

MOST_ACCEL_MPS2, MOST_YAW_RADPS = 4.0, 0.6
"""Fitted accelerations and yaw rates are cut off here (hard braking; 12 m radius at 7 m/s)."""

TYPICAL_COUNTS: Final = 10
"""What the scene's typical noise counts against an agent's own."""

TURNING_MPS: Final = 1.5
"""Slower agents have the recorded heading, and do not turn (noise of positions hides the direction
of slower motion)."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Present motion of the n agents of a history.

    Attributes:
        xy: (n, 2) present positions, freed from noise, m.
        heading: (n,) direction of travel, rad.
        speed: (n,) m/s, not negative.
        accel: (n,) slope of the speed over `SLOPE_S`, m/s2.
        accel_now: (n,) present acceleration, m/s2.
        yaw_rate: (n,) rad/s.
        noise_m: (n,) standard deviation of each coordinate's noise, m.
        noise_mps: (n,) of each recorded velocity's, m/s.
        seen_s: (n,) time since each was first seen in the history, s.
    """

    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    accel: FloatArray
    accel_now: FloatArray
    yaw_rate: FloatArray
    noise_m: FloatArray
    noise_mps: FloatArray
    seen_s: FloatArray

    @classmethod
    def of(cls, history: Tracks) -> Motion:
        """Estimate the motion of a history's agents, all of them seen in its last column."""
        ago = history.time_s - history.time_s[-1]
        valid = history.valid
        xy = _filled(history.xy, valid) - history.xy[:, -1:]
        recorded = np.where(valid, history.speed, 0.0)
        angle = np.where(valid, history.heading, 0.0)
        velocity = recorded[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        noise_m, noise_mps = _noise(ago, xy, velocity, valid)
        given = (ago, xy, velocity, valid, noise_m, noise_mps)
        at, moving, bending = _fit(*given, YAW_S, 0.0, USUAL_TURN_MPS2)
        speed = np.hypot(moving[:, 0], moving[:, 1])
        turns = (speed > TURNING_MPS) & (history.kind != PEDESTRIAN)
        across = moving[:, 0] * bending[:, 1] - moving[:, 1] * bending[:, 0]
        yaw_rate = np.where(turns, across / np.maximum(speed, TURNING_MPS) ** 2, 0.0)
        yaw_rate = np.clip(yaw_rate, -MOST_YAW_RADPS, MOST_YAW_RADPS)
        at, moving, _ = _fit(*given, SLOPE_S, JERK_MPS3, USUAL_TURN_MPS2)
        faster = np.hypot(moving[:, 0], moving[:, 1]) > TURNING_MPS
        heading = np.where(faster, np.arctan2(moving[:, 1], moving[:, 0]), angle[:, -1])
        along, forward = _along(ago, xy, heading, yaw_rate), recorded
        line = (ago, along[..., None], forward[..., None], valid, noise_m, noise_mps)
        _, _, slope = _fit(*line, SLOPE_S, 0.0)
        _, now, accel_now = _fit(*line, SLOPE_S, JERK_MPS3)
        most = MOST_ACCEL_MPS2
        first = ago[valid.argmax(axis=1)]
        return cls(
            xy=history.xy[:, -1] + np.clip(at, -2 * noise_m[:, None], 2 * noise_m[:, None]),
            heading=heading,
            speed=np.maximum(now[:, 0], 0.0),
            accel=np.clip(slope[:, 0], -most, most),
            accel_now=np.clip(accel_now[:, 0], -2 * most, 2 * most),
            yaw_rate=yaw_rate,
            noise_m=noise_m,
            noise_mps=noise_mps,
            seen_s=-first,
        )

    def to_own_frame(self, xy: FloatArray) -> FloatArray:
        """(n, ..., 2) places, m, as distances ahead of each agent and to its left."""
        shape = (-1,) + (1,) * (xy.ndim - 2)
        cos, sin = np.cos(self.heading).reshape(shape), np.sin(self.heading).reshape(shape)
        apart = xy - self.xy.reshape((*shape, 2))
        x, y = apart[..., 0], apart[..., 1]
        return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)

    def from_own_frame(self, own: FloatArray) -> FloatArray:
        """(n, ..., 2) distances ahead of each agent and to its left as places, m."""
        shape = (-1,) + (1,) * (own.ndim - 2)
        cos, sin = np.cos(self.heading).reshape(shape), np.sin(self.heading).reshape(shape)
        x, y = own[..., 0], own[..., 1]
        moved = np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)
        return np.asarray(moved + self.xy.reshape((*shape, 2)))


def fading(motion: Motion, time_s: FloatArray) -> FloatArray:
    """(n, H, 2) the base: acceleration and yaw rate fade; in each agent's frame, m.

    Args:
        motion: of the agents.
        time_s: (H,) increasing, s; integrated in steps of at most 0.1 s.
    """
    return bent(
        motion.speed, SLOPE_SHARE * motion.accel, SLOPE_FADE_S, YAW_SHARE * motion.yaw_rate,
        YAW_FADE_S, time_s,
    )  # fmt: skip


def bent(
    speed: FloatArray, accel: FloatArray, accel_fade_s: float, yaw_rate: FloatArray,
    yaw_fade_s: float, time_s: FloatArray,
) -> FloatArray:  # fmt: skip
    """(n, H, 2) where agents come whose acceleration and yaw rate fade; in their frames, m.

    Nobody reverses: vehicles that brake to a standstill stay there.

    Args:
        speed: (n,) m/s.
        accel: (n,) m/s2.
        accel_fade_s: time in which it falls to 1/e, s.
        yaw_rate: (n,) rad/s.
        yaw_fade_s: likewise.
        time_s: (H,) increasing, s.
    """
    steps = max(1, round(float(time_s[-1]) / 0.1))
    fine = np.linspace(0.0, float(time_s[-1]), steps + 1)
    gained = accel[:, None] * accel_fade_s * (1.0 - np.exp(-fine / accel_fade_s))
    fast = np.maximum(speed[:, None] + gained, 0.0)
    braked = np.minimum.accumulate(np.where(fast > 0.0, 1.0, 0.0), axis=1)
    fast = fast * np.where(accel[:, None] < 0.0, braked, 1.0)
    angle = yaw_rate[:, None] * yaw_fade_s * (1.0 - np.exp(-fine / yaw_fade_s))
    step_s = np.diff(fine)
    mean, middle = (fast[:, 1:] + fast[:, :-1]) / 2, (angle[:, 1:] + angle[:, :-1]) / 2
    moved = (mean * step_s)[..., None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
    way = np.concatenate([np.zeros((len(speed), 1, 2)), np.cumsum(moved, axis=1)], axis=1)
    after = np.clip(np.searchsorted(fine, time_s - 1e-9), 1, steps)
    share = ((time_s - fine[after - 1]) / (fine[after] - fine[after - 1]))[:, None]
    return np.asarray(way[:, after - 1] * (1.0 - share) + way[:, after] * share)


def _filled(xy: FloatArray, valid: BoolArray) -> FloatArray:
    """(n, T, 2) positions; where an agent was not seen, the next one seen."""
    columns = np.arange(valid.shape[1])
    following = np.where(valid, columns, valid.shape[1] - 1)
    following = np.minimum.accumulate(following[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.take_along_axis(xy, following[..., None], axis=1))


def _noise(
    ago: FloatArray, xy: FloatArray, velocity: FloatArray, valid: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """(n,) noise of positions, m, and (n,) of recorded velocities, m/s, one standard deviation.

    Third differences of positions and second differences of velocities, divided ones where frames
    are missing, are nearly free of what vehicles do. Each is scaled to have the noise's deviation;
    an agent's own estimate is mixed with the typical one of the scene, which counts as
    `TYPICAL_COUNTS` differences.
    """
    found = []
    for values, order, least in ((xy, 3, LEAST_NOISE_M), (velocity, 2, LEAST_NOISE_MPS)):
        n = len(values)
        if ago.size <= order:
            found.append(np.full(n, least))
            continue
        times = np.lib.stride_tricks.sliding_window_view(ago, order + 1)
        apart = times[:, :, None] - times[:, None] + np.eye(order + 1)
        weight = 1.0 / apart.prod(axis=2)
        weight /= np.sqrt((weight**2).sum(axis=1))[:, None]
        last = ago.size - order
        jumps = sum(weight[:, i, None] * values[:, i : i + last] for i in range(order + 1))
        whole = np.logical_and.reduce([valid[:, i : i + last] for i in range(order + 1)])
        count = whole.sum(axis=1)
        squared = np.where(whole, (np.asarray(jumps) ** 2).mean(axis=-1), 0.0)
        own = squared.sum(axis=1) / np.maximum(count, 1)
        known = count > 0
        typical = float(np.median(own[known])) if known.any() else 0.0
        mixed = (own * count + typical * TYPICAL_COUNTS) / (count + TYPICAL_COUNTS)
        found.append(np.sqrt(np.maximum(mixed, least**2)))
    noise_m, noise_mps = found
    # recorded velocities that do not lead from place to place are wrong by the difference
    span = valid & (ago >= -1.5 - 1e-6)
    first = span.argmax(axis=1)
    passed = np.maximum(-ago[first], 1e-3)
    moved = -np.take_along_axis(xy, first[:, None, None], axis=1)[:, 0] / passed[:, None]
    mean = np.where(span[..., None], velocity, 0.0).sum(axis=1) / span.sum(axis=1)[:, None]
    wrong = np.hypot(*(moved - mean).T) - 2.0 * noise_m / passed - 0.3
    wrong = np.where(passed > 0.7, np.maximum(wrong, 0.0), 0.0)
    return noise_m, np.hypot(noise_mps, wrong)


def _along(
    ago: FloatArray, xy: FloatArray, heading: FloatArray, yaw_rate: FloatArray
) -> FloatArray:
    """(n, T) distance travelled along the bent way, m; 0 now and negative before."""
    middle = (ago[1:] + ago[:-1]) / 2
    angle = heading[:, None] + yaw_rate[:, None] * np.maximum(middle, -YAW_S)
    moved = np.diff(xy, axis=1)
    step = moved[..., 0] * np.cos(angle) + moved[..., 1] * np.sin(angle)
    back = np.cumsum(step[:, ::-1], axis=1)[:, ::-1]
    return np.concatenate([-back, np.zeros((len(xy), 1))], axis=1)


def _fit(
    ago: FloatArray, xy: FloatArray, velocity: FloatArray, valid: BoolArray, noise_m: FloatArray,
    noise_mps: FloatArray, span_s: float, jerk: float, usual: float = USUAL_ACCEL_MPS2,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Uniformly accelerated motion that explains positions and velocities best.

    Args:
        ago: (T,) times before the present, s, negative.
        xy: (n, T, A) positions along A axes, m; 0 at present.
        velocity: (n, T, A) m/s.
        valid: (n, T).
        noise_m: (n,) m.
        noise_mps: (n,) m/s.
        span_s: how much of the past counts, s.
        jerk: by how much the acceleration may wander, m/s3; 0 if not at all.
        usual: standard deviation of accelerations before anything is seen, m/s2.

    Returns:
        Present position (n, A), velocity (n, A) and acceleration (n, A).
    """
    used = ago >= -span_s - 1e-6
    if used.sum() < 3:
        used = np.arange(ago.size) >= ago.size - 3
    s = ago[used]
    seen = valid[:, used]
    weight_m = seen / (noise_m[:, None] ** 2 + (jerk * s**3 / 6) ** 2)
    weight_mps = seen / (noise_mps[:, None] ** 2 + (jerk * s**2 / 2) ** 2)
    one, zero = np.ones_like(s), np.zeros_like(s)
    place, rate = np.stack([one, s, s**2 / 2]), np.stack([zero, one, s])
    left = np.einsum("at,bt,nt->nab", place, place, weight_m, optimize=True)
    left += np.einsum("at,bt,nt->nab", rate, rate, weight_mps, optimize=True)
    left[:, 2, 2] += 1.0 / usual**2
    left[:, 1, 1] += 1e-4
    right = np.einsum("at,nt,ntc->nac", place, weight_m, xy[:, used], optimize=True)
    right += np.einsum("at,nt,ntc->nac", rate, weight_mps, velocity[:, used], optimize=True)
    state = np.linalg.solve(left, right) if len(xy) else right
    return state[:, 0], state[:, 1], state[:, 2]


KALMAN_JERK: Final = 1.0
"""Spectral density of the white jerk that drives the filter, m2/s5 (accelerations of 1 m/s2 that
last a second)."""


def tracked(history: Tracks) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A Kalman filter of constant acceleration along each axis, over positions and velocities.

    Returns:
        (n, 2) present positions, m, velocities, m/s, and accelerations, m/s2.

    References:
        Bar-Shalom, Li, Kirubarajan (2001), Estimation with applications to tracking and
        navigation, section 6.2.3 (the Wiener-process acceleration model).
    """
    valid = history.valid
    origin = history.xy[:, -1:]
    angle = np.where(valid, history.heading, 0.0)
    speed = np.where(valid, history.speed, 0.0)
    xy = np.where(valid[..., None], history.xy - origin, 0.0)
    velocity = speed[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    noise = _noise(history.time_s, _filled(history.xy, valid) - origin, velocity, valid)
    n = len(xy)
    state, started = np.zeros((n, 3, 2)), np.zeros(n, dtype=bool)
    spread = np.zeros((n, 3, 3))
    measured = np.eye(2, 3)
    error = np.zeros((n, 2, 2))
    error[:, 0, 0], error[:, 1, 1] = noise[0] ** 2, noise[1] ** 2
    for t in range(history.time_s.size):
        step = history.time_s[t] - history.time_s[t - 1] if t else 0.0
        move = np.array([[1.0, step, step**2 / 2], [0.0, 1.0, step], [0.0, 0.0, 1.0]])
        power = step ** np.array([[5, 4, 3], [4, 3, 2], [3, 2, 1]])
        wander = KALMAN_JERK * power / np.array([[20, 8, 6], [8, 3, 2], [6, 2, 1]])
        state, spread = move @ state, move @ spread @ move.T + wander
        seen = np.stack([xy[:, t], velocity[:, t]], axis=1)
        first = valid[:, t] & ~started
        state[first, :2] = seen[first]
        spread[first] = np.diag([0.0, 0.0, USUAL_ACCEL_MPS2**2])
        spread[first, :2, :2] = error[first]
        gain = spread[:, :, :2] @ np.linalg.inv(spread[:, :2, :2] + error)
        better = state + gain @ (seen - state[:, :2])
        tighter = spread - gain @ measured @ spread
        update = valid[:, t] & started
        state = np.where(update[:, None, None], better, state)
        spread = np.where(update[:, None, None], tighter, spread)
        started |= valid[:, t]
    return state[:, 0] + origin[:, 0], state[:, 1], state[:, 2]
