"""Inputs of the network for recordings: each agent's past, its neighbours, and the noise.

Everything is given in the agent's own frame and as the difference from what the base says, so that
an agent that moves as the base expects looks the same at any speed.

Some recordings in circulation have tracks that are shifted in time: vehicles overlap, and what a
neighbour does says nothing. Then the network is told of no neighbours.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.recorded.motion import Motion
from sim.frames import KINDS, PEDESTRIAN, AgentKind, Tracks

HALF_LANE_M: Final = 1.5
"""A vehicle this close to the line along which another one drives is in its lane, m (half of a 3 m
lane)."""

AHEAD_M: Final = 100.0
"""Leaders count up to this distance, m."""

MOST_OVERLAPS: Final = 0.01
"""Share of followers that may overlap their leader before gaps count as implausible."""

STANDING_MPS: Final = 0.5
"""Vehicles slower than this stand."""


def _relative(xy: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 2) unit vectors, (n, n) distances ahead of each agent to the others, and to its left."""
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    apart = xy[None] - xy[:, None]
    along = (apart * facing[:, None]).sum(axis=-1)
    return facing, along, facing[:, None, 0] * apart[..., 1] - facing[:, None, 1] * apart[..., 0]


def inferred_leaders(history: Tracks, column: int = -1) -> tuple[IntArray, FloatArray]:
    """(n,) row of each vehicle's leader, -1 for none, and (n,) gap, m, without a map.

    Gaps are from bumper to bumper at one column of the tracks, +inf without a leader.
    """
    n = history.ids.size
    drives = (history.kind != PEDESTRIAN) & history.valid[:, column]
    heading = history.heading[:, column]
    _, along, across = _relative(history.xy[:, column], heading)
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
    every = 1 if history.time_s.size < 2 else max(1, round(1.0 / history.step_s))
    for column in range(history.time_s.size - 1, -1, -every):
        leader, gap = inferred_leaders(history, column)
        moves = history.speed[:, column] > STANDING_MPS
        counts = (leader >= 0) & (moves | moves[leader])
        followers += int(counts.sum())
        overlaps += int((counts & (gap < 0)).sum())
    return overlaps <= MOST_OVERLAPS * followers


AGES_S: Final = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
"""Ages of the places of the own past that are described, s."""

SLOTS: Final = ("leader", "follower", "left leader", "left follower", "right leader",
                "right follower")  # fmt: skip
"""The neighbours that are described one by one."""

NEAREST: Final = 3
"""Further agents, pedestrians included, by their distance."""

LANE_M: Final = 3.5
"""Width of a lane where none is known, m."""

REACH_M: Final = 120.0
"""Neighbours count up to this distance, m."""

CHANGE_S, LEAST_CHANGE_S = 3.0, 0.3
"""Past over which speeds of a queue are compared, and the shortest one that tells anything, s
(speeds of some recordings are constant for seconds, and then jump)."""

AHEAD: Final = 3
"""How many vehicles ahead are described."""

SAME_WAY: Final = 0.7
"""Least cosine between the directions of neighbours in the six slots (45 degrees)."""

QUEUE: Final = 3 * AHEAD + 1
"""How many numbers describe the queue that an agent is in."""

LONG_KINDS: Final = tuple(KINDS.index(k) for k in (AgentKind.BUS, AgentKind.TRUCK))
TWO_WHEELS: Final = tuple(KINDS.index(k) for k in (AgentKind.MOTORCYCLE, AgentKind.BICYCLE))


def scale_of(speed: NDArray[np.floating]) -> FloatArray:
    """(n,) m: the size of what the network corrects; it grows with the speed up to 12 m/s."""
    return np.asarray(1.0 + 0.15 * np.minimum(speed, 12.0))


def features_of(history: Tracks, motion: Motion, believable: bool = True) -> FloatArray:
    """(n, F) inputs of the network, for every agent of a history.

    All are seen in its last column. Where gaps are not ``believable``, nobody has neighbours.
    """
    around = _neighbours(history, motion)
    if not believable:
        around = np.zeros_like(around)
    seen = np.full((len(around), 1), float(believable))
    return np.concatenate([_own(history, motion), _past(history, motion), seen, around], axis=1)


def _own(history: Tracks, motion: Motion) -> FloatArray:
    """(n, 16) speed, accelerations, size, kind and how the agent was observed."""
    speed = motion.speed
    slip = np.sin(history.heading[:, -1] - motion.heading)
    step_s = history.step_s if history.time_s.size > 1 else 0.1
    fastest = np.where(history.valid, history.speed, 0.0).max(axis=1, initial=0.0)
    columns = [
        speed / 10.0,
        np.log1p(speed),
        motion.accel,
        motion.accel_now,
        motion.yaw_rate * 5.0,
        motion.yaw_rate * speed,
        np.clip(slip, -0.5, 0.5) * 5.0,
        fastest / 15.0,
        history.length / 10.0,
        np.isin(history.kind, LONG_KINDS),
        np.isin(history.kind, TWO_WHEELS),
        history.kind == PEDESTRIAN,
        np.log10(motion.noise_m),
        np.log10(motion.noise_mps),
        np.minimum(motion.seen_s, 5.0) / 5.0,
        np.full(speed.size, np.log10(step_s)),
    ]
    return np.stack(columns, axis=1).astype(np.float64)


def _past(history: Tracks, motion: Motion) -> FloatArray:
    """(n, 4 AGES) place against steady motion over the scale, speed, and whether it is known."""
    ago = history.time_s - history.time_s[-1]
    n = history.ids.size
    scale = scale_of(motion.speed)
    columns = []
    for age_s in AGES_S:
        after = int(np.searchsorted(ago, -age_s - 1e-6))
        before = max(after - 1, 0)
        if after >= ago.size or ago[0] > -age_s + 0.05:
            columns += [np.zeros(n)] * 4
            continue
        span = ago[after] - ago[before]
        share = np.clip((-age_s - ago[before]) / span, 0.0, 1.0) if span > 1e-9 else 1.0
        known = history.valid[:, after]
        both = (known & history.valid[:, before])[:, None]
        begin = np.where(both, history.xy[:, before], history.xy[:, after])
        place = motion.to_own_frame(begin + share * (history.xy[:, after] - begin))
        off = np.where(known, place[:, 0] + motion.speed * age_s, 0.0) / scale / age_s
        left = np.where(known, place[:, 1], 0.0) / scale / age_s
        slower = np.where(known, history.speed[:, after] - motion.speed, 0.0) / scale
        columns += [off * 4.0, left * 4.0, slower, known.astype(np.float64)]
    return np.stack(columns, axis=1)


def neighbour_slots(history: Tracks, motion: Motion) -> tuple[IntArray, FloatArray]:
    """(n, 6) rows of the neighbours that drive the same way, -1 for none, and (n, 6) gaps, m.

    The order is that of `SLOTS`; gaps are from bumper to bumper. Lanes are unknown: an agent is
    ahead in the own lane when it is within half a lane's width of the line on which the base says
    this one will go, and beside when within one and a half.
    """
    n = history.ids.size
    rows, gaps = np.full((n, 6), -1), np.full((n, 6), np.inf)
    if n < 2:
        return rows, gaps
    facing, along, left = _relative(motion.xy, motion.heading)
    bend = motion.yaw_rate / np.maximum(motion.speed, 2.0)
    ahead_only = np.clip(along, -30.0, 30.0)
    left = left - bend[:, None] * ahead_only**2 / 2.0
    drives = history.kind != PEDESTRIAN
    same = (facing @ facing.T > SAME_WAY) & drives[:, None] & drives[None]
    same &= np.abs(along) < REACH_M
    np.fill_diagonal(same, False)
    half = (history.length[:, None] + history.length[None]) / 2
    side = np.rint(left / LANE_M)
    for slot, (lane, forward) in enumerate(
        ((0, True), (0, False), (1, True), (1, False), (-1, True), (-1, False))
    ):
        there = same & (side == lane) & ((along > 0) == forward)
        distance = np.where(there, np.abs(along), np.inf)
        nearest = distance.argmin(axis=1)
        row = np.arange(n)
        found = np.isfinite(distance[row, nearest])
        rows[:, slot] = np.where(found, nearest, -1)
        gaps[:, slot] = np.where(found, distance[row, nearest] - half[row, nearest], np.inf)
    return rows, gaps


def _neighbours(history: Tracks, motion: Motion) -> FloatArray:
    """(n, 6 x 6 + 3 + 5 NEAREST + 3) the slots, the leader's leader, the nearest, the traffic."""
    n = history.ids.size
    speed, accel = motion.speed, motion.accel
    rows, gaps = neighbour_slots(history, motion)
    columns = []
    for slot in range(rows.shape[1]):
        who, gap = rows[:, slot], np.maximum(gaps[:, slot], 0.0)
        here = who >= 0
        closing = np.where(here, speed - speed[who], 0.0)
        sign = 1.0 if slot % 2 == 0 else -1.0
        columns += [
            here.astype(np.float64),
            np.where(here, np.exp(-gap / 30.0), 0.0),
            np.where(here, np.exp(-gap / np.maximum(speed, 2.0) / 2.0), 0.0),
            closing / 5.0,
            np.where(here, accel[who], 0.0),
            np.where(here, np.clip(sign * closing / (gap + 2.0), -1.5, 1.5), 0.0),
        ]
    leader = rows[:, 0]
    second = np.where(leader >= 0, rows[leader, 0], -1)
    here = second >= 0
    columns += [
        here.astype(np.float64),
        np.where(here, speed - speed[second], 0.0) / 5.0,
        np.where(here, accel[second], 0.0),
    ]
    apart = motion.xy[None] - motion.xy[:, None]
    distance = np.hypot(apart[..., 0], apart[..., 1])
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")[:, :NEAREST]
    velocity = speed[:, None] * np.stack([np.cos(motion.heading), np.sin(motion.heading)], axis=1)
    cos, sin = np.cos(motion.heading), np.sin(motion.heading)
    row = np.arange(n)
    for k in range(NEAREST):
        if k >= order.shape[1]:
            columns += [np.zeros(n)] * 5
            continue
        who = order[:, k]
        near = np.isfinite(distance[row, who]) & (distance[row, who] < REACH_M)
        to, moves = apart[row, who], velocity[who] - velocity
        weight = np.where(near, np.exp(-distance[row, who] / 20.0), 0.0)
        unit = to / np.maximum(np.where(near, distance[row, who], 1.0), 0.5)[:, None]
        columns += [
            weight,
            weight * (unit[:, 0] * cos + unit[:, 1] * sin),
            weight * (unit[:, 1] * cos - unit[:, 0] * sin),
            weight * (moves[:, 0] * cos + moves[:, 1] * sin) / 5.0,
            weight * (moves[:, 1] * cos - moves[:, 0] * sin) / 5.0,
        ]
    alike = (np.cos(motion.heading[None] - motion.heading[:, None]) > SAME_WAY) & (distance < 60.0)
    alike &= (history.kind != PEDESTRIAN)[None]
    count = alike.sum(axis=1)
    mean = (alike * speed[None]).sum(axis=1) / np.maximum(count, 1)
    mean_accel = (alike * accel[None]).sum(axis=1) / np.maximum(count, 1)
    columns += [
        np.minimum(count, 15) / 5.0,
        np.where(count > 0, mean - speed, 0.0) / 5.0,
        mean_accel,
        *_queue(history, motion, rows, gaps, alike),
    ]
    return np.stack(columns, axis=1)


def _queue(
    history: Tracks, motion: Motion, rows: IntArray, gaps: FloatArray, alike: BoolArray
) -> list[FloatArray]:
    """Whether a queue gathers or dissolves: who is ahead of the leader, and how speeds changed."""
    speed, n = motion.speed, history.ids.size
    ago = history.time_s - history.time_s[-1]
    then = int(np.searchsorted(ago, -CHANGE_S - 1e-6))
    passed_s = max(-ago[then], LEAST_CHANGE_S)
    known = history.valid[:, then] & (-ago[then] >= LEAST_CHANGE_S)
    change = np.where(known, speed - history.speed[:, then], 0.0) / passed_s
    who, far, faster, columns = np.arange(n), np.zeros(n), np.zeros(n), []
    for place in range(AHEAD):
        far = far + np.where(who >= 0, gaps[who, 0], 0.0)
        who = np.where(who >= 0, rows[who, 0], -1)
        here = who >= 0
        faster = np.where(here, np.maximum(faster, speed[who] - speed), faster)
        columns.append(np.where(here, change[who], 0.0))
        if place > 0:  # the leader's gap and speed, and the next one's speed, are told before
            columns.append(np.where(here, np.exp(-np.maximum(far, 0.0) / 30.0), 0.0))
        if place > 1:
            columns.append(np.where(here, speed - speed[who], 0.0) / 5.0)
    others = alike & known[None]
    fastest = np.where(history.valid, history.speed, 0.0).max(axis=1, initial=0.0)
    pace = np.where(alike, fastest[None], 0.0).max(axis=1, initial=0.0)
    return [
        *columns,
        faster / 5.0,
        change,
        (others * change[None]).sum(axis=1) / np.maximum(others.sum(axis=1), 1),
        np.where(pace > 0.0, pace - speed, 0.0) / 10.0,
    ]


def feature_count() -> int:
    """How many inputs the network has (F)."""
    return 17 + 4 * len(AGES_S) + 6 * len(SLOTS) + 3 + 5 * NEAREST + 3 + QUEUE
