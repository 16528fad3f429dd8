"""What can be foreseen of a recording that comes without a map.

Lanes are inferred from the traffic: the leader is whoever drives ahead in the same direction
within a lane's half width of one's own line. Everyone's acceleration fades, and who follows
someone takes on its speed. Where the recording's gaps are implausible (vehicles that overlap, as in
recordings whose tracks are shifted in time) leaders are not trusted and each driver's own past is
all that is used.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.scene import STEP_S
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FADE_S, FADE_ALONE_S = 0.7, 0.4
"""Time in which an acceleration falls to 1/e, s, where leaders are known and where they are not
(our choice on simulated recordings)."""

FIT_S: Final = 1.0
"""Past over which the acceleration is fitted, s (our choice: shorter is noise)."""

FOLLOW_S: Final = 2.0
"""Time in which a follower takes on 1 - 1/e of its leader's speed (our choice, likewise)."""

HALF_LANE_M: Final = 1.5
"""Who is this close to one's own line is in one's lane (half of a 3 m lane)."""

AHEAD_M, AHEAD_S = 100.0, 6.0
"""Leaders count up to this far and, fading, this long ahead (our choice, likewise)."""

MOST_OVERLAPS: Final = 0.01
"""Share of followers that may overlap their leader before gaps count as implausible (ours)."""

FAN_MPS2: Final = (0.0, -1.0, 1.0, -2.5, 2.0, -4.0)
"""What each future's acceleration adds to the likeliest one's."""

FAN_PROBABILITY: Final = (0.4, 0.18, 0.18, 0.1, 0.08, 0.06)
"""How likely each is (our choice)."""


def predict_unmapped(history: Tracks, horizon_s: float, predictor: str) -> Prediction:
    """What a predictor foresees without a map.

    Args:
        history: tracks whose last column is the present.
        horizon_s: how far ahead, s.
        predictor: ``constant-velocity`` keeps its meaning; every other one becomes `own_past`.

    Returns:
        Futures of the agents present now.

    Raises:
        InputError: if the history is empty.
    """
    if history.time_s.size == 0:
        raise InputError("history: found no frame, expected at least 1")
    present = history.window(history.time_s.size, history.time_s.size)
    time_s = np.arange(1, round(horizon_s / STEP_S) + 1, dtype=np.float64) * STEP_S
    function = steady_motion if predictor == "constant-velocity" else own_past
    return function(present, time_s)


def steady_motion(history: Tracks, time_s: FloatArray) -> Prediction:
    """Everyone keeps its present speed and heading."""
    speed, facing = history.speed[:, -1], _facing(history)
    xy = history.xy[:, None, -1] + (speed[:, None] * time_s)[..., None] * facing[:, None]
    return Prediction(history.ids, time_s, xy[:, None], np.ones((history.ids.size, 1)))


def own_past(history: Tracks, time_s: FloatArray) -> Prediction:
    """Six futures from the drivers' own past and, where gaps are plausible, their leaders.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        time_s: (H,) seconds from the present.

    Returns:
        Futures along each agent's present heading, the likeliest first; pedestrians walk on.
    """
    speed, accel = _fitted(history)
    walks = history.kind == PEDESTRIAN
    accel = np.where(walks, 0.0, accel)
    leader, gap = inferred_leaders(history)
    believable = plausible(history)
    fade_s = FADE_S if believable else FADE_ALONE_S
    trusted = (leader >= 0) & ~walks & believable
    target = np.where(trusted, speed[np.maximum(leader, 0)] if leader.size else speed, speed)
    close = np.where(trusted, np.clip(1.0 - gap / (AHEAD_S * np.maximum(speed, 3.0)), 0, 1), 0.0)
    futures = []
    for extra in FAN_MPS2:
        lasting = (accel + np.where(walks, 0.0, extra)) * fade_s
        travelled = _travelled(speed, lasting, fade_s, (target - speed) * close, time_s)
        futures.append(travelled)
    ahead = np.stack(futures, axis=1)
    xy = history.xy[:, None, None, -1] + ahead[..., None] * _facing(history)[:, None, None]
    probability = np.tile(FAN_PROBABILITY, (history.ids.size, 1))
    return Prediction(history.ids, time_s, xy, probability)


def _travelled(
    speed: FloatArray,
    lasting: FloatArray,
    fade_s: float,
    catching: FloatArray,
    time_s: FloatArray,
) -> FloatArray:
    """(n, H) way gone when speed gains ``lasting`` and ``catching`` gradually; nobody reverses."""
    fine = np.arange(1, round(float(time_s[-1]) / 0.1) + 1) * 0.1
    gained = lasting[:, None] * (1 - np.exp(-fine / fade_s))
    gained = gained + catching[:, None] * (1 - np.exp(-fine / FOLLOW_S))
    now = np.maximum(speed[:, None] + gained, 0.0)
    before = np.concatenate([np.maximum(speed, 0.0)[:, None], now[:, :-1]], axis=1)
    way = np.cumsum((now + before) * 0.05, axis=1)
    at = np.minimum(np.round(time_s / 0.1).astype(np.int64) - 1, fine.size - 1)
    return np.asarray(way[:, at])


def _facing(history: Tracks) -> FloatArray:
    heading = history.heading[:, -1]
    return np.stack([np.cos(heading), np.sin(heading)], axis=1)


def _fitted(history: Tracks) -> tuple[FloatArray, FloatArray]:
    """(n,) present speed, m/s, and (n,) slope of the speed over the last `FIT_S`, m/s2."""
    recent = history.time_s >= history.time_s[-1] - FIT_S - 1e-6
    ago = history.time_s[recent] - history.time_s[-1]
    seen = history.valid[:, recent]
    speed = np.where(seen, history.speed[:, recent], 0.0)
    count = np.maximum(seen.sum(axis=1), 1)
    middle = (seen * ago).sum(axis=1) / count
    mean = speed.sum(axis=1) / count
    apart = np.where(seen, ago - middle[:, None], 0.0)
    spread = (apart**2).sum(axis=1)
    slope = np.divide(
        (apart * (speed - mean[:, None])).sum(axis=1), spread,
        out=np.zeros(len(mean)), where=spread > 1e-9,
    )  # fmt: skip
    return np.asarray(history.speed[:, -1]), slope


def inferred_leaders(history: Tracks, column: int = -1) -> tuple[IntArray, FloatArray]:
    """Who drives ahead in whose line, without a map.

    Args:
        history: tracks.
        column: at which time.

    Returns:
        (n,) row of the leader or -1, and (n,) bumper-to-bumper gap, m, +inf without one.
    """
    n = history.ids.size
    drives = (history.kind != PEDESTRIAN) & history.valid[:, column]
    xy, heading = history.xy[:, column], history.heading[:, column]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    apart = xy[None] - xy[:, None]
    along = (apart * facing[:, None]).sum(axis=2)
    across = facing[:, None, 0] * apart[..., 1] - facing[:, None, 1] * apart[..., 0]
    same = np.cos(heading[None] - heading[:, None]) > 0.85
    ahead = (along > 0) & (along < AHEAD_M) & (np.abs(across) < HALF_LANE_M) & same
    ahead &= drives[:, None] & drives[None]
    distance = np.where(ahead, along, np.inf)
    if not n:
        return np.empty(0, np.int64), np.empty(0)
    leader = np.where(ahead.any(axis=1), distance.argmin(axis=1), -1)
    row = np.arange(n)
    gap = distance[row, np.maximum(leader, 0)]
    gap = np.where(leader >= 0, gap - (history.length + history.length[leader]) / 2, np.inf)
    return leader, gap


def plausible(history: Tracks) -> bool:
    """Whether hardly any follower overlaps its leader, over the last seconds seen."""
    overlaps = followers = 0
    for column in range(history.time_s.size - 1, -1, -10):
        leader, gap = inferred_leaders(history, column)
        followers += int((leader >= 0).sum())
        overlaps += int((gap < 0).sum())
    return overlaps <= MOST_OVERLAPS * followers
