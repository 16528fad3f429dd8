"""Which road-agents touch each other, and for how long: their outlines overlap.

An outline is a rectangle of an agent's length and width about its centre, turned by its heading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sim.episode.rows import TrajectoryRows
from sim.frames import IntArray
from sim.geometry import Outlines, separation

GRAZE_M: Final = 0.15
"""Outlines may overlap by this much without a contact (our choice: a corner rounded with a radius
of 0.4 m, as cars' are, lies 0.4 (sqrt(2) - 1) m inside the rectangle's, and recorded positions are
no more accurate)."""


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
    first, second = _near(steps)
    touch = separation(_outlines(steps, first), _outlines(steps, second)) < -GRAZE_M
    first, second = first[touch], second[touch]
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


def _near(steps: TrajectoryRows) -> tuple[IntArray, IntArray]:
    """(k,) rows of both of a pair, wherever the circles about their outlines meet."""
    agent, x, y = steps.row_index.agent, steps.xy[:, 0], steps.xy[:, 1]
    reach = 0.5 * np.hypot(steps.length, steps.width)[agent]
    widest = float(reach.max(initial=0.0))
    # along x, one instant after the other, far enough apart that instants never meet
    span = float(np.ptp(x)) + 4.0 * widest + 1.0 if x.size else 1.0
    key = x + span * steps.row_index.step
    order = np.argsort(key)
    key = key[order]
    until = np.searchsorted(key, key + 2.0 * widest, side="right")
    count = until - np.arange(key.size) - 1
    one = np.repeat(np.arange(key.size), count)
    begin = np.cumsum(count) - count
    other = np.arange(one.size) - np.repeat(begin, count) + one + 1
    a, b = order[one], order[other]
    near = np.hypot(x[a] - x[b], y[a] - y[b]) < reach[a] + reach[b]
    near &= ~(steps.walking[a] & steps.walking[b])
    a, b = a[near], b[near]
    return np.minimum(a, b), np.maximum(a, b)


def _outlines(steps: TrajectoryRows, rows: IntArray) -> Outlines:
    agent = steps.row_index.agent[rows]
    return Outlines.of(steps.xy[rows], steps.heading[rows], steps.length[agent], steps.width[agent])
