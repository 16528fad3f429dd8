"""From a network's numbers to trajectories.

A network gives `MODES` futures per driver, each at `KNOTS` knots in the driver's own frame: origin
at its position, x along its heading, in metres. A future is a blend of the driver's anchor
trajectories plus a residual, so that a network only has to learn what the anchors miss. Each future
also has a probability and a spread, from which sets of a given coverage follow.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S, Prediction
from sim.compiled import in_place
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]

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
    """What a network predicts of each driver, in the driver's frame.

    Attributes:
        own: (n, K, KNOTS, 2) positions at the knots, m.
        spread: (n, K, KNOTS) standard deviation of each coordinate, m.
        probability: (n, K); the first future is the likeliest.
    """

    own: FloatArray
    spread: FloatArray
    probability: FloatArray


def decode(raw: NDArray[np.floating], anchors: FloatArray, spread_scale: float) -> Futures:
    """A network's numbers as futures.

    Args:
        raw: (n, K PER_MODE) outputs.
        anchors: (n, ANCHORS, KNOTS, 2) anchor trajectories, m.
        spread_scale: factor that makes the sets' coverage right, found on validation episodes.
    """
    # in double precision: kernels are compiled again for single precision
    each = raw.astype(np.float64, copy=False).reshape(len(raw), MODES, PER_MODE)
    n, knots = len(raw), TIME_S.size
    own, spread = np.empty((n, MODES, knots, 2)), np.empty((n, MODES, knots))
    probability = np.empty((n, MODES))
    _decode(
        each, anchors, TIME_S, spread_scale, np.empty(anchors.shape[1]), own, spread, probability
    )
    return Futures(own, spread, probability)


def spread_out(history: Tracks, futures: Futures, steps: int) -> Prediction:
    """Futures at the knots, in each driver's frame, as positions at every step.

    Between knots positions lie on a cubic spline that starts at the present speed; after the last
    knot they go straight on. Pedestrians walk on at their present velocity.

    Args:
        history: tracks whose last column is the present, everyone seen there.
        futures: theirs.
        steps: how many, `STEP_S` apart.
    """
    matrix, start = _spline(steps)
    # copies: kernels are compiled again for read-only arrays
    now, speed, heading = (x[:, -1].copy() for x in (history.xy, history.speed, history.heading))
    n, modes, knots = futures.spread.shape
    xy = np.empty((n, modes, steps, 2))
    _find_positions(
        futures.own, matrix, start, speed, heading, now, history.kind == PEDESTRIAN,
        np.empty((2, steps)), xy,
    )  # fmt: skip
    time_s = np.arange(1, steps + 1, dtype=np.float64) * STEP_S
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


@in_place()
def _decode(
    raw: Any, anchors: Any, time_s: Any, spread_scale: float, weight: Any, own: Any, spread: Any,
    probability: Any,
) -> None:  # fmt: skip
    """Write the columns of `Futures`."""
    n, modes, _ = raw.shape
    _, count, knots, _ = anchors.shape
    for i in range(n):
        best = -np.inf
        for k in range(modes):
            best = max(best, raw[i, k, -1])
            most, total = -np.inf, 0.0
            for b in range(count):
                most = max(most, raw[i, k, b])
            for b in range(count):
                weight[b] = math.exp(raw[i, k, b] - most)
                total += weight[b]
            for j in range(knots):
                x = total * time_s[j] * raw[i, k, count + 2 * j]
                y = total * time_s[j] * raw[i, k, count + 2 * j + 1]
                for b in range(count):
                    x += weight[b] * anchors[i, b, j, 0]
                    y += weight[b] * anchors[i, b, j, 1]
                own[i, k, j, 0], own[i, k, j, 1] = x / total, y / total
                scale = math.exp(min(max(raw[i, k, count + 2 * knots + j], -6.0), 4.0))
                spread[i, k, j] = max(scale * time_s[j] * spread_scale, LEAST_SPREAD_M)
        total, largest = 0.0, 0.0
        for k in range(modes):
            probability[i, k] = math.exp(raw[i, k, -1] - best)
            total += probability[i, k]
            largest = max(largest, probability[i, k])
        total += largest - probability[i, 0]
        probability[i, 0] = largest
        for k in range(modes):
            probability[i, k] /= total


@in_place(reordered=True)
def _find_positions(
    own: Any, matrix: Any, start: Any, speed: Any, heading: Any, now: Any, walks: Any, room: Any,
    out: Any,
) -> None:  # fmt: skip
    """Find positions at every step from knots in the drivers' frames."""
    n, modes, knots, _ = own.shape
    steps = start.size
    ahead, left = room[0], room[1]
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for k in range(modes):
            if walks[i]:
                for h in range(steps):
                    ahead[h], left[h] = speed[i] * (h + 1) * STEP_S, 0.0
            else:
                for h in range(steps):
                    ahead[h], left[h] = speed[i] * start[h], 0.0
                for j in range(knots):
                    x, y = own[i, k, j, 0], own[i, k, j, 1]
                    for h in range(steps):
                        ahead[h] += matrix[j, h] * x
                        left[h] += matrix[j, h] * y
            for h in range(steps):
                out[i, k, h, 0] = now[i, 0] + ahead[h] * cos - left[h] * sin
                out[i, k, h, 1] = now[i, 1] + ahead[h] * sin + left[h] * cos
