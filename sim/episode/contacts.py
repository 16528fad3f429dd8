"""Which road-agents touch each other, and for how long: their outlines overlap.

An outline is a rectangle of an agent's length and width about its centre, turned by its heading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sim.episode.rows import BLOCK_ROWS, TrajectoryRows
from sim.frames import PEDESTRIAN, IntArray
from sim.geometry import GRAZE_M, Outlines, separation

KEY_ERROR_M: Final = 0.01
"""Pairs are looked for this much farther than circles reach, m: places along x and times are sorted
as one number, which is rounded."""


@dataclass(frozen=True, slots=True)
class Contact:
    """Two agents that touch.

    Attributes:
        agents: the two, the smaller first, as in ``TrajectoryRows.ids``.
        begin: index of the first time at which they touch.
        end: one past the last.
    """

    agents: tuple[int, int]
    begin: int
    end: int


def contacts(steps: TrajectoryRows) -> tuple[Contact, ...]:
    """Every unbroken stretch of time for which two agents touch, pedestrians with each other aside.

    Args:
        steps: an episode or a recording.

    Returns:
        Contacts in order of their beginning, then of agents.

    Examples:
        >>> from sim.frames import Tracks
        >>> time_s = np.array([0.1, 0.2, 0.3])
        >>> xy = np.array([[[0.0, 0.0]] * 3, [[9.0, 0.0], [4.0, 0.0], [9.0, 0.0]]])
        >>> still = np.zeros((2, 3))
        >>> contacts(TrajectoryRows.of(Tracks(
        ...     ids=np.arange(2), names=("a", "b"), kind=np.zeros(2), length=np.full(2, 5.0),
        ...     width=np.full(2, 2.0), time_s=time_s, xy=xy, heading=still, speed=still,
        ...     valid=np.ones((2, 3)), signals=np.zeros((0, 3)))))
        (Contact(agents=(0, 1), begin=1, end=2),)
    """
    pairs = [_touching(steps, rows) for rows, _, _ in steps.row_index.time_blocks(BLOCK_ROWS)]
    first, second = (np.concatenate(part) for part in zip(*pairs, strict=True))
    one, two = steps.row_index.agent[first], steps.row_index.agent[second]
    at = steps.row_index.step[first]
    order = np.lexsort((at, two, one))
    one, two, at = one[order], two[order], at[order]
    new = np.ones(at.size, dtype=bool)
    new[1:] = (np.diff(one) != 0) | (np.diff(two) != 0) | (np.diff(at) != 1)
    begin = np.flatnonzero(new)
    end = begin + np.diff(begin, append=at.size)
    found = [
        Contact((int(one[b]), int(two[b])), int(at[b]), int(at[e - 1]) + 1)
        for b, e in zip(begin, end, strict=True)
    ]
    return tuple(sorted(found, key=lambda c: (c.begin, c.agents)))


def _touching(steps: TrajectoryRows, rows: IntArray) -> tuple[IntArray, IntArray]:
    """(k,) rows of both of each pair among these rows whose outlines overlap at one time."""
    first, second = _near(steps, rows)
    touch = separation(_outlines(steps, first), _outlines(steps, second)) < -GRAZE_M
    return first[touch], second[touch]


def _near(steps: TrajectoryRows, rows: IntArray) -> tuple[IntArray, IntArray]:
    """(k,) rows of both of a pair, wherever the circles about their outlines meet.

    Rows are sorted along x within bands that are as high as the widest two circles reach, one time
    after the other. So each row is compared with those near it in its own band and in the next,
    however large the crowd and the map are.
    """
    if not rows.size:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    agent, step = steps.row_index.agent[rows], steps.row_index.step[rows]
    x, y = steps.xy[rows].T
    walking = (steps.kind == PEDESTRIAN)[agent]
    reach = 0.5 * np.hypot(steps.length, steps.width)[agent]
    far = 2.0 * float(reach.max()) + KEY_ERROR_M
    band = np.floor((y - y.min()) / far).astype(np.int64)
    bands = int(band.max()) + 2  # one stays empty between one time and the next
    span = float(np.ptp(x)) + 2.0 * far + 1.0  # bands never meet
    key = x - x.min() + span * (band + bands * (step - step[0]))
    order = np.argsort(key)
    key = key[order]
    found = []
    for first, last in ((None, key + far), (key + span - far, key + span + far)):
        begin = np.arange(1, key.size + 1) if first is None else np.searchsorted(key, first, "left")
        count = np.searchsorted(key, last, "right") - begin
        one = np.repeat(np.arange(key.size), count)
        other = np.arange(one.size) - np.repeat(np.cumsum(count) - count, count) + begin[one]
        a, b = order[one], order[other]
        near = np.hypot(x[a] - x[b], y[a] - y[b]) < reach[a] + reach[b]
        near &= ~(walking[a] & walking[b])
        found.append((rows[a[near]], rows[b[near]]))
    a, b = (np.concatenate(part) for part in zip(*found, strict=True))
    return np.minimum(a, b), np.maximum(a, b)


def _outlines(steps: TrajectoryRows, rows: IntArray) -> Outlines:
    agent = steps.row_index.agent[rows]
    return Outlines.of(steps.xy[rows], steps.heading[rows], steps.length[agent], steps.width[agent])
