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

from behaviors.traits import runs
from sim.frames import PEDESTRIAN, FloatArray, IntArray, Tracks

GRAZE_M: Final = 0.15
"""Boxes may overlap by this much without touching (our choice: a corner rounded with a radius of
0.4 m, as cars' are, lies 0.4 (sqrt(2) - 1) m inside the box's; and recorded positions are no more
accurate)."""


@dataclass(frozen=True, slots=True)
class Contact:
    """Two agents that touch.

    Attributes:
        rows: the two agents' rows, the smaller first.
        begin: first column in which they touch.
        end: one past the last.
    """

    rows: tuple[int, int]
    begin: int
    end: int


def contacts(tracks: Tracks) -> tuple[Contact, ...]:
    """Every unbroken stretch of time for which two agents touch, pedestrians with each other aside.

    Args:
        tracks: an episode or a recording.

    Returns:
        Contacts in order of their beginning, then of rows.

    Examples:
        >>> time_s = np.array([0.1, 0.2, 0.3])
        >>> xy = np.array([[[0.0, 0.0]] * 3, [[9.0, 0.0], [4.0, 0.0], [9.0, 0.0]]])
        >>> still = np.zeros((2, 3))
        >>> contacts(Tracks(
        ...     ids=np.arange(2), names=("a", "b"), kind=np.zeros(2), length=np.full(2, 5.0),
        ...     width=np.full(2, 2.0), time_s=time_s, xy=xy, heading=still, speed=still,
        ...     valid=np.ones((2, 3)), signals=np.zeros((0, 3))))
        (Contact(rows=(0, 1), begin=1, end=2),)
    """
    first, second, column = _near(tracks)
    depth = _overlap(tracks, first, second, column)
    touch = depth > GRAZE_M
    first, second, column = first[touch], second[touch], column[touch]
    pair, number = np.unique(np.stack([first, second], axis=1), axis=0, return_inverse=True)
    flags = np.zeros((len(pair), tracks.time_s.size), dtype=bool)
    flags[number.reshape(-1), column] = True
    found = [Contact((int(pair[k, 0]), int(pair[k, 1])), b, e) for k, b, e in runs(flags)]
    return tuple(sorted(found, key=lambda c: (c.begin, c.rows)))


def _near(tracks: Tracks) -> tuple[IntArray, IntArray, IntArray]:
    """(m,) rows of both of a pair and the column, wherever their circles about the boxes meet."""
    row, column = np.nonzero(tracks.valid)
    reach = 0.5 * np.hypot(tracks.length, tracks.width)
    widest = float(reach.max(initial=0.0))
    x, y = tracks.xy[row, column].T
    # along x, one instant after the other, far enough apart that instants never meet
    span = float(np.ptp(x)) + 4.0 * widest + 1.0 if x.size else 1.0
    key = x + span * column
    order = np.argsort(key)
    key, row, column, x, y = key[order], row[order], column[order], x[order], y[order]
    until = np.searchsorted(key, key + 2.0 * widest, side="right")
    count = until - np.arange(key.size) - 1
    one = np.repeat(np.arange(key.size), count)
    begin = np.cumsum(count) - count
    other = np.arange(one.size) - np.repeat(begin, count) + one + 1
    a, b = row[one], row[other]
    walks = tracks.kind == PEDESTRIAN
    near = np.hypot(x[one] - x[other], y[one] - y[other]) < reach[a] + reach[b]
    near &= ~(walks[a] & walks[b])
    a, b, at = a[near], b[near], column[one[near]]
    return np.minimum(a, b), np.maximum(a, b), at


def _overlap(tracks: Tracks, first: IntArray, second: IntArray, column: IntArray) -> FloatArray:
    """(m,) how deep the boxes of each pair overlap, m; negative when apart."""
    apart = tracks.xy[second, column] - tracks.xy[first, column]
    turned = [tracks.heading[agent, column] for agent in (first, second)]
    axes = [np.stack([np.cos(h), np.sin(h)], axis=1) for h in turned]
    axes += [np.stack([-u[:, 1], u[:, 0]], axis=1) for u in axes]
    depth = np.full(first.size, np.inf)
    for axis in axes:
        reach = np.zeros(first.size)
        for agent, along in ((first, axes[0]), (second, axes[1])):
            cos = (along * axis).sum(axis=1)
            sin = along[:, 0] * axis[:, 1] - along[:, 1] * axis[:, 0]
            reach += 0.5 * (tracks.length[agent] * abs(cos) + tracks.width[agent] * abs(sin))
        depth = np.minimum(depth, reach - np.abs((apart * axis).sum(axis=1)))
    return depth
