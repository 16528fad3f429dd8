"""The compiled loops that turn a network's numbers into places."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim.compiled import compiled, reordered


@compiled
def decode(
    raw: Any, bases: Any, time_s: Any, spread_scale: float, least_spread: float
) -> tuple[Any, Any, Any]:
    """The network's numbers as futures.

    Args:
        raw: (n, K, B + 3 J + 1) per future weights of the bases, residuals of the knots, logarithms
            of the spreads, and a score.
        bases: (n, B, J, 2) m.
        time_s: (J,) of the knots, s.
        spread_scale: factor of all spreads.
        least_spread: no spread is smaller, m.

    Returns:
        (n, K, J, 2) places, m, (n, K, J) spreads, m, and (n, K) probabilities, the first of which
        is the largest.
    """
    n, modes = raw.shape[0], raw.shape[1]
    count, knots = bases.shape[1], bases.shape[2]
    own, spread = np.empty((n, modes, knots, 2)), np.empty((n, modes, knots))
    probability, weight = np.empty((n, modes)), np.empty(count)
    for i in range(n):
        best = -np.inf
        for k in range(modes):
            best = max(best, raw[i, k, -1])
            most, total = -np.inf, 0.0
            for b in range(count):
                most = max(most, raw[i, k, b])
            for b in range(count):
                weight[b] = math.exp(raw[i, k, b] - most)
                total += weight[b]
            for j in range(knots):
                x = total * time_s[j] * raw[i, k, count + 2 * j]
                y = total * time_s[j] * raw[i, k, count + 2 * j + 1]
                for b in range(count):
                    x += weight[b] * bases[i, b, j, 0]
                    y += weight[b] * bases[i, b, j, 1]
                own[i, k, j, 0], own[i, k, j, 1] = x / total, y / total
                scale = math.exp(min(max(raw[i, k, count + 2 * knots + j], -6.0), 4.0))
                spread[i, k, j] = max(scale * time_s[j] * spread_scale, least_spread)
        total, largest = 0.0, 0.0
        for k in range(modes):
            probability[i, k] = math.exp(raw[i, k, -1] - best)
            total += probability[i, k]
            largest = max(largest, probability[i, k])
        total += largest - probability[i, 0]
        probability[i, 0] = largest
        for k in range(modes):
            probability[i, k] /= total
    return own, spread, probability


@reordered
def every_place(
    own: Any, matrix: Any, start: Any, speed: Any, heading: Any, now: Any, walks: Any, step_s: float
) -> Any:
    """(n, K, H, 2) places of knots (n, K, J, 2) in the drivers' frames.

    Args:
        own: knots ahead and to the left, m.
        matrix: (J, H) weight of each knot at each step.
        start: (H,) weight of the present speed.
        speed: (n,) m/s.
        heading: (n,) rad.
        now: (n, 2) present places, m.
        walks: (n,) who walks on as it does instead.
        step_s: time between steps, s.
    """
    n, modes, knots, _ = own.shape
    steps = start.size
    out = np.empty((n, modes, steps, 2))
    ahead, left = np.empty(steps), np.empty(steps)
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for k in range(modes):
            if walks[i]:
                for h in range(steps):
                    ahead[h], left[h] = speed[i] * (h + 1) * step_s, 0.0
            else:
                for h in range(steps):
                    ahead[h], left[h] = speed[i] * start[h], 0.0
                for j in range(knots):
                    x, y = own[i, k, j, 0], own[i, k, j, 1]
                    for h in range(steps):
                        ahead[h] += matrix[j, h] * x
                        left[h] += matrix[j, h] * y
            for h in range(steps):
                out[i, k, h, 0] = now[i, 0] + ahead[h] * cos - left[h] * sin
                out[i, k, h, 1] = now[i, 1] + ahead[h] * sin + left[h] * cos
    return out
