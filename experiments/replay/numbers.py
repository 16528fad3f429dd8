"""What is known of each driver's car-following numbers over the time of one episode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.populations import NUMBERS, Population
from experiments.replay.beliefs import sampled
from graphrqi.calibrate.live import LiveNumbers
from sim.frames import FloatArray, IntArray, Tracks

EVERY_S: Final = 5.0
"""Time between two estimates, s (estimates change over tens of seconds)."""

MAX_LOOKS: Final = 200_000
"""Most estimates that are kept: agents times instants (a page of some megabytes)."""

WORDS: Final[dict[str, tuple[str, str]]] = {
    "desired_speed_mps": ("desired speed", "m/s"),
    "time_headway_s": ("time headway", "s"),
    "min_gap_m": ("gap at a standstill", "m"),
    "max_accel_mps2": ("acceleration", "m/s²"),
    "comfort_decel_mps2": ("braking", "m/s²"),
}
"""What people call each number, and its unit."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownNumbers:
    """Drivers' numbers at some times.

    Attributes:
        population: name of the population that drivers are taken to be of.
        ids: (N,) agent ids, ascending.
        time_s: (S,) when, s, increasing.
        interval: (N, S, 5, 3) beginning, median and end of the 90 % intervals, in the order of
            ``NUMBERS``; NaN where the driver's driving does not tell.
    """

    population: str
    ids: IntArray
    time_s: FloatArray
    interval: NDArray[np.float32]

    def rows(self, agent: int) -> list[list[object]]:
        """The changes of one agent's numbers in order of time: when, and the numbers in words.

        Args:
            agent: its row.
        """
        found: list[list[object]] = []
        for time_s, told in zip(self.time_s, self.interval[agent], strict=True):
            said = [
                [WORDS[name][0], f"{middle:.2g} {WORDS[name][1]} ({low:.2g} to {high:.2g})"]
                for name, (low, middle, high) in zip(NUMBERS, told.tolist(), strict=True)
                if not math.isnan(middle)
            ]
            if said != (found[-1][1] if found else []):
                found.append([round(float(time_s), 2), said])
        return found


def known_numbers(tracks: Tracks, population: Population) -> KnownNumbers:
    """Infer the numbers of all drivers of an episode, instant by instant.

    Args:
        tracks: the episode.
        population: of which the drivers are.
    """
    span_s = float(tracks.time_s[-1] - tracks.time_s[0])
    longer = math.ceil(tracks.ids.size * span_s / EVERY_S / MAX_LOOKS)
    steps = sampled(tracks, EVERY_S * max(1, longer))
    column = {int(step): i for i, step in enumerate(steps)}
    interval = np.full((tracks.ids.size, steps.size, len(NUMBERS), 3), np.nan, dtype=np.float32)
    live = LiveNumbers(population)
    for step, frame in enumerate(tracks.frames()):
        live.update(frame)
        if step in column:
            told = live.numbers()
            both = np.stack([told.low, told.median, told.high], axis=2)
            rows = np.searchsorted(tracks.ids, told.ids)
            interval[rows, column[step]] = np.where(told.known[..., None], both, np.nan)
    return KnownNumbers(population.name, tracks.ids, tracks.time_s[steps], interval)
