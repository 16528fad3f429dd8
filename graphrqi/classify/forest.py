"""Random forest (Breiman 2001), grown by scikit-learn and kept as plain arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import CodeArray, FloatArray
from graphrqi.classify.contract import Classifier, HeldOut, saved


class Forest(Classifier):
    """Averaged decision trees on resampled data.

    Args:
        num_classes: C.
        trees: number of trees.
        min_leaf: fewest training samples in a leaf.
        feature_share: share of the features considered for each split.
    """

    def __init__(
        self, num_classes: int, trees: int = 100, min_leaf: int = 8, feature_share: float = 0.1
    ) -> None:
        super().__init__(num_classes)
        self._options = {
            "n_estimators": trees, "min_samples_leaf": min_leaf, "max_features": feature_share,
        }  # fmt: skip
        self._root, self._nodes = np.zeros(1, np.int64), np.array([[-1, 0, 0]])
        self._threshold = np.zeros(1)
        self._share: FloatArray = np.full((1, num_classes), 1.0 / num_classes)

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.ensemble import RandomForestClassifier

        grown = RandomForestClassifier(random_state=seed, **self._options).fit(features, codes)
        trees = [estimator.tree_ for estimator in grown.estimators_]
        self._root = np.cumsum([0, *(tree.node_count for tree in trees)])[:-1]
        nodes = [
            np.stack([tree.feature, tree.children_left + root, tree.children_right + root], 1)
            for tree, root in zip(trees, self._root, strict=True)
        ]
        self._nodes = np.concatenate(nodes)
        self._threshold = np.concatenate([tree.threshold for tree in trees])
        counts = np.concatenate([tree.value[:, 0, :] for tree in trees])
        self._share = np.zeros((len(counts), self._num_classes))
        self._share[:, grown.classes_] = counts / counts.sum(axis=1, keepdims=True)

    @property
    def _trained(self) -> NDArray[np.bool_]:
        return np.asarray(self._share.any(axis=0))

    def _untempered(self, features: FloatArray) -> FloatArray:
        asked, left, right = self._nodes.T
        x, rows = features.astype(np.float32), np.arange(len(features))
        total = np.zeros((len(features), self._num_classes))
        for root in self._root:
            node = np.full(len(features), root)
            while (inner := asked[node] >= 0).any():
                goes_left = x[rows, asked[node]] <= self._threshold[node]
                node = np.where(inner, np.where(goes_left, left[node], right[node]), node)
            total += self._share[node]
        return total / self._root.size

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Nodes and temperature."""
        return {
            "root": self._root, "nodes": self._nodes, "threshold": self._threshold,
            "share": self._share, **super().arrays(),
        }  # fmt: skip

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `Classifier.restore`."""
        super().restore(arrays, num_features)
        root, nodes = (np.asarray(arrays[name], np.int64) for name in ("root", "nodes"))
        inner = nodes[:, 0] >= 0
        reached = np.concatenate([root, nodes[inner, 1:].ravel()])
        if (
            not np.array_equal(np.sort(reached), np.arange(len(nodes)))
            or (nodes[:, 0] >= num_features).any()
            or (nodes[inner, 1:] <= np.flatnonzero(inner)[:, None]).any()
        ):
            raise InputError("nodes: found some that lead nowhere, expected whole trees")
        self._root, self._nodes = root, nodes
        self._threshold = saved(arrays, "threshold", (len(nodes),))
        self._share = saved(arrays, "share", (len(nodes), self._num_classes))
        shares = self._share[nodes[:, 0] < 0]
        if (shares < 0.0).any() or (abs(shares.sum(axis=1) - 1.0) > 1e-6).any():
            raise InputError("share: found leaves without probabilities, expected rows of sum 1")
