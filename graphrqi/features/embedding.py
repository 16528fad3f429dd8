"""DANE: embedding of a network that changes and whose nodes have attributes.

Two Laplacians are embedded separately: the traffic graph's, and that of the similarity of the
agents' motion. Each embedding consists of the generalised eigenvectors L a = lambda D a of the
smallest eigenvalues above zero. The consensus consists of the projections of the two that correlate
most. From one moment to the next the eigenpairs are updated by first-order perturbation instead of
being solved again. Arrays are dense, which suits up to some hundred agents.

Differs from the paper: a newcomer's row begins as the mean of its neighbours' rows. The
eigenproblem is solved again every ``RESTART_S`` and when many agents have changed.

References:
    Li, Dani, Hu, Tang, Chang, Liu (2017), Attributed Network Embedding for Learning in a Dynamic
    Environment, CIKM.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import eigh

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.motion import Motion, RawMotion, align
from graphrqi.features.observer import Observation
from graphrqi.features.spectral import NEIGHBORS, NullObserver
from graphrqi.graph import TrafficGraph

NUM_DIMENSIONS: Final = 8
"""Dimensions of each embedding and of the consensus; as many as the rows of U have."""

EVERY_S: Final = 0.5
"""Time between updates of the embedding."""

RESTART_S: Final = 10.0
"""Time after which the eigenproblem is solved again; the paper's graph resets as often."""

MAX_CHANGED: Final = 0.3
"""Share of agents new since the last update above which the eigenproblem is solved again."""

MIN_SPLIT: Final = 1e-2
"""Eigenvalues closer than this are not mixed by the perturbation, since the first-order mixture is
unbounded there; normalised eigenvalues lie in 0 to 2."""

_ZERO: Final = 1e-8
"""Eigenvalues up to this one belong to connected components and are left out of the embedding."""

_RIDGE: Final = 1e-6
"""Weight of a loop at every agent, so that agents without neighbours have a positive degree."""


@dataclass(frozen=True, slots=True)
class LaplacianPairs:
    """Generalised eigenpairs L a = lambda D a of a weighted graph.

    Attributes:
        values: (k,) ascending, above zero.
        vectors: (n, k) with a' D a = 1.
        adjacency: (n, n) the graph they belong to.
    """

    values: FloatArray
    vectors: FloatArray
    adjacency: FloatArray

    @classmethod
    def solved(cls, adjacency: FloatArray, num_pairs: int = NUM_DIMENSIONS) -> LaplacianPairs:
        """At most so many pairs of the smallest eigenvalues above zero of symmetric weights (n, n).

        Examples:
            >>> path = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
            >>> LaplacianPairs.solved(path, 2).values.round(3)
            array([1., 2.])
        """
        if not len(adjacency):
            return cls(np.zeros(0), np.zeros((0, 0)), adjacency)
        degree = np.diag(adjacency.sum(axis=1) + _RIDGE)
        laplacian = degree - adjacency - _RIDGE * np.eye(len(adjacency))
        values, vectors = eigh(laplacian, degree)
        kept = np.flatnonzero(values > _ZERO)[:num_pairs]
        return cls(values[kept], vectors[:, kept], adjacency)

    def moved(self, adjacency: FloatArray) -> LaplacianPairs:
        """The pairs of a slightly different graph (n, n) of the same vertices, to first order."""
        change = adjacency - self.adjacency
        degree_change = change.sum(axis=1)
        a, values = self.vectors, self.values
        by_degree = a.T @ (degree_change[:, None] * a)  # a_j' dD a_i
        by_laplacian = by_degree - a.T @ change @ a  # a_j' dL a_i
        numerator = by_laplacian - by_degree * values[None, :]
        split = values[None, :] - values[:, None]  # lambda_i - lambda_j
        apart = np.abs(split) > MIN_SPLIT
        mixing = np.where(apart, numerator / np.where(apart, split, 1.0), 0.0)
        np.fill_diagonal(mixing, -0.5 * np.diag(by_degree))
        vectors = a + a @ np.clip(mixing, -1.0, 1.0)
        degree = adjacency.sum(axis=1) + _RIDGE
        vectors = vectors - degree @ vectors / degree.sum()  # orthogonal to the constant vector
        norm = np.sqrt((degree[:, None] * vectors**2).sum(axis=0))
        vectors = vectors / np.where(norm > 0, norm, 1.0)
        return LaplacianPairs(np.maximum(values + np.diag(numerator), 0.0), vectors, adjacency)

    def of_vertices(self, kept: IntArray, into: IntArray, adjacency: FloatArray) -> LaplacianPairs:
        """The pairs where rows ``kept`` of this graph become rows ``into`` of the next (m, m).

        Newcomers start at the mean of their neighbours. The pairs' graph is the old one among
        vertices that remain, and the new one for all others.
        """
        known = adjacency[:, into]
        total = known.sum(axis=1)
        vectors = known @ self.vectors[kept] / np.where(total > 0, total, 1.0)[:, None]
        vectors[into] = self.vectors[kept]
        before = adjacency.copy()
        before[np.ix_(into, into)] = self.adjacency[np.ix_(kept, kept)]
        return LaplacianPairs(self.values, vectors, before)


def consensus(network: FloatArray, attributes: FloatArray) -> FloatArray:
    """Projections in which two embeddings (n, k) and (n, l) of the same vertices correlate most.

    Returns:
        (n, NUM_DIMENSIONS) projections [network, attributes] p in descending order of correlation,
        each of mean square 1 and with its largest entry positive; zeros where there are fewer.
    """
    n, k = network.shape
    both = np.concatenate([network, attributes], axis=1)
    out = np.zeros((n, NUM_DIMENSIONS))
    if n == 0 or both.shape[1] == 0:
        return out
    gram = both.T @ both
    within = gram.copy()
    within[:k, k:] = within[k:, :k] = 0.0
    within += np.eye(len(within)) * 1e-9 * max(float(np.trace(gram)), 1e-12)
    found = both @ eigh(gram, within)[1][:, ::-1][:, :NUM_DIMENSIONS]
    size = np.sqrt((found**2).mean(axis=0))
    found = found / np.where(size > 0, size, 1.0)
    sign = np.sign(found[np.abs(found).argmax(axis=0), np.arange(found.shape[1])])
    out[:, : found.shape[1]] = found * np.where(sign == 0, 1.0, sign)
    return out


def similarity(motion: Motion) -> FloatArray:
    """(n, n) cosine similarity of speed, acceleration and sideways movement, none negative.

    Each is standardised over the agents present.
    """
    if motion.ids.size == 0:
        return np.zeros((0, 0))
    traits = np.nan_to_num(np.stack([motion.speed, motion.acceleration, motion.sideways], axis=1))
    spread = traits.std(axis=0)
    traits = (traits - traits.mean(axis=0)) / np.where(spread > 1e-9, spread, 1.0)
    size = np.sqrt((traits**2).sum(axis=1))
    unit = traits / np.where(size > 1e-9, size, 1.0)[:, None]
    out = np.maximum(unit @ unit.T, 0.0)
    np.fill_diagonal(out, 0.0)
    return np.asarray(out)


class EmbeddingObserver(NullObserver):
    """Rows of the present consensus embedding.

    Args:
        solver: not used; this is a different eigenproblem, with the smallest eigenvalues.
    """

    feature_names = tuple(f"dane_{k + 1}" for k in range(NUM_DIMENSIONS))

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__()
        self._graph = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._motion = RawMotion()
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        nobody = LaplacianPairs.solved(np.zeros((0, 0)))
        self._network, self._likeness = nobody, nobody
        self._embedding: FloatArray = np.zeros((0, NUM_DIMENSIONS))
        self._updated_s = self._solved_s = -np.inf

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> bool:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        motion = self._motion.update(time_s, ids, xy, drives)
        super().update(time_s, ids, xy, drives)
        if time_s - self._updated_s < EVERY_S - 1e-6:
            return False
        self._updated_s = time_s
        self._graph = self._graph.observe(ids, xy)
        network, likeness = self._graph.adjacency.toarray(), similarity(motion)
        into, kept = align(self._ids, ids)
        changed = 1.0 - into.size / max(ids.size, 1)
        pairs = min(self._network.values.size, self._likeness.values.size)
        whole = pairs == NUM_DIMENSIONS and changed <= MAX_CHANGED
        if whole and time_s - self._solved_s < RESTART_S - 1e-6:
            self._network = self._network.of_vertices(kept, into, network).moved(network)
            self._likeness = self._likeness.of_vertices(kept, into, likeness).moved(likeness)
        else:
            self._solved_s = time_s
            self._network = LaplacianPairs.solved(network)
            self._likeness = LaplacianPairs.solved(likeness)
        self._ids = ids
        self._embedding = consensus(self._network.vectors, self._likeness.vectors)
        return True

    def observation(self) -> Observation:
        """The last embedding of the drivers present; zeros for drivers that appeared since."""
        present = super().observation()
        rows = np.zeros((present.ids.size, NUM_DIMENSIONS))
        into, source = align(self._ids, present.ids)
        rows[into] = self._embedding[source]
        return dataclasses.replace(present, instant=rows)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, NUM_DIMENSIONS) the rows."""
        return instant
