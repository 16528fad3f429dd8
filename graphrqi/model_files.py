"""Model folders: one file, ``model.safetensors``, with the whole trained model."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, read_behaviors, tables_of
from graphrqi.classify import CLASSIFIERS
from graphrqi.classify.contract import part_of
from graphrqi.methods import METHODS, Model
from graphrqi.networks.weights import Arrays, restored, save_weights
from graphrqi.places.adaptation import Adaptation
from graphrqi.places.other_traffic import FEATURES, OtherTraffic
from graphrqi.spectrum import SOLVERS
from sim.files import whole_folder

MODELS: Final = Path(__file__).parent / "models"
"""Folder of the models that ship with the package."""

FILE: Final = "model.safetensors"
"""Name of the file in a model's folder."""

KIND: Final = "classifier"
"""The kind of its weights, see `graphrqi.networks.weights`."""

_CLASSIFIER, _OTHER = "classifier", "other"
"""Parts of the arrays: the classifier's, and those of the networks for other traffic."""


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
        adapted = {"scale": model.adaptation.scale, "offset": model.adaptation.offset.tolist()}
    about = {
        "method": model.method.name,
        "solver": model.solver,
        "classes": [str(behavior) for behavior in model.classes],
        "behaviors": tables_of(model.classes[len(BEHAVIORS) :]),
        "features": model.method.observer(model.solver).feature_names,
        "shares": model.shares,
        "card": dict(model.card),
        "network_features": None if model.other is None else FEATURES,
        "adaptation": adapted,
    }
    parts = {_CLASSIFIER: model.classifier.arrays()}
    if model.other is not None:
        parts[_OTHER] = model.other.arrays()
    arrays = {f"{part}.{k}": array for part, named in parts.items() for k, array in named.items()}
    with whole_folder(folder) as partial:
        save_weights(partial / FILE, KIND, about, arrays)


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
    return restored(_model_folder(name_or_folder) / FILE, KIND, _restored)


def _restored(about: dict[str, Any], arrays: Arrays) -> Model:
    """A model from its header and arrays."""
    classes = (*BEHAVIORS, *read_behaviors(about.get("behaviors")))
    if about["classes"] != [str(behavior) for behavior in classes]:
        raise InputError(f"classes: found {about['classes']}, expected {[*map(str, classes)]}")
    shares = about["shares"]
    numbers = len(shares) == len(classes) and all(isinstance(each, float) for each in shares)
    if not numbers or min(shares) < 0.0 or not math.isclose(sum(shares), 1.0, abs_tol=1e-6):
        raise InputError(f"shares: found {shares}, expected {len(classes)} that sum to 1")
    method, solver = METHODS[about["method"]], about["solver"]
    _ = SOLVERS[solver]  # refuses an unknown name
    names = list(method.observer(solver).feature_names)
    if about["features"] != names or about["network_features"] not in (None, list(FEATURES)):
        raise InputError("features: found those of another version; train the model again")
    classifier = CLASSIFIERS[method.classifier](len(classes), **method.options)
    classifier.restore(part_of(arrays, _CLASSIFIER), len(names))
    other = adaptation = None
    if about["network_features"] is not None:
        other = OtherTraffic.restored(part_of(arrays, _OTHER))
    if about["adaptation"] is not None:
        scale, offset = (np.array(about["adaptation"][name]) for name in ("scale", "offset"))
        adaptation = Adaptation(float(scale), offset.reshape(len(BEHAVIORS)))
    return Model(
        method, solver, classifier, tuple(shares), about["card"], other, adaptation, classes
    )


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
