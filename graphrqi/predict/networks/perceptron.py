"""A perceptron in numpy, and the files of trained predictors.

The first future is the single best guess, trained on its mean distance; the others are trained
winner-takes-all. The network runs in numpy; torch is needed for training only.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
    Rupprecht et al. (2017), "Learning in an uncertain world", ICCV (its relaxed form).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray
from graphrqi.networks.weights import load_weights, save_weights
from graphrqi.predict.networks.futures import Futures, PredictorInputs, decode

Layers = tuple[NDArray[np.float32], ...]
Arrays = Mapping[str, NDArray[Any]]

KIND: Final = "predictor"
"""The kind of a trained predictor's file, see `graphrqi.networks.weights`."""

WEIGHTS: Final = Path(__file__).parent.parent / "weights"
"""The folder of the weights that ship in the package."""

OUTLIER: Final = 8.0
"""Standardised features are clipped here."""


@dataclass(frozen=True, slots=True, eq=False)
class Perceptron:
    """Fully connected layers with SiLU between them.

    Attributes:
        mean: (F,) of the training features.
        scale: (F,) their standard deviations.
        weights: an (in, out) float32 matrix per layer.
        biases: an (out,) float32 vector per layer.
        most: standardised features are clipped here.
    """

    mean: FloatArray
    scale: FloatArray
    weights: Layers
    biases: Layers
    most: float = OUTLIER

    def __call__(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """(n, out) raw numbers of features (n, F)."""
        return self.through(standardized(features, self.mean, self.scale, self.most))

    def through(self, hidden: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, out) raw numbers of standardised features (n, F)."""
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = hidden @ weight + bias
            if i < len(self.weights) - 1:  # SiLU; beyond 80 the exponential would overflow
                hidden /= np.float32(1.0) + np.exp(np.minimum(-hidden, np.float32(80.0)))
        return hidden

    def arrays(self, prefix: str = "") -> dict[str, NDArray[np.float32]]:
        """The arrays of a file, in single precision."""
        found: dict[str, NDArray[np.floating]] = {"mean": self.mean, "scale": self.scale}
        found |= {f"weight_{i}": weight for i, weight in enumerate(self.weights)}
        found |= {f"bias_{i}": bias for i, bias in enumerate(self.biases)}
        return {prefix + name: array.astype(np.float32) for name, array in found.items()}

    @classmethod
    def read(cls, arrays: Arrays, prefix: str = "", most: float = OUTLIER) -> Perceptron:
        """The network among a file's arrays."""
        layers = range(sum(name.startswith(f"{prefix}weight_") for name in arrays))
        return cls(
            arrays[f"{prefix}mean"].astype(np.float64),
            arrays[f"{prefix}scale"].astype(np.float64),
            tuple(arrays[f"{prefix}weight_{i}"] for i in layers),
            tuple(arrays[f"{prefix}bias_{i}"] for i in layers),
            most,
        )

    def check(self, path: Path, inputs: int, answers: int) -> None:
        """Refuse a network with other numbers of inputs or answers, as older ones have."""
        found = self.mean.size, self.biases[-1].size
        if found != (inputs, answers):
            raise InputError(
                f"{path}: found a network with {found[0]} inputs and {found[1]} answers, expected "
                f"{inputs} and {answers}: train it anew"
            )


def standardized(
    features: NDArray[Any], mean: FloatArray, scale: FloatArray, most: float = OUTLIER
) -> NDArray[np.float32]:
    """(n, F) features as a network takes them; outliers are clipped at ``most`` deviations."""
    return np.clip((features - mean) / scale, -most, most).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class FuturesNetwork:
    """A trained network that gives futures.

    Attributes:
        network: gives (n, MODES PER_MODE) raw numbers of features (n, F); its ``arrays`` are saved.
        spread_scale: see `graphrqi.predict.networks.futures.decode`.
    """

    network: Any
    spread_scale: float

    def __call__(self, data: PredictorInputs) -> Futures:
        """The futures of every row."""
        return decode(self.network(data.features), data.anchors, self.spread_scale)

    def save(self, path: Path, card: dict[str, Any]) -> None:
        """Write the network with its card (data, split, scores)."""
        about = {"spread_scale": self.spread_scale, "card": card}
        save_weights(path, KIND, about, self.network.arrays())


def load_futures_network(path: Path, read: Callable[[Arrays], Any]) -> FuturesNetwork:
    """A network from a file, whose arrays ``read`` understands."""
    about, arrays = load_predictor(path)
    with refused(path):
        return FuturesNetwork(read(arrays), about["spread_scale"])


def load_predictor(path: Path) -> tuple[dict[str, Any], Arrays]:
    """The JSON values and the arrays of a predictor's file; `InputError` if it is no such file."""
    about, arrays = load_weights(path, KIND)
    with refused(path):
        if not 0.0 < about["spread_scale"] < math.inf:
            raise ValueError(f"spread_scale: {about['spread_scale']}")
    return about, arrays


@contextmanager
def refused(path: Path) -> Iterator[None]:
    """Report content that is missing or of another kind as of a file."""
    try:
        yield
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: found {reason}, expected a trained predictor") from None
