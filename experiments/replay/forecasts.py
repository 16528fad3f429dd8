"""Predictions over the time of an episode."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.replay.beliefs import Beliefs, sampled
from graphrqi.predict import predict
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.predict.prediction import Prediction
from graphrqi.stream import HISTORY_STEPS
from sim.frames import FloatArray, IntArray, Tracks
from sim.road import Road

HORIZON_S: Final = 5.0
"""How far ahead is shown, s."""

EVERY_S: Final = 1.0
"""Time between two predictions, s (a horizon of 5 s is looked at five times)."""

LEAST_PROBABILITY: Final = 0.02
"""Futures less likely than this are not kept."""

MAX_FUTURES: Final = 1_000_000
"""Most futures that a page keeps (some 15 MB). If there are more, each agent's likeliest future is
kept; if these alone are too many, there are fewer predictions."""


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """What was predicted at one instant.

    Attributes:
        time_s: the present, s.
        agent: (M,) index into the tracks' agents of each future, ascending.
        probability: (M,) of each future; falling within an agent.
        ahead_s: (H,) s from the present.
        xy: (M, H, 2) m.
    """

    time_s: float
    agent: IntArray
    probability: FloatArray
    ahead_s: FloatArray
    xy: FloatArray


def forecast(
    tracks: Tracks,
    beliefs: Beliefs,
    road: Road | None,
    predictor: str,
) -> list[Forecast]:
    """Predict every agent throughout an episode: every second, or less often if there are many.

    Args:
        tracks: the episode; each prediction sees only its past.
        beliefs: about its drivers.
        road: where it happened; None if there is no map.
        predictor: a key of ``PREDICTORS``.

    Returns:
        One entry per instant at which anybody is there.
    """
    found = []
    seconds = sampled(tracks, EVERY_S)
    stride = -(-int(tracks.rows.index.counts()[seconds].sum()) // MAX_FUTURES)
    for step in seconds[1 :: max(stride, 1)]:
        history = tracks.window(int(step) + 1, HISTORY_STEPS)
        if not history.ids.size:
            continue
        time_s = float(tracks.time_s[step])
        prediction = predict(history, beliefs.at(time_s), road, HORIZON_S, predictor)
        rows = np.searchsorted(tracks.ids, prediction.ids)
        found.append(_kept(time_s, rows, prediction))
    return found


def _kept(time_s: float, rows: IntArray, prediction: Prediction) -> Forecast:
    """The futures worth keeping, those of one agent together, the likeliest first."""
    ahead = np.arange(1, round(prediction.time_s[-1] / SAMPLE_S) + 1) * SAMPLE_S
    at = np.clip(np.searchsorted(prediction.time_s, ahead - 1e-6), 0, prediction.time_s.size - 1)
    order = np.argsort(-prediction.probability, axis=1, kind="stable")
    probability = np.take_along_axis(prediction.probability, order, axis=1)
    kept = probability >= LEAST_PROBABILITY
    kept[:, 0] = True
    agent, rank = np.nonzero(kept)
    return Forecast(
        time_s=time_s,
        agent=rows[agent],
        probability=probability[agent, rank],
        ahead_s=prediction.time_s[at],
        xy=prediction.xy[agent, order[agent, rank]][:, at],
    )


def likeliest(forecasts: Sequence[Forecast], most: int = MAX_FUTURES) -> list[Forecast]:
    """All futures, or each agent's likeliest in every prediction if they are too many.

    Args:
        forecasts: in order of time.
        most: how many futures are kept in all.

    Examples:
        >>> one = Forecast(1.0, np.array([4, 4, 7]), np.array([0.6, 0.4, 1.0]), np.array([0.5]),
        ...     np.zeros((3, 1, 2)))
        >>> [kept.agent.tolist() for kept in likeliest([one], 2)]
        [[4, 7]]
    """
    if sum(one.agent.size for one in forecasts) <= most:
        return list(forecasts)
    return [
        dataclasses.replace(
            one, agent=one.agent[kept], probability=one.probability[kept], xy=one.xy[kept]
        )
        for one in forecasts
        for kept in [np.diff(one.agent, prepend=-1) != 0]
    ]
