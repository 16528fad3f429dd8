"""Model folders: one file, ``model.safetensors``, with the whole trained model."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.classify import CLASSIFIERS, Classifier
from graphrqi.classify.contract import part_of
from graphrqi.methods import METHODS, Method, Model
from graphrqi.networks.weights import load_weights, save_weights
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

_OTHER_VERSION: Final = (
    "found those of another version, expected this version's; train the model again"
)


_ABOUT: Final[dict[str, type | tuple[type, ...]]] = {
    "method": str, "solver": str, "classes": list, "features": list, "shares": list, "card": dict,
    "network_features": (list, type(None)), "adaptation": (dict, type(None)),
}  # fmt: skip
"""Fields of a file's header, and their types."""


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
        "classes": [str(behavior) for behavior in BEHAVIORS],
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
    path = _model_folder(name_or_folder) / FILE
    found, arrays = load_weights(path, KIND)
    try:
        _check_header(found)
        method = METHODS[found["method"]]
        _ = SOLVERS[found["solver"]]  # refuses an unknown name
        names = method.observer(found["solver"]).feature_names
        if found["features"] != list(names):
            raise InputError(f"features: {_OTHER_VERSION}")
        learned = _restored(method, part_of(arrays, _CLASSIFIER), len(names))
        other = adaptation = None
        if found["network_features"] is not None:
            other = OtherTraffic.restored(part_of(arrays, _OTHER))
        if found["adaptation"] is not None:
            adaptation = Adaptation(**found["adaptation"])
    except TypeError:
        raise InputError(f"{path}: adaptation: found no scale and offset, expected them") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    shares = tuple(found["shares"])
    return Model(method, found["solver"], learned, shares, found["card"], other, adaptation)


def _check_header(about: dict[str, Any]) -> None:
    """Refuse a header that is not of this version's models.

    Raises:
        InputError: naming the field.
    """
    for name, kind in _ABOUT.items():
        if not isinstance(about.get(name, ...), kind):
            raise InputError(f"{name}: found {about.get(name)!r:.60}, expected another type")
    if about["classes"] != list(BEHAVIORS):
        raise InputError(f"classes: found {about['classes']}, expected {list(map(str, BEHAVIORS))}")
    shares = about["shares"]
    numbers = len(shares) == len(BEHAVIORS) and all(isinstance(each, float) for each in shares)
    if not numbers or min(shares) < 0.0 or not math.isclose(sum(shares), 1.0, abs_tol=1e-6):
        raise InputError(f"shares: found {shares}, expected {len(BEHAVIORS)} that sum to 1")
    if about["network_features"] not in (None, list(FEATURES)):
        raise InputError(f"network_features: {_OTHER_VERSION}")


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
