"""Gradient-boosted trees: scikit-learn's histogram boosting grows them, plain arrays keep them.

Validation data decides after how many rounds to stop and the temperature of the probabilities.

References:
    Friedman (2001), Ann. Statist. 29, 1189; Ke et al. (2017), LightGBM, NeurIPS.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.checks import of_trained_classes, saved, saved_temperature
from graphrqi.classify.contract import CodeArray, FloatArray
from graphrqi.classify.softmax import NEVER, best_temperature, softmax, tempered
from graphrqi.classify.trees import ShortTrees, Trees

PATIENCE: Final = 30
"""After so many rounds without a smaller validation loss no more are grown (our choice)."""


class Boosted:
    """Trees that each mend what those before got wrong.

    Args:
        num_classes: C.
        rounds: at most this many trees per class; none are grown once they stop helping.
        learning_rate: how much of each tree counts.
        max_leaves: of a tree.
        max_depth: of a tree; every sample takes as many steps as a tree is deep.
        min_leaf: fewest training samples in a leaf.
        ridge: penalty of squared leaf values.
        feature_share: share of the features looked at for each split.
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
        self._num_classes = num_classes
        self._options = {
            "max_iter": rounds,
            "learning_rate": learning_rate,
            "max_leaf_nodes": max_leaves,
            "max_depth": max_depth,
            "min_samples_leaf": min_leaf,
            "l2_regularization": ridge,
            "max_features": feature_share,
        }
        self._keep(Trees.constant(np.zeros(1)))
        self._baseline = np.zeros(num_classes)
        self._temperature = 1.0

    def fit(
        self,
        features: FloatArray,
        codes: CodeArray,
        validation: tuple[FloatArray, CodeArray] | None,
        seed: int,
    ) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        from sklearn.ensemble import HistGradientBoostingClassifier

        held: dict[str, Any] = {}
        validation = of_trained_classes(validation, codes)
        if validation is not None:
            held = {"X_val": validation[0], "y_val": validation[1]}
        grown = HistGradientBoostingClassifier(
            early_stopping=bool(held), n_iter_no_change=PATIENCE, random_state=seed, **self._options
        ).fit(features, codes, **held)
        classes = grown.classes_.astype(np.int64)
        shown = classes[1:] if classes.size == 2 else classes  # two classes share one tree
        self._baseline = np.full(self._num_classes, NEVER)
        self._baseline[classes] = 0.0
        self._baseline[shown] = grown._baseline_prediction.ravel()
        rounds = grown._predictors
        if held:  # those up to the smallest loss; the first one told is that of no trees
            rounds = rounds[: int(np.argmax(grown.validation_score_[1:])) + 1]
        self._temperature = 1.0
        self._keep(
            Trees.join(
                [
                    self._plain(grower.nodes, code)
                    for each in rounds
                    for grower, code in zip(each, shown, strict=True)
                ]
            )
        )
        if validation is not None:
            found = self._untempered(validation[0])
            self._temperature = best_temperature(found, validation[1], self._trained())

    def _keep(self, trees: Trees) -> None:
        self._trees = trees
        self._quickest: Trees | ShortTrees = ShortTrees.of(trees) or trees

    def _plain(self, nodes: NDArray[Any], code: int) -> Trees:
        """One of scikit-learn's trees, its leaves adding to the score of a class."""
        leaf = nodes["is_leaf"].astype(bool)
        return Trees.single(
            np.where(leaf, -1, nodes["feature_idx"]),
            np.where(leaf, 0.0, nodes["num_threshold"]),
            nodes["left"].astype(np.int64),
            nodes["right"].astype(np.int64),
            np.where(leaf, nodes["value"], 0.0)[:, None],
            int(code),
        )

    def _untempered(self, features: FloatArray) -> FloatArray:
        return softmax(self._quickest.total(features, self._num_classes) + self._baseline)

    def _trained(self) -> NDArray[np.bool_]:
        return self._baseline > NEVER

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return tempered(self._untempered(features), self._temperature, self._trained())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All nodes, the baseline and the temperature."""
        return {
            **self._trees.arrays(),
            "baseline": self._baseline,
            "temperature": np.array([self._temperature]),
        }

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """Take what was saved."""
        self._keep(Trees.restored(arrays, num_features, self._num_classes))
        self._baseline = saved(arrays, "baseline", (self._num_classes,))
        self._temperature = saved_temperature(arrays)
