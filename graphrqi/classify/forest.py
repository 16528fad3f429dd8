"""Random forest (Breiman 2001), grown by scikit-learn and kept as plain arrays.

The answer is the mean of the trees' leaf shares, with a temperature fitted on validation data.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.checks import of_trained_classes, saved, saved_temperature
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import best_temperature, tempered


class Forest:
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
        self._num_classes = num_classes
        self._options = {
            "n_estimators": trees, "min_samples_leaf": min_leaf, "max_features": feature_share,
        }  # fmt: skip
        self._root = np.zeros(1, np.int64)
        self._nodes = np.array([[-1, 0, 0]])
        self._threshold = np.zeros(1)
        self._share: FloatArray = np.full((1, num_classes), 1.0 / num_classes)
        self._temperature = 1.0

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        from sklearn.ensemble import RandomForestClassifier

        grown = RandomForestClassifier(random_state=seed, **self._options).fit(features, codes)
        trees = [estimator.tree_ for estimator in grown.estimators_]
        self._root = np.cumsum([0, *(tree.node_count for tree in trees)])[:-1]
        self._nodes = np.concatenate(
            [
                np.stack([tree.feature, tree.children_left + root, tree.children_right + root], 1)
                for tree, root in zip(trees, self._root, strict=True)
            ]
        )
        self._threshold = np.concatenate([tree.threshold for tree in trees])
        counts = np.concatenate([tree.value[:, 0, :] for tree in trees])
        self._share = np.zeros((len(counts), self._num_classes))
        self._share[:, grown.classes_] = counts / counts.sum(axis=1, keepdims=True)
        self._temperature = 1.0
        held = of_trained_classes(validation, codes)
        if held is not None:
            self._temperature = best_temperature(self._mean(held[0]), held[1], self._trained)

    @property
    def _trained(self) -> NDArray[np.bool_]:
        """(C,) whether each class occurred in training."""
        return np.asarray(self._share.any(axis=0))

    def _mean(self, features: FloatArray) -> FloatArray:
        """(n, C) mean share of the leaves that samples fall into."""
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

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return tempered(self._mean(features), self._temperature, self._trained)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Nodes and temperature."""
        return {
            "root": self._root, "nodes": self._nodes, "threshold": self._threshold,
            "share": self._share, "temperature": np.array([self._temperature]),
        }  # fmt: skip

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        root, nodes = (np.asarray(arrays[name], np.int64) for name in ("root", "nodes"))
        count = len(nodes)
        threshold = saved(arrays, "threshold", (count,))
        share = saved(arrays, "share", (count, self._num_classes))
        inner = nodes[:, 0] >= 0
        reached = np.concatenate([root, nodes[inner, 1:].ravel()])
        whole = np.array_equal(np.sort(reached), np.arange(count))
        if (
            not whole
            or (nodes[:, 0] >= num_features).any()
            or (nodes[inner, 1:] <= np.flatnonzero(inner)[:, None]).any()
        ):
            raise InputError("nodes: found some that lead nowhere, expected whole trees")
        if (share < 0.0).any() or not share[~inner].any(axis=1).all():
            raise InputError("share: found leaves without shares, expected some of each class")
        self._root, self._nodes, self._threshold, self._share = root, nodes, threshold, share
        self._temperature = saved_temperature(arrays)
