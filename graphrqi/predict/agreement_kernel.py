"""The compiled loop behind `graphrqi.predict.agreement`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def gained(
    probability: NDArray[np.float64],
    least_belief: float,
    miss: NDArray[np.float64],
    on_path: NDArray[np.bool_],
    free_factor: NDArray[np.float64],
    least_factor: NDArray[np.float64],
    wish: NDArray[np.float64],
    wish_sd: float,
    over: float,
    most_miss: float,
    most_wish: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Logarithm of how much more likely beliefs make what is seen of each driver than none.

    Args:
        probability: (n, B) beliefs.
        least_belief: no behaviour is believed in less.
        miss: (B, n) acceleration seen less that of each behaviour, in standard deviations.
        on_path: (n,) whose acceleration counts.
        free_factor: (n,) speed over limit driven freely; NaN if never.
        least_factor: (n,) largest speed over limit.
        wish: (B,) logarithm of each behaviour's wished speed over limit.
        wish_sd: its standard deviation.
        over: excess over it that says nothing.
        most_miss: log-likelihood lost at most for the acceleration.
        most_wish: the same for a wish.

    Returns:
        (n,) logarithms, and (n,) whether anything is believed; the logarithm is 0 where not.
    """
    n, count = probability.shape
    out, known = np.zeros(n), np.zeros(n, np.bool_)
    lost = np.empty(count)
    for i in range(n):
        if not probability[i].max() > 1.0 / count + 1e-6:
            continue
        known[i] = True
        fastest = math.log(max(least_factor[i], 0.1))
        free = math.log(max(free_factor[i], 0.1))
        for b in range(count):
            lost[b] = min(0.5 * miss[b, i] * miss[b, i], most_miss) if on_path[i] else 0.0
            if not math.isnan(free_factor[i]):
                apart = (free - wish[b]) / wish_sd
                lost[b] += min(0.5 * apart * apart, most_wish)
            excess = max(fastest - wish[b] - over, 0.0) / wish_sd
            lost[b] += min(0.5 * excess * excess, most_wish)
        least = lost.min()
        believed, blind = 0.0, 0.0
        for b in range(count):
            likelihood = math.exp(least - lost[b])
            believed += max(probability[i, b], least_belief) * likelihood
            blind += likelihood / count
        out[i] = math.log(believed / blind)
    return out, known
