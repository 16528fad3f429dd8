"""From a network's numbers to trajectories.

A network gives `MODES` futures per driver, each at `KNOTS` knots in the driver's own frame: origin
at its position, x along its heading, in metres. A future is a weighted mean of the driver's anchor
trajectories plus a residual. Each future also has a probability and a spread, from which sets of a
given coverage follow.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray
from graphrqi.predict.prediction import STEP_S, Prediction
from sim.frames import PEDESTRIAN, Tracks
from sim.geometry import from_own_frame

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
    weight = _shares(each[..., :ANCHORS])
    residual = each[..., ANCHORS:ends].reshape(n, MODES, KNOTS, 2) * TIME_S[:, None]
    blend = weight @ anchors.reshape(n, ANCHORS, 2 * KNOTS)
    spread = np.exp(np.clip(each[..., ends:-1], -6.0, 4.0)) * TIME_S * spread_scale
    probability = _shares(each[..., -1])
    probability[:, 0] = probability.max(axis=1)
    return Futures(
        blend.reshape(residual.shape) + residual,
        np.maximum(spread, LEAST_SPREAD_M),
        probability / probability.sum(axis=1, keepdims=True),
    )


def _shares(scores: FloatArray) -> FloatArray:
    """Probabilities along the last axis."""
    likely = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(likely / likely.sum(axis=-1, keepdims=True))


def spread_out(history: Tracks, futures: Futures, steps: int) -> Prediction:
    """Futures at the knots, in each driver's frame, as positions at every step.

    Between knots positions lie on a cubic spline that starts at the present speed; after the last
    knot they go straight on. Pedestrians walk on at their present velocity.
    """
    matrix, start = _spline(steps)
    n, modes, knots = futures.spread.shape
    speed, heading = history.speed[:, -1], history.heading[:, -1]
    time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
    own = np.ascontiguousarray((futures.own.swapaxes(2, 3) @ matrix).swapaxes(2, 3))
    own[..., 0] += (speed[:, None] * start)[:, None]
    walks = history.kind == PEDESTRIAN
    own[walks] = 0.0
    own[walks, ..., 0] = (speed[walks, None] * time_s)[:, None]
    xy = from_own_frame(own, history.xy[:, -1], heading)
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
