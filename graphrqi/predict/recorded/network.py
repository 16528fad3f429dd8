"""The networks that predict recordings, in numpy, and their file.

A small perceptron gives `MODES` futures per agent. Each is the base plus a polynomial of time along
each axis of the agent's frame, times `scale_of` its speed; it begins with the base's velocity. The
first is the single best guess; the correction counts as much as it earned on recordings that were
left out, by speed, noise and time. The others cover what else may happen. Outside the range of
speed, noise and rate that it was trained on, the futures come down to the base.

Where there is a map, a second perceptron looks at each path that an agent may follow
(`graphrqi.predict.recorded.lanes_ahead`), and once at leaving them all. It gives each path a
score and `PER_PATH` futures, which `graphrqi.predict.recorded.predictor` joins with the others.

References:
    Guzman-Rivera et al. (2012), "Multiple choice learning", NeurIPS (winner takes all).
"""

from __future__ import annotations

import functools
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray, softmax
from graphrqi.networks.weights import Arrays, restored, save_weights
from graphrqi.predict.networks import (
    KIND,
    LEAST_SPREAD_M,
    MODES,
    TIME_S,
    WEIGHTS,
    Futures,
    Perceptron,
    spread_scale_of,
    standardized,
)
from graphrqi.predict.recorded.features import feature_count, scale_of
from graphrqi.predict.recorded.lanes_ahead import HORIZON_S, MOST, PATH_FEATURES, LanesAhead
from graphrqi.predict.recorded.motion import Motion

POWERS: Final = 4
"""Powers of time, from 2 on, in the polynomial of each axis: all futures begin with the base."""

PER_MODE: Final = 2 * POWERS + 3
"""Numbers per future: coefficients, two for the spread, a score."""

PER_PATH: Final = 6
"""Futures along each path: the best guess, and five that cover what else may happen."""

PATH_OUTPUTS: Final = PER_PATH * PER_MODE + 1
"""Numbers for each path: its futures, and its score."""

LIKELIEST: Final = 1.05
"""The first future is as likely as this many times the likeliest other one."""

CLIP: Final = 3.0
"""Standardised inputs are clipped here, since larger ones mislead the network."""

SPEEDS_MPS: Final = (0.5, 5.0, 12.0, 20.0)
"""Where the classes of speed begin after the first, that of who stands, m/s."""

NOISY_M: Final = 0.05
"""Positions with more noise are noisy, m."""

EARNED: Final = (2, len(SPEEDS_MPS) + 1, 2, TIME_S.size)
"""Shape of the shares that corrections have earned."""

MARGIN: Final = 0.15
"""Beyond the trained range the network gives way to the base over this share of the range's end."""


LEAST: Final = 1e-9
"""The trained range reaches at least this far."""


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
        values = np.stack([speed, noise_m, noise_mps, np.full_like(speed, step_s)])
        most = np.maximum(astuple(self), LEAST)[:, None]
        return np.asarray(np.clip(1.0 - (values / most - 1.0) / MARGIN, 0.0, 1.0).min(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class RecordedNetwork:
    """A trained network.

    Attributes:
        free: gives `MODES` futures from an agent's features.
        spread_scale: factor that makes the sets' coverage right, found on recordings apart.
        trained: the range that it was trained on.
        lanes: looks at paths along lanes: its inputs are the agent's features, then the path's;
            None where no map was trained on.
        earned: `EARNED` shares of the best guess's correction: without and with a map, by class
            of speed, without and with noise, at each of `TIME_S`.
    """

    free: Perceptron
    spread_scale: float
    trained: TrainedRange
    lanes: Perceptron | None = None
    earned: FloatArray = field(default_factory=lambda: np.ones(EARNED))

    def share(self, motion: Motion, mapped: bool, time_s: FloatArray) -> FloatArray:
        """(n, H) how much of the correction of the best guess counts, 0 to 1."""
        table = self.earned[int(mapped)]
        each = table[kind_of(motion.speed, motion.stands), (motion.noise_m > NOISY_M).astype(int)]
        return np.stack([np.interp(time_s, TIME_S, one) for one in each]).reshape(-1, time_s.size)

    def __call__(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """(n, MODES, PER_MODE) raw numbers."""
        return self.free(features).reshape(len(features), MODES, PER_MODE)

    def save(self, path: Path, card: dict[str, Any]) -> None:
        """Write the network with its card (data, split, scores)."""
        about = {
            "spread_scale": self.spread_scale, "card": card, "trained": asdict(self.trained),
            "earned": np.round(self.earned, 3).tolist(),
        }  # fmt: skip
        lanes = self.lanes.arrays("lanes_") if self.lanes else {}
        save_weights(path, KIND, about, {**self.free.arrays(), **lanes})


def lane_answers(
    lanes: Perceptron, features: NDArray[np.floating], ahead: LanesAhead
) -> NDArray[np.float32]:
    """(n, MOST + 1, PATH_OUTPUTS) raw numbers; the last path stands for leaving them all."""
    inputs = lane_inputs(features, ahead, lanes.mean, lanes.scale)
    raw = lanes.through(inputs.reshape(-1, inputs.shape[-1]))
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
    """The network's numbers (n, MODES, PER_MODE) as futures at times (H,), in each agent's frame.

    They correct the base (n, H, 2) as far as trust (n,) allows, 0 to 1. The first is the likeliest.
    Spreads are not scaled yet.
    """
    n = len(raw)
    size = scale_of(speed)[:, None, None, None] * trust[:, None, None, None]
    bend = raw[..., : 2 * POWERS].reshape(n, MODES, POWERS, 2).astype(np.float64)
    own = base[:, None] + size * np.einsum("nkpc,pt->nktc", bend, powers(time_s), optimize=True)
    other = softmax(raw[..., 1:, -1].astype(np.float64))
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
    """Read a network; `InputError` if the file is missing, broken or of another version."""
    return restored(path, KIND, _read)


def _read(about: dict[str, Any], arrays: Arrays) -> RecordedNetwork:
    free, lanes = Perceptron.read(arrays, most=CLIP), None
    free.check(feature_count(), MODES * PER_MODE)
    if "lanes_mean" in arrays:
        lanes = Perceptron.read(arrays, "lanes_", CLIP)
        lanes.check(feature_count() + PATH_FEATURES, PATH_OUTPUTS)
    earned = np.array(about["earned"], dtype=np.float64).reshape(EARNED)
    trained = TrainedRange(**about["trained"])
    return RecordedNetwork(free, spread_scale_of(about), trained, lanes, earned)


SHIPPED: Final = "recorded.safetensors"
"""The file of the weights that ship."""


@functools.lru_cache(maxsize=4)
def trained_network(folder: Path = WEIGHTS) -> RecordedNetwork:
    """The network that ships, or that ``graphrqi train --predictor`` wrote into a folder."""
    return load_network(folder / SHIPPED)
