"""DANE: embedding of a network that changes and whose nodes have attributes.

Two Laplacians are embedded separately: the traffic graph's, and that of the similarity of the
agents' motion. Each embedding consists of the generalised eigenvectors L a = lambda D a of the
smallest eigenvalues above zero. The consensus consists of the projections of the two that correlate
most. Arrays are dense, which suits up to some hundred agents.

Differs from the paper: the eigenproblems are solved at every update. The paper solves them once,
and then follows their solution by first-order perturbation.

References:
    Li, Dani, Hu, Tang, Chang, Liu (2017), Attributed Network Embedding for Learning in a Dynamic
    Environment, CIKM.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import eigh

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.motion import Motion, RawMotion, align
from graphrqi.features.observer import Observation, Observer
from graphrqi.features.spectral import NEIGHBORS
from graphrqi.graph import TrafficGraph

NUM_DIMENSIONS: Final = 8
"""Dimensions of each embedding and of the consensus; as many as the rows of U have."""

EVERY_S: Final = 0.5
"""Time between updates of the embedding."""

_ZERO: Final = 1e-8
"""Eigenvalues up to this one belong to connected components and are left out of the embedding."""

_RIDGE: Final = 1e-6
"""Weight of a loop at every agent, so that agents without neighbours have a positive degree."""


def embedded(adjacency: FloatArray, dimensions: int = NUM_DIMENSIONS) -> FloatArray:
    """(n, k) generalised eigenvectors of symmetric weights (n, n), at most so many."""
    if not len(adjacency):
        return np.zeros((0, 0))
    degree = np.diag(adjacency.sum(axis=1) + _RIDGE)
    values, vectors = eigh(degree - adjacency - _RIDGE * np.eye(len(adjacency)), degree)
    return np.asarray(vectors[:, np.flatnonzero(values > _ZERO)[:dimensions]])


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


class EmbeddingObserver(Observer):
    """Rows of the present consensus embedding; the solver is not used."""

    feature_names = tuple(f"dane_{k + 1}" for k in range(NUM_DIMENSIONS))

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__()
        self._graph = TrafficGraph.empty(neighbors=NEIGHBORS, kind="instantaneous")
        self._motion = RawMotion()
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._embedding: FloatArray = np.zeros((0, NUM_DIMENSIONS))
        self._updated_s = -np.inf

    def _moment(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> FloatArray:
        """Embed the network where that is due; additive evidence has no columns."""
        motion = self._motion.update(time_s, ids, xy, drives)
        if time_s >= self._updated_s + EVERY_S - 1e-6:
            self._updated_s, self._ids = time_s, ids
            self._graph = self._graph.observe(ids, xy)
            network = embedded(self._graph.adjacency.toarray())
            self._embedding = consensus(network, embedded(similarity(motion)))
        return np.zeros((ids.size, 0))

    def observation(self) -> Observation:
        """The last embedding of the drivers present; zeros for drivers that appeared since."""
        present = super().observation()
        rows = np.zeros((present.ids.size, NUM_DIMENSIONS))
        into, source = align(self._ids, present.ids)
        rows[into] = self._embedding[source]
        return present._replace(instant=rows)
