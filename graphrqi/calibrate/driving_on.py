"""Driving recorded drivers on: which numbers foretell a driver's gaps for half a minute.

The posterior of `graphrqi.calibrate.posterior` judges numbers by what a driver does within the next
second. Real drivers change their minds, and no law holds exactly; numbers that are too sure of that
go astray over half a minute. Here candidates are judged by the gaps that they would have kept over
the known past, each driver's past counting as a few independent observations only, and the gap that
is told is the mean over the candidates' weights.

References:
    Treiber, Kesting (2013), Microscopic calibration and validation of car-following models,
        Procedia Social and Behavioral Sciences 80, 922: calibration by simulated gaps.
    Kesting, Treiber (2008), Calibrating car-following models by using trajectory data,
        Transportation Research Record 2088, 148: errors lie largely within a driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from behaviors.populations import NUMBERS
from graphrqi.calibrate.drives import Drive
from graphrqi.calibrate.laws import FIELDS, Law, prior

FloatArray = NDArray[np.float64]

CANDIDATES: Final = 1024
"""Drivers that are tried: half drawn from the prior of `laws`, half around the pooled driver."""

POOLED_SPREAD: Final = 0.4
"""Log-normal spread of the latter (our choice, as that of the prior)."""

OBSERVATIONS: Final = 4.0
"""As so many independent observations each driver's past counts (of 2, 3, 4, 6 and 8, it foretells
the second halves of 300 training pairs of I-80 best, by the mean square)."""

MOST_STEPS: Final = 250
"""Most evaluations in each search for the pooled driver."""

START_OFFSETS: Final = (
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, -0.7, 1.0),
    (0.0, 0.0, 0.0, -0.7, -1.5),
)
"""Where the searches start, beside the prior's median, in logarithms: the errors have several
minima, which differ in how drivers accelerate and brake. The best is searched once more."""


def longest_led(drive: Drive) -> Drive | None:
    """The longest stretch behind one leader; None if there is none."""
    led = [
        (last - first, first, last)
        for first, last in pairwise(drive.begins.tolist())
        if np.isfinite(drive.rows[3, first])
    ]
    if not led:
        return None
    _, first, last = max(led)
    return drive.part(first, last)


def halves(drive: Drive) -> tuple[Drive, Drive] | None:
    """The longest stretch behind one leader, cut in its middle; None if there is none.

    Returns:
        Its first and its second half; both hold the moment between them.
    """
    found = longest_led(drive)
    if found is None:
        return None
    watched = np.flatnonzero(found.rows[1] > 0.0)
    if watched.size < 5:
        return None
    middle = int(watched[watched.size // 2])
    return found.part(0, middle + 1), found.part(middle, found.rows.shape[1])


def driven_places(law: Law, logs: FloatArray, drive: Drive) -> FloatArray:
    """(M, T) places, m, of M drivers who start as recorded and drive behind the recorded leader.

    Args:
        law: the law.
        logs: (M, D) logarithms of their numbers, columns as ``laws.FIELDS[law]``. Of (M, 5) the
            others count as 1: a driver reaches the safe speed of Krauss's law in 1 s.
        drive: one stretch.
    """
    from graphrqi.calibrate.kernels import drive_on

    filled = np.ones((len(logs), len(FIELDS[law])))
    filled[:, : logs.shape[1]] = np.exp(logs)
    return np.stack([drive_on(law.code, n, drive.rows, drive.step_s) for n in filled])


def gap_errors(places: FloatArray, drive: Drive) -> FloatArray:
    """(M,) root mean square errors of the gap to the recorded leader, m."""
    watched = drive.rows[1] > 0.0
    missed = places[:, watched] - drive.rows[0, watched]
    return np.asarray(np.sqrt((missed**2).mean(axis=1)))


def errors_of(law: Law, logs: FloatArray, drives: Sequence[Drive]) -> FloatArray:
    """(N,) errors of the gaps, m, that one driver makes in each of N drives; see `gap_errors`."""
    return np.array([gap_errors(driven_places(law, logs[None], one), one)[0] for one in drives])


def pooled_driver(law: Law, drives: Sequence[Drive]) -> FloatArray:
    """(5,) logarithms of the one driver whose simulated gaps err least over all drives."""

    def cost(logs: FloatArray) -> float:
        return float(sum(errors_of(law, logs, drives) ** 2))

    start = prior(law)[0][: len(NUMBERS)]
    options: Any = {"maxfev": MOST_STEPS, "xatol": 1e-3}
    found = [
        minimize(cost, start + offset, method="Nelder-Mead", options=options)
        for offset in START_OFFSETS
    ]
    best = min(found, key=lambda one: float(one.fun))
    return np.asarray(minimize(cost, best.x, method="Nelder-Mead", options=options).x)


def candidates(law: Law, pooled: FloatArray, seed: int) -> FloatArray:
    """(CANDIDATES, 5) logarithms of drivers to try.

    Args:
        law: the law.
        pooled: (5,) from `pooled_driver`.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    size = len(NUMBERS)
    mean, covariance = prior(law)
    half = CANDIDATES // 2
    usual = rng.multivariate_normal(mean[:size], covariance[:size, :size], half)
    near = pooled + POOLED_SPREAD * rng.standard_normal((CANDIDATES - half, size))
    return np.concatenate([usual, near])


def candidate_weights(errors: FloatArray) -> FloatArray:
    """(..., M) weights of candidates by the errors of their gaps over the past, m.

    Normal errors of unknown size: the likelihood falls with a power of the error.

    Examples:
        >>> candidate_weights(np.array([1.0, 2.0])).round(3)
        array([0.941, 0.059])
    """
    least = errors.min(axis=-1, keepdims=True)
    found = (np.maximum(least, 1e-9) / np.maximum(errors, 1e-9)) ** OBSERVATIONS
    return np.asarray(found / found.sum(axis=-1, keepdims=True))
