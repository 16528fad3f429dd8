"""The compiled loop behind `graphrqi.predict.rollout.agreement`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def agreement(
    probability: NDArray[np.float64],
    least_belief: float,
    accel: NDArray[np.float64],
    asked: NDArray[np.float64],
    accel_sd: float,
    on_path: NDArray[np.bool_],
    free_factor: NDArray[np.float64],
    least_factor: NDArray[np.float64],
    wish: NDArray[np.float64],
    wish_sd: float,
    over: float,
    most_miss: float,
    most_wish: float,
    sum_scale: float,
) -> NDArray[np.float64]:
    """How much more likely beliefs make what is seen; see `graphrqi.predict.rollout.agreement`.

    Args:
        probability: (n, B) beliefs.
        least_belief: no behaviour is believed in less.
        accel: (n,) acceleration seen, m/s2.
        asked: (B, n) that of each behaviour, m/s2.
        accel_sd: how far the two are apart, m/s2.
        on_path: (n,) whose acceleration counts.
        free_factor: (n,) speed over limit driven freely; NaN if never.
        least_factor: (n,) largest speed over limit.
        wish: (B,) logarithm of each behaviour's wished speed over limit.
        wish_sd: its standard deviation.
        over: excess over it that says nothing.
        most_miss: log-likelihood lost at most for the acceleration.
        most_wish: the same for a wish.
        sum_scale: what sums over the others are divided by, and the most that they then are.

    Returns:
        (n, 3) logarithm of the ratio for the driver itself, its mean and its scaled sum over all
        others of whom something is believed.
    """
    n, count = probability.shape
    out, known = np.zeros((n, 3)), np.zeros(n, np.bool_)
    lost = np.empty(count)
    for i in range(n):
        for b in range(count):
            known[i] |= probability[i, b] > 1.0 / count + 1e-6
        if not known[i]:
            continue
        fastest = math.log(max(least_factor[i], 0.1))
        free = math.log(max(free_factor[i], 0.1))
        least = np.inf
        for b in range(count):
            miss = (accel[i] - asked[b, i]) / accel_sd
            lost[b] = min(0.5 * (miss * miss), most_miss) if on_path[i] else 0.0
            if not math.isnan(free_factor[i]):
                apart = (free - wish[b]) / wish_sd
                lost[b] += min(0.5 * apart * apart, most_wish)
            excess = max(fastest - wish[b] - over, 0.0) / wish_sd
            lost[b] += min(0.5 * excess * excess, most_wish)
            least = min(least, lost[b])
        believed, blind = 0.0, 0.0
        for b in range(count):
            likelihood = math.exp(least - lost[b])
            believed += max(probability[i, b], least_belief) * likelihood
            blind += likelihood / count
        out[i, 0] = math.log(believed / blind)
    total, drivers = 0.0, 0
    for i in range(n):
        total += out[i, 0]
        drivers += known[i]
    for i in range(n):
        rest = total - out[i, 0]
        out[i, 1] = rest / max(drivers - known[i], 1)
        out[i, 2] = min(max(rest / sum_scale, -sum_scale), sum_scale)
    return out
