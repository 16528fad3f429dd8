"""Model folders: ``model.json`` and ``weights.safetensors``.

What a model knows of other traffic lies in the folder ``other_traffic`` within: ``networks.json``
and another ``weights.safetensors``; what it learned at a place, in ``adaptation.json``.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
from pydantic_core import PydanticCustomError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.adaptation import Adaptation
from graphrqi.classify import Classifier, restore_classifier
from graphrqi.features.relative.observer import RelativeObserver
from graphrqi.methods import METHODS, Method, Model
from graphrqi.other_traffic import OtherTraffic
from graphrqi.spectrum import SOLVERS
from sim.files import whole_folder
from sim.invalid_fields import first_wrong_field

MAX_CARD_BYTES: Final = 2**24
"""Largest ``model.json`` that is read (16 MiB; the shipped one has some kilobytes)."""

MAX_WEIGHTS_BYTES: Final = 2**30
"""Largest file of weights that is read (1 GiB; the shipped one has 3 MB)."""

SCHEMA_VERSION: Final = 2
"""Version of model folders; other versions are refused."""

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]

_OTHER_VERSION: Final = (
    "found those of another version, expected this version's; train the model again"
)

OTHER_TRAFFIC: Final = "other_traffic"
"""Folder, within a model's, of what it knows of foreign traffic."""

ADAPTATION: Final = "adaptation.json"
"""File, within a model's folder, of what was learned at a place."""


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

    A model that is already there is replaced, with what it had learned for other traffic and
    its adaptation; other files in its folder are kept.

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
        features=model.method.observer(model.solver).feature_names,
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
    with whole_folder(folder, outdated=(OTHER_TRAFFIC, ADAPTATION)) as partial:
        (partial / "model.json").write_text(written)
        (partial / "weights.safetensors").write_bytes(save(arrays))
        if model.other is not None:
            _save_other_traffic(model.other, partial / OTHER_TRAFFIC)
        if model.adaptation is not None:
            adapted = _AdaptationFile(
                scale=model.adaptation.scale, offset=tuple(model.adaptation.offset.tolist())
            )
            (partial / ADAPTATION).write_text(adapted.model_dump_json(indent=1) + "\n")


class _AdaptationFile(BaseModel):
    """``adaptation.json`` in a model folder."""

    model_config = ConfigDict(extra="forbid")

    scale: float
    offset: tuple[float, ...]


def _load_adaptation(path: Path) -> Adaptation | None:
    """The adaptation in a file; None if there is no such file."""
    if not path.exists():
        return None
    try:
        file = _AdaptationFile.model_validate_json(_read_small(path))
        return Adaptation(file.scale, np.array(file.offset))
    except ValidationError as error:
        fields = _AdaptationFile.model_fields
        raise InputError(f"{path}: {first_wrong_field(error, fields)}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _save_other_traffic(other: OtherTraffic, folder: Path) -> None:
    from safetensors.numpy import save

    folder.mkdir()
    arrays = {k: np.ascontiguousarray(v) for k, v in other.arrays().items()}
    described = {
        "schema_version": SCHEMA_VERSION,
        "features": RelativeObserver.feature_names,
        "card": dict(other.card),
    }
    written = json.dumps(described, indent=1, allow_nan=False) + "\n"
    (folder / "networks.json").write_text(written)
    (folder / "weights.safetensors").write_bytes(save(arrays))


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
    folder = _model_folder(name_or_folder)
    file, method = _description(folder / "model.json")

    def classifier(arrays: Arrays) -> Classifier:
        return restore_classifier(
            method.classifier, len(BEHAVIORS), len(file.features), dict(method.options), arrays
        )

    weights = folder / "weights.safetensors"
    learned = _restored(weights, classifier, file.method)
    if folder.parent != MODELS:
        _check_answers(weights, learned, len(file.features))
    other = None
    if (folder / OTHER_TRAFFIC).is_dir():
        other = _load_other_traffic(folder / OTHER_TRAFFIC)
    adaptation = _load_adaptation(folder / ADAPTATION)
    return Model(method, file.solver, learned, file.shares, file.card, other, adaptation)


def _restored(weights: Path, restore: Callable[[Arrays], T], expected: str) -> T:
    """What saved weights hold.

    Raises:
        InputError: if they do not load; the message names the file.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    if not weights.is_file() or weights.stat().st_size > MAX_WEIGHTS_BYTES:
        raise InputError(
            f"{weights}: found no file of up to {MAX_WEIGHTS_BYTES} bytes, expected weights"
        )
    try:
        return restore(load_file(weights))
    except (SafetensorError, OSError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(
            f"{weights}: found weights that do not load ({reason}), expected those of {expected}"
        ) from None


def _check_answers(weights: Path, classifier: Classifier, features: int) -> None:
    """Refuse weights with which a classifier's answers are no probabilities."""
    probes = np.array([np.zeros(features), np.ones(features), np.full(features, -30.0)])
    with np.errstate(all="ignore"):
        answers = classifier.posterior(probes)
    if not np.isfinite(answers).all() or (np.abs(answers.sum(axis=1) - 1.0) > 1e-3).any():
        raise InputError(f"{weights}: found weights whose answers are no probabilities")


def _read_small(path: Path) -> bytes:
    """The bytes of a description.

    Raises:
        InputError: if it is no file, or larger than a description can be.
    """
    if not path.is_file() or path.stat().st_size > MAX_CARD_BYTES:
        raise InputError(f"{path}: found no file of up to {MAX_CARD_BYTES} bytes, expected one")
    return path.read_bytes()


class _NetworksFile(BaseModel):
    """``networks.json`` in the folder within a model's."""

    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[2]
    features: tuple[str, ...]
    card: dict[str, Any]


def _load_other_traffic(folder: Path) -> OtherTraffic:
    path = folder / "networks.json"
    try:
        file = _NetworksFile.model_validate_json(_read_small(path))
    except ValidationError as error:
        fields = _NetworksFile.model_fields
        raise InputError(f"{path}: {first_wrong_field(error, fields)}") from None
    if file.features != RelativeObserver.feature_names:
        raise InputError(f"{path}: features: {_OTHER_VERSION}")
    return _restored(
        folder / "weights.safetensors",
        lambda arrays: OtherTraffic.restored(arrays, file.card),
        "other traffic",
    )


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
    try:
        file = _ModelFile.model_validate_json(_read_small(path))
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error, _ModelFile.model_fields)}") from None
    try:
        method = METHODS[file.method]
        _ = SOLVERS[file.solver]  # refuses an unknown name
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if file.features != method.observer(file.solver).feature_names:
        raise InputError(f"{path}: features: {_OTHER_VERSION}")
    return file, method
