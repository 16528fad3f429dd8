"""What every classifier promises, for all that are registered."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from graphrqi.classify import CLASSIFIERS

SMALL: dict[str, dict[str, object]] = {
    "boosted": {"rounds": 20, "min_leaf": 5},
    "forest": {"trees": 20},
    "mlp": {"hidden": (16,), "epochs": 15, "batch": 64},
    "lstm": {"hidden": 16, "epochs": 15, "learning_rate": 0.02, "batch": 64},
}
"""Options that keep a test short."""

NAMES = sorted(CLASSIFIERS)


def blobs(
    n: int, seed: int, classes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Points around one corner per class, well apart."""
    rng = np.random.default_rng(seed)
    codes = rng.choice(np.array(classes), n).astype(np.int8)
    centres = np.random.default_rng(0).normal(0.0, 3.0, (6, 5))
    points = centres[codes] + rng.normal(size=(n, 5))
    return points.astype(np.float32).astype(np.float64), codes


@pytest.fixture(scope="module", params=NAMES)
def learned(request: pytest.FixtureRequest) -> tuple[str, object]:
    name = request.param
    classifier = CLASSIFIERS[name](6, **SMALL.get(name, {}))
    classifier.fit(*blobs(900, 1), blobs(300, 2), seed=3)
    return name, classifier


def test_rows_are_distributions(learned):
    probability = learned[1].posterior(blobs(200, 4)[0])
    assert probability.shape == (200, 6)
    assert probability.dtype == np.float64
    assert (probability >= 0).all()
    np.testing.assert_allclose(probability.sum(axis=1), 1.0, atol=1e-9)


def test_learns_what_can_be_learned(learned):
    name, classifier = learned
    features, codes = blobs(400, 5)
    right = (classifier.posterior(features).argmax(axis=1) == codes).mean()
    if name == "majority":
        assert right < 0.35
    else:
        assert right > 0.8


def test_restored_answers_are_equal(learned):
    from safetensors.numpy import load, save

    name, classifier = learned
    arrays = {k: np.ascontiguousarray(v) for k, v in classifier.arrays().items()}
    again = CLASSIFIERS[name](6, **SMALL.get(name, {}))
    again.restore(load(save(arrays)), 5)
    features = blobs(100, 8)[0]
    np.testing.assert_array_equal(again.posterior(features), classifier.posterior(features))


def test_same_seed_same_answers(learned):
    name, classifier = learned
    again = CLASSIFIERS[name](6, **SMALL.get(name, {}))
    again.fit(*blobs(900, 1), blobs(300, 2), seed=3)
    features = blobs(100, 9)[0]
    np.testing.assert_array_equal(again.posterior(features), classifier.posterior(features))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("classes", [(0, 4), (0, 2, 3)])
def test_classes_that_never_occur_are_never_answered(name, classes):
    classifier = CLASSIFIERS[name](6, **SMALL.get(name, {}))
    classifier.fit(*blobs(400, 10, classes), None, seed=0)
    features, codes = blobs(200, 11, classes)
    answer = classifier.posterior(features).argmax(axis=1)
    assert set(answer.tolist()) <= set(classes)
    if name != "majority":
        assert (answer == codes).mean() > 0.8


def test_recurrent_network_does_not_depend_on_threads():
    import torch

    before, rows = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            classifier = CLASSIFIERS["lstm"](6, hidden=64, epochs=2)
            classifier.fit(*blobs(2000, 1), None, seed=0)
            rows.append(classifier.posterior(blobs(300, 2)[0]))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    np.testing.assert_array_equal(*rows)


def test_boosted_and_forest_answer_as_those_who_grew_them():
    from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier

    features, codes = blobs(600, 12)
    asked = blobs(200, 13)[0]
    forest = CLASSIFIERS["forest"](6, trees=10)
    forest.fit(features, codes, None, seed=1)
    theirs = RandomForestClassifier(10, min_samples_leaf=8, max_features=0.1, random_state=1).fit(
        features, codes
    )
    np.testing.assert_allclose(forest.posterior(asked), theirs.predict_proba(asked), atol=1e-6)
    boosted = CLASSIFIERS["boosted"](6, rounds=10)
    boosted.fit(features, codes, None, seed=1)
    grown = HistGradientBoostingClassifier(
        max_iter=10, max_leaf_nodes=15, min_samples_leaf=40, l2_regularization=1.0,
        early_stopping=False, random_state=1,
    ).fit(features, codes)  # fmt: skip
    np.testing.assert_allclose(boosted.posterior(asked), grown.predict_proba(asked), atol=1e-6)
