"""Compiled: how likely a drive is for given numbers, and the posterior of one driver.

A driver's position, speed and residual acceleration are the state of an extended Kalman filter; the
leader's smoothed motion is its input, and the driver's own measured positions are its observations.
The residual acceleration is an Ornstein-Uhlenbeck process. The filter's innovations give the
likelihood of the numbers with both kinds of noise integrated out.

References:
    Särkkä (2013), Bayesian Filtering and Smoothing, algorithm 5.4 and section 12.2.
    Zhang, Sun (2024), Bayesian calibration of the intelligent driver model, IEEE Transactions on
        Intelligent Transportation Systems 25, 9308: autocorrelated residuals.
    Cappé, Guillin, Marin, Robert (2004), Population Monte Carlo, Journal of Computational and
        Graphical Statistics 13, 907; Elvira, Martino, Luengo, Bugallo (2019), Generalized multiple
        importance sampling, Statistical Science 34, 129: weights of a mixture of proposals.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import compiled, inner

HARDEST_MPS2: Final = 10.0
"""No law brakes harder, m/s2 (tyres on a dry road)."""

LEAST_GAP_M: Final = 0.2
"""Gaps count as no smaller, m (our choice: measured ones may be negative)."""

DELTA: Final = 1e-3
"""Step of the differences by which derivatives are found, in logarithms."""

ITERATIONS: Final = 12
"""Most Newton steps to the most likely numbers."""

FREEDOM: Final = 6.0
"""Degrees of freedom of the proposals' Student's t: tails heavier than the posterior's."""

LEAST_RESIDUAL_MPS2: Final = 0.05
"""The residual acceleration's standard deviation is no smaller, m/s2 (our choice: smoothing, and
the unknown step and order of a simulator's own motion, leave about as much)."""

STARTS_SPEED_MPS: Final = 0.5
"""Standard deviation of the speed assumed at the start of a stretch, m/s."""


@inner
def accelerate(law: Any, n: Any, v: Any, u: Any, gap: Any, h: Any) -> Any:
    """A law's acceleration and its derivatives by speed and gap.

    The laws are those of `behaviors.driver_models`, written out once more because the derivatives
    are made of the same terms.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers.
        v: speed, m/s.
        u: the leader's speed, m/s.
        gap: bumper to bumper, m; infinite without a leader.
        h: step, s.
    """
    v0, headway, s0, a, b = n[0], n[1], n[2], n[3], n[4]
    if law == 0:
        ratio = v / v0
        cube = ratio * ratio * ratio
        accel, dv, dg = a * (1.0 - cube * ratio), -4.0 * a * cube / v0, 0.0
        if gap < 1e6:
            g = max(gap, LEAST_GAP_M)
            root = 1.0 / (2.0 * math.sqrt(a * b))
            more = v * headway + v * (v - u) * root
            wanted = s0 + max(more, 0.0)
            share = wanted / g
            accel -= a * share * share
            if more > 0.0:
                dv -= 2.0 * a * share / g * (headway + (2.0 * v - u) * root)
            if gap > LEAST_GAP_M:
                dg = 2.0 * a * share * share / g
    else:
        target, tg = v0, 0.0
        if gap < 1e6:
            reach = b * headway
            root = math.sqrt(max(reach * reach + u * u + 2.0 * b * max(gap - s0, -1.0), 1e-4))
            safe = max(root - reach, 0.0)
            if safe < target:
                target = safe
                if safe > 0.0:
                    tg = b / root
        relax = math.sqrt(h * h + n[7] * n[7])
        accel, dv, dg = (target - v) / relax, -1.0 / relax, tg / relax
        if accel > a:
            accel, dv, dg = a, 0.0, 0.0
    if accel < -HARDEST_MPS2:
        accel, dv, dg = -HARDEST_MPS2, 0.0, 0.0
    return accel, dv, dg


@inner
def innovations(law: Any, n: Any, drive: Any, begins: Any, h: Any, out: Any) -> Any:
    """Run the filter over a drive.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers, not their logarithms.
        drive: (5, T) observed place, m, standard deviation of its error, m (0: not observed),
            speed, m/s, used at the start of each stretch only, rear of the leader, m (infinite:
            none), and the leader's speed, m/s.
        begins: (B + 1,) where in ``drive`` each stretch begins, and T.
        h: time between rows, s.
        out: (2, T) takes innovations and the logarithms of their variances; 0 where not observed.

    Returns:
        The log-likelihood.
    """
    sigma = math.sqrt(n[5] * n[5] + LEAST_RESIDUAL_MPS2 * LEAST_RESIDUAL_MPS2)
    rho = math.exp(-h / n[6])
    q = sigma * sigma * (1.0 - rho * rho)
    total = 0.0
    half = 0.5 * h * h if law == 0 else h * h  # SUMO moves on by the new speed
    for k in range(begins.size - 1):
        first, last = begins[k], begins[k + 1]
        x, v, e = drive[0, first], drive[2, first], 0.0
        r = drive[1, first]
        pxx, pxv, pxe = r * r + 1e-6, 0.0, 0.0
        pvv, pve, pee = STARTS_SPEED_MPS**2, 0.0, sigma * sigma
        for i in range(first + 1, last):
            gap = drive[3, i - 1] - x
            u = drive[4, i - 1]
            if law == 1 and i > first + 1:  # SUMO's speeds are those of the step before a place
                u = 0.5 * (u + drive[4, i - 2])
            accel, dv, dg = accelerate(law, n, v, u, gap, h)
            # one step of motion, and the covariance F P F' + Q with F written out
            f00, f01 = 1.0 - half * dg, h + half * dv
            f10, f11 = -h * dg, 1.0 + h * dv
            f02, f12 = half, h
            pushed = accel + e
            if v + h * pushed <= 0.0:  # it stops, whatever exactly pushes it
                pushed = -v / h
                f00, f01, f02, f10, f11, f12 = 1.0, 0.5 * h, 0.0, 0.0, 0.0, 0.0
            x += v * h + half * pushed
            v = max(v + h * pushed, 0.0)
            e *= rho
            ax = f00 * pxx + f01 * pxv + f02 * pxe
            av = f00 * pxv + f01 * pvv + f02 * pve
            ae = f00 * pxe + f01 * pve + f02 * pee
            bx = f10 * pxx + f11 * pxv + f12 * pxe
            bv = f10 * pxv + f11 * pvv + f12 * pve
            be = f10 * pxe + f11 * pve + f12 * pee
            pxx = ax * f00 + av * f01 + ae * f02
            pxv = ax * f10 + av * f11 + ae * f12
            pvv = bx * f10 + bv * f11 + be * f12
            pxe, pve = ae * rho, be * rho
            pee = pee * rho * rho + q
            if drive[1, i] > 0.0:
                r = drive[1, i]
                s = pxx + r * r
                miss = drive[0, i] - x
                out[0, i], out[1, i] = miss, math.log(s)
                total -= 0.5 * (miss * miss / s + out[1, i])
                kx, kv, ke = pxx / s, pxv / s, pxe / s
                x += kx * miss
                v = max(v + kv * miss, 0.0)
                e += ke * miss
                pvv -= kv * pxv
                pve -= kv * pxe
                pee -= ke * pxe
                pxv -= kx * pxv
                pxe -= kx * pxe
                pxx -= kx * pxx
    return total


@compiled
def likelihood(law: Any, logs: Any, drive: Any, begins: Any, h: Any, out: Any) -> Any:
    """`innovations` for (D,) logarithms of numbers."""
    return innovations(law, np.exp(logs), drive, begins, h, out)


@inner
def penalty(z: Any, mean: Any, precision: Any) -> Any:
    """Half the squared distance to the population's mean, in its own spreads."""
    total = 0.0
    for i in range(z.size):
        for j in range(z.size):
            total += 0.5 * (z[i] - mean[i]) * precision[i, j] * (z[j] - mean[j])
    return total


@compiled
def most_likely(
    law: Any, start: Any, mean: Any, precision: Any, drive: Any, begins: Any, h: Any
) -> Any:
    """The most likely logarithms of a driver, and their precision, by Fisher scoring.

    Args:
        law: code of the law.
        start: (D,) where to begin.
        mean: (D,) the population's mean.
        precision: (D, D) of the population.
        drive: as in `innovations`; so are the next two.
        begins: see there.
        h: see there.

    Returns:
        (D,) logarithms, (D, D) precision there, and the objective.
    """
    size, t = start.size, drive.shape[1]
    base, moved = np.zeros((2, t)), np.zeros((2, t))
    jacobian = np.zeros((size, 2, t))
    z = start.copy()
    value = penalty(z, mean, precision) - innovations(
        law, np.exp(z), drive, begins, h, base)  # fmt: skip
    damping = 1e-2
    information = precision.copy()
    for _ in range(ITERATIONS):
        for d in range(size):
            there = z.copy()
            there[d] += DELTA
            innovations(law, np.exp(there), drive, begins, h, moved)
            for i in range(t):
                jacobian[d, 0, i] = (moved[0, i] - base[0, i]) / DELTA
                jacobian[d, 1, i] = (moved[1, i] - base[1, i]) / DELTA
        gradient = precision @ (z - mean)
        information = precision.copy()
        for k in range(begins.size - 1):
            for i in range(begins[k] + 1, begins[k + 1]):
                if drive[1, i] == 0.0:
                    continue
                over = math.exp(-base[1, i])
                miss = base[0, i]
                for d in range(size):
                    de, ds = jacobian[d, 0, i], jacobian[d, 1, i]
                    gradient[d] += miss * de * over + 0.5 * ds * (1.0 - miss * miss * over)
                    for c in range(d + 1):
                        more = de * jacobian[c, 0, i] * over + 0.5 * ds * jacobian[c, 1, i]
                        information[d, c] += more
                        if c < d:
                            information[c, d] += more
        better = False
        for _ in range(6):
            damped = information.copy()
            for d in range(size):
                damped[d, d] *= 1.0 + damping
            step = np.linalg.solve(damped, gradient)
            length = math.sqrt((step * step).sum())
            if length > 1.5:
                step *= 1.5 / length
            there = z - step
            found = penalty(there, mean, precision) - innovations(
                law, np.exp(there), drive, begins, h, moved)  # fmt: skip
            if found < value:
                better = True
                break
            damping = damping * 6.0 + 1e-3
        if not better:
            break
        gained = value - found
        z, value = there, found
        base[:] = moved
        damping *= 0.2
        if gained < 1e-2:
            break
    return z, information, value


@inner
def t_density(z: Any, mean: Any, lower: Any) -> Any:
    """Log density of Student's t with the Cholesky factor ``lower`` of its scale."""
    size = z.size
    solved = np.zeros(size)
    squared, log_det = 0.0, 0.0
    for i in range(size):
        left = z[i] - mean[i]
        for j in range(i):
            left -= lower[i, j] * solved[j]
        solved[i] = left / lower[i, i]
        squared += solved[i] * solved[i]
        log_det += math.log(lower[i, i])
    constant = (
        math.lgamma(0.5 * (FREEDOM + size)) - math.lgamma(0.5 * FREEDOM)
        - 0.5 * size * math.log(FREEDOM * math.pi)
    )  # fmt: skip
    return constant - log_det - 0.5 * (FREEDOM + size) * math.log1p(squared / FREEDOM)


@inner
def flattened(weight: Any, count: Any, least: Any) -> Any:
    """Weights with at least an effective number of draws, from their logarithms.

    The logarithms are multiplied by the largest factor up to 1 that gives so many.
    """
    top = weight[:count].max()
    low, high, power = 0.0, 1.0, 1.0
    out = np.zeros(count)
    for _ in range(12):
        total, squares = 0.0, 0.0
        for i in range(count):
            out[i] = math.exp(power * (weight[i] - top))
            total += out[i]
            squares += out[i] * out[i]
        if total * total / squares >= least:
            low = power
            if power == 1.0:
                break
        else:
            high = power
        power = 0.5 * (low + high)
    return out / out.sum()


@compiled
def draw(
    law: Any, mode: Any, scale: Any, mean: Any, precision: Any, points: Any, drive: Any,
    begins: Any, h: Any,
) -> Any:  # fmt: skip
    """Weighted draws from a driver's posterior.

    The first points are proposed around the most likely numbers; each later part around the mean
    of all draws so far, with their covariance. All weights are those of the mixture of proposals.

    Args:
        law: code of the law.
        mode: (D,) where the first proposal lies.
        scale: (D, D) its covariance.
        mean: (D,) the population's mean.
        precision: (D, D) of the population.
        points: (P, M, D) draws of a standard Student's t with `FREEDOM` degrees, in P parts.
        drive: as in `innovations`; so are the next two.
        begins: see there.
        h: see there.

    Returns:
        (P M, D) logarithms, (P M,) log-likelihoods, and (P M,) log densities of the proposals.
    """
    parts, m, size = points.shape
    z = np.zeros((parts * m, size))
    told, out = np.zeros(parts * m), np.zeros((2, drive.shape[1]))
    mixed, weight = np.zeros(parts * m), np.zeros(parts * m)
    centres, lowers = np.zeros((parts, size)), np.zeros((parts, size, size))
    centres[0], lowers[0] = mode, np.linalg.cholesky(scale)
    for part in range(parts):
        count = (part + 1) * m
        for i in range(part * m, count):
            z[i] = centres[part] + lowers[part] @ points[part, i - part * m]
            told[i] = innovations(law, np.exp(z[i]), drive, begins, h, out)
        for i in range(count):
            top, total = -1e300, 0.0
            for p in range(part + 1):
                one = t_density(z[i], centres[p], lowers[p])
                if one > top:
                    total = total * math.exp(top - one) + 1.0
                    top = one
                else:
                    total += math.exp(one - top)
            mixed[i] = top + math.log(total / (part + 1))
            weight[i] = told[i] - penalty(z[i], mean, precision) - mixed[i]
        if part + 1 < parts:
            share = flattened(weight, count, 4.0 * size)
            for d in range(size):
                centres[part + 1, d] = (share * z[:count, d]).sum()
            spread = 0.05 * scale
            for i in range(count):
                away = z[i] - centres[part + 1]
                for d in range(size):
                    for c in range(size):
                        spread[d, c] += share[i] * away[d] * away[c]
            lowers[part + 1] = np.linalg.cholesky(spread)
    return z, told, mixed


@compiled
def drive_on(law: Any, n: Any, drive: Any, h: Any) -> Any:
    """Drive behind a recorded leader by a law, from where the driver was first seen.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers.
        drive: (5, T) as in `innovations`: one stretch.
        h: time between rows, s.

    Returns:
        (T,) places, m.
    """
    out = np.zeros(drive.shape[1])
    x, v = drive[0, 0], drive[2, 0]
    out[0] = x
    for i in range(1, out.size):
        u = drive[4, i - 1]
        if law == 1 and i > 1:
            u = 0.5 * (u + drive[4, i - 2])
        accel, _, _ = accelerate(law, n, v, u, drive[3, i - 1] - x, h)
        faster = max(v + h * accel, 0.0)
        x += 0.5 * h * (v + faster) if law == 0 else h * faster
        v = faster
        out[i] = x
    return out


@compiled
def local_parabolas(time_s: Any, values: Any, at_s: Any, half_s: Any, out: Any) -> None:
    """Fit a parabola to the values around each of some times, by least squares.

    Args:
        time_s: (n,) increasing, s.
        values: (n,) measured then.
        at_s: (k,) increasing, s.
        half_s: values no farther than this from a time count, s; the nearest three do in any case.
        out: (4, k) takes value, slope and second derivative at these times, and the standard
            deviation of that value over that of the measurements.
    """
    n = time_s.size
    first = 0
    for k in range(at_s.size):
        while first < n and time_s[first] < at_s[k] - half_s - 1e-9:
            first += 1
        begin, end = first, first
        while end < n and time_s[end] <= at_s[k] + half_s + 1e-9:
            end += 1
        while end - begin < 3 and (begin > 0 or end < n):
            before = at_s[k] - time_s[begin - 1] if begin > 0 else 1e9
            after = time_s[end] - at_s[k] if end < n else 1e9
            if before <= after:
                begin -= 1
            else:
                end += 1
        moments, sums = np.zeros((3, 3)), np.zeros(3)
        base = values[begin]
        for i in range(begin, end):
            t = time_s[i] - at_s[k]
            powers = (1.0, t, t * t)
            for r in range(3):
                sums[r] += powers[r] * (values[i] - base)
                for c in range(3):
                    moments[r, c] += powers[r] * powers[c]
        if end - begin < 3:
            out[0, k], out[1, k], out[2, k], out[3, k] = base, 0.0, 0.0, 1.0
            if end - begin == 2:
                slope = (values[end - 1] - base) / (time_s[end - 1] - time_s[begin])
                out[0, k], out[1, k] = base + slope * (at_s[k] - time_s[begin]), slope
            continue
        inverse = np.linalg.inv(moments)
        solved = inverse @ sums
        out[0, k], out[1, k], out[2, k] = base + solved[0], solved[1], 2.0 * solved[2]
        out[3, k] = math.sqrt(inverse[0, 0])
