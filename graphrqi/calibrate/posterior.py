"""The population of drivers and every driver's numbers, inferred together.

Each driver's logarithms are drawn from a normal distribution that all drivers of a place share.
For each driver, draws are made from its posterior under the population (`sampling.sample`); the
population is the most likely one given all drivers' draws (expectation maximisation), and a prior
from the literature (`laws`), which rules where drivers tell little. Drawing and fitting alternate
among some of the drivers; in the end, all of them are drawn, and the population and their draws are
corrected by that.

References:
    Dempster, Laird, Rubin (1977), Maximum likelihood from incomplete data via the EM algorithm,
        Journal of the Royal Statistical Society B 39, 1.
    Wei, Tanner (1990), A Monte Carlo implementation of the EM algorithm, Journal of the American
        Statistical Association 85, 699.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from behaviors.populations import NUMBERS
from graphrqi.calibrate.drives import LEAST_NOISE_M, Drive
from graphrqi.calibrate.laws import FIELDS, NUISANCES, Law, place_spread, prior
from graphrqi.calibrate.likelihood import log_likelihood
from graphrqi.calibrate.untold import from_population, untold

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FIRST_POINTS, POINTS = 64, 128
"""Draws of a driver that move together, while the population is sought and in the end."""

BLUR_M: Final = 3.0
"""Blur of the places to begin with, m (our choice: drivers differ by more)."""

MOVES, FIRST_SWEEPS, SWEEPS = 4, 8, 20
"""Their steps at each blur of the places, and without any; see `sampling.sample` (our
choice: three times as many change no interval's share of truths by more than chance does)."""

ROUNDS, STEPS = 4, 8
"""Rounds of drawing, and steps of expectation maximisation in each (our choice: afterwards nothing
moves by more than a twentieth of a spread)."""

PRIOR_DRIVERS: Final = 10.0
"""Strength of the prior on the population's covariance, in drivers."""

MOST_DRIVERS: Final = 30.0
"""Against the prior on the population's mean, so many drivers count at most, unless the law holds:
a law's own error is the same for all drivers and does not average out (our choice: the prior then
takes a twentieth of what every driver tells as exactly as drivers differ, and nearly all of what
they hardly tell)."""

MOST_FIRST: Final = 250
"""The population is sought among so many drivers at most, a standard error of 6 % of a spread, and
corrected once by the draws of all."""

ALL_EVERY: Final = 4
"""Of all drivers' draws, one in so many corrects the population (our choice: all of them move it
by a hundredth of a spread more, and take a tenth of the whole time)."""

EXACT_SPREAD: Final = 3.0
"""Spread of the logarithm of an exact driver's residual before anything is seen (our choice: exact
places are mostly simulated ones, with any residual from none to people's)."""

PARTS_S: Final = (10.0, 3.0)
"""Length of the parts of a drive that are compared, s: the first of which one drive in ten has two
(our choice: what a driver does in 10 s is over in the next; recordings of short roads have only
shorter ones). With parts of 2 to 10 s, what `agreement` divides by `REACHED` is .71 to .78 for
I-80's drives, and 2.3 to 3.2 for drivers that are simulated behind US-101's leaders."""

LEAST_PARTED: Final = 0.1
"""See `PARTS_S`."""

BETWEEN: Final = 0.5
"""Who moves on by the mean of the old and the new speed; see `moving_on`."""

EXACT_M: Final = 1.5 * LEAST_NOISE_M
"""Places whose errors seem no larger are exact, m (our choice)."""

LOOKED_FIRST, LOOKED_AT, MOST_TOLD, FAR_LIKELIER = 24, 96, 6.0, 3.0
"""So many drivers are asked how they move on, and then so many in all, unless the first ones are
likelier to move by the mean; each says by how much the logarithm of its likelihood differs, at
most, as draws may get lost; and all of them must differ by so much times the root of their number
(our choice: chance moves the sum by about five times that root, and drivers who move on by the mean
lie as much below zero)."""

STEP: Final = 0.3
"""Step of the differences by which slopes and curvature are found, in a driver's spreads (our
choice: short enough for a parabola, long enough for kinks)."""

REACHED: Final = 2.5
"""What drivers that are simulated by a law reach: curvature over the variance of slopes, in the
median driver (found: 2 to 6; more than 1 because the filter allows for errors of smoothing)."""

HOLDS, LEAST_COUNTS = 0.6, 0.05
"""From this share of it on a law is taken to hold, and what is left at least (our choice)."""

WIDTHS: Final[dict[Law, tuple[tuple[float, ...], tuple[float, ...]]]] = {
    Law.IDM: ((0.81, 0.96, 0.98, 0.65, 0.74), (1.01, 1.06, 1.08, 1.00, 1.00)),
    Law.KRAUSS: ((1.06, 0.90, 0.86, 1.08, 0.86), (1.02, 0.86, 0.89, 1.13, 0.75)),
}
"""Intervals of `NUMBERS` reach so many times as far from the median as the draws do, for drivers
whose residual is no larger than the first of `EXACT_MPS2`, and from the second on. So wide, nine
tenths held the truth of drivers simulated by the law, half of them with noise, in the mean of eight
varied populations of 120 and of seven to nine draws of 1,000 from the bench's (Cook, Gelman, Rubin
2006, Validation of software for Bayesian models using posterior quantiles, Journal of Computational
and Graphical Statistics 15, 675). An exact drive does not tell how small its residual is, so that
IDM's draws reach too far."""

EXACT_MPS2: Final = (0.02, 0.08)
"""Told residuals of exact drives and of others, m/s2; between them, widths go with the logarithm
(our choice: those that were simulated exactly reach .018, those with noise begin at .11)."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Drivers under one law.

    Attributes:
        law: the law.
        mean: (D,) the population's mean logarithms, columns as ``laws.FIELDS[law]``.
        covariance: (D, D) its covariance.
        counts: power with which likelihoods counted, see `agreement`.
        newer: with how much of a step's new speed drivers move on, see `moving_on`.
        logs: (N, M, D) draws of each driver, all alike; of unknown numbers, from the population.
        known: (N, 5) whether the data tell each of `NUMBERS`, see ``untold.untold``.
        evidence: (N,) log-likelihood of each driver's drive under the population.
    """

    law: Law
    mean: FloatArray
    covariance: FloatArray
    counts: float
    newer: float
    logs: FloatArray
    known: BoolArray
    evidence: FloatArray

    @property
    def spread(self) -> FloatArray:
        """(D,) the population's standard deviations of logarithms."""
        return np.sqrt(np.diag(self.covariance))

    def summary(self) -> Summary:
        """Mean and 90 % interval of every driver's `NUMBERS`, and whether the data tell them."""
        size = len(NUMBERS)
        logs = self.logs[:, :, :size]
        all_mean, all_spread = self.mean[:size], self.spread[:size]
        known = self.known
        outside = (0.05 * (POINTS + 1) - 1.0) / (
            POINTS - 1
        )  # the truth is one more draw of as many
        median, *ends = np.quantile(logs, (0.5, outside, 1.0 - outside), axis=1)
        low, high = (median + self._widths() * (end - median) for end in ends)
        reach = norm.ppf(0.95) * all_spread
        return Summary(
            mean=np.where(known, np.exp(logs).mean(axis=1), np.exp(all_mean + 0.5 * all_spread**2)),
            low=np.exp(np.where(known, low, all_mean - reach)),
            high=np.exp(np.where(known, high, all_mean + reach)),
            known=known,
        )

    def _widths(self) -> FloatArray:
        """(N, 5) see `WIDTHS`."""
        residual = self.logs[:, :, FIELDS[self.law].index(NUISANCES[0])].mean(axis=1)
        exact, noisy = np.array(WIDTHS[self.law])
        share = np.interp(residual, np.log(EXACT_MPS2), (0.0, 1.0))[:, None]
        return np.asarray(exact + share * (noisy - exact))


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
    some = [drives[i] for i in _first(len(drives))]
    drawn: FloatArray | None = None
    counts, newer = 1.0, moving_on(law, some)
    for turn in range(ROUNDS):
        drawn, _ = _draw_all(law, some, mean, covariance, drawn, counts, newer, on_driver)
        if turn == 0:
            counts = agreement(law, some, drawn, newer)
        at, around = mean, covariance
        mean, covariance = _population(law, drawn, at, around, counts)
        drawn = _redrawn(drawn, _ratios(drawn, mean, covariance, at, around), FIRST_POINTS)
    logs, evidence = _draw_all(
        law, drives, mean, covariance, None, counts, newer, on_driver, POINTS, SWEEPS
    )
    at, around = mean, covariance
    mean, covariance = _population(law, logs[:, ::ALL_EVERY], at, around, counts)
    ratios = _ratios(logs, mean, covariance, at, around)
    evidence += np.log(np.exp(ratios).mean(axis=1))
    logs = _redrawn(logs, ratios, logs.shape[1])
    known = np.ones((len(drives), len(NUMBERS)), dtype=bool)
    for i, drive in enumerate(drives):
        unknown = untold(law, drive, logs[i], mean, covariance, counts, newer)
        if unknown.any():
            logs[i] = from_population(logs[i], unknown, mean, covariance, i)
            known[i] = ~unknown
    return Calibration(law, mean, covariance, counts, newer, logs, known, evidence)


def moving_on(law: Law, drives: Sequence[Drive]) -> float:
    """With how much of a step's new speed drivers move on, the rest being the old one's.

    Simulators differ in that, and numbers of exact drives go astray by it. SUMO's Krauss moves by
    the new speed. Under IDM it is the mean of both (who drives as time flows does too), unless
    exact drives are far likelier by the old or by the new one; noisy ones do not tell.
    """
    if law is Law.KRAUSS:
        return 1.0
    mean, covariance = prior(law)
    exact = [one for one in drives if one.rows[1].max() <= EXACT_M]
    some = [exact[i] for i in np.random.default_rng(1).permutation(len(exact))[:LOOKED_AT]]
    if not some:
        return BETWEEN
    more = dict.fromkeys((0.0, 1.0), 0.0)
    for part in (some[:LOOKED_FIRST], some[LOOKED_FIRST:]):
        if not part:
            break
        best = {}
        for newer in (BETWEEN, *more):
            drawn, _ = _draw_all(law, part, mean, covariance, None, 1.0, newer, _nothing)
            told = [
                log_likelihood(law, logs, one, newer) for logs, one in zip(drawn, part, strict=True)
            ]
            best[newer] = np.max(told, axis=1)
        for newer in more:
            by = (best[newer] - best[BETWEEN]).clip(-MOST_TOLD, MOST_TOLD)
            more[newer] += float(by.sum())
        if max(more.values()) < 0.0:
            return BETWEEN
    newer = max(more, key=lambda one: more[one])
    return newer if more[newer] > FAR_LIKELIER * len(some) ** 0.5 else BETWEEN


def drawn_again(
    fitted: Calibration, drives: Sequence[Drive], points: int = 32 * POINTS
) -> FloatArray:
    """(N, M, D) draws of drivers under a fitted population, by a longer run than `calibrate`'s.

    Args:
        fitted: whose population.
        drives: of the drivers.
        points: draws that move together, a multiple of ``filter.LANES``.
    """
    given = (
        fitted.law,
        drives,
        fitted.mean,
        fitted.covariance,
        None,
        fitted.counts,
        fitted.newer,
        _nothing,
    )
    return _draw_all(*given, points, 4 * SWEEPS)[0]


def visits(drivers: int) -> int:
    """How often `calibrate` calls ``on_driver`` for so many drivers."""
    return drivers + ROUNDS * _first(drivers).size


def _first(drivers: int) -> NDArray[np.int64]:
    """Drivers among whom the population is sought: drawn, as files list drivers in turns."""
    return np.sort(np.random.default_rng(0).permutation(drivers)[:MOST_FIRST])


def _log_normal(points: FloatArray, mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Log density of a normal distribution at (..., D) points."""
    away = points - mean
    squared = np.einsum("...i,ij,...j->...", away, np.linalg.inv(covariance), away, optimize=True)
    return np.asarray(-0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * covariance)[1]))


def _draw_all(
    law: Law, drives: Sequence[Drive], mean: FloatArray, covariance: FloatArray,
    starts: FloatArray | None, counts: float, newer: float, on_driver: Callable[[], None],
    points: int = FIRST_POINTS, sweeps: int = FIRST_SWEEPS,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(N, M, D) draws of every driver, and (N,) log-likelihoods of the drives.

    ``starts`` (N, K, D) are draws from about the posterior; None to begin with the population.
    An exact driver's residual is drawn with `EXACT_SPREAD`.
    """
    from graphrqi.calibrate.sampling import sample

    size = mean.size
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    uniform = qmc.Sobol(size, seed=1).random(points).clip(1e-4, 1.0 - 1e-4)
    spread = norm.ppf(uniform) @ np.linalg.cholesky(covariance).T
    residual = FIELDS[law].index(NUISANCES[0])
    wider = np.ones(size)
    wider[residual] = EXACT_SPREAD / covariance[residual, residual] ** 0.5
    logs = np.empty((len(drives), sweeps // 4 * points, size))
    evidence = np.empty(len(drives))
    for i, drive in enumerate(drives):
        scale = wider if drive.rows[1].max() <= EXACT_M else np.ones(size)
        start, blur_m = (mean + scale * spread, BLUR_M) if starts is None else (starts[i], 0.0)
        rng = np.random.default_rng((i, points))
        rows = np.minimum(drive.rows, 1e9)  # leaders that are none
        logs[i], evidence[i] = sample(
            law.code, start, blur_m, counts, mean, precision / np.outer(scale, scale), MOVES,
            sweeps, rng, rows, drive.begins, drive.steps(newer),
        )  # fmt: skip
        on_driver()
    return logs, evidence


def agreement(law: Law, drives: Sequence[Drive], logs: FloatArray, newer: float = BETWEEN) -> float:
    """How much less than it seems drives tell, because their parts disagree.

    Where a law holds, the slopes of the likelihood in different parts of a drive vary as its
    curvature says. Where it does not, or drivers change their minds, they vary by more, and the
    likelihood is to count with the power that makes up for it (as in Ribatet, Cooley, Davison 2012,
    Bayesian inference from composite likelihoods, Statistica Sinica 22, 813).

    Args:
        law: the law.
        drives: of N drivers.
        logs: (N, M, D) draws of each.
        newer: from `moving_on`.

    Returns:
        1 from `HOLDS` on, less where parts disagree more.
    """
    from graphrqi.calibrate.filter import LANES

    size = len(NUMBERS)
    for part_s in PARTS_S:
        parted = [_parts(drive, part_s) for drive in drives]
        if np.mean([len(parts) > 1 for parts in parted]) >= LEAST_PARTED:
            break
    shares = []
    for one, parts in zip(logs, parted, strict=True):
        if len(parts) < 2:
            continue
        centre, spread = one.mean(axis=0), one.std(axis=0)
        around = np.tile(centre, (LANES, 1))
        for d in range(size):
            around[2 * d + 1, d] += STEP * spread[d]
            around[2 * d + 2, d] -= STEP * spread[d]
        told = np.stack([log_likelihood(law, around, part, newer) for part in parts])
        told = told[:, : 2 * size + 1]
        up, down = told[:, 1::2], told[:, 2::2]
        slopes = float(np.var(0.5 * (up - down), axis=0, ddof=1).sum() * len(told))
        curved = float((2.0 * told[:, :1] - up - down).sum())
        shares.append(curved / max(slopes, 1e-12))
    share = float(np.median(shares)) / REACHED if shares else 1.0
    return 1.0 if share > HOLDS else max(share, LEAST_COUNTS)


def _parts(drive: Drive, part_s: float) -> list[Drive]:
    """Parts of about so many seconds of a drive."""
    found = []
    for first, last in pairwise(drive.begins.tolist()):
        watched = first + np.flatnonzero(drive.rows[1, first:last] > 0.0)
        every = max(2, round(part_s / (drive.step_s * float(np.diff(watched).mean()))))
        edges = watched[::every].tolist()
        found += [drive.part(here, there + 1) for here, there in pairwise(edges)]
    return found


def _ratios(
    logs: FloatArray, mean: FloatArray, covariance: FloatArray, drawn_mean: FloatArray,
    drawn_covariance: FloatArray,
) -> FloatArray:  # fmt: skip
    """(N, M) log densities of a population at draws, less those of the one that made them."""
    found = _log_normal(logs, mean, covariance)
    return np.asarray(found - _log_normal(logs, drawn_mean, drawn_covariance))


def _weights(ratios: FloatArray) -> FloatArray:
    """(N, M) weights of draws under another population; see `_ratios`."""
    found = np.exp(ratios - ratios.max(axis=1, keepdims=True))
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def _redrawn(logs: FloatArray, ratios: FloatArray, points: int) -> FloatArray:
    """(N, points, D) of the draws, each as often as its weight asks for."""
    reached = np.cumsum(_weights(ratios), axis=1)
    at = (np.arange(points) + 0.5) / points
    chosen = [np.searchsorted(one / one[-1], at) for one in reached]
    return np.stack([one[rows] for one, rows in zip(logs, chosen, strict=True)])


def _population(
    law: Law, logs: FloatArray, drawn_mean: FloatArray, drawn_covariance: FloatArray,
    counts: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The most likely population given the drivers' draws, which were drawn under another one.

    A law's own error is the same for all drivers, so against the prior a driver counts with the
    same power as its likelihood does; see `MOST_DRIVERS`.

    Size and correlation time of the residual stay as the prior has them: they form a ridge along
    which the draws' noise would carry both away, and what is simulated exactly would make the
    others' residuals small.
    """
    fixed = [FIELDS[law].index(name) for name in NUISANCES[:2]]
    first_mean, first_covariance = prior(law)
    places = np.diag(place_spread(law) ** -2.0)
    n, heard = len(logs), counts * len(logs)
    mean, covariance = drawn_mean, drawn_covariance
    for _ in range(STEPS):
        weight = _weights(_ratios(logs, mean, covariance, drawn_mean, drawn_covariance))
        centre = np.einsum("nm,nmd->d", weight, logs) / n
        told = (heard if counts == 1.0 else min(heard, MOST_DRIVERS)) * np.linalg.inv(covariance)
        mean = np.linalg.solve(told + places, told @ centre + places @ first_mean)
        away = logs - mean
        scatter = np.einsum("nm,nmd,nme->de", weight, away, away, optimize=True)
        covariance = (counts * scatter + PRIOR_DRIVERS * first_covariance) / (heard + PRIOR_DRIVERS)
        mean[fixed] = first_mean[fixed]
        covariance[fixed], covariance[:, fixed] = 0.0, 0.0
        covariance[np.ix_(fixed, fixed)] = first_covariance[np.ix_(fixed, fixed)]
    return mean, covariance
