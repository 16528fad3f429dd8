"""How each agent of a recording moves now, and how its motion fades: the base of all predictions.

A Kalman filter goes over positions and recorded velocities, along and across the present heading.
Its accelerations fade. Each measurement counts by its noise, which is measured on the history
itself: what no vehicle could drive, what shakes sideways at half a second, and velocities that do
not lead from place to place. How much of an acceleration lasts is measured on the same seconds.
Vehicles that stand are told apart; they stay.

References:
    Singer (1970), "Estimating optimal tracking filter performance for manned maneuvering targets",
    IEEE Trans. Aerospace and Electronic Systems 6 (accelerations that fade).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray
from sim.frames import PEDESTRIAN, Tracks
from sim.geometry import from_own_frame, to_own_frame

PAST_S: Final = 4.0
"""Past that the filter goes over, s."""

USUAL_ACCEL_MPS2: Final = (2.0, 1.0)
"""Standard deviation of slow vehicles' accelerations along and across their way, m/s2."""

CALM_MPS: Final = 8.0
"""Faster vehicles accelerate less: at this speed by 1 / sqrt(2)."""

FILTER_FADE_S: Final = 2.0
"""Time in which the filter's accelerations fall to 1/e, s."""

ACCEL_FADE_S: Final = 2.5
"""Time in which the base's acceleration falls to 1/e, s."""

STOP_S: Final = 1.0
"""Time in which what is left of the speed of a standing vehicle falls to 1/e, s."""

STANDING_S, CREEP_MPS = 1.0, 0.1
"""A standing vehicle is at its mean place of this time, s. Its speed counts by how it compares with
its uncertainty, usual speeds being this, m/s."""

YAW_SHARE, YAW_FADE_S = 0.4, 1.0
"""This share of the yaw rate counts, and falls to 1/e in this time, s."""

LEAST_NOISE_M, LEAST_NOISE_MPS = 0.01, 0.05
"""The noise of a recording is taken to be at least this (video and lidar tracks are not)."""

LEAST_FILTER_M, LEAST_FILTER_MPS = 0.02, 0.1
"""The same in the filter, whose model of drivers is not exact."""

TYPICAL_COUNTS: Final = 10
"""What the scene's typical noise counts against an agent's own, in measurements."""

SHAKE_S: Final = 0.6
"""Noise that is correlated over half a second shows in second differences this far apart, s."""

AGREES_MPS: Final = 0.2
"""Recorded velocities may differ from the speed over the last half second by this, m/s."""

MOST_ACCEL_MPS2, MOST_YAW_RADPS = 4.0, 0.6
"""Accelerations and yaw rates are cut off here (hard braking; 12 m radius at 7 m/s)."""

TURNING_MPS: Final = 1.5
"""Slower agents have the recorded heading, and do not turn (noise of positions hides the direction
of slower motion)."""

STANDS_MPS, STANDS_M = 0.3, 0.3
"""Vehicles stand that are slower than this, and within a second moved less, beyond noise."""

UNSURE: Final = 2.0
"""Speeds may be larger by this many of their standard deviations."""

LOOKED_BACK_S: Final = (1.0, 1.5, 2.0, 2.5)
"""Moments of the past, s ago, from which the speed a second later is compared."""

PRIOR_SHARE, PRIOR_WEIGHT = 0.8, 0.5
"""Share of accelerations that lasts before anything is seen, and its weight, m2/s2."""

MOST_SHARE, MOST_CHANGE_MPS = 1.1, 3.0
"""The measured share is at most this; changes of speed count up to this, m/s."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Present motion of the n agents of a history.

    Attributes:
        xy: (n, 2) present positions, freed from noise, m.
        heading: (n,) direction of travel, rad.
        speed: (n,) m/s, not negative.
        accel: (n,) part of the acceleration that lasts, m/s2.
        accel_now: (n,) present acceleration, m/s2.
        yaw_rate: (n,) rad/s.
        stands: (n,) whether each stands.
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
    stands: BoolArray
    noise_m: FloatArray
    noise_mps: FloatArray
    seen_s: FloatArray

    @classmethod
    def of(cls, history: Tracks) -> Motion:
        """Estimate the motion of a history's agents, all of them seen in its last column."""
        seen = _Seen.of(history, PAST_S)
        ago, valid, n = seen.ago, seen.valid, len(seen.xy)
        noise_m, noise_mps, filtered_m, filtered_mps = _noises(seen)
        heading = seen.heading[:, -1]
        facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        axes = np.stack([facing, np.stack([-facing[:, 1], facing[:, 0]], axis=1)], axis=1)
        place, rate = (np.einsum("ntc,nac->nat", one, axes) for one in (seen.xy, seen.velocity))
        calm = np.sqrt(1.0 + (seen.velocity[:, -1] ** 2).sum(axis=-1) / CALM_MPS**2)
        usual = np.asarray(USUAL_ACCEL_MPS2)[None] / calm[:, None]
        noises = np.repeat(filtered_m, 2), np.repeat(filtered_mps, 2)
        shape = (2 * n, ago.size)
        states, spread = filtered(
            ago, place.reshape(shape), rate.reshape(shape), np.repeat(valid, 2, axis=0), *noises,
            usual.ravel(), FILTER_FADE_S,
        )  # fmt: skip
        states = states.reshape(n, 2, ago.size, 3)
        now = states[:, :, -1]
        ahead, drives = now[:, 0, 1], history.kind != PEDESTRIAN
        swift = np.hypot(ahead, now[:, 1, 1])
        turns = (swift > TURNING_MPS) & drives
        aside = np.where(turns, np.arctan2(now[:, 1, 1], np.maximum(ahead, 1e-3)), 0.0)
        cos, sin = np.cos(aside), np.sin(aside)
        accel = now[:, 0, 2] * cos + now[:, 1, 2] * sin
        across = now[:, 1, 2] * cos - now[:, 0, 2] * sin
        yaw_rate = np.where(turns, across / np.maximum(swift, TURNING_MPS), 0.0)
        speed = np.where(turns, swift, np.maximum(ahead, 0.0))
        unsure = np.sqrt(spread.reshape(n, 2)[:, 0])
        second = np.maximum(valid.argmax(axis=1), np.searchsorted(ago, -1.0 - 1e-6))
        moved = np.linalg.norm(seen.xy[np.arange(n), second], axis=1)
        stands = drives & (speed < STANDS_MPS + UNSURE * unsure)
        stands &= moved < STANDS_M + 3.0 * noise_m
        accel = np.where(stands, 0.0, accel)
        speed = np.where(stands, speed / (1.0 + (unsure / CREEP_MPS) ** 2), speed)
        lasts = _lasting_share(ago, rate[:, 0], valid & drives[:, None], states[:, 0])
        shaken = (noise_m - LEAST_NOISE_M)[:, None]
        lately = valid & (ago >= -STANDING_S - 1e-6)
        weight = lately / lately.sum(axis=1)[:, None]
        mean = np.einsum("nat,nt->na", place, weight)
        mean[:, 0] -= speed * (weight @ ago)
        off = np.clip(np.where(stands[:, None], mean, now[:, :, 0]), -shaken, shaken)
        most = MOST_ACCEL_MPS2
        return cls(
            xy=history.xy[:, -1] + np.einsum("na,nac->nc", off, axes),
            heading=heading + aside,
            speed=speed,
            accel=np.clip(lasts * accel, -most, most),
            accel_now=np.clip(accel, -2 * most, 2 * most),
            yaw_rate=np.clip(yaw_rate, -MOST_YAW_RADPS, MOST_YAW_RADPS),
            stands=stands,
            noise_m=noise_m,
            noise_mps=noise_mps,
            seen_s=history.time_s[-1] - history.time_s[history.valid.argmax(axis=1)],
        )

    def to_own_frame(self, xy: FloatArray) -> FloatArray:
        """(n, ..., 2) places, m, as distances ahead of each agent and to its left."""
        return to_own_frame(xy, self.xy, self.heading)

    def from_own_frame(self, own: FloatArray) -> FloatArray:
        """(n, ..., 2) distances ahead of each agent and to its left as places, m."""
        return from_own_frame(own, self.xy, self.heading)


def fading(motion: Motion, time_s: FloatArray) -> FloatArray:
    """(n, H, 2) the base at increasing times (H,), s: acceleration and yaw rate fade.

    Places are in each agent's frame, m. Nobody reverses: vehicles that brake to a standstill stay
    there. Steps are 0.1 s at most.
    """
    speed, yaw_rate = motion.speed[:, None], YAW_SHARE * motion.yaw_rate[:, None]
    accel = np.where(motion.stands, -motion.speed / STOP_S, motion.accel)[:, None]
    fade_s = np.where(motion.stands, STOP_S, ACCEL_FADE_S)[:, None]
    steps = max(1, round(float(time_s[-1]) / 0.1))
    fine = np.linspace(0.0, float(time_s[-1]), steps + 1)
    gained = accel * fade_s * (1.0 - np.exp(-fine / fade_s))
    fast = np.maximum(speed + gained, 0.0)
    braked = np.minimum.accumulate(np.where(fast > 0.0, 1.0, 0.0), axis=1)
    fast = fast * np.where(accel < 0.0, braked, 1.0)
    angle = yaw_rate * YAW_FADE_S * (1.0 - np.exp(-fine / YAW_FADE_S))
    step_s = np.diff(fine)
    mean, middle = (fast[:, 1:] + fast[:, :-1]) / 2, (angle[:, 1:] + angle[:, :-1]) / 2
    moved = (mean * step_s)[..., None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
    way = np.concatenate([np.zeros((len(speed), 1, 2)), np.cumsum(moved, axis=1)], axis=1)
    after = np.clip(np.searchsorted(fine, time_s - 1e-9), 1, steps)
    share = ((time_s - fine[after - 1]) / (fine[after] - fine[after - 1]))[:, None]
    return np.asarray(way[:, after - 1] * (1.0 - share) + way[:, after] * share)


class _Seen(NamedTuple):
    """The last seconds of a history, with positions relative to the present ones."""

    ago: FloatArray
    xy: FloatArray
    velocity: FloatArray
    valid: BoolArray
    heading: FloatArray

    @classmethod
    def of(cls, history: Tracks, past_s: float) -> _Seen:
        """At least four frames, where there are so many."""
        first = int(np.searchsorted(history.time_s, history.time_s[-1] - past_s - 1e-6))
        first = max(0, min(first, history.time_s.size - 4))
        valid = history.valid[:, first:]
        angle = np.where(valid, history.heading[:, first:], 0.0)
        speed = np.where(valid, history.speed[:, first:], 0.0)
        return cls(
            history.time_s[first:] - history.time_s[-1],
            _filled(history.xy[:, first:], valid) - history.xy[:, -1:],
            speed[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1),
            valid,
            angle,
        )


def filtered(
    ago: FloatArray, place: FloatArray, rate: FloatArray, valid: BoolArray, noise_m: FloatArray,
    noise_mps: FloatArray, accel_mps2: FloatArray, fade_s: float, wander: float | None = None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """A Kalman filter of m motions along one axis each, whose accelerations fade.

    Args:
        ago: (T,) times, s.
        place: (m, T) m.
        rate: (m, T) m/s.
        valid: (m, T) which of them were seen.
        noise_m: (m,) standard deviation of places, m.
        noise_mps: (m,) of rates, m/s.
        accel_mps2: (m,) of accelerations before anything is seen, m/s2.
        fade_s: time in which accelerations fall to 1/e, s.
        wander: power of the white jerk that drives them, m2/s5; None keeps their deviation.

    Returns:
        (m, T, 3) places, rates and accelerations at each time, and the (m,) variance of the last
        rate, m2/s2.
    """
    m = len(place)
    state, spread, begun = np.zeros((m, 3)), np.zeros((m, 3, 3)), np.zeros(m, dtype=bool)
    states = np.zeros((m, ago.size, 3))
    for t in range(ago.size):
        step = ago[t] - ago[t - 1] if t else 0.0
        keep = np.exp(-step / fade_s)
        move = np.array(
            [[1.0, step, fade_s**2 * (keep - 1.0) + fade_s * step],
             [0.0, 1.0, fade_s * (1.0 - keep)], [0.0, 0.0, keep]]
        )  # fmt: skip
        push = np.array([step**2 / 6, step / 2, 1.0])
        driven = (1.0 - keep**2) * accel_mps2**2 if wander is None else np.full(m, wander * step)
        state = state @ move.T
        spread = move @ spread @ move.T + driven[:, None, None] * np.outer(push, push)
        new, update = valid[:, t] & ~begun, (valid[:, t] & begun)[:, None]
        state[new, 0], state[new, 1] = place[new, t], rate[new, t]
        spread[new] = 0.0
        for row, (seen, noise) in enumerate(((place, noise_m), (rate, noise_mps))):
            spread[new, row, row] = noise[new] ** 2
            gain = spread[:, :, row] / (spread[:, row, row] + noise**2)[:, None]
            gain = np.where(update, gain, 0.0)
            state = state + gain * (seen[:, t] - state[:, row])[:, None]
            spread = spread - gain[:, :, None] * spread[:, row][:, None]
        spread[new, 2, 2] = accel_mps2[new] ** 2
        begun |= valid[:, t]
        states[:, t] = state
    return states, spread[:, 1, 1]


def _lasting_share(
    ago: FloatArray, rate: FloatArray, valid: BoolArray, states: FloatArray
) -> float:
    """Which share of the accelerations that the filter saw a second ago came about since."""
    above, below, used = 0.0, 0.0, 0
    for back_s in LOOKED_BACK_S:
        then = int(np.searchsorted(ago, -back_s - 1e-6))
        first, last = np.searchsorted(ago, (0.75 - back_s - 1e-6, 1.25 - back_s + 1e-6))
        if ago[0] > -back_s - 0.7 or first >= last:
            continue
        used += 1
        speed, accel = states[:, then, 1], states[:, then, 2]
        counts = valid[:, then] & valid[:, first:last].all(axis=1) & (speed > 1.0)
        passed = ago[first:last].mean() - ago[then]
        foreseen = accel * ACCEL_FADE_S * (1.0 - np.exp(-passed / ACCEL_FADE_S))
        change = rate[:, first:last].mean(axis=1) - speed
        change = np.clip(change, -MOST_CHANGE_MPS, MOST_CHANGE_MPS)
        above += float((foreseen * change)[counts].sum()) / len(LOOKED_BACK_S)
        below += float((foreseen**2)[counts].sum()) / len(LOOKED_BACK_S)
    share = (above + PRIOR_WEIGHT * PRIOR_SHARE) / (below + PRIOR_WEIGHT)
    return float(np.clip(share, 0.0, MOST_SHARE))


def _filled(xy: FloatArray, valid: BoolArray) -> FloatArray:
    """(n, T, 2) positions; where an agent was not seen, the next one seen."""
    columns = np.arange(valid.shape[1])
    following = np.where(valid, columns, valid.shape[1] - 1)
    following = np.minimum.accumulate(following[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.take_along_axis(xy, following[..., None], axis=1))


def _noises(seen: _Seen) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(n,) white noise of positions and of velocities, and both as the filter takes them."""
    ago, xy, velocity, valid, _ = seen
    noise_m = _white(ago, xy, valid, 3, LEAST_NOISE_M)
    noise_mps = np.hypot(
        _white(ago, velocity, valid, 2, LEAST_NOISE_MPS), _disagreement(seen, noise_m)
    )
    step = float(np.median(np.diff(ago))) if ago.size > 1 else 0.1
    slow = np.maximum(_shaking(seen, step) ** 2 - 1.2 * noise_m**2, 0.0) * (1.0 + 1.0 / step)
    filtered_m = np.sqrt(np.maximum(noise_m, LEAST_FILTER_M) ** 2 + slow)
    return noise_m, noise_mps, filtered_m, np.maximum(noise_mps, LEAST_FILTER_MPS)


def _white(
    ago: FloatArray, values: FloatArray, valid: BoolArray, order: int, least: float
) -> FloatArray:
    """(n,) deviation of white noise, from differences of an order that vehicles hardly show."""
    n = len(values)
    if ago.size <= order:
        return np.full(n, least)
    times = np.lib.stride_tricks.sliding_window_view(ago, order + 1)
    apart = times[:, :, None] - times[:, None] + np.eye(order + 1)
    weight = 1.0 / apart.prod(axis=2)
    weight /= np.sqrt((weight**2).sum(axis=1))[:, None]
    last = ago.size - order
    jumps = sum(weight[:, i, None] * values[:, i : i + last] for i in range(order + 1))
    whole = np.logical_and.reduce([valid[:, i : i + last] for i in range(order + 1)])
    squared = np.where(whole, (np.asarray(jumps) ** 2).mean(axis=-1), 0.0)
    return np.sqrt(np.maximum(_mixed(squared, whole, TYPICAL_COUNTS), least**2))


def _mixed(squared: FloatArray, counts: BoolArray, typical_counts: float) -> FloatArray:
    """(n,) means of (n, T) squares, mixed with their median over the agents."""
    count = counts.sum(axis=1)
    own = np.where(counts, squared, 0.0).sum(axis=1) / np.maximum(count, 1)
    typical = float(np.median(own[count > 0])) if (count > 0).any() else 0.0
    return np.asarray((own * count + typical * typical_counts) / (count + typical_counts))


def _shaking(seen: _Seen, step_s: float) -> float:
    """The scene's noise across the way at `SHAKE_S`, m; 0 where nobody shows it."""
    lag = max(1, round(SHAKE_S / step_s))
    if seen.ago.size < 2 * lag + 1:
        return 0.0
    bend = seen.xy[:, 2 * lag :] - 2.0 * seen.xy[:, lag:-lag] + seen.xy[:, : -2 * lag]
    way = seen.velocity[:, lag:-lag]
    speed = np.hypot(way[..., 0], way[..., 1])
    shown = seen.valid[:, 2 * lag :] & seen.valid[:, lag:-lag] & seen.valid[:, : -2 * lag]
    shown &= speed > 2.0 * TURNING_MPS
    if shown.sum() < TYPICAL_COUNTS:
        return 0.0
    across = np.abs(way[..., 0] * bend[..., 1] - way[..., 1] * bend[..., 0])[shown] / speed[shown]
    return float(np.median(across) / 0.6745 / np.sqrt(6.0))  # deviation of a median, of 1 -2 1


def _disagreement(seen: _Seen, noise_m: FloatArray) -> FloatArray:
    """(n,) by how much recorded velocities miss what leads from place to place, m/s."""
    ago, xy, velocity, valid, _ = seen
    if ago.size < 2:
        return np.zeros(len(xy))
    leads = (velocity[:, 1:] + velocity[:, :-1]) / 2 * np.diff(ago)[None, :, None]
    way = np.concatenate([np.zeros_like(xy[:, :1]), np.cumsum(leads, axis=1)], axis=1)
    off = xy - way
    then = int(np.searchsorted(ago, -0.5 - 1e-6))
    passed = max(-float(ago[then]), 1e-3)
    recent = np.linalg.norm(off[:, -1] - off[:, then], axis=1) / passed
    recent = np.maximum(recent - 6.0 * noise_m - AGREES_MPS, 0.0)
    recent = np.where(valid[:, then] & (passed > 0.25), recent, 0.0)
    lag = max(1, round(1.0 / float(np.median(np.diff(ago)))))
    if ago.size <= lag + 1:
        return np.asarray(recent)
    span = (ago[lag:] - ago[:-lag])[None, :, None]
    squared = (((off[:, lag:] - off[:, :-lag]) / span) ** 2).sum(axis=-1) / 2
    mixed = _mixed(squared, valid[:, lag:] & valid[:, :-lag], TYPICAL_COUNTS)
    return np.asarray(np.sqrt(recent**2 + np.maximum(mixed - 2.0 * noise_m**2, 0.0)))


KALMAN_JERK: Final = 1.0
"""Power of the white jerk that drives the filter of constant acceleration, m2/s5."""


def tracked(history: Tracks) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A Kalman filter of constant acceleration along each axis, over positions and velocities.

    Returns:
        (n, 2) present positions, m, velocities, m/s, and accelerations, m/s2.

    References:
        Bar-Shalom, Li, Kirubarajan (2001), Estimation with applications to tracking and
        navigation, section 6.2.3 (the Wiener-process acceleration model).
    """
    seen = _Seen.of(history, np.inf)
    n = len(seen.xy)
    noise_m, noise_mps, _, _ = _noises(seen)
    place, rate = (
        np.swapaxes(one, 1, 2).reshape(2 * n, seen.ago.size) for one in (seen.xy, seen.velocity)
    )
    noises = np.repeat(noise_m, 2), np.repeat(noise_mps, 2)
    valid = np.repeat(seen.valid, 2, axis=0)
    states, _ = filtered(seen.ago, place, rate, valid, *noises, np.ones(2 * n), 1e3, KALMAN_JERK)
    now = states[:, -1].reshape(n, 2, 3)
    return now[..., 0] + history.xy[:, -1], now[..., 1], now[..., 2]
