"""The predictor for recordings: a base that nobody has to train, and networks that correct it.

The base lets acceleration and yaw rate fade (`graphrqi.predict.recorded.motion`). It is also the
fallback: outside the range of speed, noise and rate that the networks were trained on, the futures
come down to it.

Where there is a map, a network answers for each path along its lanes, too. Along each path, a
future says how far the agent gets and how far aside of it; the first goes on from the best guess
without a map. All futures of an agent are then brought down to `MODES`: the first is the mean of
the best guesses, weighed by the paths' probabilities; the others are chosen so that whatever may
happen is near to one of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import BoolArray, FloatArray, IntArray, softmax
from graphrqi.predict.networks import MODES, Futures
from graphrqi.predict.prediction import STEP_S, Prediction, coming_times
from graphrqi.predict.recorded.features import features_of, plausible, scale_of
from graphrqi.predict.recorded.lanes_ahead import MOST, LanesAhead, along_way, lanes_ahead
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import (
    LIKELIEST,
    PER_MODE,
    PER_PATH,
    POWERS,
    RecordedNetwork,
    decode,
    lane_answers,
    powers,
    spreads,
    trained_network,
)
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road

Floats = NDArray[np.floating]

LEAST_WITHOUT: Final = 0.4
"""Weight that the futures without a map keep beside all paths (chosen on datasets left out, where
two networks together are better)."""

KEPT_M: Final = 0.8
"""Vehicles keep this distance from a lane's line at most, m (lines of maps are off by so much)."""

RETURN_S, RETURN_M = 1.5, 7.5
"""The rest of the distance, and of the velocity that differs, falls within this time, s, and way,
m: who stands stays aside."""

COMPARED_S: Final = (1.0, 2.0, 3.0, 4.0, 5.0)
"""Futures are compared at these times, s."""


def join_lanes(
    raw: NDArray[np.floating], ahead: LanesAhead, free: Futures, speed: FloatArray,
    trust: FloatArray, time_s: FloatArray,
) -> Futures:  # fmt: skip
    """The futures of a network without a map, joined with those along lanes.

    Args:
        raw: (n, MOST + 1, PATH_OUTPUTS) of `graphrqi.predict.recorded.network.lane_answers`.
        ahead: the paths; an agent without any keeps its futures.
        free: what the network without a map says.
        speed: (n,) m/s.
        trust: (n,) how much of each correction counts, 0 to 1.
        time_s: (H,) s.
    """
    chance = _chances(raw[..., -1].astype(np.float64), ahead.exists, trust)
    rows = np.flatnonzero(chance[:, -1] < 1.0)
    if not rows.size:
        return free
    some = ahead.of(rows)
    each = raw[rows, :-1, :-1].reshape(rows.size, MOST, PER_PATH, PER_MODE).astype(np.float64)
    own = beside_paths(
        each, some, along_way(free.own[rows, 0]), scale_of(speed[rows]) * trust[rows],
        speed[rows], time_s,
    )  # fmt: skip
    spread = spreads(each, speed[rows], time_s)
    chance = chance[rows]
    guesses = _with(own[:, :, 0], free.own[rows, :1])
    all_ = _with(own[:, :, 1:], free.own[rows, 1:], guesses)
    all_spread = _with(
        spread[:, :, 1:], free.spread[rows, 1:], spread[:, :, 0], free.spread[rows, :1]
    )
    likely = softmax(each[:, :, 1:, -1])
    other = free.probability[rows, 1:]
    weight = (
        _with(
            chance[:, :-1, None] * likely,
            chance[:, -1:] * (other / other.sum(axis=1, keepdims=True)),
            chance,
        )
        / 2.0
    )
    mean = np.einsum("np,npht->nht", chance, guesses)
    off = ((all_ - mean[:, None]) ** 2).sum(axis=-1) / 2.0  # along each coordinate
    mean_spread = np.sqrt(np.einsum("nk,nkh->nh", weight, all_spread**2 + off))
    chosen, belongs = _covering(all_, weight, time_s)
    share, near_spread = _stand_for(all_, all_spread, weight, chosen, belongs)
    first = LIKELIEST * share.max(axis=1, keepdims=True)
    joined = Futures(free.own.copy(), free.spread.copy(), free.probability.copy())
    joined.own[rows] = _with(mean[:, None], all_[np.arange(rows.size)[:, None], chosen])
    joined.spread[rows] = _with(mean_spread[:, None], near_spread)
    joined.probability[rows] = _with(first, share) / (1.0 + first)
    return joined


def _with(*parts: FloatArray) -> FloatArray:
    """(n, K, ...) all parts in a row; those of paths (n, P, K, ...) one path after the other."""
    least = min(part.ndim for part in parts)
    flat = [
        part.reshape(len(part), -1, *part.shape[3:]) if part.ndim > least else part
        for part in parts
    ]
    return np.concatenate(flat, axis=1)


def _chances(score: FloatArray, exists: BoolArray, trust: FloatArray) -> FloatArray:
    """(n, MOST + 1) weight of each path, and of the futures without a map."""
    there = np.concatenate([exists, np.ones_like(exists[:, :1])], axis=1)
    sure = (1.0 - LEAST_WITHOUT) * trust
    chance = softmax(np.where(there, score, -np.inf)) * sure[:, None]
    chance[:, -1] += 1.0 - sure
    chance[:, -1] = np.where(chance[:, :-1].any(axis=1), chance[:, -1], 1.0)
    return np.asarray(chance)


def beside_paths(
    each: FloatArray, ahead: LanesAhead, gone: FloatArray, size: FloatArray, speed: FloatArray,
    time_s: FloatArray,
) -> FloatArray:  # fmt: skip
    """(n, MOST, PER_PATH, H, 2) places along paths and aside of them, in the agents' frames, m.

    Every future begins where the agent is, with its velocity: what differs at first fades. The
    network's numbers are ``each`` (n, MOST, PER_PATH, PER_MODE). The best guess without a map goes
    ``gone`` (n, H), m. Corrections have ``size`` (n,), m.
    """
    n, most, futures, _ = each.shape
    bend = each[..., : 2 * POWERS].reshape(n, most, futures, POWERS, 2)
    moved = size[:, None, None, None, None] * np.einsum("nmkpc,pt->nmktc", bend, powers(time_s))
    along = np.maximum(gone[:, None, None] + moved[..., 0], 0.0)
    along /= ahead.spacing_m[:, None, None, None]
    piece = np.minimum(along.astype(np.int64), ahead.points.shape[2] - 2)
    row, path = np.arange(n)[:, None, None, None], np.arange(most)[None, :, None, None]
    begin, end = ahead.points[row, path, piece], ahead.points[row, path, piece + 1]
    step = end - begin
    unit = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-3)
    kept, fading = beginnings(ahead, speed, time_s)
    aside = kept[:, :, None, None] + moved[..., 1]
    left = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
    along_lane = begin + (along - piece)[..., None] * step + aside[..., None] * left
    return np.asarray(along_lane + fading[:, :, None])


def beginnings(ahead: LanesAhead, speed: Floats, time_s: Floats) -> tuple[FloatArray, FloatArray]:
    """How agents come from where they are, as they move, to where their paths are.

    Returns:
        (n, MOST) distance to the left that is kept, m, and (n, MOST, H, 2) what is added, m.
    """
    begin, offset_m = ahead.points[:, :, 0], ahead.offset_m
    step = ahead.points[:, :, 1] - begin
    unit = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-3)
    kept = np.clip(offset_m, -KEPT_M, KEPT_M)
    left = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
    apart = -(begin + kept[..., None] * left)
    swift = -(speed / ahead.spacing_m)[:, None, None] * step
    swift[..., 0] += speed[:, None]
    rate = 1.0 / (RETURN_S + RETURN_M / np.maximum(speed, 0.01))[:, None, None]
    grows = (swift + apart * rate)[:, :, None] * time_s[:, None]
    fade = np.exp(-time_s[:, None] * rate[..., None])
    return np.asarray(kept), np.asarray((apart[:, :, None] + grows) * fade)


def _covering(
    futures: FloatArray, weight: FloatArray, time_s: FloatArray
) -> tuple[IntArray, IntArray]:
    """Choose futures that cover all others, and say which of them stands for each."""
    at = np.searchsorted(time_s, np.asarray(COMPARED_S) - 1e-9)
    at = np.unique(np.minimum(at, time_s.size - 1))
    some = futures[:, :, at]
    apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1).mean(axis=-1)
    row = np.arange(len(futures))
    nearest = np.full(weight.shape, np.inf)
    chosen = np.empty((len(futures), MODES - 1), np.int64)
    for k in range(MODES - 1):
        left = np.einsum("nck,nk->nc", np.minimum(nearest[:, None], apart), weight)
        left[weight == 0.0] = np.inf
        chosen[:, k] = left.argmin(axis=1)
        nearest = np.minimum(nearest, apart[row, chosen[:, k]])
    return chosen, apart[row[:, None], chosen].argmin(axis=1)


def _stand_for(
    futures: FloatArray, spread: FloatArray, weight: FloatArray, chosen: IntArray,
    belongs: IntArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Probability of the futures that each chosen one stands for, and their spread around it."""
    row = np.arange(len(futures))
    share = np.zeros(chosen.shape)
    around = np.empty((*chosen.shape, spread.shape[2]))
    for k in range(chosen.shape[1]):
        mine = np.where(belongs == k, weight, 0.0)
        mine[row, chosen[:, k]] += 1e-12  # a future chosen twice stands for nothing the second time
        share[:, k] = mine.sum(axis=1)
        off = ((futures - futures[row, chosen[:, k]][:, None]) ** 2).sum(axis=-1) / 2.0
        around[:, k] = np.einsum("nk,nkh->nh", mine, spread**2 + off) / share[:, k, None]
    return share, np.sqrt(around)


FAN_MPS2: Final = (0.0, 0.0, -1.0, 1.0, -2.5, 2.0)
"""Acceleration that each future adds to the base's outside the networks' trained range, m/s2."""

FAN_PROBABILITY: Final = (0.31, 0.29, 0.13, 0.13, 0.07, 0.07)
"""Probability of each."""

BACK_M: Final = 11.0
"""A future that ends behind the agent must end this far to its side; otherwise it would reverse, m
(the usual circle in which a car turns)."""


def predict_recorded(
    history: Tracks, steps: int, network: RecordedNetwork | None = None, road: Road | None = None
) -> Prediction:
    """Futures from the past of the agents and their neighbours, and from a map if there is one.

    All agents are seen in the last column. Without a given network, the one that ships answers.
    """
    network = network or trained_network()
    time_s = coming_times(steps)
    motion = Motion.of(history)
    base = fading(motion, time_s)
    features = features_of(history, motion, plausible(history))
    trust = network.trained.trust(
        motion.speed, motion.noise_m, motion.noise_mps,
        history.step_s if history.time_s.size > 1 else STEP_S,
    )  # fmt: skip
    drives = history.kind != PEDESTRIAN
    trust = np.where(drives, trust, 0.0)
    futures = decode(network(features), base, motion.speed, trust, time_s)
    if road is not None and network.lanes is not None:
        ahead = lanes_ahead(history, motion, road, float(time_s[-1]))
        raw = lane_answers(network.lanes, features, ahead)
        futures = join_lanes(raw, ahead, futures, motion.speed, trust, time_s)
    own, probability = futures.own, futures.probability
    mapped = road is not None and network.lanes is not None
    share = network.share(motion, mapped, time_s)[..., None]
    own[:, 0] = base + share * (own[:, 0] - base)
    doubt = 1.0 - trust
    if doubt.any():
        own += doubt[:, None, None, None] * (_fan(motion, time_s) - base[:, None])
        probability = trust[:, None] * probability + doubt[:, None] * np.asarray(FAN_PROBABILITY)
    aside = np.abs(own[..., 1]) > BACK_M
    own[..., 0] = np.where(aside, own[..., 0], np.maximum(own[..., 0], 0.0))
    spread = network.spread_scale * futures.spread
    return Prediction(history.ids, time_s, motion.from_own_frame(own), probability, spread)


def _fan(motion: Motion, time_s: FloatArray) -> FloatArray:
    """(n, MODES, H, 2) the base with other accelerations, in each agent's frame, m."""
    base = fading(motion, time_s)
    out = np.repeat(base[:, None], MODES, axis=1)
    for k, extra in enumerate(FAN_MPS2):
        if extra:
            other = replace(motion, accel=np.clip(motion.accel + extra, -6.0, 6.0))
            out[:, k] = fading(other, time_s)
    return out
