"""Who touches whom: pairs of road-agents whose boxes overlap, for how long.

A box is an agent's length and width about its centre, turned by its heading. Two boxes are apart
when some side of one has the other wholly beyond it (separating axis theorem), so the overlap is
the least that one would have to be moved by to be free.

References:
    Gottschalk, Lin, Manocha (1996), OBBTree: a hierarchical structure for rapid interference
    detection, SIGGRAPH.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sim.episode.rows import TrajectoryRows
from sim.frames import FloatArray, IntArray

GRAZE_M: Final = 0.15
"""Boxes may overlap by this much without touching (our choice: a corner rounded with a radius of
0.4 m, as cars' are, lies 0.4 (sqrt(2) - 1) m inside the box's; and recorded positions are no more
accurate)."""


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
    touch = _overlap(steps, first, second) > GRAZE_M
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
    """(k,) rows of both of a pair, wherever their circles about the boxes meet."""
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


def _overlap(steps: TrajectoryRows, first: IntArray, second: IntArray) -> FloatArray:
    """(k,) how deep the boxes of each pair of rows overlap, m; negative when apart."""
    apart = steps.xy[second] - steps.xy[first]
    turned = [steps.heading[row] for row in (first, second)]
    axes = [np.stack([np.cos(h), np.sin(h)], axis=1) for h in turned]
    axes += [np.stack([-u[:, 1], u[:, 0]], axis=1) for u in axes]
    length, width = steps.length, steps.width
    depth = np.full(first.size, np.inf)
    for axis in axes:
        reach = np.zeros(first.size)
        for row, along in ((first, axes[0]), (second, axes[1])):
            agent = steps.row_index.agent[row]
            cos = (along * axis).sum(axis=1)
            sin = along[:, 0] * axis[:, 1] - along[:, 1] * axis[:, 0]
            reach += 0.5 * (length[agent] * abs(cos) + width[agent] * abs(sin))
        depth = np.minimum(depth, reach - np.abs((apart * axis).sum(axis=1)))
    return depth
