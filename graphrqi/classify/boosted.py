"""Gradient-boosted trees, grown by scikit-learn's histogram boosting and kept as plain arrays.

The number of rounds is chosen on validation data.

References:
    Friedman (2001), Ann. Statist. 29, 1189; Ke et al. (2017), LightGBM, NeurIPS.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import CodeArray, FloatArray
from graphrqi.classify.calibrated import NEVER, Calibrated, softmax
from graphrqi.classify.contract import HeldOut, saved
from graphrqi.classify.trees import Trees

PATIENCE: Final = 30
"""Growing stops after this many rounds without a smaller validation loss."""


class Boosted(Calibrated):
    """Trees of which each one corrects the errors of those before it.

    Args:
        num_classes: C.
        rounds: largest number of trees per class; growing stops when the validation loss does
            not fall any more.
        learning_rate: factor of each tree's leaves.
        max_leaves: of a tree, at most 32.
        max_depth: of a tree.
        min_leaf: fewest training samples in a leaf.
        ridge: penalty of squared leaf values.
        feature_share: share of the features considered for each split.
    """

    def __init__(
        self,
        num_classes: int,
        rounds: int = 120,
        learning_rate: float = 0.1,
        max_leaves: int = 15,
        max_depth: int | None = None,
        min_leaf: int = 40,
        ridge: float = 1.0,
        feature_share: float = 1.0,
    ) -> None:
        super().__init__(num_classes)
        self._options = {
            "max_iter": rounds, "learning_rate": learning_rate, "max_leaf_nodes": max_leaves,
            "max_depth": max_depth, "min_samples_leaf": min_leaf, "l2_regularization": ridge,
            "max_features": feature_share,
        }  # fmt: skip
        leaf, zero = np.full(1, -1), np.zeros(1)
        self._trees = Trees.single(leaf, zero, zero, zero, zero)
        self._baseline = np.zeros(num_classes)

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.ensemble import HistGradientBoostingClassifier

        beside: dict[str, Any] = {}
        if held is not None:
            beside = {"X_val": held[0], "y_val": held[1]}
        grown = HistGradientBoostingClassifier(
            early_stopping=held is not None, n_iter_no_change=PATIENCE, random_state=seed,
            **self._options,
        ).fit(features, codes, **beside)  # fmt: skip
        classes = grown.classes_.astype(np.int64)
        shown = classes[1:] if classes.size == 2 else classes  # two classes share one tree
        self._baseline = np.full(self._num_classes, NEVER)
        self._baseline[classes] = 0.0
        self._baseline[shown] = grown._baseline_prediction.ravel()
        rounds = grown._predictors
        if held is not None:  # up to the smallest loss; the first one is that of no trees
            rounds = rounds[: int(np.argmax(grown.validation_score_[1:])) + 1]
        self._trees = Trees.join(
            [
                _converted(one.nodes, c)
                for each in rounds
                for one, c in zip(each, shown, strict=True)
            ]
        )

    def _untempered(self, features: FloatArray) -> FloatArray:
        return softmax(self._trees.total(features, self._num_classes) + self._baseline)

    @property
    def _trained(self) -> NDArray[np.bool_]:
        return self._baseline > NEVER

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Nodes, baseline and temperature."""
        return {**self._trees.arrays(), "baseline": self._baseline, **super().arrays()}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        super().restore(arrays, num_features)
        self._trees = Trees.restored(arrays, num_features, self._num_classes)
        self._baseline = saved(arrays, "baseline", (self._num_classes,))


def _converted(nodes: NDArray[Any], code: int) -> Trees:
    """One of scikit-learn's trees, whose leaves add to the score of a class."""
    leaf = nodes["is_leaf"].astype(bool)
    feature = np.where(leaf, -1, nodes["feature_idx"])
    return Trees.single(
        feature, nodes["num_threshold"], nodes["left"], nodes["right"], nodes["value"], int(code)
    )
