"""Compiled: draws from one driver's posterior, by tempered sequential Monte Carlo.

Draws begin spread over the population and are moved towards the posterior: the places are blurred
at first, and the blur shrinks step by step. In each step the draws are resampled by what the
sharper places add, and moved by Metropolis's rule: in turn afresh, from a Student's t around all of
them, and by a step with their own covariance. No mode is sought and no derivative taken, so that
kinks in a law and several modes do no harm. (Raising the likelihood's power step by step instead
strands on the way to exact drives: as long as few numbers fit, large residuals do.)

References:
    Del Moral, Doucet, Jasra (2006), Sequential Monte Carlo samplers, Journal of the Royal
        Statistical Society B 68, 411.
    Haario, Saksman, Tamminen (2001), An adaptive Metropolis algorithm, Bernoulli 7, 223.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from graphrqi.calibrate.filter import tell
from sim.compiled import compiled, inner

SHARE, LEAST_SHARE = 0.5, 0.2
"""The blur shrinks by so much that this share of the draws counts; if less than the second one
does, it shrinks by half as much (usual in this method)."""

FIRST_SHRINKS: Final = 0.5
"""By the exponential of so much the blur shrinks at first (our choice)."""

BLUR_ENDS: Final = 0.3
"""Blur that is no longer seen, in standard deviations of the places' own errors."""

MOST_BLUR_M: Final = 1e4
"""At this blur nothing is told, m."""

ACCEPTED: Final = 0.25
"""Share of steps that are to be accepted (Roberts, Gelman, Gilks 1997: .234)."""

FREEDOM: Final = 6
"""Degrees of freedom of the draws that are proposed afresh: heavier tails than the posterior's. A
multiple of 2."""

ADAPTS: Final = 0.7
"""How fast the steps' length follows that (our choice)."""

SPREADS: Final = 0.5
"""Log-normal spread of the steps' length (our choice: short ones help at kinks)."""


@inner
def log_normal(z: Any, mean: Any, precision: Any) -> Any:
    """Log density of a normal distribution at (D,) z, but for its constant."""
    total = 0.0
    for i in range(z.size):
        away = z[i] - mean[i]
        total += 0.5 * precision[i, i] * away * away
        for j in range(i):
            total += precision[i, j] * away * (z[j] - mean[j])
    return -total


@inner
def spread_of(z: Any, centre: Any) -> Any:
    """(D, D) Cholesky factor of the covariance of (K, D) draws; ``centre`` takes their mean."""
    count, size = z.shape
    spread = np.zeros((size, size))
    centre[:] = 0.0
    for i in range(count):
        for d in range(size):
            centre[d] += z[i, d] / count
    for i in range(count):
        for d in range(size):
            for c in range(d + 1):
                spread[d, c] += (z[i, d] - centre[d]) * (z[i, c] - centre[c]) / count
    for d in range(size):
        spread[d, d] = spread[d, d] * 1.02 + 1e-10
        for c in range(d):
            spread[c, d] = spread[d, c]
    return np.linalg.cholesky(spread)


@inner
def log_student(z: Any, centre: Any, lower: Any, solved: Any) -> Any:
    """Log density of Student's t with `FREEDOM` degrees, but for its constant."""
    squared = 0.0
    for i in range(z.size):
        left = z[i] - centre[i]
        for j in range(i):
            left -= lower[i, j] * solved[j]
        solved[i] = left / lower[i, i]
        squared += solved[i] * solved[i]
    return -0.5 * (FREEDOM + z.size) * math.log1p(squared / FREEDOM)


@inner
def blurred(
    law: Any, z: Any, blur_m: Any, counts: Any, drive: Any, begins: Any, steps: Any, out: Any
) -> None:
    """``filter.tell`` times ``counts``."""
    tell(law, z, blur_m, drive, begins, steps, out)
    for i in range(out.size):
        out[i] *= counts


@inner
def share_left(gain: Any) -> Any:
    """Which share of draws is left, effectively, by weights of these logarithms."""
    top, total, squares = gain.max(), 0.0, 0.0
    for i in range(gain.size):
        weight = math.exp(gain[i] - top)
        total += weight
        squares += weight * weight
    return total * total / (squares * gain.size)


@compiled
def sample(
    law: Any, start: Any, blur_m: Any, counts: Any, mean: Any, precision: Any, moves: Any,
    sweeps: Any, rng: Any, drive: Any, begins: Any, steps: Any,
) -> Any:  # fmt: skip
    """Draw from a driver's posterior.

    Args:
        law: code of the law.
        start: (K, D) draws to begin with; K is a multiple of ``filter.LANES``.
        blur_m: blur of places to begin with, m, if they are drawn from the population; 0 if they
            are drawn from about the posterior.
        counts: power with which the likelihood counts.
        mean: (D,) of the population.
        precision: (D, D) of the population.
        moves: steps of all draws at each blur.
        sweeps: so many steps follow without any; of the later half, every other one is returned.
        rng: source of the steps.
        drive: as in ``filter.tell``; so are the next two.
        begins: see there.
        steps: see there.

    Returns:
        (sweeps // 4 * K, D) draws, all alike, and the log-likelihood of the drive under the
        population, with that power (0 unless drawn from the population).
    """
    count, size = start.shape
    z, told, known = start.copy(), np.zeros(count), np.zeros(count)
    there, found, gain = np.zeros((count, size)), np.zeros(count), np.zeros(count)
    before, known_before = z.copy(), known.copy()
    kept = np.zeros((sweeps // 4 * count, size))
    step, centre = np.zeros(size), np.zeros(size)
    evidence, length, shrinks, at_sweep = 0.0, 2.38 / math.sqrt(size), FIRST_SHRINKS, 0
    for i in range(count):
        known[i] = log_normal(z[i], mean, precision)
    exact_m = 0.0
    for i in range(begins[0], begins[1]):
        exact_m = max(exact_m, BLUR_ENDS * drive[1, i])
    fresh = blur_m > 0.0
    if not fresh:
        blurred(law, z, 0.0, counts, drive, begins, steps, told)
    while True:
        if fresh or blur_m > 0.0:
            sharper = blur_m if fresh else blur_m * math.exp(-shrinks)
            while True:
                if sharper < exact_m:
                    sharper = 0.0
                blurred(law, z, sharper, counts, drive, begins, steps, found)
                for i in range(count):
                    gain[i] = found[i] - told[i]
                left = share_left(gain)
                if left >= LEAST_SHARE or sharper > MOST_BLUR_M or shrinks < 1e-3:
                    break
                if fresh:
                    sharper *= 2.0
                else:
                    shrinks *= 0.5
                    sharper = blur_m * math.exp(-shrinks)
            if not fresh:  # the logarithm of the share falls with the square of the step
                wanted = math.sqrt(math.log(SHARE) / min(math.log(left), -1e-3))
                shrinks *= min(max(wanted, 0.5), 2.0)
            fresh, blur_m = False, sharper
            top, total = gain.max(), 0.0
            for i in range(count):
                gain[i] = math.exp(gain[i] - top)
                total += gain[i]
            evidence += math.log(total / count) + top
            before[:], known_before[:] = z, known
            at, reached, chosen = rng.random(), gain[0], 0
            for i in range(count):
                while reached < (at + i) * total / count and chosen < count - 1:
                    chosen += 1
                    reached += gain[chosen]
                z[i], told[i], known[i] = before[chosen], found[chosen], known_before[chosen]
        last = blur_m == 0.0
        lower = spread_of(z, centre)
        for sweep in range(sweeps if last else moves):
            if last and sweep == sweeps // 2:
                lower = spread_of(z, centre)
            at_sweep += 1
            afresh = at_sweep % 2 == 0
            far = length * math.exp(SPREADS * rng.standard_normal())
            for i in range(count):
                if afresh:
                    gamma = 1.0
                    for _ in range(FREEDOM // 2):
                        gamma *= 1.0 - rng.random()
                    far = math.sqrt(-0.5 * FREEDOM / math.log(gamma))
                for d in range(size):
                    step[d] = far * rng.standard_normal()
                for d in range(size):
                    moved = centre[d] if afresh else z[i, d]
                    for c in range(d + 1):
                        moved += lower[d, c] * step[c]
                    there[i, d] = moved
            blurred(law, there, blur_m, counts, drive, begins, steps, found)
            accepted = 0.0
            for i in range(count):
                beside = log_normal(there[i], mean, precision)
                more = found[i] - told[i] + beside - known[i]
                if afresh:
                    more += log_student(z[i], centre, lower, step)
                    more -= log_student(there[i], centre, lower, step)
                chance = math.exp(min(more, 0.0))
                accepted += chance / count
                if rng.random() < chance:
                    z[i] = there[i]
                    told[i], known[i] = found[i], beside
            if not afresh:
                length *= math.exp(ADAPTS * (accepted - ACCEPTED))
            later = sweep - sweeps // 2
            if last and later > 0 and later % 2 == 1 and later // 2 < sweeps // 4:
                kept[later // 2 * count : (later // 2 + 1) * count] = z
        if last:
            return kept, evidence
