"""Many decision trees as plain arrays, and the sum of the leaves that a sample falls into.

Every inner node has the mask of the leaves that remain reachable when its comparison is true. A
sample falls into the first leaf that remains after all masks. No step depends on another one, so a
comparison is made for many samples at once.

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
from graphrqi.arrays import FloatArray

MOST_LEAVES: Final = 32
"""Largest number of leaves of a tree: the bits of a mask."""

_HASH: Final = ((0x077CB531 << np.arange(MOST_LEAVES)) & 0xFFFFFFFF) >> 27
"""Index of each bit's leaf (Leiserson, Prokop, Randall 1998, Using de Bruijn sequences to index a 1
in a computer word)."""


@dataclass(frozen=True, eq=False)
class Trees:
    """Trees of at most 32 leaves. Features are compared in single precision.

    Attributes:
        first: (B + 1,) first inner node of each tree.
        column: (B,) sum that each tree adds to.
        feature: (I,) feature compared at an inner node.
        threshold: (I,) a larger feature goes right.
        keep: (I,) mask of the tree's leaves that then remain reachable.
        leaf: (B, 32) values of the leaves from left to right, then zeros.

    Examples:
        >>> stump = Trees.single(
        ...     feature=np.array([0, -1, -1]), threshold=np.array([0.5, 0.0, 0.0]),
        ...     left=np.array([1, 0, 0]), right=np.array([2, 0, 0]),
        ...     value=np.array([0.0, -1.0, 1.0]))
        >>> Trees.join([stump, stump]).total(np.array([[0.2], [0.7]]), 1).ravel()
        array([-2.,  2.])
    """

    first: NDArray[np.uint32]
    column: NDArray[np.uint32]
    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    keep: NDArray[np.uint32]
    leaf: NDArray[np.float32]

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

        Raises:
            InputError: if the tree has too many leaves.
        """
        inner: list[int] = []
        keep: list[int] = []
        leaves: list[int] = []

        def walk(node: int) -> None:
            if feature[node] < 0:
                leaves.append(node)
                return
            place, before = len(inner), len(leaves)
            inner.append(node)
            keep.append(0)
            walk(int(left[node]))
            keep[place] = 0xFFFFFFFF & ~((1 << len(leaves)) - (1 << before))
            walk(int(right[node]))

        walk(0)
        if len(leaves) > MOST_LEAVES:
            raise InputError(
                f"trees: found one of {len(leaves)} leaves, expected at most {MOST_LEAVES}"
            )
        exact = threshold[inner].astype(np.float64)
        single = exact.astype(np.float32)
        below = np.nextafter(single, np.float32(-np.inf))
        leaf = np.zeros((1, MOST_LEAVES), np.float32)
        leaf[0, : len(leaves)] = value[leaves]
        return cls(
            np.array([0, len(inner)], np.uint32),
            np.array([column], np.uint32),
            feature[inner].astype(np.uint16),
            np.where(single > exact, below, single),
            np.array(keep, np.uint32),
            leaf,
        )

    @classmethod
    def join(cls, parts: Sequence[Trees]) -> Trees:
        """All trees of several collections."""
        joined = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(cls)
        }
        sizes = np.concatenate([np.diff(part.first) for part in parts])
        return cls(**joined | {"first": np.cumsum([0, *sizes]).astype(np.uint32)})

    def total(self, features: FloatArray, sums: int) -> FloatArray:
        """(n, sums) sums over all trees of the leaves that samples (n, F) fall into."""
        from graphrqi.classify.tree_kernel import WIDTH, sum_of_leaves

        n, width = features.shape
        batches = -(-n // WIDTH)
        padded = np.zeros((batches * WIDTH, width), np.float32)
        padded[:n] = features
        turned = np.ascontiguousarray(padded.reshape(batches, WIDTH, width).swapaxes(1, 2))
        out = np.zeros((batches, sums, WIDTH))
        first, feature, threshold, keep, leaf, column = self._wide
        sum_of_leaves(
            turned.reshape(-1, WIDTH), first, feature, threshold, keep, leaf, column,
            np.empty(WIDTH, np.uint32), out,
        )  # fmt: skip
        return out.swapaxes(1, 2).reshape(-1, sums)[:n]

    @cached_property
    def _wide(self) -> tuple[NDArray[Any], ...]:
        """The arrays in the types and order of the kernel."""
        leaf = np.empty(self.leaf.shape)
        leaf[:, _HASH] = self.leaf
        first, feature, column = (
            array.astype(np.int64) for array in (self.first, self.feature, self.column)
        )
        return first, feature, self.threshold, self.keep, leaf, column

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, to be saved."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

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
            InputError: if the arrays are not those of trees.
        """
        trees = cls(*(np.array(arrays[field.name]) for field in fields(cls)))
        types = ["uint32", "uint32", "uint16", "float32", "uint32", "float32"]
        count, inner = trees.column.size, trees.feature.size
        shapes = [(count + 1,), (count,), (inner,), (inner,), (inner,), (count, MOST_LEAVES)]
        for (name, found), kind, shape in zip(trees.arrays().items(), types, shapes, strict=True):
            if str(found.dtype) != kind or found.shape != shape:
                wanted = f"{kind} of {shape}"
                raise InputError(f"{name}: found {found.dtype} of {found.shape}, expected {wanted}")
        first = trees.first.astype(np.int64)
        if first[0] != 0 or first[-1] != inner or (np.diff(first) < 0).any():
            raise InputError("first: found numbers that do not ascend over all nodes")
        if (trees.feature >= num_features).any() or (trees.column >= num_classes).any():
            raise InputError(f"trees: found a feature beyond {num_features} or class {num_classes}")
        if np.isnan(trees.threshold).any() or not np.isfinite(trees.leaf).all():
            raise InputError("trees: found a threshold or leaf that is no number")
        return trees
