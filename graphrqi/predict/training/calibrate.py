"""Finds the driver parameters with which the car-following law predicts best on training episodes.

A (1+1) evolution strategy with the one-fifth rule runs for all behaviours at once. The parameters
of all behaviours are perturbed together, and all drivers are simulated jointly. Each behaviour
keeps its new parameters if its own drivers' error fell. Behaviours act on each other only through
leaders, so that this is nearly one search per behaviour for the price of one.

References:
    Beyer, Schwefel (2002), "Evolution strategies", Natural Computing 1 (one-fifth success rule).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.posterior import Posterior
from graphrqi.predict.rollout.driver_table import DRIVER_FIELDS, DriverTable, initial_table
from graphrqi.predict.rollout.following import aware, blind, certain
from graphrqi.predict.scene.scene import Scene

EVERY: Final = 5
"""Errors are taken at every fifth step, 0.5 s apart."""

FIRST_WIDTH: Final = 0.15
"""Standard deviation of the first perturbations' logarithm: the drivers' own spread."""

FARTHEST: Final = 2.0
"""Numbers stay within this factor of the profiles' own."""

RECHECK: Final = 15
"""Perturbations after which the best error is measured again."""

DECAYS_S: Final = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Decay times tried, s."""


@dataclass(frozen=True, eq=False)
class Sample:
    """A scene and what happened next.

    Attributes:
        scene: the present.
        future: (n, H, 2) where the agents went, m; NaN where unseen.
        counts: (n,) whether the agent's error counts (drives and is seen throughout).
        behavior: (n,) true behaviours, -1 unknown.
    """

    scene: Scene
    future: FloatArray
    counts: BoolArray
    behavior: NDArray[np.int64]


def displacement(sample: Sample, xy: FloatArray) -> FloatArray:
    """(n,) mean distance of (n, H, 2) places to what happened, m; NaN where it does not count."""
    error = np.full(sample.counts.size, np.nan)
    gone = xy[sample.counts, EVERY - 1 :: EVERY] - sample.future[sample.counts, EVERY - 1 :: EVERY]
    error[sample.counts] = np.linalg.norm(gone, axis=-1).mean(axis=1)
    return error


def by_behavior(samples: Sequence[Sample], table: DriverTable) -> FloatArray:
    """(6,) mean displacement of each behaviour's drivers when their behaviour is known, m."""
    total, count = np.zeros(len(BEHAVIORS)), np.zeros(len(BEHAVIORS))
    for sample in samples:
        beliefs = Posterior(sample.scene.ids, certain(sample.behavior))
        error = displacement(sample, aware(sample.scene, beliefs, table).best)
        kept = sample.counts & (sample.behavior >= 0)
        total += np.bincount(sample.behavior[kept], error[kept], len(BEHAVIORS))
        count += np.bincount(sample.behavior[kept], minlength=len(BEHAVIORS))
    return np.asarray(total / np.maximum(count, 1))


def without_behavior(samples: Sequence[Sample], table: DriverTable) -> float:
    """Mean displacement of all drivers by the average driver's numbers, m."""
    errors = [displacement(s, blind(s.scene, None, table).best)[s.counts] for s in samples]
    return float(np.concatenate(errors).mean())


def calibrate(
    samples: Sequence[Sample], iterations: int = 80, seed: int = 0, start: DriverTable | None = None
) -> DriverTable:
    """Search the numbers of every behaviour and of the average driver, on training episodes only.

    The search begins at ``start``, the profiles' own numbers by default.
    """
    rng = np.random.default_rng(seed)
    origin = initial_table()
    table = start or origin
    width = np.full(len(BEHAVIORS), FIRST_WIDTH)
    best = by_behavior(samples, table)
    average_width, average_best = FIRST_WIDTH, without_behavior(samples, table)
    for iteration in range(iterations):
        trial = dataclasses.replace(
            table,
            behavior=_near(table.behavior * _factors(rng, width), origin.behavior),
            average=_near(
                table.average * _factors(rng, np.array([average_width]))[0], origin.average
            ),
        )
        error = by_behavior(samples, trial)
        won = error < best
        behavior = np.where(won[:, None], trial.behavior, table.behavior)
        width = np.clip(np.where(won, width * 1.5, width * 0.9), 0.01, 0.4)
        average_won = (average_error := without_behavior(samples, trial)) < average_best
        average_best = min(average_error, average_best)
        average_width = float(np.clip(average_width * (1.5 if average_won else 0.9), 0.01, 0.4))
        table = dataclasses.replace(
            table, behavior=behavior, average=trial.average if average_won else table.average
        )
        stale = iteration % RECHECK == RECHECK - 1  # the others have moved on since
        best = by_behavior(samples, table) if stale else np.minimum(best, error)
    return _with_best_decay(samples, table)


def _factors(rng: np.random.Generator, width: FloatArray) -> FloatArray:
    """Log-normal factors, with each number left alone as often as not."""
    shape = (width.size, len(DRIVER_FIELDS))
    step = rng.standard_normal(shape) * (rng.random(shape) < 0.6)
    return np.asarray(np.exp(width[:, None] * step))


def _near(values: FloatArray, origin: FloatArray) -> FloatArray:
    """The values, kept within a factor `FARTHEST` of where calibration starts."""
    return np.asarray(np.clip(values, origin / FARTHEST, origin * FARTHEST))


def _with_best_decay(samples: Sequence[Sample], table: DriverTable) -> DriverTable:
    """The same numbers with the best of a few decay times of the residual acceleration."""
    aware = {
        d: by_behavior(samples, dataclasses.replace(table, decay_s=d)).mean() for d in DECAYS_S
    }
    blind = {
        d: without_behavior(samples, dataclasses.replace(table, average_decay_s=d))
        for d in DECAYS_S
    }
    return dataclasses.replace(
        table, decay_s=min(aware, key=aware.__getitem__),
        average_decay_s=min(blind, key=blind.__getitem__),
    )  # fmt: skip
