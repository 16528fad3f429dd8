"""Many decision trees as plain arrays, and the sum of the leaves that a sample falls into.

`Trees` holds and evaluates any trees. `QuickScorer` evaluates boosted trees of few leaves: a frame
of ``graphrqi-plus`` takes 1.5 times as long without it, for 60 drivers and for 1,000.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.contract import FloatArray

_KINDS: Final = {
    "root": (np.uint32, 1),
    "depth": (np.uint32, 1),
    "column": (np.uint32, 1),
    "feature": (np.uint16, 1),
    "threshold": (np.float32, 1),
    "child": (np.uint32, 1),
    "value": (np.float32, 2),
}
"""Type and dimensions of each array of `Trees`."""

MOST_LEAVES: Final = 32
"""Largest number of leaves of a tree in `QuickScorer`: the bits of a mask."""

CACHE_LINE: Final = 64
"""Bytes that a processor reads at once. Registers are filled a third faster from memory that begins
with such a line."""


@dataclass(frozen=True, slots=True)
class Trees:
    """The nodes of all trees one after another, siblings side by side.

    Features are compared in single precision.

    Attributes:
        root: (B,) root node of each tree.
        depth: (B,) steps from the root to the deepest leaf.
        column: (B,) index of the sum that the first of a leaf's values adds to.
        feature: (N,) feature compared at a node; 0 at a leaf.
        threshold: (N,) a larger feature goes to the second child; infinite at a leaf.
        child: (N,) first child, which the second one follows; a leaf is its own child.
        value: (N, W) values that a leaf adds to the sums; zero elsewhere.

    Examples:
        >>> stump = Trees.single(
        ...     feature=np.array([0, -1, -1]), threshold=np.array([0.5, 0.0, 0.0]),
        ...     left=np.array([1, 0, 0]), right=np.array([2, 0, 0]),
        ...     value=np.array([[0.0], [-1.0], [1.0]]))
        >>> Trees.join([stump, stump]).total(np.array([[0.2], [0.7]]), 1).ravel()
        array([-2.,  2.])
    """

    root: NDArray[np.uint32]
    depth: NDArray[np.uint32]
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
            value: (N, W) values of a leaf.
            column: index of the sum that the first value adds to.

        Returns:
            The tree, with its nodes level by level.
        """
        order, child, level, depth = [0], [0], [0], 0
        for place in range(feature.size):
            old = order[place]
            if feature[old] < 0:
                child[place] = place
                continue
            child[place] = len(order)
            depth = max(depth, level[place] + 1)
            order += [int(left[old]), int(right[old])]
            child += [0, 0]
            level += [level[place] + 1] * 2
        compared = feature[order]
        exact = threshold[order].astype(np.float64)
        single = exact.astype(np.float32)
        single = np.where(single > exact, np.nextafter(single, np.float32(-np.inf)), single)
        return cls(
            np.zeros(1, dtype=np.uint32),
            np.array([depth], dtype=np.uint32),
            np.array([column], dtype=np.uint32),
            np.maximum(compared, 0).astype(np.uint16),
            np.where(compared < 0, np.float32(np.inf), single).astype(np.float32),
            np.array(child, dtype=np.uint32),
            value[order].astype(np.float32),
        )

    @classmethod
    def constant(cls, value: FloatArray) -> Trees:
        """A single leaf with (C,) values, for every sample."""
        none = np.zeros(1)
        return cls.single(none - 1, none, none, none, value[None])

    @classmethod
    def join(cls, parts: Sequence[Trees]) -> Trees:
        """All trees of several collections."""
        first = np.cumsum([0, *(p.feature.size for p in parts)])[:-1].astype(np.uint32)
        return cls(
            root=np.concatenate([p.root + f for p, f in zip(parts, first, strict=True)]),
            depth=np.concatenate([p.depth for p in parts]),
            column=np.concatenate([p.column for p in parts]),
            feature=np.concatenate([p.feature for p in parts]),
            threshold=np.concatenate([p.threshold for p in parts]),
            child=np.concatenate([p.child + f for p, f in zip(parts, first, strict=True)]),
            value=np.concatenate([p.value for p in parts]),
        )

    def total(self, features: FloatArray, sums: int) -> FloatArray:
        """(n, sums) sums over all trees of the leaves that samples (n, F) fall into."""
        from graphrqi.classify.ensembles.tree_kernel import WIDTH, sum_of_leaves

        out = np.zeros((len(features), sums))
        sum_of_leaves(
            np.ascontiguousarray(features, dtype=np.float32), self.root, self.depth, self.column,
            self.feature, self.threshold, self.child, self.value, np.empty(WIDTH, np.uint32), out,
        )  # fmt: skip
        return out

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
        return trees

    def is_leaf(self) -> NDArray[np.bool_]:
        """(N,) whether a node is a leaf."""
        return np.asarray(self.child == np.arange(self.child.size))

    def _fault(self, num_features: int, num_classes: int) -> str:
        """What is wrong with the nodes; empty if every walk ends and stays within the arrays."""
        n, nodes = self.feature.size, np.arange(self.feature.size)
        root, child = self.root.astype(np.int64), self.child.astype(np.int64)
        if {self.threshold.size, child.size, len(self.value)} != {n}:
            return "arrays of nodes that differ in length"
        if not root.size or {self.depth.size, self.column.size} != {root.size}:
            return "arrays of trees that are empty or differ in length"
        inner = child != nodes
        if (child[inner] < nodes[inner]).any():
            return "a node that leads back"
        reached = np.concatenate([root, child[inner], child[inner] + 1])
        if not np.array_equal(np.sort(reached), nodes):
            return "nodes that are not reached once each"
        if (self.feature >= num_features).any():
            return f"a feature beyond {num_features}"
        if (self.column.astype(np.int64) + self.value.shape[1] > num_classes).any():
            return f"a column beyond {num_classes}"
        if np.isnan(self.threshold).any() or (self.threshold[~inner] != np.inf).any():
            return "a threshold that is no number or lets a leaf go on"
        if not self.value.shape[1] or not np.isfinite(self.value).all():
            return "no value or one that is not finite"
        needed = np.zeros(root.size, dtype=np.int64)
        tree, node, level = np.arange(root.size), root, 0
        while node.size:
            needed[tree] = level
            on = inner[node]
            tree, node, level = np.tile(tree[on], 2), child[node[on]], level + 1
            node = np.concatenate([node, node + 1])
        return "" if np.array_equal(self.depth, needed) else "a depth that is not its tree's"


@dataclass(frozen=True, slots=True)
class QuickScorer:
    """Trees of at most 32 leaves with one value each, evaluated by bit masks.

    Every inner node has the mask of the leaves that remain reachable when its comparison is true;
    the first leaf of a tree that remains after all its masks is the one that a sample falls into.
    No step depends on another one, a comparison is made for 64 samples together, and their masks
    stay in registers. The sums equal those of `Trees` to the bit.

    Attributes:
        first: (B + 1,) first inner node of each tree, and the number of inner nodes.
        feature: (I,) feature compared at an inner node.
        threshold: (I,) the comparison is true for a larger feature.
        keep: (I,) mask of the leaves that then remain reachable.
        leaf: (B, 32) values of the leaves, from left to right.
        column: (B,) index of the sum that the tree adds to.

    References:
        Lucchese et al. (2015), "QuickScorer: a fast algorithm to rank documents with additive
        ensembles of regression trees", SIGIR.
    """

    first: NDArray[np.uint64]
    feature: NDArray[np.uint64]
    threshold: NDArray[np.float32]
    keep: NDArray[np.uint32]
    leaf: NDArray[np.float64]
    column: NDArray[np.uint64]

    @classmethod
    def of(cls, trees: Trees) -> QuickScorer | None:
        """The same trees; None if one has too many leaves, or leaves have several values.

        Examples:
            >>> stump = Trees.single(
            ...     feature=np.array([0, -1, -1]), threshold=np.array([0.5, 0.0, 0.0]),
            ...     left=np.array([1, 0, 0]), right=np.array([2, 0, 0]),
            ...     value=np.array([[0.0], [-1.0], [1.0]]))
            >>> QuickScorer.of(stump).total(np.array([[0.2], [0.7]]), 1).ravel()
            array([-1.,  1.])
        """
        child = trees.child.tolist()
        first, nodes, keep = [0], [], []
        leaf = np.zeros((trees.root.size, MOST_LEAVES))
        if trees.value.shape[1] != 1:
            return None
        for tree, root in enumerate(trees.root.tolist()):
            inner: list[tuple[int, list[int]]] = []
            leaves = _leaves_below(root, child, inner)
            if len(leaves) > MOST_LEAVES:
                return None
            leaf[tree, : len(leaves)] = trees.value[leaves, 0]
            bit = {node: 1 << i for i, node in enumerate(leaves)}
            for node, left_leaves in inner:
                nodes.append(node)
                keep.append(0xFFFFFFFF & ~sum(bit[one] for one in left_leaves))
            first.append(len(nodes))
        return cls(
            np.array(first, dtype=np.uint64),
            trees.feature[nodes].astype(np.uint64),
            trees.threshold[nodes],
            np.array(keep, dtype=np.uint32),
            leaf,
            trees.column.astype(np.uint64),
        )

    def total(self, features: FloatArray, sums: int) -> FloatArray:
        """(n, sums) as `Trees.total`."""
        from graphrqi.classify.ensembles.tree_kernel import WIDTH, sum_of_first_leaves

        n, width = features.shape
        whole, rest = divmod(n, WIDTH)
        batches = whole + (rest > 0)
        space = np.empty(batches * width * WIDTH + CACHE_LINE // 4, dtype=np.float32)
        begin = -space.ctypes.data % CACHE_LINE // 4
        every = space[begin:][: batches * width * WIDTH].reshape(batches, width, WIDTH)
        every[:whole] = features[: n - rest].reshape(whole, WIDTH, width).swapaxes(1, 2)
        if rest:
            every[whole, :, :rest], every[whole, :, rest:] = features[n - rest :].T, 0.0
        out = np.zeros((batches, sums, WIDTH))
        sum_of_first_leaves(
            every.reshape(-1, WIDTH), self.first, self.feature, self.threshold, self.keep,
            self.leaf, self.column, np.empty(WIDTH, np.uint32), out,
        )  # fmt: skip
        return out.swapaxes(1, 2).reshape(-1, sums)[:n]


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
