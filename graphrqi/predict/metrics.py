"""Errors of predictions as Argoverse 2 defines them, and which agents are predicted to collide.

References:
    Wilson et al. (2021), "Argoverse 2: next generation datasets for self-driving perception and
    forecasting", NeurIPS Datasets and Benchmarks; ``av2.datasets.motion_forecasting.eval.metrics``.
    Deo, Trivedi (2018), "Convolutional social pooling for vehicle trajectory prediction", CVPR
    Workshops: RMSE per second.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray
from sim.geometry import Outlines, separation

MISS_THRESHOLD_M: Final = 2.0
"""An agent is missed when no future ends this close (Argoverse 2)."""

SAMPLE_S: Final = 0.5
"""Displacement errors are averaged over every half second: 0.5, 1, 1.5, ..."""


def distances(xy: FloatArray, truth: FloatArray) -> FloatArray:
    """(n, K, H) distance of each future to what happened, m."""
    return np.asarray(np.linalg.norm(xy - truth[:, None], axis=-1))


METRICS: Final = (
    "ade_m", "fde_m", "rmse_m", "miss_rate", "min_ade_m", "min_fde_m", "brier_min_fde_m",
)  # fmt: skip
"""Names of displacement errors."""


def displacement_errors(gap: FloatArray, probability: FloatArray) -> dict[str, FloatArray]:
    """Displacement errors of each agent, whose means are the metrics.

    Args:
        gap: (n, K, H) from `distances`, m.
        probability: (n, K) of the futures.

    Returns:
        (n,) numbers by name, m: mean and final distance of the likeliest future; its squared final
        distance, m2, the root of whose mean is the metric; 1 where every future ends farther than
        `MISS_THRESHOLD_M` away; mean and final distance of the best future, and that final distance
        plus (1 - its probability)^2.

    Examples:
        >>> two = np.array([[[0.5], [3.0]], [[2.5], [4.0]]])
        >>> displacement_errors(two, np.full((2, 2), 0.5))["miss_rate"].tolist()
        [0.0, 1.0]
    """
    row, likeliest = np.arange(len(gap)), probability.argmax(axis=1)
    mean, final = gap.mean(axis=2), gap[:, :, -1]
    best = final.argmin(axis=1)
    least = final[row, best]
    found = (
        mean[row, likeliest], final[row, likeliest], final[row, likeliest] ** 2,
        (least > MISS_THRESHOLD_M).astype(np.float64), mean.min(axis=1), least,
        least + (1.0 - probability[row, best]) ** 2,
    )  # fmt: skip
    return dict(zip(METRICS, found, strict=True))


def overlap(
    xy: FloatArray, heading: FloatArray, length: FloatArray, width: FloatArray
) -> NDArray[np.bool_]:
    """(n,) whether each agent's outline overlaps another one's at one instant.

    Args:
        xy: (n, 2) centres, m.
        heading: (n,) rad.
        length: (n,) m.
        width: (n,) m.

    Returns:
        Whether each touches any other.

    Examples:
        >>> overlap(np.array([[0.0, 0.0], [4.0, 0.5], [9.0, 0.0]]), np.zeros(3), np.full(3, 4.5),
        ...         np.full(3, 2.0)).tolist()
        [True, True, False]
    """
    out = np.zeros(len(xy), dtype=bool)
    reach = np.hypot(length, width) / 2
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    a, b = np.nonzero(np.triu(apart < reach[:, None] + reach[None], k=1))
    if not a.size:
        return out
    outlines = Outlines.of(xy, heading, length, width)
    touching = separation(outlines.rows(a), outlines.rows(b)) < 0.0
    out[a[touching]] = out[b[touching]] = True
    return out


COVERAGE: Final = 0.9
"""Nominal coverage of the predicted sets."""

_SET_SAMPLES: Final = 40
"""Points per future from which a set's density threshold is taken."""


def log_density(
    at: FloatArray, xy: FloatArray, spread: FloatArray, probability: FloatArray
) -> FloatArray:
    """(n, Q) log density at (n, Q, 2) of a mixture of round normal distributions.

    They lie around (n, K, 2), m, with standard deviations (n, K), m, and probabilities (n, K).
    """
    squared = ((at[:, :, None] - xy[:, None]) ** 2).sum(axis=-1)
    exponent = (
        -0.5 * squared / spread[:, None] ** 2
        - np.log(2 * np.pi * spread[:, None] ** 2)
        + np.log(np.maximum(probability[:, None], 1e-12))
    )
    top = exponent.max(axis=2, keepdims=True)
    return np.asarray(top[..., 0] + np.log(np.exp(exponent - top).sum(axis=2)))


def covered(
    xy: FloatArray, spread: FloatArray, probability: FloatArray, truth: FloatArray
) -> NDArray[np.bool_]:
    """(n,) whether what happened (n, 2) lies in the predicted 90 % set at one time.

    The set is where the predicted density is highest: the smallest that holds `COVERAGE` of it
    (Hyndman 1996, "Computing and graphing highest density regions", Am. Stat. 50). Its threshold is
    a quantile over points that fill each future's distribution evenly, on a golden spiral. The
    futures are as those of `log_density`.
    """
    if not len(xy):
        return np.zeros(0, dtype=bool)
    share = (np.arange(_SET_SAMPLES) + 0.5) / _SET_SAMPLES
    turn = np.arange(_SET_SAMPLES) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(-2.0 * np.log1p(-share))
    draws = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    points = xy[:, :, None] + spread[:, :, None, None] * draws
    n = len(xy)
    density = log_density(points.reshape(n, -1, 2), xy, spread, probability)
    weight = np.repeat(probability / _SET_SAMPLES, _SET_SAMPLES, axis=1)
    order = np.argsort(density, axis=1)
    below = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    first = (below > 1.0 - COVERAGE).argmax(axis=1)
    row = np.arange(n)
    threshold = density[row, order[row, first]]
    return np.asarray(log_density(truth[:, None], xy, spread, probability)[:, 0] >= threshold)
