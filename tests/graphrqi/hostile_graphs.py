"""Graphs and questions that eigenvalue algorithms get wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, cast

import numpy as np

from graphrqi.graph import TrafficGraph

STEP_S: Final = 0.1
"""Time between observations, s."""


def hostile_graphs(count: int, largest: int = 400, seed: int = 0) -> Iterator[tuple[Any, ...]]:
    """Graphs and questions that eigenvalue algorithms get wrong.

    Sequences of ten: traffic graphs of either kind, nearest or within a radius, with and without
    weights, on a road or a crossing, vehicles coming and going, at times on whole metres (equal
    distances, coincident vehicles); between them stars, rings, complete graphs, paths, matchings,
    random graphs, trees, cliques and graphs without edges, with and without weights.

    Args:
        count: how many.
        largest: vehicles of the largest.
        seed: of all of it.

    Yields:
        Graph, pairs wanted (1 to 32), end, whether to start from the last answer at that end.
    """
    rng = np.random.default_rng(seed)
    done = 0
    while done < count:
        d = int(np.exp(rng.uniform(0.0, np.log(largest))))
        kind = ("accumulated", "instantaneous")[rng.integers(2)]
        traffic = TrafficGraph.empty(
            int(rng.integers(1, 6)), int(rng.integers(3, 12)), cast(Any, kind)
        )
        xy = rng.random((2 * d, 2)) * [[4.0 * d, 12.0]]
        if rng.random() < 0.5:
            xy[::2] = xy[::2, ::-1]
        speed = rng.normal(0.0, 2.0, (2 * d, 2))
        present = np.arange(0)
        for step in range(10):
            xy = xy + speed * STEP_S
            if step % 3 == 0:
                present = np.flatnonzero(rng.random(2 * d) < 0.5)
            if rng.random() < 0.25:
                graph = _special_graph(d, rng)
            else:
                seen = np.round(xy[present]) if rng.random() < 0.15 else xy[present]
                graph = traffic = traffic.observe(present, seen)
            end = ("largest", "smallest")[rng.integers(2)]
            yield graph, int(rng.integers(1, 33)), end, rng.random() < 0.8
            done += 1
            if done == count:
                return


def _special_graph(d: int, rng: np.random.Generator) -> TrafficGraph:
    i = np.arange(d)
    shape = int(rng.integers(9))
    block = int(rng.integers(2, 8))
    random = rng.integers(0, d, (int(rng.integers(0, 3 * d)), 2))
    edges = [
        np.stack([0 * i[1:], i[1:]], 1),  # star
        np.stack([i, (i + 1) % d], 1),  # ring
        np.stack(np.triu_indices(min(d, 60), 1), 1),  # complete
        np.stack([i[:-1], i[1:]], 1),  # path
        np.stack([i[: d - d % 2 : 2], i[1::2]], 1),  # matching
        random,
        np.stack([(i[1:] - 1) // 2, i[1:]], 1),  # binary tree
        np.array([(a, b) for a in i for b in range(a - a % block, a)]).reshape(-1, 2),  # cliques
        np.empty((0, 2), np.int64),
    ][shape].astype(np.int64)
    edges = edges[edges[:, 0] != edges[:, 1]]
    ids = rng.permutation(5 * d)[:d]
    return TrafficGraph.from_edges(ids, ids[edges])
