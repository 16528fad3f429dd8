"""The traffic graph over the time of an episode: who is joined, and each agent's part in w = L u.

w is the graph's Laplacian times the eigenvector u of its largest eigenvalue, the paper's figure of
which vehicles the leading eigenvector is about. The sign of u means nothing; |w| is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.replay.beliefs import kept_steps
from graphrqi.features.spectral import NEIGHBORS, RESET
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS
from sim.frames import FloatArray, IntArray, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class GraphHistory:
    """A traffic graph over time.

    Attributes:
        time_s: (S,) times of the samples, s.
        w: (N, S) |w| of each agent; NaN where it is not there.
        edges: (E, 4) of each edge: the two agents' rows, the first sample that found it and the
            first that did not.
    """

    time_s: FloatArray
    w: FloatArray
    edges: IntArray


def graph_history(tracks: Tracks) -> GraphHistory:
    """Follow the paper's accumulated 4-nearest-neighbour graph through an episode.

    Args:
        tracks: the episode.

    Returns:
        The graph as looked at every half a second.
    """
    steps = kept_steps(tracks)
    seen = tracks.rows
    column = {int(step): i for i, step in enumerate(steps)}
    many = tracks.ids.size
    w = np.full((many, steps.size), np.nan)
    graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
    previous = None
    since: dict[int, int] = {}
    edges: list[tuple[int, int, int, int]] = []
    for step in range(tracks.time_s.size):
        at = seen.index.at(step)
        rows = seen.index.agent[at]
        graph = graph.observe(tracks.ids[rows], seen.xy[at])
        if step not in column:
            continue
        sample = column[step]
        pairs = np.sort(np.searchsorted(tracks.ids, graph.edges), axis=1)
        keys = (pairs[:, 0] * many + pairs[:, 1]).tolist()
        now = set(keys)
        for key in [key for key in since if key not in now]:
            edges.append((*divmod(key, many), since.pop(key), sample))
        for key in keys:
            since.setdefault(key, sample)
        if not rows.size:
            continue
        previous = SOLVERS["graphrqi"](graph, num_pairs=1, end="largest", previous=previous)
        leading = np.asarray(previous.eigenvectors[:, 0])
        value = np.abs(np.asarray(graph.laplacian @ leading))
        w[rows, sample] = value[graph.rows_of(tracks.ids[rows])]
    edges += [(*divmod(key, many), begin, steps.size) for key, begin in since.items()]
    return GraphHistory(
        tracks.time_s[steps], w, np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
    )
