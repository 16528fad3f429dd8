"""Random forest (Breiman 2001), grown by scikit-learn and kept as plain arrays.

The answer is the mean of the trees' leaf shares, with a temperature fitted on validation data.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.checks import of_trained_classes, saved_temperature
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.ensembles.trees import Trees
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
        self._count = trees
        self._min_leaf = min_leaf
        self._feature_share = feature_share
        self._keep(Trees.constant(np.full(num_classes, 1.0 / num_classes)))
        self._temperature = 1.0

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        from sklearn.ensemble import RandomForestClassifier

        grown = RandomForestClassifier(
            self._count, min_samples_leaf=self._min_leaf, max_features=self._feature_share,
            random_state=seed,
        ).fit(features, codes)  # fmt: skip
        trees = []
        for estimator in grown.estimators_:
            tree = estimator.tree_
            leaf = tree.children_left < 0
            counts = tree.value[:, 0, :]
            share = np.zeros((leaf.size, self._num_classes))
            share[:, grown.classes_] = counts / counts.sum(axis=1, keepdims=True) / self._count
            share[~leaf] = 0.0
            asked = np.where(leaf, -1, tree.feature)
            below = np.maximum(tree.children_left, 0), np.maximum(tree.children_right, 0)
            trees.append(Trees.single(asked, tree.threshold, *below, share))
        self._keep(Trees.join(trees))
        self._temperature = 1.0
        held = of_trained_classes(validation, codes)
        if held is not None:
            share = self._share(held[0])
            self._temperature = best_temperature(share, held[1], self._trained)

    def _keep(self, trees: Trees) -> None:
        self._trees = trees
        self._trained = np.asarray(trees.value.any(axis=0))

    def _share(self, features: FloatArray) -> FloatArray:
        total = self._trees.total(features, self._num_classes)
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return tempered(self._share(features), self._temperature, self._trained)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Nodes and temperature."""
        return {**self._trees.arrays(), "temperature": np.array([self._temperature])}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._keep(Trees.restored(arrays, num_features, self._num_classes))
        share = self._trees.value[self._trees.is_leaf()]
        if (
            share.shape[1] != self._num_classes
            or (share < 0.0).any()
            or not share.any(axis=1).all()
        ):
            raise InputError("value: found leaves without shares, expected some of each class")
        self._temperature = saved_temperature(arrays)
