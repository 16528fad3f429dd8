"""Compiled: how likely a drive is for many drivers' numbers at once.

A driver's position, speed and residual acceleration are the state of an extended Kalman filter; the
leader's smoothed motion is its input, and the driver's own measured positions are its observations.
The residual acceleration is an Ornstein-Uhlenbeck process. The filter's innovations give the
likelihood of the numbers with both kinds of noise integrated out. `LANES` drivers' filters run side
by side, so that the processor computes several of them in one instruction.

References:
    Särkkä (2013), Bayesian Filtering and Smoothing, algorithm 5.4 and section 12.2.
    Zhang, Sun (2024), Bayesian calibration of the intelligent driver model, IEEE Transactions on
        Intelligent Transportation Systems 25, 9308: autocorrelated residuals.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from graphrqi.calibrate.drives import LEAST_NOISE_M
from graphrqi.calibrate.kernels import HARDEST_MPS2, LEAST_GAP_M
from sim.compiled import reordered

LANES: Final = 32
"""Filters that run side by side; the number of drivers is a multiple."""

LEAST_RESIDUAL_MPS2: Final = 0.003
"""The residual acceleration's standard deviation is no smaller, m/s2 (our choice: what a leader's
motion through three exact places is wrong by)."""

LEADER_ERROR_MPS, LEADER_ERROR_S = 0.0005, 1.7
"""Error of the leader's smoothed speed: for exact places, m/s, and the time that divides what
places err by more than exact ones do, s (found for stretches of `drives.LEAST_HALF_S` to
`drives.MOST_HALF_S`). Krauss's driver takes its speed from its leader's, so this adds to its
residual there."""

STARTS_SPEED_MPS: Final = 0.5
"""Standard deviation of the speed assumed at the start of a stretch, m/s."""

FACTORS: Final = 8
"""So many variances are multiplied before their logarithm is taken, which takes longer than all
else that an observation asks for."""

ROWS: Final = 32
"""Rows of the working array: a row for each quantity of a filter, a column for each filter."""


@reordered
def tell(law: Any, logs: Any, blur_m: Any, drive: Any, begins: Any, steps: Any, out: Any) -> None:
    """Log-likelihoods of a drive, by the filter's innovations.

    The laws are those of `behaviors.driver_models`, written out once more because their derivatives
    are made of the same terms. Krauss's driver dawdles as SUMO's does: in each step it loses a
    uniform share of up to ``imperfection`` of its acceleration, whose mean and variance are taken.
    It reacts after one step of its own; where that is shorter than the filter's, it is looked at
    where it will be so long before the filter's step ends.

    Args:
        law: code of the law.
        logs: (K, D) logarithms of numbers, columns as ``laws.FIELDS``; K is a multiple of `LANES`.
        blur_m: standard deviation of an error that is added to those of all places, m.
        drive: (5, T) observed place, m, standard deviation of its error, m (0: not observed),
            speed, m/s, used at the start of each stretch only, rear of the leader, m (1e9 or
            more: none), and the leader's speed, m/s; all finite.
        begins: (B + 1,) where in ``drive`` each stretch begins, and T.
        steps: (3,) time between rows, s, a simulator's own step, s, no longer, and with how much
            of its new speed it moves on, the rest being the old one's.
        out: (K,) takes them.
    """
    # v0, T, s0, a, b | sigma^2, rho, q | root, relax, total | x, v, e | P | a, dv, dg | product of
    # variances | dawdle, share of the residual that counts | 1 / v0
    s = np.zeros((ROWS, LANES))
    blur = blur_m * blur_m
    h, own, newer = steps[0], steps[1], steps[2]
    half = 0.5 * h * (h + (2.0 * newer - 1.0) * own)
    ahead = h - own if law == 1 else 0.0
    later = (ahead - (newer - 0.5) * own) / h  # new speeds are those of the step before a place
    for begin in range(0, logs.shape[0], LANES):
        for j in range(LANES):
            for d in range(5):
                s[d, j] = math.exp(logs[begin + j, d])
            sigma = math.exp(logs[begin + j, 5])
            s[5, j] = sigma * sigma + LEAST_RESIDUAL_MPS2 * LEAST_RESIDUAL_MPS2
            rho = math.exp(-h * math.exp(-logs[begin + j, 6]))
            s[6, j] = rho
            s[7, j] = s[5, j] * (1.0 - rho * rho)
            s[8, j] = 0.5 / math.sqrt(s[3, j] * s[4, j])
            s[9, j] = s[10, j] = s[24, j] = 0.0
            s[23, j], s[27, j] = 1.0, 1.0 / s[0, j]
            if law == 1:
                relax = math.exp(logs[begin + j, 7])
                s[9, j] = 1.0 / math.sqrt(h * h + relax * relax)
                s[24, j] = min(math.exp(logs[begin + j, 8]), 1.0)
            s[26, j] = 1.0
        factors = 0
        for k in range(begins.size - 1):
            first, last = begins[k], begins[k + 1]
            r = drive[1, first]
            errs = max(r * r - LEAST_NOISE_M**2, 0.0)  # exact places of its own are shaken
            unsure = LEADER_ERROR_MPS**2 + errs / LEADER_ERROR_S**2
            for j in range(LANES):
                s[25, j] = math.sqrt(1.0 + unsure * s[9, j] * s[9, j] / s[5, j])
                s[11, j], s[12, j], s[13, j] = drive[0, first], drive[2, first], 0.0
                s[14, j], s[15, j], s[16, j] = r * r + blur + 1e-6, 0.0, 0.0
                s[17, j], s[18, j], s[19, j] = STARTS_SPEED_MPS**2, 0.0, s[5, j]
            for i in range(first + 1, last):
                lead, u = drive[3, i - 1], drive[4, i - 1]
                if law == 1:
                    lead = min(lead, 1e6) + u * ahead
                if later > 0.0:
                    u += later * (drive[4, i] - u)
                elif i > first + 1:
                    u -= later * (drive[4, i - 2] - u)
                if law == 1:
                    for j in range(LANES):
                        v, a, b = s[12, j], s[3, j], s[4, j]
                        reach = b * s[1, j]
                        beyond = max(lead - s[11, j] - v * ahead - s[2, j], -1.0)
                        root = math.sqrt(max(reach * reach + u * u + 2.0 * b * beyond, 1e-4))
                        safe = max(root - reach, 0.0)
                        tg = b / root if (safe < s[0, j]) and (safe > 0.0) else 0.0
                        accel = (min(safe, s[0, j]) - v) * s[9, j]
                        most = accel > a
                        hard = accel < -HARDEST_MPS2
                        s[20, j] = -HARDEST_MPS2 if hard else (a if most else accel)
                        s[21, j] = 0.0 if hard or most else -s[9, j] * (1.0 + tg * ahead)
                        s[22, j] = 0.0 if hard or most else tg * s[9, j]
                        s[26, j] = 1.0 if hard or most else s[25, j]
                elif lead < 1e9:
                    for j in range(LANES):
                        v, a = s[12, j], s[3, j]
                        ratio = v * s[27, j]
                        cube = ratio * ratio * ratio
                        gap = lead - s[11, j]
                        over = 1.0 / max(gap, LEAST_GAP_M)
                        more = v * s[1, j] + v * (v - u) * s[8, j]
                        slope = s[1, j] + (2.0 * v - u) * s[8, j]
                        slope = slope if more > 0.0 else 0.0
                        share = (s[2, j] + max(more, 0.0)) * over
                        accel = a * (1.0 - cube * ratio - share * share)
                        dv = -4.0 * a * cube * s[27, j] - 2.0 * a * share * over * slope
                        dg = 2.0 * a * share * share * over
                        dg = dg if gap > LEAST_GAP_M else 0.0
                        hard = accel < -HARDEST_MPS2
                        s[20, j] = -HARDEST_MPS2 if hard else accel
                        s[21, j] = 0.0 if hard else dv
                        s[22, j] = 0.0 if hard else dg
                else:
                    for j in range(LANES):
                        ratio = s[12, j] * s[27, j]
                        cube = ratio * ratio * ratio
                        s[20, j] = s[3, j] * (1.0 - cube * ratio)
                        s[21, j] = -4.0 * s[3, j] * cube * s[27, j]
                        s[22, j] = 0.0
                for j in range(LANES):  # motion, and the covariance F P F' + Q with F written out
                    accel, dv, dg = s[20, j], s[21, j], s[22, j]
                    x, v, e, rho = s[11, j], s[12, j], s[13, j], s[6, j]
                    pxx, pxv, pxe = s[14, j], s[15, j], s[16, j]
                    pvv, pve, pee = s[17, j], s[18, j], s[19, j]
                    pushed = accel + s[26, j] * e
                    stops = v + h * pushed <= 0.0  # whatever exactly pushes it
                    pushed = -v / h if stops else pushed
                    lost = s[24, j] * min(max(v + h * pushed, 0.0), s[3, j]) * h
                    pushed -= 0.5 * lost / h
                    f00 = 1.0 if stops else 1.0 - half * dg
                    f01 = 0.5 * h if stops else h + half * dv
                    f10 = 0.0 if stops else -h * dg
                    f11 = 0.0 if stops else 1.0 + h * dv
                    f02 = 0.0 if stops else half * s[26, j]
                    f12 = 0.0 if stops else h * s[26, j]
                    s[11, j] = x + v * h + half * pushed
                    s[12, j] = max(v + h * pushed, 0.0)
                    s[13, j] = e * rho
                    ax = f00 * pxx + f01 * pxv + f02 * pxe
                    av = f00 * pxv + f01 * pvv + f02 * pve
                    ae = f00 * pxe + f01 * pve + f02 * pee
                    bx = f10 * pxx + f11 * pxv + f12 * pxe
                    bv = f10 * pxv + f11 * pvv + f12 * pve
                    be = f10 * pxe + f11 * pve + f12 * pee
                    uneven = lost * lost * (1.0 / 12.0)
                    s[14, j] = ax * f00 + av * f01 + ae * f02 + h * h * uneven
                    s[15, j] = ax * f10 + av * f11 + ae * f12 + h * uneven
                    s[17, j] = bx * f10 + bv * f11 + be * f12 + uneven
                    s[16, j], s[18, j] = ae * rho, be * rho
                    s[19, j] = pee * rho * rho + s[7, j]
                r = drive[1, i]
                if r > 0.0:
                    for j in range(LANES):
                        pxx, pxv, pxe = s[14, j], s[15, j], s[16, j]
                        variance = pxx + r * r + blur
                        over = 1.0 / variance
                        miss = drive[0, i] - s[11, j]
                        s[10, j] -= 0.5 * miss * miss * over
                        s[23, j] *= variance
                        kx, kv, ke = pxx * over, pxv * over, pxe * over
                        s[11, j] += kx * miss
                        s[12, j] = max(s[12, j] + kv * miss, 0.0)
                        s[13, j] += ke * miss
                        s[17, j] -= kv * pxv
                        s[18, j] -= kv * pxe
                        s[19, j] -= ke * pxe
                        s[15, j] -= kx * pxv
                        s[16, j] -= kx * pxe
                        s[14, j] -= kx * pxx
                    factors += 1
                    if factors == FACTORS:
                        factors = 0
                        for j in range(LANES):
                            s[10, j] -= 0.5 * math.log(s[23, j])
                            s[23, j] = 1.0
        for j in range(LANES):
            out[begin + j] = s[10, j] - 0.5 * math.log(s[23, j])
