"""Random draws that depend on the driver and the encounter alone, whatever happens in between.

A draw is a hash of the driver's key, of what is drawn, and of its number: which junction path,
which crossing, or how many such draws the driver has made before.

References:
    Steele, Lea, Flood (2014), Fast splittable pseudorandom number generators, OOPSLA: the mixing
        function of SplitMix64.
"""

from __future__ import annotations

import math

import numpy as np

from sim.compiled import in_place

(
    RUNS_RED, ROLLS, YIELDS, CUTS_IN, STOPS, STOP_LASTS, WRONG_WAY, DAWDLES, LAPSES, LAPSE_LASTS,
    ERRS, OVERLOOKS, OVERLOOKS_LIGHT,
) = range(13)  # fmt: skip
"""What is drawn."""


def driver_key(seed: int | tuple[int, ...]) -> np.uint64:
    """What all draws of one driver begin with, from its seed."""
    return np.uint64(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


@in_place(inner=True)
def _mixed(state: np.uint64, number: int) -> np.uint64:
    z = state + np.uint64(0x9E3779B97F4A7C15) * np.uint64(number + 1)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(z ^ (z >> np.uint64(31)))


@in_place()
def chance(key: np.uint64, kind: int, number: int) -> float:
    """A number drawn uniformly from 0 to 1, by a driver's key, what is drawn, and its number."""
    return float(_mixed(_mixed(key, kind), number) >> np.uint64(11)) * 2.0**-53


@in_place()
def wait_s(key: np.uint64, kind: int, number: int, per_minute: float) -> float:
    """Time until the next event of a Poisson process, s; infinite where nothing happens."""
    if per_minute <= 0.0:
        return np.inf
    return -60.0 / per_minute * math.log1p(-chance(key, kind, number))
