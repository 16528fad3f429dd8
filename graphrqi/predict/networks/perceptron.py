"""A perceptron that gives futures, and the files of trained networks.

The first future is the single best guess, trained on its mean distance; the others are trained
winner-takes-all. The network runs in numpy; torch is needed for training only.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
    Rupprecht et al. (2017), "Learning in an uncertain world", ICCV (its relaxed form).
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.networks.futures import Futures, PredictorInputs, decode

FloatArray = NDArray[np.float64]

Layers = tuple[NDArray[np.float32], ...]

LayerArrays = tuple[FloatArray, FloatArray, Layers, Layers]
"""Mean, scale, weights and biases of a network."""

SCHEMA_VERSION: Final = 1


@dataclass(frozen=True, slots=True, eq=False)
class Perceptron:
    """A trained network.

    Attributes:
        mean: (F,) of the features.
        scale: (F,) their standard deviations.
        weights: an (in, out) matrix per layer.
        biases: an (out,) vector per layer.
        spread_scale: see `graphrqi.predict.networks.futures.decode`.
    """

    mean: FloatArray
    scale: FloatArray
    weights: Layers
    biases: Layers
    spread_scale: float

    def __call__(self, data: PredictorInputs) -> Futures:
        """The futures of every row."""
        features = standardized(data.features, self.mean, self.scale)
        raw = through_layers(features, self.weights, self.biases)
        return decode(raw, data.anchors, self.spread_scale)

    def save(self, path: Path, card: dict[str, Any]) -> None:
        """Write the network with its card (data, split, scores) in the file's metadata."""
        save_layers(self, path, about(self.spread_scale, card))


class Layered(Protocol):
    """A network of fully connected layers: inputs' means and scales, weights and biases."""

    @property
    def mean(self) -> FloatArray:
        """(F,) of the training features."""

    @property
    def scale(self) -> FloatArray:
        """(F,) their standard deviations."""

    @property
    def weights(self) -> Layers:
        """One (in, out) float32 matrix per layer."""

    @property
    def biases(self) -> Layers:
        """One (out,) float32 vector per layer."""


def save_layers(
    network: Layered, path: Path, metadata: dict[str, str], **others: Layered | None
) -> None:
    """Write a network's arrays in single precision, with the file's metadata.

    Args:
        network: what is written.
        path: the file.
        metadata: of the file.
        others: networks written into the same file, by name; None is left out.
    """
    from safetensors.numpy import save

    arrays: dict[str, NDArray[np.floating]] = {}
    for prefix, one in {"": network, **{f"{name}_": one for name, one in others.items()}}.items():
        if one is None:
            continue
        arrays |= {f"{prefix}mean": one.mean, f"{prefix}scale": one.scale}
        for i, (weight, bias) in enumerate(zip(one.weights, one.biases, strict=True)):
            arrays |= {f"{prefix}weight_{i}": weight, f"{prefix}bias_{i}": bias}
    single = {k: np.ascontiguousarray(v, np.float32) for k, v in arrays.items()}
    path.write_bytes(save(single, metadata))  # their save_file writes owner-only files


def read_layers(path: Path) -> tuple[LayerArrays, dict[str, Any]]:
    """The network's arrays and the metadata from a file of `save_layers`.

    Raises:
        InputError: if the file is missing, broken, of another network or newer than this version
            reads.
    """
    arrays, content = read_network(path, "np")
    return layers_in(path, arrays), content


def layers_in(path: Path, arrays: dict[str, Any], name: str = "") -> LayerArrays:
    """Mean, scale, weights and biases of the network of this name among a file's arrays.

    Raises:
        InputError: if one is missing.
    """
    prefix = f"{name}_" if name else ""
    layers = sum(key.startswith(f"{prefix}weight_") for key in arrays)
    try:
        return (
            arrays[f"{prefix}mean"].astype(np.float64),
            arrays[f"{prefix}scale"].astype(np.float64),
            tuple(arrays[f"{prefix}weight_{i}"] for i in range(layers)),
            tuple(arrays[f"{prefix}bias_{i}"] for i in range(layers)),
        )
    except KeyError as error:
        raise InputError(f"{path}: expected a trained predictor, found: {error}") from None


def standardized(
    features: NDArray[Any], mean: FloatArray, scale: FloatArray, most: float = 8.0
) -> NDArray[np.float32]:
    """(n, F) features as a network takes them; outliers are clipped at ``most`` deviations."""
    return np.clip((features - mean) / scale, -most, most).astype(np.float32)


def through_layers(
    features: NDArray[np.float32], weights: Layers, biases: Layers
) -> NDArray[np.float32]:
    """(n, out) what layers with SiLU between them make of standardised features (n, in)."""
    hidden = features
    last = len(weights) - 1
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        hidden = hidden @ weight
        hidden += bias
        if i < last:
            hidden /= _one_and_exp(-hidden)  # SiLU
    return hidden


def _one_and_exp(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 + exp(x), written over x; beyond 80 the exponential would overflow."""
    np.minimum(x, np.float32(80.0), out=x)
    np.exp(x, out=x)
    x += np.float32(1.0)
    return x


def about(spread_scale: float, card: dict[str, Any], **more: Any) -> dict[str, str]:
    """The metadata of a network's file."""
    content = {"schema_version": SCHEMA_VERSION, "spread_scale": spread_scale, "card": card, **more}
    return {"about": json.dumps(content, sort_keys=True)}


def read_network(path: Path, framework: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The arrays and the metadata in a network's file; its ``spread_scale`` is a usual number.

    Args:
        path: the file.
        framework: ``np`` or ``pt``: whose arrays are wanted.

    Raises:
        InputError: if the file is missing, broken or newer than this version reads.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a trained predictor")
    try:
        with safe_open(path, framework) as file:
            content = json.loads((file.metadata() or {})["about"])
            if content["schema_version"] != SCHEMA_VERSION:
                raise InputError(
                    f"{path}: schema_version: found {content['schema_version']}, "
                    f"expected {SCHEMA_VERSION}"
                )
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            content["spread_scale"] = spread_scale = float(content["spread_scale"])
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected a trained predictor") from None
    except InputError:
        raise
    except (SafetensorError, LookupError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: expected a trained predictor, found: {error}") from None
    if not 0 < spread_scale < 1e6:
        raise InputError(f"{path}: spread_scale: found {spread_scale:g}, expected a usual number")
    for name, array in arrays.items():
        if not bool((abs(array) < float("inf")).all()):
            raise InputError(f"{path}: {name}: found numbers that are not finite")
    return arrays, content


def load_perceptron(path: Path) -> Perceptron:
    """Read a perceptron.

    Raises:
        InputError: if the file is missing, broken, of another network or newer than this version
            reads.
    """
    layers, content = read_layers(path)
    return Perceptron(*layers, content["spread_scale"])


def weights_file(name: str) -> Any:
    """A context that gives the path of a file of weights that ships in the package."""
    return resources.as_file(resources.files("graphrqi.predict").joinpath("weights", name))


@functools.cache
def shipped_perceptron(name: str) -> Perceptron:
    """A perceptron that ships in the package, by the name of its file."""
    with weights_file(name) as path:
        return load_perceptron(path)
