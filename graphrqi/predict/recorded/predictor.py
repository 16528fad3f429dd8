"""The predictor for recordings: a base that nobody has to train, and networks that correct it.

The base lets acceleration and yaw rate fade (`graphrqi.predict.recorded.motion`). It is also the
fallback: outside the range of speed, noise and rate that the networks were trained on, the futures
come down to it. Where there is a map, paths along its lanes are futures, too
(`graphrqi.predict.recorded.along_lanes`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.recorded.along_lanes import join_lanes
from graphrqi.predict.recorded.features import features_of
from graphrqi.predict.recorded.gaps import plausible
from graphrqi.predict.recorded.lanes_ahead import lanes_ahead
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import (
    MODES,
    RecordedNetwork,
    decode,
    lane_answers,
    trained_network,
)
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road

FloatArray = NDArray[np.float64]

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
    """Futures from the past of the agents and their neighbours, and from a map.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        steps: how many predicted positions, `STEP_S` apart.
        network: which network; None for the one that ships.
        road: the map; None where there is none.
    """
    network = network or trained_network()
    time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
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
