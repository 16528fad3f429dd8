"""Each driver's own car-following parameters, inferred from how it follows.

A driver that is held up by its leader keeps the largest speed that is still safe. For Krauss's law
(and at equilibrium for any law with a time headway) this is the speed at which

    gap = s0 + T v + (v^2 - v_leader^2) / (2 b),

with standstill gap s0, time headway T and comfortable braking b: linear in (s0, T, 1 / b). Sums of
products of the regressors and the gap over the moments of following are therefore sufficient
statistics. They are additive. The posterior is that of a linear model with a normal prior and
normal noise.

References:
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08. Bishop (2006), Pattern
    Recognition and Machine Learning, eqs. 3.50 to 3.51.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import FloatArray

PRIOR_MEAN: Final = np.array([2.3, 1.4, 0.3])
"""Standstill gap, m, time headway, s, and 1 / braking, s2/m, of the average driver (textbook
values: Treiber and Kesting 2013, Traffic Flow Dynamics)."""

PRIOR_SD: Final = np.array([1.3, 0.9, 0.15])
"""Their standard deviations over all drivers."""

GAP_NOISE_M: Final = 0.8
"""Standard deviation of the gap about the law: the lengths of both cars and the lag are unknown."""

LEAST_MPS: Final = 0.5
"""Speed below which a headway is not meaningful, m/s."""

COLUMNS: Final = 11
"""Additive columns: products of regressors, their products with the gap, the squared gap, the
time."""

UPPER: Final = np.triu_indices(3)
"""Where the six different entries of a symmetric matrix stand in it."""

SYMMETRIC: Final = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""The one of the six entries that stands at each place of the matrix."""

LAW_NAMES: Final[tuple[str, ...]] = (
    "standstill gap", "time headway", "inverse braking",
    "standstill gap sd", "time headway sd", "inverse braking sd", "residual",
)  # fmt: skip
"""Names of the columns of `infer`."""


def products(speed: FloatArray, leader_speed: FloatArray, gap: FloatArray) -> FloatArray:
    """(n, COLUMNS) one moment's products of regressors and gap.

    Speeds are (n,) m/s, gaps m; both of the leader are NaN without one. They count while a driver
    is following.
    """
    x = 0.5 * (speed * speed - leader_speed * leader_speed)
    out = np.ones((speed.size, COLUMNS))
    out[:, 1], out[:, 2], out[:, 6] = speed, x, gap
    np.multiply(out[:, 1:3], speed[:, None], out=out[:, 3:5])
    out[:, 5] = x * x
    np.multiply(out[:, 1:3], gap[:, None], out=out[:, 7:9])
    out[:, 9] = gap * gap
    return out


def implied_headway(
    speed: FloatArray,
    leader_speed: FloatArray,
    gap: FloatArray,
    standstill_m: float,
    braking_mps2: float,
) -> FloatArray:
    """(n,) the time headway, s, for which the law's safe speed equals the present speed.

    No driver exceeds its safe speed, so a driver's own headway is at most this at every moment,
    whether it is held up or not. Speeds below ``LEAST_MPS`` count as ``LEAST_MPS``.
    """
    left_m = gap - standstill_m - (speed * speed - leader_speed * leader_speed) / (2 * braking_mps2)
    return np.asarray(left_m / np.maximum(speed, LEAST_MPS))


def infer(sums: FloatArray) -> FloatArray:
    """(n, 7) posterior of each driver's parameters, in columns named by ``LAW_NAMES``.

    A second of following counts as one observation, since successive frames are nearly equal.
    ``sums`` (n, COLUMNS) are the products, each times its duration in seconds. Without evidence the
    prior is left.
    """
    weight, prior = GAP_NOISE_M**-2, PRIOR_SD**-2
    a, b, c, d, e, f = weight * sums[:, :6].T + np.diag(prior)[UPPER][:, None]
    minors = np.stack(
        [d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b]
    )
    minors /= a * minors[0] + b * minors[1] + c * minors[2]
    covariance, gram, target = minors[SYMMETRIC], sums.T[SYMMETRIC], sums[:, 6:9].T
    mean = (covariance * (weight * target + (PRIOR_MEAN * prior)[:, None])).sum(axis=1)
    fitted = (mean[:, None] * gram * mean).sum(axis=(0, 1))
    error = sums[:, 9] - 2.0 * (mean * target).sum(axis=0) + fitted
    # Differences of long sums may leave a variance a rounding error below zero.
    deviation = np.sqrt(np.maximum(minors[[0, 3, 5]], 0.0))
    residual = np.sqrt(np.maximum(error, 0.0) / np.maximum(sums[:, 10], 1.0))
    return np.ascontiguousarray(np.concatenate([mean, deviation, residual[None]]).T)
