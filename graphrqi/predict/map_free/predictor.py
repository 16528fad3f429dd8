"""Prediction without a map: the recording decides which of three models is used.

The models are steady motion, each driver's own fading acceleration behind an inferred leader
(`graphrqi.predict.map_free.motion`), and a network that corrects these. Recordings differ: some
are noisy, some are shifted in time, some show traffic that no simulator knows. On noisy tracks
everyone is assumed to keep its speed. Otherwise the models are tried on the history itself,
`TRIED_S` ahead: the network is used unless it did clearly worse than steady motion; where vehicles
overlap, a model has to have done clearly better to be used.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.constant import inertial_distance
from graphrqi.predict.map_free.motion import (
    MOST_TURN,
    MapFreeMotion,
    along_heading,
    fan,
    plausible,
    smooth,
    travelled,
)
from graphrqi.predict.networks.futures import TIME_S, PredictorInputs, spread_out
from graphrqi.predict.networks.perceptron import shipped_perceptron
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.scene.scene import LEARNED_S
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TRIED_S: Final = 2.5
"""Span of the past over which each model is tried, s (half of what a stream remembers)."""

AGAIN_S: Final = 1.0
"""How much earlier each model is tried once more, s (our choice)."""

LEAST_TRIED: Final = 4
"""Agents on which a model must have been tried for the result to count (our choice)."""

CLEARLY: Final = 0.9
"""Clearly better means a squared error below this times the other's (our choice)."""

SURE: Final = 1.64
"""Standard errors by which a model must beat steady motion where gaps are implausible (one side of
95 %)."""

PAST_S: Final = (0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Ages of the moments of the own past that are described, s."""

FAR_M: Final = 100.0
"""Distances are cut off here and divided by it (our choice)."""

BRAKING_MPS2: Final = 2.0
"""Extra braking of one of the network's anchor trajectories (our choice)."""


def predict_unmapped(history: Tracks, horizon_s: float, predictor: str) -> Prediction:
    """Predict without a map.

    Args:
        history: tracks whose last column is the present.
        horizon_s: how far ahead, s.
        predictor: ``constant-velocity`` keeps its meaning; every other one becomes the model that
            did best on the past.

    Returns:
        Futures of the agents present now.

    Raises:
        InputError: if the history is empty.
    """
    if history.time_s.size == 0:
        raise InputError("history: found no frame, expected at least 1")
    present = history.window(history.time_s.size, history.time_s.size)
    steps = round(horizon_s / STEP_S)
    if predictor == "constant-velocity":
        time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
        ahead = present.speed[:, -1][:, None] * time_s
        return along_heading(present, ahead[:, None], time_s, np.ones((present.ids.size, 1)))
    believable = plausible(present)
    model = trusted_model(present, believable)
    if model == "learned":
        return learned(present, believable, max(steps, round(LEARNED_S / STEP_S))).until(horizon_s)
    motion = MapFreeMotion.of(present, believable)
    return fan(present, motion if model == "own past" else motion.steady(), steps)


def trusted_model(history: Tracks, believable: bool) -> str:
    """``learned``, ``own past`` or ``steady``: the model that suits a recording."""
    if not smooth(history):
        return "steady"
    error = _tried(history, believable)
    steady = error.pop("steady")
    if steady.size < LEAST_TRIED:
        return "own past" if believable else "steady"
    mean = {name: float(errors.mean()) for name, errors in error.items()}
    best = min(mean, key=mean.__getitem__)
    if believable:
        if mean["learned"] * CLEARLY <= steady.mean():
            return "learned"
        return best if mean[best] < steady.mean() else "steady"
    if mean[best] >= CLEARLY * steady.mean():
        return "steady"
    gain = steady - error[best]
    sure = gain.mean() > SURE * gain.std(ddof=1) / np.sqrt(gain.size)
    return best if sure else "steady"


def _tried(history: Tracks, believable: bool) -> dict[str, FloatArray]:
    """Squared errors of each model, m2, over the agents' moves to the present and a second ago."""
    found: dict[str, list[FloatArray]] = {"steady": [], "own past": [], "learned": []}
    step = round(TRIED_S / STEP_S)
    for again_s in (0.0, AGAIN_S):
        last = history.time_s[-1] - again_s
        at = int(np.searchsorted(history.time_s, last - 1e-6))
        stop = int(np.searchsorted(history.time_s, last - TRIED_S - 1e-6)) + 1
        if last - TRIED_S < history.time_s[0] - 1e-6 or stop < 2:
            continue
        earlier = history.window(stop, stop)
        row = np.searchsorted(history.ids, earlier.ids)
        counts = (earlier.kind != PEDESTRIAN) & (earlier.valid.sum(axis=1) > 1)
        counts &= history.valid[row, at]
        truth = history.xy[row[counts], at]
        motion = MapFreeMotion.of(earlier, believable)
        for name, predicted in (
            ("steady", fan(earlier, motion.steady(), step)),
            ("own past", fan(earlier, motion, step)),
            ("learned", learned(earlier, believable, step)),
        ):
            found[name].append(((predicted.best[counts, step - 1] - truth) ** 2).sum(axis=1))
    return {name: np.concatenate(parts or [np.empty(0)]) for name, parts in found.items()}


def learned(history: Tracks, believable: bool, steps: int) -> Prediction:
    """The shipped network's futures, every 0.1 s; nobody reverses."""
    futures = shipped_perceptron("mapless.safetensors")(map_free_inputs(history, believable))
    own = futures.own.copy()
    own[..., 0] = np.maximum.accumulate(np.maximum(own[..., 0], 0.0), axis=2)
    return spread_out(history, replace(futures, own=own), steps)


def map_free_inputs(history: Tracks, believable: bool) -> PredictorInputs:
    """Inputs of a predictor without a map.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        believable: whether the gaps between vehicles can be trusted; if not, nobody has neighbours.

    Returns:
        The inputs of every agent; those of pedestrians mean nothing.
    """
    motion = MapFreeMotion.of(history, believable)
    speed, accel = motion.speed, motion.accel
    n = speed.size
    leader, gap = motion.leader, motion.gap
    follower = np.full(n, -1)
    nearest_last = np.argsort(-gap, kind="stable")
    nearest_last = nearest_last[leader[nearest_last] >= 0]
    follower[leader[nearest_last]] = nearest_last
    behind = np.where(follower >= 0, gap[follower], np.inf)
    second = np.where(leader >= 0, leader[leader], -1)
    beyond = gap + gap[leader] + history.length[leader] if n else gap
    fastest = np.where(history.valid, history.speed, 0.0).max(axis=1, initial=0.0)
    features = [
        speed / 10.0, accel / 3.0, history.length / 10.0, fastest / 15.0, 5.0 * _turning(history),
        np.full(n, float(believable)),
    ]  # fmt: skip
    for ago in PAST_S:
        column = int(np.searchsorted(history.time_s, history.time_s[-1] - ago - 1e-6))
        long_enough = history.time_s[0] <= history.time_s[-1] - ago + 1e-6
        there = history.valid[:, column] & long_enough
        turned = np.sin(history.heading[:, -1] - history.heading[:, column])
        features += [
            there.astype(np.float64),
            np.where(there, history.speed[:, column] - speed, 0.0) / 5.0,
            np.where(there, turned, 0.0),
        ]
    for who, far in ((leader, gap), (follower, behind), (second, beyond)):
        here = who >= 0
        headway = np.where(here, far, 0.0) / np.maximum(speed, 2.0) / 5.0
        features += [
            here.astype(np.float64),
            np.where(here, 1.0 - np.clip(far, -5.0, FAR_M) / FAR_M, 0.0),
            np.where(here, speed[who] - speed, 0.0) / 10.0 if n else speed,
            np.where(here, accel[who], 0.0) / 3.0 if n else speed,
            np.clip(headway, 0.0, 2.0),
        ]
    return PredictorInputs(np.stack(features, axis=1), _anchors(history, motion))


def _turning(history: Tracks) -> FloatArray:
    """(n,) rate at which each has turned over the last half second, rad/s; 0 where unknown."""
    column = int(np.searchsorted(history.time_s, history.time_s[-1] - 0.5 - 1e-6))
    span = max(float(history.time_s[-1] - history.time_s[column]), 1e-3)
    sine = np.sin(history.heading[:, -1] - history.heading[:, column])
    known = history.valid[:, column] & (history.speed[:, -1] > 0.5)
    return np.where(known, np.clip(np.arcsin(sine) / span, -MOST_TURN, MOST_TURN), 0.0)


def _anchors(history: Tracks, motion: MapFreeMotion) -> FloatArray:
    """(n, 5, KNOTS, 2) own past straight on and turning on, steady, inertia, braking, m."""
    time_s = TIME_S
    own = travelled(motion, time_s)
    speed, accel = motion.speed[:, None], motion.accel[:, None]
    inertia = inertial_distance(speed, accel, time_s[None])
    rate = _turning(history)[:, None]
    angle = rate * time_s
    turns = np.abs(rate) > 1e-3
    radius = np.divide(own / time_s, rate, out=np.zeros_like(own), where=turns)
    forward = np.where(turns, radius * np.sin(angle), own)
    left = np.where(turns, radius * (1.0 - np.cos(angle)), 0.0)
    straight = np.zeros_like(own)
    return np.stack(
        [
            np.stack([own, straight], axis=-1),
            np.stack([forward, left], axis=-1),
            np.stack([speed * time_s, straight], axis=-1),
            np.stack([inertia, straight], axis=-1),
            np.stack([travelled(motion, time_s, -BRAKING_MPS2), straight], axis=-1),
        ],
        axis=1,
    )
