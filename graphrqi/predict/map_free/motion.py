"""Motion extrapolated from each driver's own past, for a recording that comes without a map.

Leaders are inferred from the traffic: the leader of a vehicle is the next one ahead that drives in
the same direction, within half a lane's width of the vehicle's own line. Accelerations fade, and
followers take on their leader's speed. Where the recording's gaps are implausible (vehicles that
overlap, as in recordings whose tracks are shifted in time) leaders are not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S, Prediction
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
"""A vehicle this close to one's own line is in one's lane (half of a 3 m lane)."""

AHEAD_M, AHEAD_S = 100.0, 6.0
"""Leaders count up to this distance and, with falling weight, this headway (our choice,
likewise)."""

MOST_OVERLAPS: Final = 0.01
"""Share of followers that may overlap their leader before gaps count as implausible (our
choice)."""

STANDING_MPS: Final = 0.5
"""Vehicles slower than this stand (our choice)."""

MOST_TURN: Final = 0.6
"""Fastest turn of a vehicle, rad/s (our choice: 12 m radius at 7 m/s)."""

MOVING_MPS: Final = 2.0
"""Least speed at which turns are judged (our choice: at lower speed headings are noise)."""

MOST_JUMPS: Final = 0.1
"""Share of moves that may turn faster before tracks count as noisy (our choice on simulated and
training recordings)."""

FAN_MPS2: Final = (0.0, -1.0, 1.0, -2.5, 2.0, -4.0)
"""Acceleration that each future adds to the likeliest one's."""

FAN_PROBABILITY: Final = (0.4, 0.18, 0.18, 0.1, 0.08, 0.06)
"""Probability of each (our choice)."""


@dataclass(frozen=True, slots=True, eq=False)
class MapFreeMotion:
    """How n agents move, and behind whom.

    Attributes:
        speed: (n,) m/s.
        accel: (n,) m/s2; 0 for pedestrians.
        leader: (n,) row of the leader, -1: none, or none that can be trusted.
        gap: (n,) bumper to bumper, m; +inf without leader.
        fade_s: time in which accelerations fall to 1/e, s.
    """

    speed: FloatArray
    accel: FloatArray
    leader: IntArray
    gap: FloatArray
    fade_s: float

    @classmethod
    def of(cls, history: Tracks, believable: bool) -> MapFreeMotion:
        """The present motion of a history; leaders count only where its gaps are believable."""
        speed, accel = _fitted(history)
        walks = history.kind == PEDESTRIAN
        leader, gap = inferred_leaders(history)
        trusted = (leader >= 0) & ~walks & believable
        return cls(
            speed=speed,
            accel=np.where(walks, 0.0, accel),
            leader=np.where(trusted, leader, -1),
            gap=np.where(trusted, gap, np.inf),
            fade_s=FADE_S if believable else FADE_ALONE_S,
        )

    def steady(self) -> MapFreeMotion:
        """The same speeds, without acceleration or leaders."""
        alone = np.full(self.leader.size, -1)
        return replace(self, accel=np.zeros_like(self.accel), leader=alone)


def fan(history: Tracks, motion: MapFreeMotion, steps: int) -> Prediction:
    """Six futures straight on, the likeliest first, the others slower and faster.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        motion: theirs.
        steps: how many, `STEP_S` apart.

    Returns:
        Futures along each agent's present heading; pedestrians walk on.
    """
    time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
    drives = (history.kind != PEDESTRIAN).astype(np.float64)
    ahead = np.stack([travelled(motion, time_s, extra * drives) for extra in FAN_MPS2], axis=1)
    return along_heading(history, ahead, time_s, np.tile(FAN_PROBABILITY, (history.ids.size, 1)))


def along_heading(
    history: Tracks, ahead: FloatArray, time_s: FloatArray, probability: FloatArray
) -> Prediction:
    """Distances (n, K, H) travelled straight on, m, as a prediction."""
    heading = history.heading[:, -1]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    xy = history.xy[:, None, None, -1] + ahead[..., None] * facing[:, None, None]
    return Prediction(history.ids, time_s, xy, probability)


def travelled(
    motion: MapFreeMotion, time_s: FloatArray, extra: FloatArray | float = 0.0
) -> FloatArray:
    """(n, H) distance travelled at each time, m.

    Accelerations, the extra one included, fade; followers gradually take on their leader's speed.
    Nobody reverses.
    """
    speed, leader = motion.speed, motion.leader
    follows = leader >= 0
    target = np.where(follows, speed[leader], speed) if speed.size else speed
    reach = AHEAD_S * np.maximum(speed, 3.0)
    close = np.where(follows, np.clip(1.0 - motion.gap / reach, 0.0, 1.0), 0.0)
    lasting = (motion.accel + extra) * motion.fade_s
    fine = np.arange(1, round(float(time_s[-1]) / STEP_S) + 1) * STEP_S
    gained = lasting[:, None] * (1 - np.exp(-fine / motion.fade_s))
    gained = gained + ((target - speed) * close)[:, None] * (1 - np.exp(-fine / FOLLOW_S))
    now = np.maximum(speed[:, None] + gained, 0.0)
    before = np.concatenate([np.maximum(speed, 0.0)[:, None], now[:, :-1]], axis=1)
    way = np.cumsum((now + before) * (STEP_S / 2), axis=1)
    at = np.minimum(np.round(time_s / STEP_S).astype(np.int64) - 1, fine.size - 1)
    return np.asarray(way[:, at])


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
    """The leader of each vehicle, without a map.

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
    """Whether hardly any follower overlaps its leader, over the history.

    Pairs that both stand are left out: parked cars do not show whether tracks are shifted in time.
    """
    overlaps = followers = 0
    for column in range(history.time_s.size - 1, -1, -10):
        leader, gap = inferred_leaders(history, column)
        moves = history.speed[:, column] > STANDING_MPS
        counts = (leader >= 0) & (moves | moves[leader])
        followers += int(counts.sum())
        overlaps += int((counts & (gap < 0)).sum())
    return overlaps <= MOST_OVERLAPS * followers


def smooth(history: Tracks) -> bool:
    """Whether hardly any track turns faster than vehicles can, as noisy tracks do."""
    step_s = np.diff(history.time_s)
    turned = np.abs((np.diff(history.heading, axis=1) + np.pi) % (2 * np.pi) - np.pi)
    drives = (history.kind != PEDESTRIAN)[:, None]
    seen = history.valid[:, 1:] & history.valid[:, :-1] & drives
    moving = seen & (np.minimum(history.speed[:, 1:], history.speed[:, :-1]) > MOVING_MPS)
    jumps = moving & (turned > MOST_TURN * step_s)
    return int(jumps.sum()) <= MOST_JUMPS * int(moving.sum())
