"""The population of drivers and every driver's numbers, inferred together.

Each driver's logarithms are drawn from a normal distribution that all drivers of a place share.
For each driver, draws are weighted by likelihood and population (`kernels.draw`); the population is
the most likely one given all drivers (expectation maximisation over the weighted draws), shrunken
towards the prior of `laws` when there are few. Drawing and fitting alternate.

References:
    Dempster, Laird, Rubin (1977), Maximum likelihood from incomplete data via the EM algorithm,
        Journal of the Royal Statistical Society B 39, 1.
    Wei, Tanner (1990), A Monte Carlo implementation of the EM algorithm, Journal of the American
        Statistical Association 85, 699.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2, norm, qmc

from behaviors.populations import NUMBERS
from graphrqi.calibrate.drives import Drive
from graphrqi.calibrate.laws import FIELDS, Law, prior

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FIRST_DRAWS, DRAWS = 128, 256
"""Draws of a driver while the population is sought, and in the end (powers of 2, for Sobol's
points). A quarter to a half of them count after weighting."""

PARTS: Final = 4
"""In so many parts; each is proposed from what those before it have shown."""

ROUNDS, STEPS = 3, 10
"""Rounds of drawing, and steps of expectation maximisation in each (our choice: afterwards nothing
moves by more than a fiftieth of a spread)."""

TRIES, CLIMBS = 32, 3
"""Points at which each driver's likelihood is looked at first, and from how many of the best the
most likely numbers are sought."""

PRIOR_DRIVERS: Final = 10.0
"""Strength of the prior on the population's covariance, in drivers."""

PRIOR_MEAN_DRIVERS: Final = 1.0
"""Strength of the prior on the population's mean, in drivers."""

MOST_FIRST: Final = 250
"""The population is sought among so many drivers at most, evenly chosen: a standard error of 6 %
of a spread."""

LEAST_NARROWING: Final = 0.9
"""A number is known if its interval is narrower than so many times the population's, or ..."""

LEAST_SHIFT: Final = 0.15
"""... its mean farther from the population's than so many spreads. Both are what the draws' own
noise does not reach (our choice); else the population's interval is told."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Drivers under one law.

    Attributes:
        law: the law.
        mean: (D,) the population's mean logarithms, columns as ``laws.FIELDS[law]``.
        covariance: (D, D) its covariance.
        logs: (N, M, D) draws of each driver.
        weight: (N, M) their weights, which sum to 1 for each driver.
        evidence: (N,) log-likelihood of each driver's drive under the population.
    """

    law: Law
    mean: FloatArray
    covariance: FloatArray
    logs: FloatArray
    weight: FloatArray
    evidence: FloatArray

    @property
    def spread(self) -> FloatArray:
        """(D,) the population's standard deviations of logarithms."""
        return np.sqrt(np.diag(self.covariance))

    def summary(self) -> Summary:
        """Mean and 90 % interval of every driver's `NUMBERS`, and whether the data tell them."""
        size = len(NUMBERS)
        logs, weight = self.logs[:, :, :size], self.weight[:, :, None]
        centre = (weight * logs).sum(axis=1)
        spread = np.sqrt((weight * (logs - centre[:, None]) ** 2).sum(axis=1))
        all_mean, all_spread = self.mean[:size], self.spread[:size]
        known = (spread < LEAST_NARROWING * all_spread) | (
            np.abs(centre - all_mean) > LEAST_SHIFT * all_spread
        )
        order = np.argsort(logs, axis=1)
        sorted_logs = np.take_along_axis(logs, order, axis=1)
        shares = np.take_along_axis(np.broadcast_to(weight, logs.shape), order, axis=1)
        reached = np.cumsum(shares, axis=1) - 0.5 * shares
        ends = np.empty((2, *centre.shape))
        for i in range(len(logs)):
            for d in range(size):
                ends[:, i, d] = np.interp((0.05, 0.95), reached[i, :, d], sorted_logs[i, :, d])
        reach = norm.ppf(0.95) * all_spread
        return Summary(
            mean=np.where(
                known, (weight * np.exp(logs)).sum(axis=1), np.exp(all_mean + 0.5 * all_spread**2)
            ),
            low=np.exp(np.where(known, ends[0], all_mean - reach)),
            high=np.exp(np.where(known, ends[1], all_mean + reach)),
            known=known,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """What is told of N drivers; columns as `NUMBERS`.

    Attributes:
        mean: (N, 5) posterior means.
        low: (N, 5) where the 90 % intervals begin.
        high: (N, 5) where they end.
        known: (N, 5) whether the data tell the number; else all of it is the population's.
    """

    mean: FloatArray
    low: FloatArray
    high: FloatArray
    known: BoolArray


def _nothing() -> None:
    """Nobody watches the progress."""


def calibrate(
    law: Law, drives: Sequence[Drive], on_driver: Callable[[], None] = _nothing
) -> Calibration:
    """Infer a population and its drivers.

    Args:
        law: the law that all are assumed to drive by.
        drives: one for each driver, at least one.
        on_driver: called whenever a driver has been looked at; see `visits` for how often.

    Returns:
        The calibration.

    Examples:
        >>> from graphrqi.calibrate.drives import Stretch, make_drive
        >>> t = np.arange(0.0, 30.0, 0.1)
        >>> drive = make_drive([Stretch(t, 10.0 * t, 17.0 + 10.0 * t)])
        >>> told = calibrate(Law.IDM, [drive]).summary()
        >>> bool(1.0 < told.mean[0, 1] < 1.9)
        True
    """
    mean, covariance = prior(law)
    every = -(-len(drives) // MOST_FIRST)
    some, modes = list(drives)[::every], None
    for _ in range(ROUNDS):
        drawn = _draw_all(law, some, mean, covariance, modes, FIRST_DRAWS, on_driver)
        mean, covariance = _population(law, drawn, mean, covariance)
        modes = drawn.modes
    drawn = _draw_all(
        law, drives, mean, covariance, modes if every == 1 else None, DRAWS, on_driver
    )
    weight, evidence = drawn.weights(mean, covariance)
    return Calibration(law, mean, covariance, drawn.logs, weight, evidence)


def visits(drivers: int) -> int:
    """How often `calibrate` calls ``on_driver`` for so many drivers."""
    every = -(-drivers // MOST_FIRST)
    return drivers + ROUNDS * -(-drivers // every)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """Draws of N drivers, with log-likelihoods and log densities of their proposals (N, M)."""

    logs: FloatArray
    told: FloatArray
    density: FloatArray
    modes: FloatArray

    def weights(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, M) weights under a population, and (N,) log-likelihoods of the drives."""
        found = self.told + _log_normal(self.logs, mean, covariance) - self.density
        total = logsumexp(found, axis=1)
        return np.exp(found - total[:, None]), total - np.log(found.shape[1])


def _log_normal(points: FloatArray, mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Log density of a normal distribution at (..., D) points."""
    away = points - mean
    squared = np.einsum("...i,ij,...j->...", away, np.linalg.inv(covariance), away)
    return np.asarray(-0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * covariance)[1]))


def _student_points(count: int, size: int, seed: int) -> FloatArray:
    """(count, size) evenly spread draws of Student's t."""
    from graphrqi.calibrate.kernels import FREEDOM

    uniform = qmc.Sobol(size + 1, seed=seed).random(count).clip(1e-6, 1.0 - 1e-6)
    scale = np.sqrt(FREEDOM / chi2.ppf(uniform[:, size], FREEDOM))
    return np.asarray(norm.ppf(uniform[:, :size]) * scale[:, None])


def _draw_all(
    law: Law, drives: Sequence[Drive], mean: FloatArray, covariance: FloatArray,
    starts: FloatArray | None, draws: int, on_driver: Callable[[], None],
) -> _Drawn:  # fmt: skip
    """Draws of every driver; ``starts`` are modes found before."""
    from graphrqi.calibrate.kernels import draw

    size = mean.size
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    tries = norm.ppf(qmc.Sobol(size, seed=1).random(TRIES).clip(1e-3, 1 - 1e-3))
    tries = np.asarray(mean + 0.7 * tries @ np.linalg.cholesky(covariance).T, dtype=np.float64)
    tries[0] = mean
    points = np.stack([_student_points(draws // PARTS, size, 2 + part) for part in range(PARTS)])
    logs = np.empty((len(drives), draws, size))
    told, density = np.empty((2, len(drives), draws))
    modes = np.empty((len(drives), size))
    for i, drive in enumerate(drives):
        given = (drive.rows, drive.begins, drive.step_s)
        before = None if starts is None else starts[i]
        modes[i], scale = _mode(law, drive, tries, before, mean, precision)
        rng = np.random.default_rng(i)  # errors of the points are not to be the same for everybody
        turned = (points * rng.choice((-1.0, 1.0), size))[:, :, rng.permutation(size)]
        turned = np.ascontiguousarray(turned)
        logs[i], told[i], density[i] = draw(
            law.code, modes[i], scale, mean, precision, turned, *given
        )
        on_driver()
    return _Drawn(logs, told, density, modes)


def _mode(
    law: Law, drive: Drive, tries: FloatArray, before: FloatArray | None, mean: FloatArray,
    precision: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(D,) most likely logarithms of a driver, and the covariance around them."""
    from graphrqi.calibrate.kernels import likelihood, most_likely

    given = (drive.rows, drive.begins, drive.step_s)
    out: Any = np.zeros((2, drive.rows.shape[1]))
    fastest = np.log(1.03 * max(float(drive.rows[2].max()), 1.0))
    tries = tries.copy()
    tries[:, 0] = np.maximum(tries[:, 0], fastest)
    found = np.array([likelihood(law.code, one, *given, out) for one in tries])
    best = [tries[k] for k in np.argsort(found)[::-1][:CLIMBS]]
    if before is not None:
        best = [before, best[0]]
    climbed = [most_likely(law.code, one, mean, precision, *given) for one in best]
    mode, information, _ = min(climbed, key=lambda one: float(one[2]))
    return mode, np.linalg.inv(information)


def _population(
    law: Law, drawn: _Drawn, mean: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The population under which the draws are most likely.

    The correlation time of the residual stays as the prior has it: with the residual's size it
    forms a ridge along which the draws' noise would carry both away.
    """
    first_mean, first_covariance = prior(law)
    n = len(drawn.logs)
    fixed = FIELDS[law].index("correlation_s")
    for _ in range(STEPS):
        weight, _ = drawn.weights(mean, covariance)
        centre = np.einsum("nm,nmd->d", weight, drawn.logs)
        mean = (centre + PRIOR_MEAN_DRIVERS * first_mean) / (n + PRIOR_MEAN_DRIVERS)
        away = drawn.logs - mean
        scatter = np.einsum("nm,nmd,nme->de", weight, away, away, optimize=True)
        covariance = (scatter + PRIOR_DRIVERS * first_covariance) / (n + PRIOR_DRIVERS)
        mean[fixed] = first_mean[fixed]
        covariance[fixed] = covariance[:, fixed] = 0.0
        covariance[fixed, fixed] = first_covariance[fixed, fixed]
    return mean, covariance
