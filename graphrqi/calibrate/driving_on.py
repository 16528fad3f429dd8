"""Driving recorded drivers on: which numbers foretell a driver's gaps for half a minute.

The posterior of `graphrqi.calibrate.posterior` judges numbers by what a driver does within the next
second. Real drivers change their minds, and no law holds exactly; numbers that are too sure of that
go astray over half a minute. Here candidates are judged by the gaps that they would have kept over
the known past, each driver's past counting as a few independent observations only, and the gap that
is told is the mean over the candidates' weights. They are judged from several moments of the past
on, so that what a driver did lately counts more, and as people of a population that the pasts of
all drivers tell. Who lately accelerated otherwise than a candidate would have done goes on with
half of that, which fades.

References:
    Treiber, Kesting (2013), Microscopic calibration and validation of car-following models,
        Procedia Social and Behavioral Sciences 80, 922: calibration by simulated gaps.
    Laird (1978), Nonparametric maximum likelihood estimation of a mixing distribution, Journal of
        the American Statistical Association 73, 805: the candidates' shares in the population.
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
from graphrqi.calibrate.drives import FINEST_S, Drive
from graphrqi.calibrate.laws import FIELDS, Law, prior

FloatArray = NDArray[np.float64]

CANDIDATES: Final = 1024
"""Drivers that are tried: half drawn from the prior of `laws`, half around the pooled driver."""

POOLED_SPREAD: Final = 0.4
"""Log-normal spread of the latter (our choice, as that of the prior)."""

OBSERVATIONS: Final = 4.0
"""As so many independent observations each driver's past counts (of 2, 3, 4, 6 and 8, it foretells
the second halves of 300 training pairs of I-80 best, by the mean square)."""

SINCE: Final = (0.0, 0.25, 0.5, 0.75)
"""From these shares of its past on a driver is driven to the end of it. On I-80's training pairs
the foretold gaps err 3 % less than with the whole past alone, at SinD's junction 4 %; only the
later half or the last quarter foretells worse."""

ROUNDS, KEPT_PRIOR = 10, 0.5
"""Rounds in which the candidates' shares in the population are estimated, and which part of the
shares stays equal (our choice: among a few drivers, they would follow those alone)."""

LATELY_S, CARRIED, FADES_S = 1.0, 0.5, 5.0
"""A driver's residual acceleration is its mean over so many seconds, s; this share of it is carried
on, and fades within so many, s (our choice: between .5 and .75, 3 and 10 s the errors of I-80's
training pairs, whole and in pieces of 14 and 30 s, of OpenACC's, SinD's and Lankershim's followers
hardly differ, and the smaller share suits recordings that tremble). The .19 m/s2 for 1.3 s of
`laws` are what a law leaves unexplained from moment to moment; this is what a driver has in
mind."""

SMOOTHED_HALF_S: Final = 0.5
"""Half the stretch over which speeds and the leader's motion are smoothed, s (our choice: NGSIM's
tremble for as long; where recordings do not tremble, it changes no error by more than 1 %)."""

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
    """The longest stretch behind one leader, ready to drive on; None if there is none."""
    found = _longest(drive)
    return None if found is None else _smoothed(found)


def _longest(drive: Drive) -> Drive | None:
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


def _smoothed(drive: Drive) -> Drive:
    """A stretch behind a leader with smooth speeds, in steps of `FINEST_S` at most."""
    from graphrqi.calibrate.kernels import local_parabolas

    every = int(np.ceil(drive.step_s / FINEST_S - 1e-6))
    had_s = drive.step_s * np.arange(drive.rows.shape[1])
    size = every * (had_s.size - 1) + 1
    at_s = drive.step_s / every * np.arange(size)
    rows, fitted = np.zeros((5, size)), np.empty((4, size))
    rows[:2, ::every] = drive.rows[:2]
    local_parabolas(had_s, np.ascontiguousarray(drive.rows[2]), at_s, SMOOTHED_HALF_S, fitted)
    rows[2] = np.maximum(fitted[0], 0.0)
    local_parabolas(had_s, np.ascontiguousarray(drive.rows[3]), at_s, SMOOTHED_HALF_S, fitted)
    rows[3], rows[4] = fitted[0], np.maximum(fitted[1], 0.0)
    return Drive(rows, np.array([0, size]), drive.step_s / every, drive.frame_s)


def halves(drive: Drive) -> tuple[Drive, Drive] | None:
    """The longest stretch behind one leader, cut in its middle; None if there is none.

    Returns:
        Its first and its second half, ready to drive on; both hold the moment between them, whose
        speed the first half tells.
    """
    found = _longest(drive)
    if found is None:
        return None
    watched = np.flatnonzero(found.rows[1] > 0.0)
    if watched.size < 5:
        return None
    middle = int(watched[watched.size // 2])
    first = _smoothed(found.part(0, middle + 1))
    second = _smoothed(found.part(middle, found.rows.shape[1]))
    second.rows[2, 0] = first.rows[2, -1]
    return first, second


def _numbers(law: Law, logs: FloatArray) -> FloatArray:
    """(M, D) numbers, columns as ``laws.FIELDS[law]``, of (M, 5) or more logarithms.

    The others count as 1: a driver reaches the safe speed of Krauss's law in 1 s.
    """
    filled = np.ones((len(logs), len(FIELDS[law])))
    filled[:, : logs.shape[1]] = np.exp(logs)
    return filled


def driven_places(
    law: Law, logs: FloatArray, drive: Drive, residuals: FloatArray | float = 0.0
) -> FloatArray:
    """(M, T) places, m, of M drivers who start as recorded and drive behind the recorded leader.

    Args:
        law: the law.
        logs: (M, D) logarithms of their numbers, columns as ``laws.FIELDS[law]`` or `NUMBERS`.
        drive: one stretch.
        residuals: (M,) accelerations beside the law's at first, m/s2; they fade in `FADES_S`.
    """
    from graphrqi.calibrate.kernels import drive_on

    kept = float(np.exp(-drive.step_s / FADES_S))
    each = np.broadcast_to(np.asarray(residuals, dtype=np.float64), len(logs))
    return np.stack(
        [
            drive_on(law.code, n, drive.rows, drive.step_s, float(residual), kept)
            for n, residual in zip(_numbers(law, logs), each, strict=True)
        ]
    )


def carried_on(law: Law, logs: FloatArray, past: Drive) -> FloatArray:
    """(M,) accelerations, m/s2, that M drivers carry on with beside the law's; see `CARRIED`.

    Args:
        law: the law.
        logs: (M, D) logarithms of their numbers, columns as ``laws.FIELDS[law]`` or `NUMBERS`.
        past: the stretch before.
    """
    from graphrqi.calibrate.kernels import mean_residual

    size = past.rows.shape[1]
    last = slice(max(size - 1 - round(LATELY_S / past.step_s), 0), size)
    watched = np.flatnonzero(past.rows[1] > 0.0)
    places = np.interp(np.arange(size)[last], watched, past.rows[0, watched])
    rows = np.ascontiguousarray(past.rows[:, last])
    found = [mean_residual(law.code, n, rows, places, past.step_s) for n in _numbers(law, logs)]
    return CARRIED * np.array(found)


def past_errors(law: Law, logs: FloatArray, past: Drive) -> FloatArray:
    """(M,) root mean square errors of the gaps that M drivers would have kept, m; see `SINCE`.

    Args:
        law: the law.
        logs: (M, D) logarithms of their numbers, columns as ``laws.FIELDS[law]`` or `NUMBERS`.
        past: one stretch.
    """
    watched = np.flatnonzero(past.rows[1] > 0.0)
    squares, count = np.zeros(len(logs)), 0
    for share in SINCE:
        first = int(watched[round(share * (watched.size - 1))])
        part = past.part(first, past.rows.shape[1])
        held = int((part.rows[1] > 0.0).sum())
        squares += held * gap_errors(driven_places(law, logs, part), part) ** 2
        count += held
    return np.asarray(np.sqrt(squares / count))


def foretold_places(
    law: Law, logs: FloatArray, weight: FloatArray, past: Drive, ahead: Drive
) -> FloatArray:
    """(T,) places, m, that are told of a driver: the candidates' mean.

    Args:
        law: the law.
        logs: (M, D) logarithms of candidates' numbers.
        weight: (M,) of the candidates, from `candidate_weights`.
        past: a stretch.
        ahead: the stretch after it.
    """
    residuals = carried_on(law, logs, past)
    return np.asarray(weight @ driven_places(law, logs, ahead, residuals))


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
    """(N, M) weights of M candidates by the errors of their gaps over N drivers' pasts, m.

    Normal errors of unknown size: the likelihood falls with a power of the error. A candidate
    counts as much beforehand as it does among all the drivers, see `KEPT_PRIOR`.

    Examples:
        >>> candidate_weights(np.array([[1.0, 2.0]])).round(3)
        array([[0.978, 0.022]])
    """
    least = errors.min(axis=1, keepdims=True)
    likely = (np.maximum(least, 1e-9) / np.maximum(errors, 1e-9)) ** OBSERVATIONS
    equal = 1.0 / errors.shape[1]
    share = np.full(errors.shape[1], equal)
    for _ in range(ROUNDS):
        weight = likely * share
        weight /= weight.sum(axis=1, keepdims=True)
        share = (1.0 - KEPT_PRIOR) * weight.mean(axis=0) + KEPT_PRIOR * equal
    weight = likely * share
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
