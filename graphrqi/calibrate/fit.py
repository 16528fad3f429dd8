"""Drivers' car-following numbers from simulated gaps (maximum a posteriori), and their population.

A driver is simulated behind its recorded leader. Its numbers minimise the squared error of
position, weighed against the population. The population's logarithms are normal. Their mean and
covariance are estimated from all drivers in turn (empirical Bayes). Intervals come from the
curvature at the optimum (Laplace). Errors of simulated positions last for many seconds. A stretch
therefore counts as one independent observation every `OBSERVED_S`.

References:
    Treiber, Kesting (2013), Microscopic calibration and validation of car-following models,
        Procedia Social and Behavioral Sciences 80, 922: calibration by simulated gaps.
    Efron, Morris (1973), Stein's estimation rule and its competitors: an empirical Bayes approach,
        Journal of the American Statistical Association 68, 117.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from graphrqi.arrays import FloatArray
from graphrqi.calibrate.following import STEP_S, Stretch


class Law(StrEnum):
    """A car-following law; the members' order is the code order of the kernels."""

    IDM = "idm"
    KRAUSS = "krauss"

    @property
    def code(self) -> int:
        """Position among the laws."""
        return tuple(Law).index(self)


PRIOR_MEDIAN: Final = np.array([20.0, 1.3, 2.5, 1.5, 2.0])
"""The median driver before anything is seen, in the order of ``NUMBERS`` (Treiber and Kesting 2013,
Traffic Flow Dynamics, table 11.2)."""

PRIOR_SPREAD: Final = np.array([0.3, 0.4, 0.4, 0.4, 0.4])
"""Spread of the logarithms between drivers before anything is seen."""

PLACE_SPREAD: Final = np.array([0.35, 0.3, 0.25, 0.3, 0.25])
"""Spread of the logarithms of recording sites' medians around `PRIOR_MEDIAN` (twice it covers the
published fits)."""

PRIOR_DRIVERS: Final = 5.0
"""Strength of the prior of the spreads, in drivers."""

OBSERVED_S, LEAST_OBSERVATIONS = 10.0, 4.0
"""A driver counts as one observation per this time, s, and as at least this many."""

LEAST_ERROR_M: Final = 0.05
"""Least root mean square error of position, m."""

STARTS: Final = (0.0, 0.25, 0.5, 0.75)
"""Shares of a stretch from which on its driver is simulated to the stretch's end."""

ROUNDS: Final = 6
"""Rounds of drivers and population in turn."""

DIFFERENCE: Final = 1e-3
"""Step of the numerical derivatives by logarithms."""

KNOWN: Final = 0.5
"""A number is known where its variance is less than this share of the population's."""

LATELY_S, CARRIED, FADES_S = 1.0, 0.5, 5.0
"""A driver's deviation from its law is the mean over so many seconds, s. A forecast carries on this
share of it, which fades within so many seconds, s."""

DRAWS: Final = 32
"""Draws from a driver's posterior of which a forecast is the median."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The drivers of recordings under one law.

    Attributes:
        law: the law.
        mean: (5,) means of the logarithms, in the order of ``NUMBERS``.
        covariance: (5, 5) their covariance.
        logs: (N, 5) logarithms of each driver's numbers.
        spread: (N, 5, 5) their posterior covariance.
        error_m: (N,) root mean square error of each driver, m.
    """

    law: Law
    mean: FloatArray
    covariance: FloatArray
    logs: FloatArray
    spread: FloatArray
    error_m: FloatArray

    @property
    def deviation(self) -> FloatArray:
        """(N, 5) posterior standard deviations of the logarithms."""
        return np.sqrt(np.diagonal(self.spread, axis1=1, axis2=2))

    @property
    def known(self) -> NDArray[np.bool_]:
        """(N, 5) whether the recording determines a number better than the population does."""
        return np.asarray(self.deviation**2 < KNOWN * np.diag(self.covariance))


def calibrate(
    law: Law,
    drivers: Sequence[Sequence[Stretch]],
    advance: Callable[[int], object] = lambda _: None,
) -> Calibration:
    """Infer the numbers of drivers, and their population.

    Args:
        law: the law that all are taken to drive by.
        drivers: the stretches of each.
        advance: is called with 1 after each driver of each of the `ROUNDS`.

    Returns:
        The calibrated drivers and their population.

    Examples:
        >>> t = np.arange(0.0, 60.0, 0.1)
        >>> speed = 10.0 + 4.0 * np.sin(0.2 * t)
        >>> ahead = 30.0 + np.cumsum(speed) * 0.1
        >>> numbers = np.log([[25.0, 1.8, 2.0, 1.2, 2.0]])
        >>> leader = Stretch.of(t, ahead, ahead)
        >>> start = Stretch(leader.place - 25.0, leader.speed, leader.place, leader.speed)
        >>> place = simulated(Law.IDM, numbers, start)[0]
        >>> found = calibrate(Law.IDM, [[Stretch.of(t, place, ahead)]])
        >>> bool(abs(np.exp(found.logs[0, 1]) - 1.8) < 0.2)
        True
    """
    mean, covariance = np.log(PRIOR_MEDIAN), np.diag(PRIOR_SPREAD**2)
    logs = np.tile(mean, (len(drivers), 1))
    spread = np.tile(covariance, (len(drivers), 1, 1))
    errors = np.array([_error(law, logs[0], stretches) for stretches in drivers])
    for _ in range(ROUNDS):
        for i, stretches in enumerate(drivers):
            logs[i], spread[i] = _most_likely(
                law, stretches, logs[i], mean, covariance, max(errors[i], LEAST_ERROR_M)
            )
            errors[i] = _error(law, logs[i], stretches)
            advance(1)
        mean, covariance = _population(logs, spread, covariance)
    return Calibration(law, mean, covariance, logs, spread, errors)


def _most_likely(
    law: Law,
    stretches: Sequence[Stretch],
    start: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    error_m: float,
) -> tuple[FloatArray, FloatArray]:
    """(5,) logarithms with the largest posterior density, and their (5, 5) Laplace covariance."""
    whitened = np.linalg.inv(np.linalg.cholesky(covariance))
    rows = sum(stretch.place.size for stretch in _pieces(stretches))
    observations = max(
        sum(stretch.seconds for stretch in stretches) / OBSERVED_S, LEAST_OBSERVATIONS
    )
    weight = np.sqrt(observations / rows) / error_m

    def misses(logs: FloatArray) -> FloatArray:
        return np.concatenate(
            [weight * _missed(law, logs[None], stretches)[0], whitened @ (logs - mean)]
        )

    def slopes(logs: FloatArray) -> FloatArray:
        near = logs + DIFFERENCE * np.vstack([np.zeros(logs.size), np.eye(logs.size)])
        missed = weight * _missed(law, near, stretches)
        return np.vstack([(missed[1:] - missed[0]).T / DIFFERENCE, whitened])

    found = least_squares(misses, start, slopes, method="lm", xtol=1e-4, ftol=1e-4)
    slope = np.asarray(found.jac)
    return np.asarray(found.x), np.linalg.inv(slope.T @ slope)


def _population(
    logs: FloatArray, spread: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the population, from the drivers' posteriors and the priors."""
    count = len(logs)
    each, of_places = np.linalg.inv(covariance), np.diag(PLACE_SPREAD**-2.0)
    right = each @ logs.sum(axis=0) + of_places @ np.log(PRIOR_MEDIAN)
    mean = np.linalg.solve(count * each + of_places, right)
    away = logs - mean
    scatter = away.T @ away + spread.sum(axis=0) + PRIOR_DRIVERS * np.diag(PRIOR_SPREAD**2)
    return mean, scatter / (count + PRIOR_DRIVERS)


def _pieces(stretches: Sequence[Stretch]) -> list[Stretch]:
    """The parts of stretches that are simulated, each from its own beginning."""
    return [
        stretch.part(int(share * stretch.place.size), stretch.place.size)
        for stretch in stretches
        for share in STARTS
    ]


def _missed(law: Law, logs: FloatArray, stretches: Sequence[Stretch]) -> FloatArray:
    """(M, R) simulated minus measured places of M drivers over all pieces, m."""
    pieces = _pieces(stretches)
    return np.hstack([simulated(law, logs, piece) - piece.place for piece in pieces])


def _error(law: Law, logs: FloatArray, stretches: Sequence[Stretch]) -> float:
    """Root mean square error of a driver's simulated places, m."""
    return float(np.sqrt((_missed(law, logs[None], stretches) ** 2).mean()))


def simulated(
    law: Law, logs: FloatArray, stretch: Stretch, beside: FloatArray | None = None
) -> FloatArray:
    """(M, T) places, m, from where a recorded driver began, behind its recorded leader.

    M drivers have logarithms (M, 5) of their numbers, and at first a residual acceleration (M,),
    m/s2.
    """
    from graphrqi.calibrate.kernels import drive

    if beside is None:
        beside = np.zeros(len(logs))
    places: FloatArray = drive(
        law.code, np.exp(logs), float(stretch.place[0]), float(stretch.speed[0]), stretch.leader,
        stretch.leader_speed, STEP_S, beside, float(np.exp(-STEP_S / FADES_S)),
    )  # fmt: skip
    return places


def second_half_errors(law: Law, stretches: Sequence[Stretch]) -> FloatArray:
    """(N,) errors of each driver's gaps in its second half, predicted from its first half, m.

    They are root mean squares over one stretch of each driver, behind a leader.
    """
    both = []
    for stretch in stretches:  # the moment in the middle belongs to both halves
        middle = stretch.place.size // 2
        both.append((stretch.part(0, middle + 1), stretch.part(middle, stretch.place.size)))
    fitted = calibrate(law, [[past] for past, _ in both])
    missed = [
        forecast(law, fitted.logs[i], fitted.spread[i], past, ahead) - ahead.place
        for i, (past, ahead) in enumerate(both)
    ]
    return np.array([np.sqrt((one**2).mean()) for one in missed])


def forecast(
    law: Law, logs: FloatArray, spread: FloatArray, past: Stretch, ahead: Stretch
) -> FloatArray:
    """(T,) where a driver will be behind a leader whose motion is known, m.

    They are medians over `DRAWS` from the posterior of the numbers. Only the first row of the
    driver's future is used.
    """
    from graphrqi.calibrate.kernels import mean_beside

    normal = np.random.default_rng(0).standard_normal((DRAWS // 2, logs.size))
    both = np.vstack([normal, -normal])
    drawn = logs + both @ np.linalg.cholesky(spread).T
    last = past.part(max(past.place.size - 1 - round(LATELY_S / STEP_S), 0), past.place.size)
    beside = CARRIED * mean_beside(
        law.code, np.exp(drawn), last.place, last.speed, last.leader, last.leader_speed, STEP_S
    )
    return np.asarray(np.median(simulated(law, drawn, ahead, beside), axis=0))
