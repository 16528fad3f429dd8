"""A perceptron in numpy, the files of trained predictors, and their numbers as trajectories.

A network gives `MODES` futures per driver, each at `KNOTS` knots in the driver's own frame: origin
at its position, x along its heading, in metres. A future is a weighted mean of the driver's anchor
trajectories plus a residual. Each future also has a probability and a spread, from which sets of a
given coverage follow. The first future is the single best guess, trained on its mean distance; the
others are trained winner-takes-all. Networks run in numpy; torch is needed for training only.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
    Rupprecht et al. (2017), "Learning in an uncertain world", ICCV (its relaxed form).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray, softmax
from graphrqi.networks.weights import Arrays, restored, save_weights
from graphrqi.predict.prediction import Prediction, coming_times
from sim.frames import PEDESTRIAN, Tracks
from sim.geometry import turned

KNOT_S: Final = 0.5
"""Time between knots, s."""

KNOTS: Final = 10
"""Number of knots: up to 5 s."""

TIME_S: Final[FloatArray] = np.arange(1, KNOTS + 1, dtype=np.float64) * KNOT_S
"""(KNOTS,) s."""

ANCHORS: Final = 5
"""Anchor trajectories per driver."""

MODES: Final = 6
"""Futures per driver: what Argoverse 2 scores."""

PER_MODE: Final = ANCHORS + 3 * KNOTS + 1
"""Numbers that a network gives per future: weights of the anchors, residuals, spreads, a score."""

LEAST_SPREAD_M = 0.05
"""Spreads are no smaller, m (lane centres are not known better)."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictorInputs:
    """Inputs of a network.

    Attributes:
        features: (n, F) numbers.
        anchors: (n, ANCHORS, KNOTS, 2) anchor trajectories in the driver's frame, m.
    """

    features: FloatArray
    anchors: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Futures:
    """A network's predicted futures of each driver, in the driver's frame.

    Attributes:
        own: (n, K, KNOTS, 2) positions at the knots, m.
        spread: (n, K, KNOTS) standard deviation of each coordinate, m.
        probability: (n, K); the first future is the likeliest.
    """

    own: FloatArray
    spread: FloatArray
    probability: FloatArray


def decode(raw: NDArray[np.floating], anchors: FloatArray, spread_scale: float) -> Futures:
    """Outputs (n, K PER_MODE) of a network as futures beside anchors (n, ANCHORS, KNOTS, 2), m.

    ``spread_scale`` makes the sets' coverage right; it is found on validation episodes.
    """
    each = raw.astype(np.float64, copy=False).reshape(len(raw), MODES, PER_MODE)
    n, ends = len(raw), ANCHORS + 2 * KNOTS
    weight = softmax(each[..., :ANCHORS])
    residual = each[..., ANCHORS:ends].reshape(n, MODES, KNOTS, 2) * TIME_S[:, None]
    blend = weight @ anchors.reshape(n, ANCHORS, 2 * KNOTS)
    spread = np.exp(np.clip(each[..., ends:-1], -6.0, 4.0)) * TIME_S * spread_scale
    probability = softmax(each[..., -1])
    probability[:, 0] = probability.max(axis=1)
    return Futures(
        blend.reshape(residual.shape) + residual,
        np.maximum(spread, LEAST_SPREAD_M),
        probability / probability.sum(axis=1, keepdims=True),
    )


def spread_out(history: Tracks, futures: Futures, steps: int) -> Prediction:
    """Futures at the knots, in each driver's frame, as positions at every step.

    Between knots positions lie on a cubic spline that starts at the present speed; after the last
    knot they go straight on. Pedestrians walk on at their present velocity.
    """
    matrix, start = _spline(steps)
    n, modes, knots = futures.spread.shape
    speed, heading = history.speed[:, -1], history.heading[:, -1]
    time_s = coming_times(steps)
    walks = history.kind == PEDESTRIAN
    ahead = turned(futures.own, heading[:, None, None])
    ahead[walks] = 0.0
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steadily = np.where(walks[:, None], time_s, start) * speed[:, None]
    begin = history.xy[:, -1, :, None] + facing[:, :, None] * steadily[:, None]
    on = (ahead.swapaxes(2, 3).reshape(-1, knots) @ matrix).reshape(n, modes, 2, steps)
    on += begin[:, None]
    xy = np.ascontiguousarray(on.swapaxes(2, 3))
    spread = (futures.spread.reshape(-1, knots) @ np.abs(matrix)).reshape(n, modes, steps)
    return Prediction(history.ids, time_s, xy, futures.probability, spread)


@functools.cache
def _spline(steps: int) -> tuple[FloatArray, FloatArray]:
    """(KNOTS, H) weights of the knots at each step and (H,) of the present speed."""
    from scipy.interpolate import CubicSpline

    at = np.arange(KNOTS + 1) * KNOT_S
    values = np.concatenate([np.zeros((1, KNOTS)), np.eye(KNOTS)])
    nothing, one = np.zeros(KNOTS), np.array([1.0])
    time_s = coming_times(steps)
    inside = np.minimum(time_s, at[-1])
    through = CubicSpline(at, values, bc_type=((1, nothing), (2, nothing)))
    starting = CubicSpline(at, np.zeros((KNOTS + 1, 1)), bc_type=((1, one), (2, 0 * one)))
    beyond = (time_s - inside)[:, None]
    matrix = through(inside) + beyond * through(inside, 1)
    return np.ascontiguousarray(matrix.T), np.asarray(
        (starting(inside) + beyond * starting(inside, 1))[:, 0]
    )


Layers = tuple[NDArray[np.float32], ...]

KIND: Final = "predictor"
"""The kind of a trained predictor's file, see `graphrqi.networks.weights`."""

WEIGHTS: Final = Path(__file__).parent / "weights"
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
            hidden = hidden @ weight
            hidden += bias
            if i < len(self.weights) - 1:  # SiLU; beyond 80 the exponential would overflow
                growth = np.minimum(-hidden, np.float32(80.0))
                np.exp(growth, out=growth)
                growth += np.float32(1.0)
                hidden /= growth
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

    def check(self, inputs: int, answers: int) -> None:
        """Refuse a network with other numbers of inputs or answers, as older ones have."""
        found = self.mean.size, self.biases[-1].size
        if found != (inputs, answers):
            raise InputError(
                f"found a network with {found[0]} inputs and {found[1]} answers, expected "
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
        spread_scale: see `decode`.
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
    return restored(
        path, KIND, lambda about, arrays: FuturesNetwork(read(arrays), spread_scale_of(about))
    )


def spread_scale_of(about: Mapping[str, Any]) -> float:
    """The scale of the spreads in a file's JSON values; it is positive."""
    scale = about["spread_scale"]
    if not 0.0 < scale < math.inf:
        raise ValueError(f"spread_scale: {scale}")
    return float(scale)
