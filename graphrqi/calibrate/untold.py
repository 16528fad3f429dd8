"""Which of a driver's numbers its drive does not tell: their posterior is the population's.

A thousand draws tell a posterior's mean no better than to a few hundredths of its spread, so they
alone do not show that it is the population's. Here every number is varied alone, over what the
population leaves to it given the others, and integrated on a grid: of what the likelihood does not
depend on, nothing but the population remains, without any noise of draws. By Stein's identity the
means of these integrals over few draws are moments of the posterior. With r a draw less what the
population expects of it given the numbers that are plainly told, S the covariance of r in the
population and g the slopes of the log-likelihood, E[r] = S E[g] and E[r r'] = S + S E[g r'].

References:
    Stein (1981), Estimation of the mean of a multivariate normal distribution, The Annals of
        Statistics 9, 1135.
    Mira, Solgi, Imparato (2013), Zero variance Markov chain Monte Carlo for Bayesian estimators,
        Statistics and Computing 23, 653.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from behaviors.populations import NUMBERS
from graphrqi.calibrate.drives import Drive
from graphrqi.calibrate.laws import Law
from graphrqi.calibrate.likelihood import log_likelihood

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAME, SURE = 0.05, 2.0
"""A posterior is the population's if its mean is no farther away than so many of the population's
spreads, and its spread differs by no larger share; so many standard errors, and at least
`LEAST_ERROR`, are added to what is found (our choice)."""

LEAST_ERROR: Final = 0.01
"""An error that is added in any case (our choice: draws of the other numbers err, too)."""

NEAR: Final = 0.25
"""Numbers whose draws differ by more are told, without a closer look (our choice: draws err by
about .08, so that hardly any that is the population's is lost)."""

NODES: Final = np.linspace(-4.0, 4.0, 32)
"""Values that each number is given, in the spreads that the population leaves to it (our choice:
on so many, a normal distribution's moments are exact to six digits, kinks in a law to one in a
thousand). They fill a multiple of ``filter.LANES``."""

LOOKS: Final = (8, 48)
"""Draws around which numbers are varied: first so many, then, if nothing is clear, all (our
choice)."""

UNCLEAR: Final = 3.0
"""So many standard errors beyond `SAME`, the first look is enough (our choice)."""


def untold(
    law: Law, drive: Drive, logs: FloatArray, mean: FloatArray, covariance: FloatArray,
    counts: float, newer: float,
) -> BoolArray:  # fmt: skip
    """(5,) whether the posterior of each of `NUMBERS` is the population's; see `SAME`.

    Args:
        law: the law.
        drive: of the driver.
        logs: (M, D) draws from about its posterior, columns as ``laws.FIELDS[law]``.
        mean: (D,) the population's mean logarithms.
        covariance: (D, D) their covariance.
        counts: power with which the likelihood counts.
        newer: as ``posterior.moving_on`` has it.

    Examples:
        Who never follows anybody tells its desired speed, but no headway, gap or braking.

        >>> from graphrqi.calibrate.drives import Stretch, make_drive
        >>> from graphrqi.calibrate.laws import prior
        >>> t = np.arange(0.0, 20.0, 0.1)
        >>> drive = make_drive([Stretch(t, 20.0 * t, np.full(t.size, np.inf))])
        >>> mean, covariance = prior(Law.IDM)
        >>> logs = np.random.default_rng(0).multivariate_normal(mean, covariance, 640)
        >>> logs[:, 0] = np.log(20.0) + 0.01 * (logs[:, 0] - mean[0])  # drives at 20 m/s
        >>> untold(Law.IDM, drive, logs, mean, covariance, 1.0, 0.5).tolist()
        [False, True, True, False, True]
    """
    size = len(NUMBERS)
    away = logs - mean
    spread = np.sqrt(np.diag(covariance))
    near = (np.abs(away.mean(axis=0)) < NEAR * spread) & (
        np.abs(away.std(axis=0) - spread) < NEAR * spread
    )
    found = near[:size]
    for look in LOOKS:
        if not found.any():
            break
        some = np.flatnonzero(found)
        rows = np.linspace(0, len(logs) - 1, look).round().astype(np.int64)
        varied = _varied(law, drive, logs[rows], some, mean, covariance, counts, newer)
        off, error = _off(away, rows, some, varied, covariance)
        found[some] = (off + np.maximum(SURE * error, LEAST_ERROR) <= SAME).all(axis=0)
        if look < LOOKS[-1]:
            in_the_end = error * (look / LOOKS[-1]) ** 0.5
            found[some] |= ((off <= SAME + UNCLEAR * error) & (SURE * in_the_end <= SAME)).all(
                axis=0
            )
    return np.asarray(found)


def _varied(
    law: Law, drive: Drive, logs: FloatArray, some: NDArray[np.int64], mean: FloatArray,
    covariance: FloatArray, counts: float, newer: float,
) -> FloatArray:  # fmt: skip
    """(3, m, S) for some numbers and m draws, each number alone being varied.

    Mean of the log-likelihood's slope, its product with how far the number is from what the
    population expects given the draw's others, and that expectation less the population's mean.
    """
    precision = np.linalg.inv(covariance)
    prior = norm.pdf(NODES)
    out = np.empty((3, len(logs), some.size))
    for place, k in enumerate(some):
        width = precision[k, k] ** -0.5
        expected = logs[:, k] - (logs - mean) @ precision[k] * width**2
        tried = np.repeat(logs, NODES.size, axis=0)
        tried[:, k] = (expected[:, None] + width * NODES).ravel()
        told = counts * log_likelihood(law, tried, drive, newer).reshape(-1, NODES.size)
        weight = prior * np.exp(told - told.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        out[0, :, place] = weight @ NODES / width
        out[1, :, place] = weight @ NODES**2 - 1.0
        out[2, :, place] = expected - mean[k]
    return out


def _off(
    away: FloatArray, rows: NDArray[np.int64], some: NDArray[np.int64], varied: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(2, S) how far mean and spread of some numbers are off the population's, and standard errors.

    Args:
        away: (M, D) all draws, less the population's mean.
        rows: (m,) those around which numbers were varied.
        some: (S,) the numbers.
        varied: (3, m, S) from `_varied`.
        covariance: (D, D) the population's.
    """
    slope, product, expected = varied
    others = np.setdiff1d(np.arange(len(covariance)), some)
    by_others = np.linalg.solve(
        covariance[np.ix_(others, others)], covariance[np.ix_(others, some)]
    )
    left = covariance[np.ix_(some, some)] - covariance[np.ix_(some, others)] @ by_others
    told = away[:, others] @ by_others  # what the numbers that are told say of these
    said = told[rows]
    rest = away[np.ix_(rows, some)] - said
    shift = slope @ left
    together = slope[:, :, None] * rest[:, None, :]
    alone = np.arange(some.size)
    together[:, alone, alone] = product + slope * (expected - said)
    square = np.einsum("kj,mjk->mk", left, together) + 2.0 * said * shift
    mean = told.mean(axis=0) + shift.mean(axis=0)
    variance = (told**2).mean(axis=0) + np.diag(left) + square.mean(axis=0) - mean**2
    spread = np.sqrt(np.diag(covariance)[some])
    wider = np.sqrt(np.maximum(variance, 0.0)) / spread - 1.0
    error = np.stack([shift.std(axis=0) / spread, 0.5 * square.std(axis=0) / spread**2])
    return np.abs([mean / spread, wider]), error / len(rows) ** 0.5


def from_population(
    logs: FloatArray, unknown: BoolArray, mean: FloatArray, covariance: FloatArray, seed: int
) -> FloatArray:
    """(M, D) draws in which unknown numbers are drawn from the population, given the others.

    Args:
        logs: (M, D) draws.
        unknown: (5,) from `untold`.
        mean: (D,) the population's mean logarithms.
        covariance: (D, D) their covariance.
        seed: of the draws.

    Examples:
        >>> drawn = from_population(
        ...     np.zeros((100, 2)), np.array([False, True]), np.zeros(2), np.eye(2), 0
        ... )
        >>> (drawn.mean(axis=0).round(6) + 0.0).tolist(), drawn.std(axis=0).round(6).tolist()
        ([0.0, 0.0], [0.0, 1.0])
    """
    some = np.flatnonzero(unknown)
    others = np.setdiff1d(np.arange(mean.size), some)
    by_others = np.linalg.solve(
        covariance[np.ix_(others, others)], covariance[np.ix_(others, some)]
    )
    left = covariance[np.ix_(some, some)] - covariance[np.ix_(some, others)] @ by_others
    away = logs[:, others] - mean[others]
    drawn = np.random.default_rng(seed).standard_normal((len(logs), some.size))
    # exactly normal moments, and independent of the other numbers, by regression on them
    beside = np.column_stack([np.ones(len(logs)), away])
    drawn -= beside @ np.linalg.lstsq(beside, drawn, rcond=None)[0]
    drawn = np.linalg.solve(np.linalg.cholesky(drawn.T @ drawn / len(logs)), drawn.T).T
    out = logs.copy()
    out[:, some] = mean[some] + away @ by_others + drawn @ np.linalg.cholesky(left).T
    return out
