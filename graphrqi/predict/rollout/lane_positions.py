"""Positions in lane coordinates: along paths, and back to metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.road.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def along_path(
    path: IntArray, x: FloatArray, path_lane: IntArray, path_start: FloatArray
) -> tuple[IntArray, FloatArray]:
    """(n, H) lanes and distances along them, m, of distances x (n, H) along paths (n,)."""
    start = path_start[path]
    on = np.maximum((start[:, None] <= x[..., None]).sum(axis=2) - 1, 0)
    lane = np.take_along_axis(path_lane[path], on, axis=1)
    return lane, x - np.take_along_axis(start, on, axis=1)


def positions(graph: LaneGraph, lane: IntArray, s: FloatArray, offset: FloatArray) -> FloatArray:
    """(n, H, 2) positions of (n, H) distances along lanes and to the left of their centres, m.

    Lanes go on straight before their begin and beyond their end.
    """
    apart = float(graph.length.max(initial=0.0)) + 1.0
    owner = np.searchsorted(graph.segment_first, np.arange(graph.segment_at.size), "right") - 1
    within = np.clip(s, 0.0, apart - 0.5)
    piece = np.searchsorted(owner * apart + graph.segment_at, lane * apart + within, "right") - 1
    piece = np.clip(piece, graph.segment_first[lane], graph.segment_last[lane])
    along, way = s - graph.segment_at[piece], graph.segment_direction[piece]
    left = np.stack([-way[..., 1], way[..., 0]], axis=-1)
    start = graph.segment_start[piece]
    return np.asarray(start + along[..., None] * way + offset[..., None] * left)
