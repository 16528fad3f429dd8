"""Many decision trees as plain arrays, and the sum of the leaves that a sample falls into.

Every inner node has the mask of the leaves that remain reachable when its comparison is true; the
first leaf of a tree that remains after all its masks is the one that a sample falls into. No step
depends on another one, so that a comparison is made for many samples at once.

References:
    Lucchese et al. (2015), "QuickScorer: a fast algorithm to rank documents with additive
    ensembles of regression trees", SIGIR.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.contract import FloatArray

_KINDS: Final = {
    "root": (np.uint32, 1),
    "column": (np.uint32, 1),
    "feature": (np.uint16, 1),
    "threshold": (np.float32, 1),
    "child": (np.uint32, 1),
    "value": (np.float32, 2),
}
"""Type and dimensions of each array of `Trees`."""

MOST_LEAVES: Final = 32
"""Largest number of leaves of a tree: the bits of a mask."""

_DE_BRUIJN: Final = 0x077CB531
"""The upper five bits of its products with powers of two all differ (Leiserson, Prokop, Randall
1998, Using de Bruijn sequences to index a 1 in a computer word)."""


@dataclass(frozen=True, eq=False)
class Trees:
    """Trees of at most 32 leaves, their nodes one after another, siblings side by side.

    Features are compared in single precision.

    Attributes:
        root: (B,) root node of each tree.
        column: (B,) index of the sum that the tree adds to.
        feature: (N,) feature compared at a node; 0 at a leaf.
        threshold: (N,) a larger feature goes to the second child; infinite at a leaf.
        child: (N,) first child, which the second one follows; a leaf is its own child.
        value: (N, 1) what a leaf adds to the sum; zero elsewhere.

    Examples:
        >>> stump = Trees.single(
        ...     feature=np.array([0, -1, -1]), threshold=np.array([0.5, 0.0, 0.0]),
        ...     left=np.array([1, 0, 0]), right=np.array([2, 0, 0]),
        ...     value=np.array([0.0, -1.0, 1.0]))
        >>> Trees.join([stump, stump]).total(np.array([[0.2], [0.7]]), 1).ravel()
        array([-2.,  2.])
    """

    root: NDArray[np.uint32]
    column: NDArray[np.uint32]
    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    child: NDArray[np.uint32]
    value: NDArray[np.float32]

    @classmethod
    def single(
        cls,
        feature: NDArray[Any],
        threshold: NDArray[Any],
        left: NDArray[Any],
        right: NDArray[Any],
        value: NDArray[Any],
        column: int = 0,
    ) -> Trees:
        """One tree, its nodes in any order.

        Args:
            feature: (N,) feature compared at a node; -1 at a leaf. The first node is the root.
            threshold: (N,) a feature not larger than this goes left.
            left: (N,) node to the left.
            right: (N,) node to the right.
            value: (N,) values of the leaves.
            column: index of the sum that the tree adds to.

        Returns:
            The tree, with its nodes level by level.
        """
        order, child = [0], [0]
        for place in range(feature.size):
            old = order[place]
            if feature[old] < 0:
                child[place] = place
                continue
            child[place] = len(order)
            order += [int(left[old]), int(right[old])]
            child += [0, 0]
        compared = feature[order]
        exact = threshold[order].astype(np.float64)
        single = exact.astype(np.float32)
        single = np.where(single > exact, np.nextafter(single, np.float32(-np.inf)), single)
        return cls(
            np.zeros(1, dtype=np.uint32),
            np.array([column], dtype=np.uint32),
            np.maximum(compared, 0).astype(np.uint16),
            np.where(compared < 0, np.float32(np.inf), single).astype(np.float32),
            np.array(child, dtype=np.uint32),
            value[order].astype(np.float32)[:, None],
        )

    @classmethod
    def join(cls, parts: Sequence[Trees]) -> Trees:
        """All trees of several collections."""
        first = np.cumsum([0, *(p.feature.size for p in parts)])[:-1].astype(np.uint32)
        return cls(
            root=np.concatenate([p.root + f for p, f in zip(parts, first, strict=True)]),
            column=np.concatenate([p.column for p in parts]),
            feature=np.concatenate([p.feature for p in parts]),
            threshold=np.concatenate([p.threshold for p in parts]),
            child=np.concatenate([p.child + f for p, f in zip(parts, first, strict=True)]),
            value=np.concatenate([p.value for p in parts]),
        )

    def total(self, features: FloatArray, sums: int) -> FloatArray:
        """(n, sums) sums over all trees of the leaves that samples (n, F) fall into."""
        from graphrqi.classify.tree_kernel import WIDTH, sum_of_leaves

        n, width = features.shape
        batches = -(-n // WIDTH)
        padded = np.zeros((batches * WIDTH, width), np.float32)
        padded[:n] = features
        turned = np.ascontiguousarray(padded.reshape(batches, WIDTH, width).swapaxes(1, 2))
        out = np.zeros((batches, sums, WIDTH))
        first, feature, threshold, keep, leaf, column = self._masks
        sum_of_leaves(
            turned.reshape(-1, WIDTH), first, feature, threshold, keep, leaf, column,
            np.empty(WIDTH, np.uint32), out,
        )  # fmt: skip
        return out.swapaxes(1, 2).reshape(-1, sums)[:n]

    @cached_property
    def _masks(self) -> tuple[NDArray[Any], ...]:
        """What the kernel takes: see `graphrqi.classify.tree_kernel.sum_of_leaves`.

        Raises:
            InputError: if a tree has too many leaves.
        """
        child = self.child.tolist()
        first, nodes, keep = [0], [], []
        leaf = np.zeros((self.root.size, MOST_LEAVES))
        for tree, root in enumerate(self.root.tolist()):
            inner: list[tuple[int, list[int]]] = []
            leaves = _leaves_below(root, child, inner)
            if len(leaves) > MOST_LEAVES:
                raise InputError(
                    f"trees: found one of {len(leaves)} leaves, expected at most {MOST_LEAVES}"
                )
            bit = {node: 1 << i for i, node in enumerate(leaves)}
            for node, one in bit.items():
                leaf[tree, (one * _DE_BRUIJN & 0xFFFFFFFF) >> 27] = self.value[node, 0]
            for node, left_leaves in inner:
                nodes.append(node)
                keep.append(0xFFFFFFFF & ~sum(bit[one] for one in left_leaves))
            first.append(len(nodes))
        return (
            np.array(first, dtype=np.int64),
            self.feature[nodes].astype(np.int64),
            self.threshold[nodes],
            np.array(keep, dtype=np.uint32),
            leaf,
            self.column.astype(np.int64),
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, to be saved."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def restored(
        cls, arrays: dict[str, NDArray[Any]], num_features: int, num_classes: int
    ) -> Trees:
        """Trees from saved arrays, which are checked here because the compiled loops check nothing.

        Args:
            arrays: as from `arrays`.
            num_features: F of the samples.
            num_classes: number of sums.

        Raises:
            InputError: if the arrays are not those of whole trees.
        """
        for name, (kind, ndim) in _KINDS.items():
            found = arrays.get(name)
            if found is None or found.dtype != kind or found.ndim != ndim:
                said = "no array" if found is None else f"{found.dtype} in {found.ndim} dimensions"
                wanted = f"{np.dtype(kind)} in {ndim}"
                raise InputError(f"{name}: found {said}, expected {wanted}")
        trees = cls(*(np.array(arrays[f.name]) for f in fields(cls)))
        wrong = trees._fault(num_features, num_classes)
        if wrong:
            raise InputError(f"trees: found {wrong}, expected whole trees")
        _ = trees._masks  # refuses trees of too many leaves
        return trees

    def _fault(self, num_features: int, num_classes: int) -> str:
        """What is wrong with the nodes; empty if every walk ends and stays within the arrays."""
        n, nodes = self.feature.size, np.arange(self.feature.size)
        root, child = self.root.astype(np.int64), self.child.astype(np.int64)
        if {self.threshold.size, child.size, len(self.value)} != {n}:
            return "arrays of nodes that differ in length"
        if not root.size or self.column.size != root.size:
            return "arrays of trees that are empty or differ in length"
        inner = child != nodes
        if (child[inner] < nodes[inner]).any():
            return "a node that leads back"
        reached = np.concatenate([root, child[inner], child[inner] + 1])
        if not np.array_equal(np.sort(reached), nodes):
            return "nodes that are not reached once each"
        if (self.feature >= num_features).any():
            return f"a feature beyond {num_features}"
        if (self.column >= num_classes).any():
            return f"a column beyond {num_classes}"
        if np.isnan(self.threshold).any() or (self.threshold[~inner] != np.inf).any():
            return "a threshold that is no number or lets a leaf go on"
        if self.value.shape[1] != 1 or not np.isfinite(self.value).all():
            return "no value or one that is not finite"
        return ""


def _leaves_below(node: int, child: list[int], inner: list[tuple[int, list[int]]]) -> list[int]:
    """The leaves under a node, from left to right.

    The inner nodes are added to ``inner`` from the top down, each with the leaves on its left.
    """
    first = child[node]
    if first == node:
        return [node]
    left_leaves: list[int] = []
    inner.append((node, left_leaves))
    left_leaves += _leaves_below(first, child, inner)
    return left_leaves + _leaves_below(first + 1, child, inner)
