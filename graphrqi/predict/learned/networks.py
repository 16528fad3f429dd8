"""The default predictor: rollouts of what each driver is believed to be, corrected by a network.

A perceptron takes what is known of a driver (`graphrqi.predict.learned.anchors.known`) and gives
six futures. Each future is a blend of the base rollouts plus a residual, so that the network only
has to learn what the rollouts miss. The first future is the single best guess, trained on its mean
distance; the others are trained winner-takes-all to cover what else may happen. Each future also
has a spread, from which sets of a given coverage follow.

It is trained on the classifier's own posteriors, wrong ones included, with a share of uniform and
of shuffled ones: trained on true labels it would trust labels that are often wrong.

The network runs in numpy; torch is needed for training only.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
    Rupprecht et al. (2017), "Learning in an uncertain world", ICCV (its relaxed form).
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict.learned import decode_kernel
from graphrqi.predict.learned.anchors import (
    BASES,
    KNOT_S,
    KNOTS,
    TIME_S,
    PredictorInputs,
    known,
    unlabelled,
)
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.rollout.following import shuffled_posterior, true_behavior
from graphrqi.predict.scene.scene import Scene
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]

Predictor = Callable[[Scene, Posterior], Prediction]

MODES: Final = 6
"""Futures per driver: what Argoverse 2 scores."""

PER_MODE: Final = len(BASES) + 3 * KNOTS + 1
"""Numbers the network gives per future: weights of the bases, residual, spreads, one score."""

LEAST_SPREAD_M: Final = 0.05
"""Spreads are no smaller, m (our choice: lane centres are not known better)."""

WEIGHTS, MLP_WEIGHTS = "graphrqi-predict.safetensors", "mlp.safetensors"
"""The trained networks that ship beside this module."""

SCHEMA_VERSION: Final = 1


@dataclass(frozen=True, slots=True)
class Futures:
    """What a learned predictor says of each driver, in the driver's frame.

    Attributes:
        own: (n, K, KNOTS, 2) places at the knots, m.
        spread: (n, K, KNOTS) standard deviation of each coordinate, m.
        probability: (n, K); the first future is the likeliest.
    """

    own: FloatArray
    spread: FloatArray
    probability: FloatArray


def decode(raw: NDArray[np.floating], bases: FloatArray, spread_scale: float) -> Futures:
    """The network's numbers as futures.

    Args:
        raw: (n, K PER_MODE) outputs.
        bases: (n, B, KNOTS, 2) rollouts, m.
        spread_scale: factor that makes the sets' coverage right, found on validation episodes.

    Returns:
        The futures.
    """
    each = raw.reshape(len(raw), MODES, PER_MODE)
    return Futures(*decode_kernel.decode(each, bases, TIME_S, spread_scale, LEAST_SPREAD_M))


@dataclass(frozen=True, slots=True, eq=False)
class Perceptron:
    """A trained network.

    Attributes:
        mean: (F,) of the training inputs.
        scale: (F,) their standard deviations.
        weights: one (in, out) float32 matrix per layer.
        biases: one (out,) float32 vector per layer.
        spread_scale: see `decode`.
    """

    mean: FloatArray
    scale: FloatArray
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    spread_scale: float

    def __call__(self, data: PredictorInputs) -> Futures:
        """The futures of every row."""
        hidden = np.clip((data.inputs - self.mean) / self.scale, -8.0, 8.0).astype(np.float32)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = hidden @ weight
            hidden += bias
            if i < last:
                hidden /= _one_and_exp(-hidden)  # SiLU
        return decode(hidden, data.bases, self.spread_scale)

    def arrays(self) -> dict[str, NDArray[np.floating]]:
        """Everything that is saved, by name."""
        found: dict[str, NDArray[np.floating]] = {"mean": self.mean, "scale": self.scale}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            found |= {f"weight_{i}": weight, f"bias_{i}": bias}
        return found


def _one_and_exp(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 + exp(x), written over x; beyond 80 the exponential would overflow."""
    np.minimum(x, np.float32(80.0), out=x)
    np.exp(x, out=x)
    x += np.float32(1.0)
    return x


def save_network(network: Perceptron, path: Path, card: dict[str, Any]) -> None:
    """Write a network with its card (data, split, scores) in the file's metadata."""
    from safetensors.numpy import save_file

    arrays = {k: np.ascontiguousarray(v, np.float32) for k, v in network.arrays().items()}
    about = {"schema_version": SCHEMA_VERSION, "spread_scale": network.spread_scale, "card": card}
    save_file(arrays, path, {"about": json.dumps(about, sort_keys=True)})


def load_network(path: Path) -> Perceptron:
    """Read a network.

    Raises:
        InputError: if the file is missing, broken or newer than this version reads.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "np") as file:
            about = json.loads((file.metadata() or {})["about"])
            if about["schema_version"] != SCHEMA_VERSION:
                raise InputError(
                    f"{path}: schema_version: found {about['schema_version']}, "
                    f"expected {SCHEMA_VERSION}"
                )
            layers = sum(name.startswith("weight_") for name in file.keys())  # noqa: SIM118
            arrays = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118
            return Perceptron(
                arrays["mean"].astype(np.float64),
                arrays["scale"].astype(np.float64),
                tuple(arrays[f"weight_{i}"] for i in range(layers)),
                tuple(arrays[f"bias_{i}"] for i in range(layers)),
                float(about["spread_scale"]),
            )
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected a trained predictor") from None
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: expected a trained predictor, found: {error}") from None


@functools.cache
def shipped_network(name: str) -> Perceptron:
    """A network that ships in the package, by the name of its file."""
    shipped_file = resources.files("graphrqi.predict").joinpath("weights", name)
    with resources.as_file(shipped_file) as path:
        return load_network(path)


class FuturesModel(Protocol):
    """Anything that turns what is known of drivers into futures."""

    def __call__(self, data: PredictorInputs) -> Futures:
        """The futures of every row."""
        ...


def on_known_roads(predictor: Predictor) -> Predictor:
    """A learned predictor that takes a road whose limits are unknown for no road at all.

    Such a road is a recording's map: lanes without limits, lights and priority. The networks were
    trained where all of these are known, and take who stands at a light or is parked for somebody
    about to drive off.

    Args:
        predictor: what foresees on known roads.

    Returns:
        The same there; `graphrqi.predict.map_free.predictor.predict_unmapped` elsewhere.
    """

    @functools.wraps(predictor)
    def foresee(scene: Scene, posterior: Posterior) -> Prediction:
        if np.isnan(scene.graph.limit[scene.graph.drivable]).any():
            from graphrqi.predict.map_free.predictor import (
                predict_unmapped,  # it needs this module, too
            )

            return predict_unmapped(scene.history, scene.steps * STEP_S, "graphrqi-predict")
        return predictor(scene, posterior)

    return foresee


@on_known_roads
def graphrqi_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """Believed rollouts corrected by the shipped network: the best predictor here."""
    data = known(scene, posterior.of(scene.ids), default_table())
    return to_prediction(scene, shipped_network(WEIGHTS)(data))


@on_known_roads
def mlp(scene: Scene, posterior: Posterior) -> Prediction:
    """A perceptron with the inputs, data and budget of the label-free ``lstm``: its measure."""
    return to_prediction(scene, shipped_network(MLP_WEIGHTS)(unlabelled(scene)))


def to_prediction(scene: Scene, futures: Futures) -> Prediction:
    """A scene's futures at the knots as places at every step; see `spread_out`."""
    return spread_out(scene.history, futures, scene.steps)


def spread_out(history: Tracks, futures: Futures, steps: int) -> Prediction:
    """Futures at the knots, in each driver's frame, as places at every step.

    Between knots places lie on a cubic spline that starts at the present speed; after the last
    knot they go straight on. Pedestrians walk on as they do.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        futures: theirs.
        steps: how many, `STEP_S` apart.
    """
    matrix, start = _spline(steps)
    # copies: what is read-only only sometimes is compiled for twice
    now, speed, heading = (x[:, -1].copy() for x in (history.xy, history.speed, history.heading))
    xy = decode_kernel.every_place(
        futures.own, matrix, start, speed, heading, now, history.kind == PEDESTRIAN, STEP_S
    )
    time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
    n, modes, knots = futures.spread.shape
    spread = (futures.spread.reshape(-1, knots) @ np.abs(matrix)).reshape(n, modes, steps)
    return Prediction(history.ids, time_s, xy, futures.probability, spread)


@functools.cache
def _spline(steps: int) -> tuple[FloatArray, FloatArray]:
    """(KNOTS, H) weights of the knots at each step and (H,) of the present speed."""
    from scipy.interpolate import CubicSpline

    at = np.arange(KNOTS + 1) * KNOT_S
    values = np.concatenate([np.zeros((1, KNOTS)), np.eye(KNOTS)])
    nothing, one = np.zeros(KNOTS), np.array([1.0])
    time_s = np.arange(1, steps + 1) * STEP_S
    inside = np.minimum(time_s, at[-1])
    through = CubicSpline(at, values, bc_type=((1, nothing), (2, nothing)))
    starting = CubicSpline(at, np.zeros((KNOTS + 1, 1)), bc_type=((1, one), (2, 0 * one)))
    beyond = (time_s - inside)[:, None]
    matrix = through(inside) + beyond * through(inside, 1)
    return np.ascontiguousarray(matrix.T), np.asarray(
        (starting(inside) + beyond * starting(inside, 1))[:, 0]
    )


def unlabelled_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """`graphrqi_predict` told nothing of who drives how: what the labels are measured against."""
    nothing = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
    return graphrqi_predict(scene, nothing)


def oracle_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """`graphrqi_predict` told every driver's true behaviour.

    Raises:
        InputError: if the history carries no labels.
    """
    return graphrqi_predict(scene, Posterior(scene.ids, true_behavior(scene)))


def shuffled_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """`graphrqi_predict` told other drivers' behaviours: how far wrong labels mislead it."""
    return graphrqi_predict(scene, shuffled_posterior(scene, posterior))
