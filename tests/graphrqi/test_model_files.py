"""Damaged model files: one error that names the file, whatever is wrong with them."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from graphrqi.classify import CLASSIFIERS
from graphrqi.classify.baselines import Majority
from graphrqi.methods import METHODS, Method, train
from graphrqi.model_files import FILE, KIND, load_model, save_model
from graphrqi.networks.weights import load_weights, save_weights
from graphrqi.samples import Samples

SMALL = {
    "boosted": {"rounds": 4, "min_leaf": 5},
    "forest": {"trees": 4},
    "mlp": {"hidden": (8,), "epochs": 2},
    "lstm": {"hidden": 4, "epochs": 1},
}
"""Options that keep a test short."""

pytestmark = pytest.mark.filterwarnings("ignore:Objective did not converge")

NAMES = ("boosted", "cheung", "dane", "forest", "logistic", "lstm", "majority", "svm")


def drawn(method: str, n: int, seed: int = 0, classes: int = 6) -> Samples:
    """Samples that are told apart by every feature."""
    rng = np.random.default_rng(seed)
    width = len(METHODS[method].observer("eigh").feature_names)
    codes = (np.arange(n) % classes).astype(np.int8)
    features = codes[:, None] + rng.normal(0.0, 0.3, (n, width))
    zeros, flags = np.zeros(n), np.ones(n, dtype=bool)
    numbers = np.arange(n)
    return Samples(features.astype(np.float32), codes, numbers, numbers, zeros, zeros, zeros, flags)


@pytest.fixture
def small(monkeypatch):
    for name, method in METHODS.items():
        options = SMALL.get(method.classifier, {})
        monkeypatch.setitem(METHODS, name, dataclasses.replace(method, options=options))


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    out = {}
    with pytest.MonkeyPatch.context() as patch:
        for name in NAMES:
            options = SMALL.get(METHODS[name].classifier, {})
            patch.setitem(METHODS, name, dataclasses.replace(METHODS[name], options=options))
            out[name] = tmp_path_factory.mktemp("models") / name
            save_model(train(name, drawn(name, 240), drawn(name, 60, 1), "eigh"), out[name])
    return out


def refused(folder: Path, copy: Path, change) -> None:
    shutil.copytree(folder, copy)
    about, found = load_weights(folder / FILE, KIND)
    arrays = {k.removeprefix("classifier."): v.copy() for k, v in found.items()}
    change(arrays)
    save_weights(copy / FILE, KIND, about, {f"classifier.{k}": v for k, v in arrays.items()})
    with pytest.raises(InputError, match=r"model\.safetensors: ") as caught:
        load_model(copy)
    assert "\n" not in str(caught.value)


def filled(name: str, value: float):
    return lambda arrays: arrays[name].fill(value)


def replaced(name: str, made):
    return lambda arrays: arrays.__setitem__(name, np.ascontiguousarray(made(arrays[name])))


@pytest.mark.parametrize(
    "change",
    [
        filled("feature", 60000),
        filled("column", 10**6),
        filled("first", 2**31),
        filled("first", 0),
        filled("leaf", np.nan),
        filled("threshold", np.nan),
        filled("temperature", 0.0),
        filled("temperature", np.nan),
        replaced("first", lambda a: a[::-1]),
        replaced("keep", lambda a: a[:-1]),
        replaced("keep", lambda a: a.astype(np.int64)),
        replaced("feature", lambda a: a[:, None]),
        replaced("leaf", lambda a: a.ravel()),
        replaced("leaf", lambda a: a[:, :0]),
        replaced("column", lambda a: a[:0]),
        replaced("temperature", lambda a: a[:0]),
        lambda arrays: arrays.pop("column"),
    ],
)
def test_damaged_trees_are_refused(small, folders, tmp_path, change):
    refused(folders["boosted"], tmp_path / "model", change)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"solver": "eihg"}, "unknown solver 'eihg': did you mean 'eigh'"),
        ({"method": "majorty"}, "unknown method 'majorty'"),
        ({"shares": [2.0, -1.0, 0.0, 0.0, 0.0, 0.0]}, "shares: found"),
        ({"shares": [0.5] * 6}, "shares: found"),
    ],
)
def test_damaged_descriptions_are_refused(small, folders, tmp_path, changes, said):
    shutil.copytree(folders["majority"], tmp_path / "model")
    path = tmp_path / "model" / FILE
    about, arrays = load_weights(path, KIND)
    save_weights(path, KIND, about | changes, arrays)
    with pytest.raises(InputError, match=said) as caught:
        load_model(tmp_path / "model")
    assert str(path) in str(caught.value)


def test_cards_are_valid_json(tmp_path):
    estimate = {"metric": "ece", "value": 0.5, "low": None, "high": None, "n": 3}
    training = drawn("majority", 6)
    save_model(train("majority", training, card={"score": estimate}), tmp_path / "model")
    assert load_model(tmp_path / "model").card == {"score": estimate}
    with pytest.raises(InputError, match=r"model\.safetensors: found what JSON"):
        save_model(train("majority", training, card={"score": np.nan}), tmp_path / "other")
    assert not (tmp_path / "other").exists()


class Elsewhere(Majority):
    """A classifier that is not part of the package, such as a plugin's."""


def test_models_of_methods_from_elsewhere_load_by_name(tmp_path):
    CLASSIFIERS["elsewhere"] = Elsewhere
    METHODS["plugin"] = Method("plugin", "another one", METHODS["svm"].observer, "elsewhere")
    try:
        model = train("plugin", drawn("plugin", 30), solver="eigh")
        save_model(model, tmp_path / "model")
        again = load_model(tmp_path / "model")
        assert type(again.classifier) is Elsewhere
        features = drawn("plugin", 5).features.astype(np.float64)
        np.testing.assert_array_equal(
            again.classifier.posterior(features), model.classifier.posterior(features)
        )
        refused(tmp_path / "model", tmp_path / "damaged", lambda arrays: arrays.pop("bias"))
    finally:
        del CLASSIFIERS["elsewhere"], METHODS["plugin"]
    with pytest.raises(InputError, match=r"model\.safetensors: unknown method 'plugin'"):
        load_model(tmp_path / "model")
