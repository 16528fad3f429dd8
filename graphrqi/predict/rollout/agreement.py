"""How well the beliefs about drivers agree with what those drivers are seen doing.

A classifier may be wrong about one driver or, far from its training data, about all. Each behaviour
predicts a wished speed and, by the car-following law, a present acceleration. The likelihood ratio
of the observations under the beliefs against no beliefs tells how far the beliefs about one driver
can be trusted; the ratios of all other drivers tell how far the classifier can be.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.rollout.driver_table import DriverTable
from graphrqi.predict.rollout.route import ACCELERATION_SD
from graphrqi.predict.scene.scene import Scene
from sim.compiled import in_place

FloatArray = NDArray[np.float64]

WISH_SD = 0.18
"""Standard deviation of the logarithm of wished speeds within a behaviour (the scenarios' spread of
15 %, and the error of the estimate)."""

OVER = 0.03
"""Excess over the wished speed, as its logarithm, that counts as none."""

MOST_ACCELERATION, MOST_WISH = 4.0, 8.0
"""Largest log-likelihoods that one acceleration and a wished speed can cost."""

LEAST_BELIEF = 1e-4
"""Least probability given to a behaviour, so that one error does not exclude it."""

SUM_SCALE = 5.0
"""Divisor and bound of the sum over the other drivers."""


def agreement(
    scene: Scene, probability: FloatArray, asked: FloatArray, table: DriverTable
) -> FloatArray:
    """How much more likely the beliefs make the observations than no beliefs would.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform rows for drivers of whom nothing is known.
        asked: (6, n) acceleration that each behaviour would have now, m/s2.
        table: calibrated driver parameters.

    Returns:
        (n, 3) logarithm of the ratio for the driver itself, its mean over all other drivers about
        whom there are beliefs, and its scaled sum over them.
    """
    states, (n, count) = scene.states, probability.shape
    out = np.empty((n, 3))
    _find_log_ratios(
        probability, scene.accel, asked, scene.on_path, states.free_factor, states.least_factor,
        np.log(table.behavior[:, 0]), np.empty(n, np.bool_), np.empty(count), out,
    )  # fmt: skip
    return out


@in_place()
def _find_log_ratios(
    probability: Any, accel: Any, asked: Any, on_path: Any, free_factor: Any, least_factor: Any,
    wish: Any, known: Any, lost: Any, out: Any,
) -> None:  # fmt: skip
    """See `agreement`."""
    n, count = probability.shape
    for i in range(n):
        out[i, 0], known[i] = 0.0, False
        for b in range(count):
            known[i] |= probability[i, b] > 1.0 / count + 1e-6
        if not known[i]:
            continue
        fastest = math.log(max(least_factor[i], 0.1))
        free = math.log(max(free_factor[i], 0.1))
        least = np.inf
        for b in range(count):
            miss = (accel[i] - asked[b, i]) / ACCELERATION_SD
            lost[b] = min(0.5 * (miss * miss), MOST_ACCELERATION) if on_path[i] else 0.0
            if not math.isnan(free_factor[i]):
                apart = (free - wish[b]) / WISH_SD
                lost[b] += min(0.5 * apart * apart, MOST_WISH)
            excess = max(fastest - wish[b] - OVER, 0.0) / WISH_SD
            lost[b] += min(0.5 * excess * excess, MOST_WISH)
            least = min(least, lost[b])
        believed, blind = 0.0, 0.0
        for b in range(count):
            likelihood = math.exp(least - lost[b])
            believed += max(probability[i, b], LEAST_BELIEF) * likelihood
            blind += likelihood / count
        out[i, 0] = math.log(believed / blind)
    total, drivers = 0.0, 0
    for i in range(n):
        total += out[i, 0]
        drivers += known[i]
    for i in range(n):
        rest = total - out[i, 0]
        out[i, 1] = rest / max(drivers - known[i], 1)
        out[i, 2] = min(max(rest / SUM_SCALE, -SUM_SCALE), SUM_SCALE)
