"""Many decision trees as plain arrays, and the sum of what their leaves say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.contract import FloatArray


@dataclass(frozen=True, slots=True)
class Trees:
    """The nodes of all trees one after another.

    Attributes:
        root: (B,) node at which each tree begins.
        feature: (N,) feature asked at a node; -1 at a leaf.
        threshold: (N,) a value at most this goes left.
        left: (N,) node to the left.
        right: (N,) node to the right.
        value: (N, C) what a leaf adds; zero elsewhere.

    Examples:
        >>> stump = Trees.single(
        ...     feature=np.array([0, -1, -1]), threshold=np.array([0.5, 0.0, 0.0]),
        ...     left=np.array([1, 0, 0]), right=np.array([2, 0, 0]),
        ...     value=np.array([[0.0], [-1.0], [1.0]]))
        >>> Trees.join([stump, stump]).total(np.array([[0.2], [0.7]])).ravel()
        array([-2.,  2.])
    """

    root: NDArray[np.int64]
    feature: NDArray[np.int32]
    threshold: FloatArray
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    value: NDArray[np.float32]

    @classmethod
    def single(
        cls,
        feature: NDArray[Any],
        threshold: NDArray[Any],
        left: NDArray[Any],
        right: NDArray[Any],
        value: NDArray[Any],
    ) -> Trees:
        """One tree that begins at its first node; see the attributes."""
        return cls(
            np.zeros(1, dtype=np.int64),
            feature.astype(np.int32),
            threshold.astype(np.float64),
            left.astype(np.int32),
            right.astype(np.int32),
            value.astype(np.float32),
        )

    @classmethod
    def constant(cls, value: FloatArray) -> Trees:
        """A single leaf that says (C,) values of everyone."""
        none = np.zeros(1)
        return cls.single(none - 1, none, none, none, value[None])

    @classmethod
    def join(cls, parts: Sequence[Trees]) -> Trees:
        """All trees of several collections."""
        first = np.cumsum([0, *(p.feature.size for p in parts)])[:-1]
        moved = [
            (p.root + f, p.left + np.int32(f), p.right + np.int32(f))
            for p, f in zip(parts, first, strict=True)
        ]
        return cls(
            root=np.concatenate([m[0] for m in moved]),
            feature=np.concatenate([p.feature for p in parts]),
            threshold=np.concatenate([p.threshold for p in parts]),
            left=np.concatenate([m[1] for m in moved]),
            right=np.concatenate([m[2] for m in moved]),
            value=np.concatenate([p.value for p in parts]),
        )

    def total(self, features: FloatArray) -> FloatArray:
        """(n, C) sum over all trees of the leaves that samples (n, F) fall into."""
        from graphrqi.classify.tree_kernel import sum_of_leaves

        out = np.zeros((len(features), self.value.shape[1]))
        sum_of_leaves(
            np.ascontiguousarray(features, dtype=np.float64), self.root, self.feature,
            self.threshold, self.left, self.right, self.value, out,
        )  # fmt: skip
        return out

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What to save."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def restored(cls, arrays: dict[str, NDArray[Any]]) -> Trees:
        """From what was saved."""
        return cls(*(np.array(arrays[f.name]) for f in fields(cls)))
