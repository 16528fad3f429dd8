"""Drivers' car-following numbers while they drive: told frame by frame, without a fit.

Candidates are drawn once from a population. Each moment in which a driver follows the same leader
as half a second before weighs them by how well IDM with their numbers foretells its acceleration.
Who follows nobody stays as the population is. Residual accelerations last longer than half a
second, so a moment counts as less than one observation.

`graphrqi.calibrate.posterior` infers the numbers of a whole recording, and the population along
with them, more exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from behaviors.populations import NUMBERS, Population, read_population
from graphrqi.predict.recorded.gaps import inferred_leaders
from sim.frames import Frame, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

CANDIDATES: Final = 1024
"""How many (a power of 2, for Sobol's points; our choice: intervals move by less than a tenth of
their width with four times as many)."""

WATCHED_S: Final = 0.5
"""Time between the moments that are looked at, s, as in the calibration of recordings."""

LONGEST_S: Final = 1.5
"""Two moments farther apart tell nothing, s."""

RESIDUAL_MPS2, RESIDUAL_S = 0.19, 1.3
"""Standard deviation of the acceleration around the law, m/s2, and the time in which it is
forgotten, s (Zhang and Sun 2024, Transportation Research Part C)."""

MEASURED_MPS2: Final = 0.3
"""Standard deviation of a measured acceleration over `WATCHED_S`, m/s2 (our choice: speeds known to
0.1 m/s)."""

LEAST_GAP_M: Final = 0.5
"""Nearer pairs overlap or stand, and tell nothing, m."""

KNOWN: Final = 0.8
"""A number is told once its interval is narrower than that of the population by this factor."""


@dataclass(frozen=True, slots=True, eq=False)
class DriverNumbers:
    """What is known of drivers' numbers at one instant.

    Attributes:
        ids: (n,) agent ids, ascending.
        median: (n, 5) columns as ``NUMBERS``.
        low: (n, 5) where the 90 % interval begins.
        high: (n, 5) where it ends.
        known: (n, 5) whether the driver's own driving tells it; the others are the population's.
        factor: (n, 5) the median over that of the population; 1 where it is not known.
    """

    ids: IntArray
    median: FloatArray
    low: FloatArray
    high: FloatArray
    known: BoolArray
    factor: FloatArray

    def __repr__(self) -> str:
        """How many drivers there are, and of how many something is known."""
        told = int(self.known.any(axis=1).sum())
        return f"DriverNumbers({self.ids.size} drivers, something known of {told})"


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """Who followed whom, and how."""

    time_s: float
    ids: IntArray
    leader: IntArray
    speed: FloatArray
    leader_speed: FloatArray
    gap: FloatArray


class LiveNumbers:
    """Infers the numbers of all drivers present, frame by frame.

    Args:
        population: of which drivers are drawn: a name, a file or a `Population`.

    Examples:
        >>> live = LiveNumbers("us101")
        >>> live.numbers()
        DriverNumbers(0 drivers, something known of 0)
    """

    def __init__(self, population: str | Population = "us101") -> None:
        self.population = read_population(population)
        points = qmc.Sobol(len(NUMBERS), scramble=True, rng=0).random(CANDIDATES)
        values, vectors = np.linalg.eigh(self.population.correlation)
        z = norm.ppf(points) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        self._numbers = self.population.median * np.exp(self.population.log_spread * z)
        self._told: dict[int, FloatArray] = {}
        self._before: _Moment | None = None
        self._ids = np.empty(0, dtype=np.int64)
        forgotten = math.exp(-WATCHED_S / RESIDUAL_S)
        self._worth = (1.0 - forgotten) / (1.0 + forgotten)

    def update(self, frame: Frame) -> None:
        """Take the next frame; most of them cost nothing.

        Args:
            frame: later than the one before. Speeds count where they are known.
        """
        self._ids = frame.ids[frame.driving]
        if self._before is not None and frame.time_s < self._before.time_s + WATCHED_S - 1e-6:
            return
        now = _moment(frame)
        if self._before is not None and now.time_s - self._before.time_s <= LONGEST_S:
            self._tell(self._before, now)
        self._before = now
        present = set(now.ids.tolist())
        self._told = {agent: told for agent, told in self._told.items() if agent in present}

    def _tell(self, before: _Moment, now: _Moment) -> None:
        from graphrqi.calibrate.live_kernel import tell

        _, then, here = np.intersect1d(before.ids, now.ids, return_indices=True)
        same = (before.leader[then] >= 0) & (before.leader[then] == now.leader[here])
        then, here = then[same], here[same]
        seen = np.stack(
            [
                0.5 * (before.speed[then] + now.speed[here]),
                0.5 * (before.leader_speed[then] + now.leader_speed[here]),
                0.5 * (before.gap[then] + now.gap[here]),
                (now.speed[here] - before.speed[then]) / (now.time_s - before.time_s),
            ],
            axis=1,
        )
        good = np.isfinite(seen).all(axis=1) & (seen[:, 2] > LEAST_GAP_M)
        ids = now.ids[here][good].tolist()
        if not ids:
            return
        told = np.stack([self._told.get(i, np.zeros(CANDIDATES)) for i in ids])
        noise = math.hypot(RESIDUAL_MPS2, MEASURED_MPS2)
        tell(told, self._numbers, np.ascontiguousarray(seen[good]), noise, self._worth)
        self._told.update(zip(ids, told - told.max(axis=1, keepdims=True), strict=True))

    def numbers(self) -> DriverNumbers:
        """What is known of the drivers of the last frame."""
        ids = np.sort(self._ids)
        shape = (ids.size, len(NUMBERS))
        reach = norm.ppf(0.95) * self.population.log_spread
        median = np.tile(self.population.median, (ids.size, 1))
        low, high = median * np.exp(-reach), median * np.exp(reach)
        known = np.zeros(shape, dtype=bool)
        for i, agent in enumerate(ids.tolist()):
            told = self._told.get(agent)
            if told is None:
                continue
            weight = np.exp(told)
            found = np.stack([_quantiles(values, weight) for values in self._numbers.T])
            away = np.log(found / found[:, 1:2])
            coarse = reach * CANDIDATES ** (-1.0 / len(NUMBERS))  # how far apart candidates lie
            found = found[:, 1:2] * np.exp(np.sign(away) * np.hypot(away, coarse[:, None]))
            narrow = np.log(found[:, 2] / found[:, 0]) < KNOWN * 2.0 * reach
            known[i] = narrow
            low[i, narrow], median[i, narrow], high[i, narrow] = found[narrow].T
        factor = np.where(known, median / self.population.median, 1.0)
        return DriverNumbers(ids, median, low, high, known, factor)


def _quantiles(values: FloatArray, weight: FloatArray) -> FloatArray:
    """(3,) the weighted quantiles at .05, .5 and .95."""
    order = np.argsort(values)
    reached = np.cumsum(weight[order]) - 0.5 * weight[order]
    return np.interp((0.05, 0.5, 0.95), reached / weight.sum(), values[order])


def _moment(frame: Frame) -> _Moment:
    leader, gap = inferred_leaders(Tracks.from_frames([frame]))
    drives = frame.driving
    ahead = np.maximum(leader, 0)
    ids = np.where(leader >= 0, frame.ids[ahead], -1) if frame.ids.size else leader
    speed = frame.speed[ahead] if frame.ids.size else gap
    return _Moment(
        frame.time_s, frame.ids[drives], ids[drives], frame.speed[drives], speed[drives],
        gap[drives],
    )  # fmt: skip
