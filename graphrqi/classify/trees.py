"""Ensembles of trees, grown by scikit-learn and kept as plain arrays.

Boosted trees are evaluated as follows. Every inner node has the mask of the leaves that remain
reachable when its comparison is true. A sample falls into the first leaf that remains after all
masks. No step depends on another one, so a comparison is made for many samples at once. Features
are compared in single precision.

References:
    Breiman (2001), Random forests, Machine Learning 45, 5.
    Friedman (2001), Ann. Statist. 29, 1189; Ke et al. (2017), LightGBM, NeurIPS.
    Lucchese et al. (2015), "QuickScorer: a fast algorithm to rank documents with additive
    ensembles of regression trees", SIGIR.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, CodeArray, FloatArray, softmax
from graphrqi.classify.contract import NEVER, Classifier, HeldOut, saved

PATIENCE: Final = 30
"""Growing stops after this many rounds without a smaller validation loss."""

MOST_LEAVES: Final = 32
"""Largest number of leaves of a tree: the bits of a mask."""

_TYPES: Final = {
    "first": np.uint32, "column": np.uint32, "feature": np.uint16, "threshold": np.float32,
    "keep": np.uint32, "leaf": np.float32,
}  # fmt: skip
"""Arrays of B trees with I inner nodes: (B + 1,) first inner node of each tree; (B,) class that it
adds to; (I,) feature compared; (I,) threshold, above which it goes right; (I,) mask of the leaves
that then remain reachable; (B, 32) values of the leaves from left to right."""

_HASH: Final = ((0x077CB531 << np.arange(MOST_LEAVES)) & 0xFFFFFFFF) >> 27
"""Index of each bit's leaf (Leiserson, Prokop, Randall 1998, Using de Bruijn sequences to index a 1
in a computer word)."""


class Boosted(Classifier):
    """Trees of which each one corrects the errors of those before it.

    Args:
        num_classes: C.
        rounds: largest number of trees per class; growing stops when the validation loss does
            not fall any more.
        max_leaves: of a tree, at most 32.
        max_depth: of a tree.
        min_leaf: fewest training samples in a leaf.
        feature_share: share of the features considered for each split.
    """

    def __init__(
        self,
        num_classes: int,
        rounds: int = 120,
        max_leaves: int = 15,
        max_depth: int | None = None,
        min_leaf: int = 40,
        feature_share: float = 1.0,
    ) -> None:
        super().__init__(num_classes)
        if max_leaves > MOST_LEAVES:
            raise InputError(f"max_leaves: found {max_leaves}, expected at most {MOST_LEAVES}")
        self._options = {
            "max_iter": rounds, "learning_rate": 0.1, "max_leaf_nodes": max_leaves,
            "max_depth": max_depth, "min_samples_leaf": min_leaf, "l2_regularization": 1.0,
            "max_features": feature_share,
        }  # fmt: skip
        self._trees = _joined([])
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
        self._trees = _joined(
            [(one.nodes, int(c)) for each in rounds for one, c in zip(each, shown, strict=True)]
        )

    def _untempered(self, features: FloatArray) -> FloatArray:
        from graphrqi.classify.tree_kernel import WIDTH, sum_of_leaves

        n, width = features.shape
        batches = -(-n // WIDTH)
        padded = np.zeros((batches * WIDTH, width), np.float32)
        padded[:n] = features
        turned = np.ascontiguousarray(padded.reshape(batches, WIDTH, width).swapaxes(1, 2))
        out = np.zeros((batches, self._num_classes, WIDTH))
        room = np.empty(WIDTH, np.uint32)
        sum_of_leaves(turned.reshape(-1, WIDTH), **self._trees, reachable=room, out=out)
        return softmax(out.swapaxes(1, 2).reshape(-1, self._num_classes)[:n] + self._baseline)

    @property
    def _trained(self) -> BoolArray:
        return self._baseline > NEVER

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Trees, baseline and temperature."""
        found = {**self._trees, "leaf": self._trees["leaf"][:, _HASH]}
        trees = {name: found[name].astype(kind) for name, kind in _TYPES.items()}
        return {**trees, "baseline": self._baseline, **super().arrays()}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `Classifier.restore`; the compiled loops check nothing, so all is checked here."""
        super().restore(arrays, num_features)
        trees = {name: np.array(arrays[name]) for name in _TYPES}
        count, inner = trees["column"].size, trees["feature"].size
        shapes = {"first": (count + 1,), "column": (count,), "leaf": (count, MOST_LEAVES)}
        for name, kind in _TYPES.items():
            found, shape = trees[name], shapes.get(name, (inner,))
            if found.dtype != kind or found.shape != shape:
                wanted = f"{np.dtype(kind)} of {shape}"
                raise InputError(f"{name}: found {found.dtype} of {found.shape}, expected {wanted}")
        first = trees["first"].astype(np.int64)
        if first[0] != 0 or first[-1] != inner or (np.diff(first) < 0).any():
            raise InputError("first: found numbers that do not ascend over all nodes")
        if (trees["feature"] >= num_features).any():
            raise InputError(f"feature: found one beyond {num_features}")
        if (trees["column"] >= self._num_classes).any():
            raise InputError(f"column: found a class beyond {self._num_classes}")
        if np.isnan(trees["threshold"]).any() or not np.isfinite(trees["leaf"]).all():
            raise InputError("trees: found a threshold or leaf that is no number")
        self._trees = _wide(trees)
        self._baseline = saved(arrays, "baseline", (self._num_classes,))


def _wide(trees: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays in the types and the order of the kernel, leaves by the hash of their bits."""
    leaf = np.empty(trees["leaf"].shape)
    leaf[:, _HASH] = trees["leaf"]
    first, feature, column = (
        trees[name].astype(np.int64) for name in ("first", "feature", "column")
    )
    return {
        "first": first, "feature": feature, "threshold": trees["threshold"].astype(np.float32),
        "keep": trees["keep"].astype(np.uint32), "leaf": leaf, "column": column,
    }  # fmt: skip


def _joined(grown: list[tuple[NDArray[Any], int]]) -> dict[str, NDArray[Any]]:
    """scikit-learn's trees, each with the class whose score its leaves add to."""
    first, keep, inner = [0], list[int](), list[NDArray[Any]]()
    leaves = np.zeros((len(grown), MOST_LEAVES), np.float32)
    for b, (nodes, _) in enumerate(grown):
        order, masks, values = _walked(nodes)
        inner.append(nodes[order])
        keep += masks
        leaves[b, : len(values)] = values
        first.append(len(keep))
    exact = np.concatenate([nodes["num_threshold"] for nodes in inner] or [np.empty(0)])
    single = exact.astype(np.float32)
    below = np.nextafter(single, np.float32(-np.inf))
    none = [np.empty(0, np.int64)]
    trees = {
        "first": np.array(first),
        "column": np.array([code for _, code in grown], np.int64),
        "feature": np.concatenate([nodes["feature_idx"] for nodes in inner] or none),
        "threshold": np.where(single > exact, below, single),
        "keep": np.array(keep, np.int64),
        "leaf": leaves,
    }
    return _wide(trees)


def _walked(nodes: NDArray[Any]) -> tuple[list[int], list[int], list[float]]:
    """A tree's inner nodes from the root on, their masks, and the leaves' values, left to right."""
    inner: list[int] = []
    masks: list[int] = []
    values: list[float] = []

    def walk(node: int) -> None:
        if nodes["is_leaf"][node]:
            values.append(float(nodes["value"][node]))
            return
        place, before = len(inner), len(values)
        inner.append(node)
        masks.append(0)
        walk(int(nodes["left"][node]))
        masks[place] = 0xFFFFFFFF & ~((1 << len(values)) - (1 << before))
        walk(int(nodes["right"][node]))

    walk(0)
    return inner, masks, values


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
