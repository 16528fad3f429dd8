"""Methods that classify drivers, and the models that training makes of them.

A method names an observer, which turns positions into features, and a classifier. A model is a
trained method; it is saved as a folder of ``model.json`` and ``weights.safetensors``.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
from pydantic_core import PydanticCustomError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from behaviors.registry import Registry
from graphrqi.classify import Classifier, make_classifier, restore_classifier
from graphrqi.features.baseline import BaselineObserver
from graphrqi.features.driving import DrivingObserver
from graphrqi.features.embedding import EmbeddingObserver
from graphrqi.features.observer import Observer
from graphrqi.features.spectrum_observers import (
    EigenvectorObserver,
    NullObserver,
    SpectrumObserver,
)
from graphrqi.features.trajectory import TrajectoryObserver
from graphrqi.samples import Samples
from graphrqi.spectrum import SOLVERS
from sim.invalid_fields import first_wrong_field
from sim.store.atomic import whole_folder

FloatArray = NDArray[np.float64]

MAX_CARD_BYTES: Final = 2**24
"""Largest ``model.json`` that is read (our choice: 16 MiB; the shipped one has some kilobytes)."""

MAX_WEIGHTS_BYTES: Final = 2**30
"""Largest file of weights that is read (our choice: 1 GiB; the shipped one has 3 MB)."""

SCHEMA_VERSION: Final = 2
"""Version of model folders; other versions are refused."""

MOST_SEED: Final = 2**32 - 1
"""Largest seed that the generators of NumPy and scikit-learn accept."""


@dataclass(frozen=True, slots=True)
class Method:
    """A way to classify drivers.

    Attributes:
        name: its key in ``METHODS``.
        summary: one line for people.
        observer: makes an observer from a solver's name.
        classifier: a key of ``graphrqi.classify.CLASSIFIERS``.
        options: keyword options of that classifier.
    """

    name: str
    summary: str
    observer: Callable[[str], Observer]
    classifier: str
    options: Mapping[str, Any] = field(default_factory=dict)


METHODS: Final[Registry[Method]] = Registry(
    "method",
    "graphrqi.methods",
    {
        "majority": Method(
            "majority",
            "the most frequent class of the training data, without features",
            NullObserver,
            "majority",
        ),
        "graphrqi": Method(
            "graphrqi",
            "the paper: rows of the largest-end eigenvectors, perceptron, squared error",
            EigenvectorObserver,
            "mlp",
            {"loss": "squared-error", "hidden": (64, 32), "dropout": 0.0},
        ),
        "logistic": Method(
            "logistic",
            "the paper's ablation: logistic regression on the rows that graphrqi sees",
            EigenvectorObserver,
            "logistic",
        ),
        "svm": Method(
            "svm",
            "the paper's ablation: support vector machine on the rows that graphrqi sees",
            EigenvectorObserver,
            "svm",
        ),
        "lstm": Method(
            "lstm",
            "the paper's ablation: long short-term memory along the rows that graphrqi sees",
            EigenvectorObserver,
            "lstm",
        ),
        "dane": Method(
            "dane",
            "dynamic attributed network embedding (Li et al. 2017), perceptron",
            EmbeddingObserver,
            "mlp",
            {"hidden": (64, 32), "dropout": 0.0},
        ),
        "cheung": Method(
            "cheung",
            "lasso on trajectory features (Cheung et al. 2018)",
            TrajectoryObserver,
            "lasso",
        ),
        "forest": Method(
            "forest",
            "random forest on motion and interaction, without graph or inference",
            BaselineObserver,
            "forest",
        ),
        "boosted": Method(
            "boosted",
            "gradient-boosted trees on motion and interaction, without graph or inference",
            BaselineObserver,
            "boosted",
        ),
        "graphrqi-invariant": Method(
            "graphrqi-invariant",
            "the spectrum alone, independent of sign, rotation, order and size",
            SpectrumObserver,
            "mlp",
            {"hidden": (64, 32), "dropout": 0.0},
        ),
        "graphrqi-plus": Method(
            "graphrqi-plus",
            "boosted trees on spectrum, graph signals, motion, interaction and inferred drivers",
            DrivingObserver,
            "boosted",
            {"rounds": 320, "max_leaves": 31, "max_depth": 7, "feature_share": 0.15},
        ),
    },
)
"""The methods by name."""


@dataclass(frozen=True, slots=True)
class Model:
    """A trained method.

    Attributes:
        method: the method that was trained.
        solver: the eigenvalue solver that its observer uses.
        classifier: the trained classifier.
        shares: share of each behaviour among the training windows; they sum to 1.
        card: training data and scores, as JSON values.
    """

    method: Method
    solver: str
    classifier: Classifier
    shares: tuple[float, ...]
    card: Mapping[str, Any]

    def observer(self) -> Observer:
        """A fresh observer of the kind the model was trained with."""
        return self.method.observer(self.solver)

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, 6) probabilities of feature vectors (n, F)."""
        return self.classifier.posterior(features)


def train(
    method: str,
    training: Samples,
    validation: Samples | None = None,
    solver: str = "graphrqi",
    seed: int = 0,
    card: Mapping[str, Any] | None = None,
) -> Model:
    """Train a method.

    Args:
        method: a key of ``METHODS``.
        training: samples of the training episodes.
        validation: samples of other episodes, for early stopping and calibration.
        solver: a key of ``graphrqi.spectrum.SOLVERS``.
        seed: the same seed and samples give the same model.
        card: the model's card.

    Returns:
        The trained model.

    Raises:
        InputError: if there is no such method or solver, no sample, or the seed is out of range.
    """
    chosen = METHODS[method]
    _ = SOLVERS[solver]  # refuses an unknown name before anything is trained
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"seed: found {seed}, expected 0 to {MOST_SEED}")
    if not len(training):
        raise InputError("training: found no sample, expected at least one")
    classifier = make_classifier(chosen.classifier, len(BEHAVIORS), **chosen.options)
    held = None
    if validation is not None and len(validation):
        held = (validation.features.astype(np.float64), validation.codes)
    classifier.fit(training.features.astype(np.float64), training.codes, held, seed)
    count = np.bincount(training.codes, minlength=len(BEHAVIORS))
    shares = tuple((count / count.sum()).tolist())
    return Model(chosen, solver, classifier, shares, dict(card or {}))


class _ModelFile(BaseModel):
    """``model.json`` in a model folder."""

    model_config = ConfigDict(extra="forbid")

    schema_version: int
    method: str
    solver: str
    classes: tuple[str, ...]
    features: tuple[str, ...]
    shares: tuple[float, ...]
    card: dict[str, Any]

    @field_validator("schema_version")
    @classmethod
    def _of_this_version(cls, found: int) -> int:
        if found != SCHEMA_VERSION:
            raise _wrong(f"found {found}, expected {SCHEMA_VERSION}; train the model again")
        return found

    @field_validator("classes")
    @classmethod
    def _all_behaviors(cls, found: tuple[str, ...]) -> tuple[str, ...]:
        if found != tuple(BEHAVIORS):
            raise _wrong(f"found {found}, expected {tuple(map(str, BEHAVIORS))}")
        return found

    @field_validator("shares")
    @classmethod
    def _a_distribution(cls, found: tuple[float, ...]) -> tuple[float, ...]:
        if len(found) != len(BEHAVIORS):
            raise _wrong(f"found {len(found)}, expected {len(BEHAVIORS)}")
        total = sum(found)
        if min(found) < 0.0 or not math.isclose(total, 1.0, abs_tol=1e-6):
            raise _wrong(f"found a sum of {total:g} or less than 0, expected 1")
        return found


def _wrong(said: str) -> PydanticCustomError:
    return PydanticCustomError("model_file", said)


def check_model_folder(folder: Path) -> None:
    """Refuse a folder that a model must not be written to.

    Raises:
        InputError: if the folder exists, is not empty and is not a model.
    """
    if not folder.exists() or (folder / "model.json").exists():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise InputError(f"{folder}: found something that is not a model, expected no such folder")


def save_model(model: Model, folder: Path) -> None:
    """Write a model folder.

    A model that is already there is replaced; other files in its folder are kept.

    Raises:
        InputError: if the folder holds something that is not a model, or JSON cannot hold the card.
    """
    from safetensors.numpy import save

    check_model_folder(folder)
    file = _ModelFile(
        schema_version=SCHEMA_VERSION,
        method=model.method.name,
        solver=model.solver,
        classes=tuple(b.value for b in BEHAVIORS),
        features=model.observer().feature_names,
        shares=model.shares,
        card=dict(model.card),
    )
    arrays = {k: np.ascontiguousarray(v) for k, v in model.classifier.arrays().items()}
    try:
        written = json.dumps(file.model_dump(), indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{folder / 'model.json'}: card: found what JSON cannot hold ({error}), "
            "expected finite numbers, texts, lists and tables"
        ) from None
    with whole_folder(folder) as partial:
        (partial / "model.json").write_text(written)
        (partial / "weights.safetensors").write_bytes(save(arrays))


MODELS: Final = Path(__file__).parent / "models"
"""Folder of the models that ship with the package."""


def load_model(name_or_folder: str | Path) -> Model:
    """Load a trained model.

    Args:
        name_or_folder: a model that ships with the package ("graphrqi-plus") or a folder.

    Returns:
        The model.

    Raises:
        InputError: if there is no such model, or it is broken, of another version or other classes.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    folder = _model_folder(name_or_folder)
    file, method = _description(folder / "model.json")
    weights = folder / "weights.safetensors"
    if not weights.is_file() or weights.stat().st_size > MAX_WEIGHTS_BYTES:
        raise InputError(
            f"{weights}: found no file of up to {MAX_WEIGHTS_BYTES} bytes, expected weights"
        )
    try:
        arrays = load_file(weights)
        classifier = restore_classifier(
            method.classifier, len(BEHAVIORS), len(file.features), dict(method.options), arrays
        )
    except (SafetensorError, OSError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(
            f"{weights}: found weights that do not load ({reason}), expected those of {file.method}"
        ) from None
    if folder.parent != MODELS:
        _check_answers(weights, classifier, len(file.features))
    return Model(method, file.solver, classifier, file.shares, file.card)


def _check_answers(weights: Path, classifier: Classifier, features: int) -> None:
    """Refuse weights with which a classifier's answers are no probabilities."""
    probes = np.array([np.zeros(features), np.ones(features), np.full(features, -30.0)])
    with np.errstate(all="ignore"):
        answers = classifier.posterior(probes)
    if not np.isfinite(answers).all() or (np.abs(answers.sum(axis=1) - 1.0) > 1e-3).any():
        raise InputError(f"{weights}: found weights whose answers are no probabilities")


def _model_folder(name_or_folder: str | Path) -> Path:
    folder = Path(name_or_folder)
    if not folder.is_dir() and os.sep not in str(name_or_folder):
        folder = MODELS / str(name_or_folder)
    if not (folder / "model.json").is_file():
        shipped = sorted(p.parent.name for p in MODELS.glob("*/model.json"))
        raise InputError(
            f"model {str(name_or_folder)!r}: found no model.json, expected a model folder "
            f"or one of {', '.join(shipped) or 'none shipped'}"
        )
    return folder


def _description(path: Path) -> tuple[_ModelFile, Method]:
    """A checked ``model.json`` and its method."""
    size = path.stat().st_size
    if size > MAX_CARD_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_CARD_BYTES}")
    try:
        file = _ModelFile.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error, _ModelFile.model_fields)}") from None
    try:
        method = METHODS[file.method]
        _ = SOLVERS[file.solver]  # refuses an unknown name
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if file.features != method.observer(file.solver).feature_names:
        raise InputError(
            f"{path}: features: found those of another version, expected this version's; "
            "train the model again"
        )
    return file, method
