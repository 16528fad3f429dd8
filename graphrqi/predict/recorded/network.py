"""The networks that predict recordings, in numpy, and their file.

A small perceptron gives `MODES` futures per agent. Each is the base plus a polynomial of time along
each axis of the agent's frame, times `scale_of` its speed; it begins with the base's velocity. The
first is the single best guess; the correction counts as much as it earned on recordings that were
left out, by speed, noise and time. The others cover what else may happen. Outside the range of
speed, noise and rate that it was trained on, the futures come down to the base.

Where there is a map, a second perceptron looks at each path that an agent may follow
(`graphrqi.predict.recorded.lanes_ahead`), and once at leaving them all. It gives each path a
score and `PER_PATH` futures, which `graphrqi.predict.recorded.along_lanes` joins with the others.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.predict.networks.futures import TIME_S, Futures
from graphrqi.predict.networks.perceptron import (
    LayerArrays,
    Layers,
    about,
    layers_in,
    read_network,
    save_layers,
    standardized,
    through_layers,
    weights_file,
)
from graphrqi.predict.recorded.features import feature_count, scale_of
from graphrqi.predict.recorded.lanes_ahead import MOST, PATH_FEATURES, LanesAhead
from graphrqi.predict.recorded.motion import Motion

FloatArray = NDArray[np.float64]

MODES: Final = 6
"""Futures per agent: what Argoverse 2 scores."""

POWERS: Final = 4
"""Powers of time, from 2 on, in the polynomial of each axis: all futures begin with the base."""

HORIZON_S: Final = 5.0
"""Horizon that the network was trained for, s; its corrections stay constant after it."""

PER_MODE: Final = 2 * POWERS + 3
"""Numbers per future: coefficients, two for the spread, a score."""

PER_PATH: Final = 6
"""Futures along each path: the best guess, and five that cover what else may happen."""

PATH_OUTPUTS: Final = PER_PATH * PER_MODE + 1
"""Numbers for each path: its futures, and its score."""

LIKELIEST: Final = 1.05
"""The first future is as likely as this many times the likeliest other one."""

CLIP: Final = 3.0
"""Standardised inputs are clipped here: larger ones mislead the network at places that it was not
trained on."""

LEAST_SPREAD_M: Final = 0.05
"""Spreads are no smaller, m."""

SPEEDS_MPS: Final = (0.5, 5.0, 12.0, 20.0)
"""Where the classes of speed begin after the first, that of who stands, m/s."""

NOISY_M: Final = 0.05
"""Positions with more noise are noisy, m."""

EARNED: Final = (2, len(SPEEDS_MPS) + 1, 2, TIME_S.size)
"""Shape of the shares that corrections have earned."""

MARGIN: Final = 0.15
"""Beyond the trained range the network gives way to the base over this share of the range's end."""


LEAST: Final = 1e-9
"""The trained range reaches at least this far (training recordings without noise would let it end
at 0)."""


@dataclass(frozen=True, slots=True)
class TrainedRange:
    """What the network was trained on.

    Attributes:
        speed_mps: highest speed, m/s.
        noise_m: largest noise of positions, m.
        noise_mps: largest noise of recorded velocities, m/s.
        step_s: longest time between frames, s.
    """

    speed_mps: float
    noise_m: float
    noise_mps: float
    step_s: float

    def trust(
        self, speed: FloatArray, noise_m: FloatArray, noise_mps: FloatArray, step_s: float
    ) -> FloatArray:
        """(n,) 1 inside the range, 0 beyond its margin."""
        out = np.ones_like(speed)
        for value, most in (
            (speed, self.speed_mps), (noise_m, self.noise_m), (noise_mps, self.noise_mps),
            (np.full_like(speed, step_s), self.step_s),
        ):  # fmt: skip
            out = np.minimum(
                out, np.clip(1.0 - (value / max(most, LEAST) - 1.0) / MARGIN, 0.0, 1.0)
            )
        return out


@dataclass(frozen=True, slots=True, eq=False)
class LaneNetwork:
    """The trained network that looks at paths along lanes.

    Attributes:
        mean: (F + PATH_FEATURES,) of the training inputs: the agent's features, then the path's.
        scale: (F + PATH_FEATURES,) their standard deviations.
        weights: one (in, out) float32 matrix per layer.
        biases: one (out,) float32 vector per layer.
    """

    mean: FloatArray
    scale: FloatArray
    weights: Layers
    biases: Layers

    def __call__(self, features: NDArray[np.floating], ahead: LanesAhead) -> NDArray[np.float32]:
        """(n, MOST + 1, PATH_OUTPUTS) raw numbers; the last path stands for leaving them all."""
        inputs = lane_inputs(features, ahead, self.mean, self.scale)
        raw = through_layers(inputs.reshape(-1, inputs.shape[-1]), self.weights, self.biases)
        return raw.reshape(len(features), MOST + 1, PATH_OUTPUTS)


def lane_inputs(
    features: NDArray[np.floating], ahead: LanesAhead, mean: FloatArray, scale: FloatArray
) -> NDArray[np.float32]:
    """(n, MOST + 1, F + PATH_FEATURES) standardised inputs; a path that is not there has zeros."""
    own = features.shape[1]
    agent = standardized(features, mean[:own], scale[:own], CLIP)
    path = standardized(ahead.features, mean[own:], scale[own:], CLIP)
    path = np.where(ahead.exists[..., None], path, np.float32(0.0))
    path = np.concatenate([path, np.zeros_like(path[:, :1])], axis=1)
    return np.concatenate([np.repeat(agent[:, None], MOST + 1, axis=1), path], axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedNetwork:
    """A trained network.

    Attributes:
        mean: (F,) of the training features.
        scale: (F,) their standard deviations.
        weights: one (in, out) float32 matrix per layer.
        biases: one (out,) float32 vector per layer.
        spread_scale: factor that makes the sets' coverage right, found on recordings apart.
        trained: the range that it was trained on.
        lanes: the network that looks at paths along lanes; None where no map was trained on.
        earned: `EARNED` shares of the best guess's correction: without and with a map, by class
            of speed, without and with noise, at each of `TIME_S`.
    """

    mean: FloatArray
    scale: FloatArray
    weights: Layers
    biases: Layers
    spread_scale: float
    trained: TrainedRange
    lanes: LaneNetwork | None = None
    earned: FloatArray = field(default_factory=lambda: np.ones(EARNED))

    def share(self, motion: Motion, mapped: bool, time_s: FloatArray) -> FloatArray:
        """(n, H) how much of the correction of the best guess counts, 0 to 1."""
        table = self.earned[int(mapped)]
        each = table[kind_of(motion.speed, motion.stands), (motion.noise_m > NOISY_M).astype(int)]
        return np.stack([np.interp(time_s, TIME_S, one) for one in each]).reshape(-1, time_s.size)

    def __call__(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """(n, MODES, PER_MODE) raw numbers."""
        inputs = standardized(features, self.mean, self.scale, CLIP)
        raw = through_layers(inputs, self.weights, self.biases)
        return raw.reshape(len(features), MODES, PER_MODE)

    def save(self, path: Path, card: dict[str, Any]) -> None:
        """Write the network with its card (data, split, scores) in the file's metadata."""
        trained = {name: getattr(self.trained, name) for name in TrainedRange.__slots__}
        earned = np.round(self.earned, 3).tolist()
        metadata = about(self.spread_scale, card, trained=trained, earned=earned)
        save_layers(self, path, metadata, lanes=self.lanes)


def kind_of(speed: NDArray[np.floating], stands: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) class of speed, 0 for who stands; see `SPEEDS_MPS`."""
    return np.where(stands, 0, np.maximum(np.searchsorted(SPEEDS_MPS, speed, "right"), 1))


def powers(time_s: FloatArray) -> FloatArray:
    """(POWERS, H) of time over the horizon; constant beyond it."""
    share = np.minimum(time_s / HORIZON_S, 1.0)
    return np.asarray(share ** np.arange(2, POWERS + 2)[:, None])


def decode(
    raw: NDArray[np.floating], base: FloatArray, speed: FloatArray, trust: FloatArray,
    time_s: FloatArray,
) -> Futures:  # fmt: skip
    """The network's numbers as futures in each agent's frame.

    Args:
        raw: (n, MODES, PER_MODE).
        base: (n, H, 2) the base, m.
        speed: (n,) m/s.
        trust: (n,) how much of each correction counts, 0 to 1.
        time_s: (H,) s.

    Returns:
        The futures at these times, the first being the likeliest; spreads are not scaled yet.
    """
    n = len(raw)
    size = scale_of(speed)[:, None, None, None] * trust[:, None, None, None]
    bend = raw[..., : 2 * POWERS].reshape(n, MODES, POWERS, 2).astype(np.float64)
    own = base[:, None] + size * np.einsum("nkpc,pt->nktc", bend, powers(time_s), optimize=True)
    score = raw[..., 1:, -1].astype(np.float64)
    other = np.exp(score - score.max(axis=1, keepdims=True))
    other /= other.sum(axis=1, keepdims=True)
    chance = np.concatenate([LIKELIEST * other.max(axis=1, keepdims=True), other], axis=1)
    return Futures(own, spreads(raw, speed, time_s), chance / chance.sum(axis=1, keepdims=True))


def spreads(raw: NDArray[np.floating], speed: FloatArray, time_s: FloatArray) -> FloatArray:
    """(n, ..., H) spreads of futures, m, from a network's numbers (n, ..., PER_MODE)."""
    low, slope = raw[..., -3].astype(np.float64), raw[..., -2].astype(np.float64)
    log_time = np.log(np.maximum(time_s, 0.05) / HORIZON_S)
    spread = np.exp(
        np.clip(low, -4.0, 4.0)[..., None] + np.clip(1.2 + slope, 0.3, 3.0)[..., None] * log_time
    )
    size = scale_of(speed).reshape(-1, *(1,) * (spread.ndim - 1))
    return np.asarray(np.maximum(spread * size, LEAST_SPREAD_M))


def load_network(path: Path) -> RecordedNetwork:
    """Read a network.

    Raises:
        InputError: if the file is missing, broken or newer than this version reads.
    """
    arrays, content = read_network(path, "np")
    try:
        told = {name: float(value) for name, value in content["trained"].items()}
        trained = TrainedRange(**told)
        earned = np.array(content["earned"], dtype=np.float64)
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: expected a trained predictor, found: {error}") from None
    for name, value in told.items():
        if not 0.0 <= value < math.inf:
            raise InputError(f"{path}: trained.{name}: found {value:g}, expected 0 or more")
    if earned.shape != EARNED or not ((earned >= 0.0) & (earned <= 1.0)).all():
        raise InputError(f"{path}: earned: expected shares of the shape {EARNED}")
    layers = layers_in(path, arrays)
    if layers[0].size != feature_count():
        raise InputError(
            f"{path}: found a network with {layers[0].size} inputs, expected {feature_count()}: "
            "train it anew"
        )
    _check_shapes(path, layers, MODES * PER_MODE)
    lanes = None
    if "lanes_mean" in arrays:
        found = layers_in(path, arrays, "lanes")
        _check_shapes(path, found, PATH_OUTPUTS, layers[0].size + PATH_FEATURES)
        lanes = LaneNetwork(*found)
    return RecordedNetwork(*layers, content["spread_scale"], trained, lanes, earned)


def _check_shapes(path: Path, layers: LayerArrays, answers: int, inputs: int | None = None) -> None:
    """Refuse layers that do not lead from one to the next, from the inputs to the answers."""
    mean, scale, weights, biases = layers
    sizes = [mean.size if inputs is None else inputs, *(bias.size for bias in biases)]
    expected = [(sizes[0],), (sizes[0],), *((size,) for size in sizes[1:]), *pairwise(sizes)]
    arrays: tuple[NDArray[Any], ...] = (mean, scale, *biases, *weights)
    found = [array.shape for array in arrays]
    if found != expected or sizes[-1] != answers or not (scale > 0.0).all():
        raise InputError(
            f"{path}: found arrays of the shapes {found}"[:300]
            + f", expected layers of a network with {answers} answers"
        )


SHIPPED: Final = "recorded.safetensors"
"""The file of the weights that ship."""


@functools.cache
def shipped_network() -> RecordedNetwork:
    """The network that ships in the package."""
    with weights_file(SHIPPED) as path:
        return load_network(path)


@functools.lru_cache(maxsize=4)
def trained_network(folder: Path) -> RecordedNetwork:
    """The network that ``graphrqi train --predictor`` wrote into a folder.

    Raises:
        InputError: if there is none.
    """
    return load_network(folder / SHIPPED)
