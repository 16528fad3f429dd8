"""The compiled loops behind `graphrqi.features.following_law`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def write_products(
    speed: NDArray[np.float64],
    leader_speed: NDArray[np.float64],
    gap: NDArray[np.float64],
    counts: NDArray[np.bool_],
    out: NDArray[np.float64],
) -> None:
    """One moment's products of regressors and gap; see `graphrqi.features.following_law.products`.

    Args:
        speed: (n,) m/s.
        leader_speed: (n,) m/s.
        gap: (n,) m.
        counts: (n,) whether each is following.
        out: (n, 11) receives the products of those who are.
    """
    for i in range(speed.size):
        if not counts[i]:
            continue
        v, u, y = speed[i], leader_speed[i], gap[i]
        x = 0.5 * (v * v - u * u)
        out[i, 0], out[i, 1], out[i, 2] = 1.0, v, x
        out[i, 3], out[i, 4], out[i, 5] = v * v, v * x, x * x
        out[i, 6], out[i, 7], out[i, 8] = y, v * y, x * y
        out[i, 9], out[i, 10] = y * y, 1.0


@compiled
def infer(
    sums: NDArray[np.float64],
    weight: float,
    prior: NDArray[np.float64],
    prior_target: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Posterior means, deviations and residual; see `graphrqi.features.following_law.infer`.

    The symmetric 3 x 3 matrices are inverted by cofactors.

    Args:
        sums: (n, 11) products.
        weight: one over the noise's variance.
        prior: (3,) one over the prior's variances.
        prior_target: (3,) its means times these.
        out: (n, 7) receives the numbers.
    """
    for i in range(sums.shape[0]):
        r, s, t, u, w, x = sums[i, 0], sums[i, 1], sums[i, 2], sums[i, 3], sums[i, 4], sums[i, 5]
        p, q, z = sums[i, 6], sums[i, 7], sums[i, 8]
        a, b, c = weight * r + prior[0], weight * s, weight * t
        d, e, f = weight * u + prior[1], weight * w, weight * x + prior[2]
        aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
        dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * aa + b * bb + c * cc
        aa, bb, cc = aa / determinant, bb / determinant, cc / determinant
        dd, ee, ff = dd / determinant, ee / determinant, ff / determinant
        g = weight * p + prior_target[0]
        h = weight * q + prior_target[1]
        k = weight * z + prior_target[2]
        first = aa * g + bb * h + cc * k
        second = bb * g + dd * h + ee * k
        third = cc * g + ee * h + ff * k
        square = (
            first * (r * first + s * second + t * third)
            + second * (s * first + u * second + w * third)
            + third * (t * first + w * second + x * third)
        )
        error = sums[i, 9] - 2.0 * (first * p + second * q + third * z) + square
        out[i, 0], out[i, 1], out[i, 2] = first, second, third
        out[i, 3], out[i, 4], out[i, 5] = math.sqrt(aa), math.sqrt(dd), math.sqrt(ff)
        out[i, 6] = math.sqrt(max(error, 0.0) / max(sums[i, 10], 1.0))
