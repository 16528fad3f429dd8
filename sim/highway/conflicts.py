"""Where the paths across a junction come too close to each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from sim.compiled import in_place
from sim.frames import FloatArray
from sim.highway.lanes import PolylineLane
from sim.highway.tables import IntArray
from sim.road.cells import boxes_of, near_pairs
from sim.road.lane_graph import CELL_M

SAMPLE_M: Final = 0.5
"""Junction paths are compared at points this far apart to find where they conflict."""

CONFLICT_M: Final = 2.2
"""Junction paths nearer than this conflict (a car's width and 0.4 m)."""

HALF_CAR_M: Final = 2.3
"""Half a car's length: in a bend its corners swing out by this squared over the radius, m."""

WIDEST_M: Final = 3.0
"""Paths farther apart than this do not conflict, however far cars swing out (side by side)."""


def find_conflicts(
    paths: Sequence[PolylineLane], begins: IntArray
) -> Iterator[tuple[int, int, float, float, float, float]]:
    """Where junction paths come too close, other than those that begin on the same lane.

    Args:
        paths: the junction paths.
        begins: (n,) number of the lane on which each begins.

    Yields:
        A path, another one, and from where to where on either of them, m; ascending by both.
    """
    at = [np.linspace(0.0, p.length, max(int(p.length / SAMPLE_M), 1) + 1) for p in paths]
    xy = [path.positions(s) for path, s in zip(paths, at, strict=True)]
    boxes = boxes_of(xy, WIDEST_M / 2)
    pairs = near_pairs(boxes, boxes, CELL_M)
    pairs = pairs[begins[pairs[:, 0]] != begins[pairs[:, 1]]]
    if not len(pairs):
        return
    first = np.cumsum([0, *(len(line) for line in xy)], dtype=np.int64)
    ends = np.full((len(pairs), 2), -1, np.int64)
    swing = np.concatenate([_swing(line) for line in xy])
    _first_and_last_close(np.concatenate(xy), swing, first, pairs, ends)
    meet = ends[:, 0] >= 0
    spans = dict(zip(map(tuple, pairs[meet].tolist()), ends[meet].tolist(), strict=True))
    for (one, other), span in spans.items():
        yield (one, other, *at[one][span].tolist(), *at[other][spans[other, one]].tolist())


def _swing(xy: FloatArray) -> FloatArray:
    """How far a car swings out of a path at each of its points (n, 2), (n,) m."""
    step = np.diff(xy, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    per_m = np.concatenate([[0.0], turn / np.maximum(np.hypot(*step[1:].T), 1e-9), [0.0]])
    return HALF_CAR_M**2 * per_m


@in_place()
def _first_and_last_close(
    xy: FloatArray, swing: FloatArray, first: IntArray, pairs: IntArray, ends: IntArray
) -> None:
    """Find the first and the last point, of ``ends``, of each path that is too close to another."""
    for i in range(len(pairs)):
        one, other = pairs[i]
        for p in range(first[one], first[one + 1]):
            near = False
            for q in range(first[other], first[other + 1]):
                dx, dy = xy[p, 0] - xy[q, 0], xy[p, 1] - xy[q, 1]
                if math.sqrt(dx * dx + dy * dy) < min(CONFLICT_M + swing[p] + swing[q], WIDEST_M):
                    near = True
                    break
            if near:
                if ends[i, 0] < 0:
                    ends[i, 0] = p - first[one]
                ends[i, 1] = p - first[one]
