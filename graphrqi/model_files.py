"""Model folders: one file, ``model.safetensors``, with the whole trained model."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
from pydantic_core import PydanticCustomError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.classify import CLASSIFIERS, Classifier
from graphrqi.classify.contract import part_of
from graphrqi.methods import METHODS, Method, Model
from graphrqi.networks.weights import SCHEMA_VERSION, load_weights, save_weights
from graphrqi.places.adaptation import Adaptation
from graphrqi.places.other_traffic import FEATURES, OtherTraffic
from graphrqi.spectrum import SOLVERS
from sim.files import whole_folder
from sim.invalid_fields import first_wrong_field

MODELS: Final = Path(__file__).parent / "models"
"""Folder of the models that ship with the package."""

FILE: Final = "model.safetensors"
"""Name of the file in a model's folder."""

KIND: Final = "classifier"
"""The kind of its weights, see `graphrqi.networks.weights`."""

_CLASSIFIER, _OTHER = "classifier", "other"
"""Parts of the arrays: the classifier's, and those of the networks for other traffic."""

_OTHER_VERSION: Final = (
    "found those of another version, expected this version's; train the model again"
)


class _Adapted(BaseModel):
    """An adaptation to a recording site, as the file stores it."""

    model_config = ConfigDict(extra="forbid")

    scale: float
    offset: tuple[float, ...]


class _About(BaseModel):
    """The header of a model's file."""

    model_config = ConfigDict(extra="forbid")

    schema_version: int
    kind: str
    method: str
    solver: str
    classes: tuple[str, ...]
    features: tuple[str, ...]
    shares: tuple[float, ...]
    card: dict[str, Any]
    network_features: tuple[str, ...] | None
    adaptation: _Adapted | None

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
        if min(found) < 0.0 or not math.isclose(sum(found), 1.0, abs_tol=1e-6):
            raise _wrong(f"found a sum of {sum(found):g} or less than 0, expected 1")
        return found

    @field_validator("network_features")
    @classmethod
    def _of_this_version(cls, found: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if found not in (None, FEATURES):
            raise _wrong(_OTHER_VERSION)
        return found


def _wrong(said: str) -> PydanticCustomError:
    return PydanticCustomError("model_file", said)


def check_model_folder(folder: Path) -> None:
    """Refuse a folder that a model must not be written to.

    Raises:
        InputError: if the folder exists, is not empty and is not a model.
    """
    if not folder.exists() or (folder / FILE).exists():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise InputError(f"{folder}: found something that is not a model, expected no such folder")


def save_model(model: Model, folder: Path) -> None:
    """Write a model folder; a model that is already there is replaced.

    Raises:
        InputError: if the folder holds something that is not a model, or JSON cannot hold the card.
    """
    check_model_folder(folder)
    adapted = None
    if model.adaptation is not None:
        adapted = _Adapted(
            scale=model.adaptation.scale, offset=tuple(model.adaptation.offset.tolist())
        )
    about = _About(
        schema_version=SCHEMA_VERSION,
        kind=KIND,
        method=model.method.name,
        solver=model.solver,
        classes=tuple(b.value for b in BEHAVIORS),
        features=model.method.observer(model.solver).feature_names,
        shares=model.shares,
        card=dict(model.card),
        network_features=None if model.other is None else FEATURES,
        adaptation=adapted,
    )
    parts = {_CLASSIFIER: model.classifier.arrays()}
    if model.other is not None:
        parts[_OTHER] = model.other.arrays()
    arrays = {f"{part}.{k}": array for part, named in parts.items() for k, array in named.items()}
    with whole_folder(folder) as partial:
        save_weights(partial / FILE, KIND, about.model_dump(), arrays)


def load_model(name_or_folder: str | Path) -> Model:
    """Load a trained model.

    Args:
        name_or_folder: a model that ships with the package ("graphrqi-plus") or a folder.

    Returns:
        The model.

    Raises:
        InputError: if the model is missing, broken, of another version or of other classes.

    Examples:
        >>> load_model("graphrqi-plus").method.name
        'graphrqi-plus'
    """
    path = _model_folder(name_or_folder) / FILE
    found, arrays = load_weights(path, KIND)
    try:
        about = _About.model_validate(found)
        method = METHODS[about.method]
        _ = SOLVERS[about.solver]  # refuses an unknown name
        if about.features != method.observer(about.solver).feature_names:
            raise InputError(f"features: {_OTHER_VERSION}")
        learned = _restored(method, part_of(arrays, _CLASSIFIER), len(about.features))
        other = None
        if about.network_features is not None:
            other = OtherTraffic.restored(part_of(arrays, _OTHER))
        adaptation = None
        if about.adaptation is not None:
            adaptation = Adaptation(about.adaptation.scale, np.array(about.adaptation.offset))
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error, _About.model_fields)}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return Model(method, about.solver, learned, about.shares, about.card, other, adaptation)


def _restored(method: Method, arrays: dict[str, NDArray[Any]], features: int) -> Classifier:
    """A method's classifier."""
    classifier = CLASSIFIERS[method.classifier](len(BEHAVIORS), **method.options)
    try:
        classifier.restore(arrays, features)
    except InputError:
        raise
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(
            f"found weights that do not load ({reason}), expected those of {method.name}"
        ) from None
    return classifier


def _model_folder(name_or_folder: str | Path) -> Path:
    """The folder of a model that ships, or a given one."""
    folder = Path(name_or_folder)
    if not folder.is_dir() and os.sep not in str(name_or_folder):
        folder = MODELS / str(name_or_folder)
    if not (folder / FILE).is_file():
        shipped = sorted(p.parent.name for p in MODELS.glob(f"*/{FILE}"))
        raise InputError(
            f"model {str(name_or_folder)!r}: found no {FILE}, expected a model folder "
            f"or one of {', '.join(shipped) or 'none shipped'}"
        )
    return folder
