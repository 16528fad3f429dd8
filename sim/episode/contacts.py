"""Contacts of road agents: which outlines overlap, and for how long.

An outline is a rectangle of an agent's length and width about its centre, turned by its heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sim.frames import PEDESTRIAN, IntArray, Tracks
from sim.geometry import GRAZE_M, Outlines, separation


@dataclass(frozen=True, slots=True)
class Contact:
    """Two agents that touch.

    Attributes:
        agents: the two, the smaller first, as in ``Tracks.ids``.
        begin: index of the first time at which they touch.
        end: one past the last.
    """

    agents: tuple[int, int]
    begin: int
    end: int


def contacts(tracks: Tracks) -> tuple[Contact, ...]:
    """Every unbroken stretch of time for which two agents touch, pedestrians with each other aside.

    Args:
        tracks: an episode or a recording.

    Returns:
        Contacts in order of their beginning, then of agents.

    Examples:
        >>> from sim.frames import Tracks
        >>> time_s = np.array([0.1, 0.2, 0.3])
        >>> xy = np.array([[[0.0, 0.0]] * 3, [[9.0, 0.0], [4.0, 0.0], [9.0, 0.0]]])
        >>> still = np.zeros((2, 3))
        >>> contacts(Tracks.of_dense(
        ...     ids=np.arange(2), names=("a", "b"), kind=np.zeros(2), length=np.full(2, 5.0),
        ...     width=np.full(2, 2.0), time_s=time_s, xy=xy, heading=still, speed=still,
        ...     valid=np.ones((2, 3)), signals=np.zeros((0, 3))))
        (Contact(agents=(0, 1), begin=1, end=2),)
    """
    pairs = [_touching(tracks, rows) for rows, _, _ in tracks.rows.index.time_blocks()]
    first, second = (np.concatenate(part) for part in zip(*pairs, strict=True))
    one, two = tracks.rows.index.agent[first], tracks.rows.index.agent[second]
    at = tracks.rows.index.step[first]
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


def _touching(tracks: Tracks, rows: IntArray) -> tuple[IntArray, IntArray]:
    """(k,) rows of both of each pair among these rows whose outlines overlap at one time."""
    step = tracks.rows.index.step[rows]
    far_m = float(np.hypot(tracks.length, tracks.width).max(initial=0.0))
    apart = 2.0 * far_m * (step - step[:1])  # rows of different times are too far apart to meet
    at = np.column_stack([tracks.rows.xy[rows], apart])
    tree = cKDTree(at, balanced_tree=False, compact_nodes=False)
    first, second = rows[np.sort(tree.query_pairs(far_m, output_type="ndarray"), axis=1)].T
    walking = (tracks.kind == PEDESTRIAN)[tracks.rows.index.agent]
    some = ~(walking[first] & walking[second])
    first, second = first[some], second[some]
    touch = separation(_outlines(tracks, first), _outlines(tracks, second)) < -GRAZE_M
    return first[touch], second[touch]


def _outlines(tracks: Tracks, rows: IntArray) -> Outlines:
    """The outlines of agents in some rows."""
    agent = tracks.rows.index.agent[rows]
    return Outlines.of(
        tracks.rows.xy[rows], tracks.rows.heading[rows], tracks.length[agent], tracks.width[agent]
    )
