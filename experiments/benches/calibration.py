"""Calibration: do intervals hold the truth, and do a driver's numbers foretell its gaps?

``simulated``: drivers of each law are simulated by code of this module alone, half of them with
autocorrelated noise on the acceleration and noise on every place; `coverage` is the share of 90 %
intervals that hold the true number, ``known`` the share of drivers of whom it is told, and
``drivers_per_s`` counts them by processor time. ``unknown`` is the share of drivers of whom a
number is said to be unknown; ``unknown_width`` and ``unknown_shift`` compare their posteriors with
the population by a much longer run of draws, and ``unknown_within`` is the share of them whose
posterior is the population's within 5 %. The longer run is made of all drivers with a posterior
near the population's: of their numbers that are the population's, ``found_unknown`` is the share
that is said to be unknown. ``counts`` is the power with which likelihoods counted. ``alone``: the
same for fewer drivers, of whom half never follow anybody, so that nothing tells their headway.

``recorded``: of every driver in ``--data``, the first half of its longest stretch behind one
leader is calibrated, and the second is driven behind the recorded leader. The errors of the gap are
divided by those of one pooled driver (fitted to the same first halves), and by those of a driver
from the literature; beside it stands the same with numbers of another driver (``permuted``), and
that of the pooled driver if it, too, carries on what each driver lately did beside its law
(``pooled, carried on``). Intervals are over drivers.

``behind``: drivers of known numbers are simulated behind each of the recorded leaders, whose motion
is smoothed for it, and shaken by what smoothing takes from the recorded places, which is most of
what recordings tremble by. ``told`` and ``true`` are the population's medians of each number,
``told_spread`` and ``true_spread`` its log-spreads, once for drivers who accelerate as `MEDIAN`
does and once for such who do it half as hard and keep a shorter headway (``noise``: ``close``).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.populations import NUMBERS
from experiments.benches.contract import Bench, option
from experiments.score.metrics import RESAMPLES, bootstrap, ratio
from experiments.score.rows import Row, tidy_row
from experiments.training.recordings import read_sources
from graphrqi.calibrate.drives import Drive, Stretch, make_drive
from graphrqi.calibrate.driving_on import (
    candidate_weights,
    candidates,
    errors_of,
    foretold_places,
    gap_errors,
    halves,
    past_errors,
    pooled_driver,
)
from graphrqi.calibrate.laws import Law
from graphrqi.calibrate.posterior import Calibration, calibrate, drawn_again
from graphrqi.calibrate.recorded import recorded_stretches

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LITERATURE: Final = np.log([33.3, 1.6, 2.0, 0.73, 1.67])
"""IDM's first numbers, in the order of ``NUMBERS`` (Treiber, Hennecke, Helbing 2000, table I)."""

MEDIAN: Final = np.log([22.0, 1.3, 2.6, 1.6, 2.1])
SPREAD: Final = np.array([0.2, 0.35, 0.35, 0.35, 0.3])
"""The simulated population (inside what recordings show)."""

NOISE_MPS2, CORRELATION_S, NOISE_M = 0.19, 1.3, 0.1
"""Noise of every second driver: on its acceleration (Zhang and Sun 2024), and on places."""

STEP_S: Final = 0.1

SMOOTHED_HALF_S: Final = 1.6
"""Half the stretch over which recorded motion is smoothed for ``behind``, s (our choice: errors of
recordings that tremble last for up to a second or two)."""

CLOSE: Final = {"time_headway_s": 0.6, "max_accel_mps2": 0.5}
"""Factors of those who follow closely, as on a congested motorway."""

WITHIN: Final = 0.05
"""A posterior is the population's if its spread differs by no more than this share, and its mean by
no more than so many spreads."""

NEAR: Final = 0.1
"""Looked at more closely are posteriors whose draws differ by no more than this."""

ALONE: Final = 5
"""Factor by which the sample in which half of the drivers are alone is smaller."""

LEAST_HALF_S: Final = 5.0
"""Shorter second halves are not scored, s (they hardly leave the start)."""


@dataclass(frozen=True)
class Settings:
    """How much is measured.

    Attributes:
        drivers: simulated, of each law.
        seconds: length of each simulated drive, s.
        data: folder of datasets of recordings; None for none.
        seed: of everything random.
    """

    drivers: int = option(1000, "Simulated drivers of each law.")
    seconds: float = option(30.0, "Length of each of their drives, s.")
    data: Path | None = option(None, "Recordings; none for simulated drivers only.", "FOLDER")
    seed: int = option(0, "Same seed, same rows but for times.")


def measure(settings: Settings) -> Iterator[Sequence[Row]]:
    """The rows of each law's simulated drivers, then of each dataset's recorded ones."""
    if settings.drivers < 0 or settings.seconds < 5.0:
        raise InputError(
            f"drivers, seconds: found {settings.drivers}, {settings.seconds:g}, expected 0 or more "
            "drivers of at least 5 s"
        )
    if settings.drivers:
        for law in Law:
            yield list(simulated_rows(law, settings))
            yield list(alone_rows(law, settings))
    if settings.data is not None:
        found: dict[str, list[list[Stretch]]] = {}
        for place in read_sources([settings.data]):
            here = recorded_stretches(place.tracks, place.road)
            found.setdefault(place.dataset, []).extend(parts for _, parts in here)
        for name, drivers in found.items():
            drives = [drive for parts in drivers if (drive := make_drive(parts)) is not None]
            yield list(recorded_rows(name, drives, settings.seed))
            yield list(behind_rows(name, drivers, settings.seed))


def simulated_rows(law: Law, settings: Settings) -> Iterator[Row]:
    """Coverage of the intervals of simulated drivers."""
    rng = np.random.default_rng((settings.seed, law.code))
    truth = np.exp(MEDIAN + SPREAD * rng.standard_normal((settings.drivers, len(NUMBERS))))
    noisy = np.arange(settings.drivers) % 2 == 0
    drives = [
        _simulated_drive(law, one, settings.seconds, bool(shaken), rng)
        for one, shaken in zip(truth, noisy, strict=True)
    ]
    begun = time.process_time()
    fitted = calibrate(law, drives)
    told = fitted.summary()
    spent_s = time.process_time() - begun
    inside = (told.low <= truth) & (truth <= told.high)
    keys: dict[str, Any] = {
        "part": "simulated", "dataset": "", "law": str(law), "number": "", "noise": "",
        "numbers": "",
    }  # fmt: skip
    yield tidy_row(keys, "drivers_per_s", len(drives) / max(spent_s, 1e-9), None, None, len(drives))
    yield tidy_row(keys, "counts", fitted.counts, None, None, len(drives))
    yield from _unknown_rows(keys, fitted, drives)
    for k, number in enumerate(NUMBERS):
        for noise, who in (("", noisy | True), ("noisy", noisy), ("exact", ~noisy)):
            if who.any():
                named = {**keys, "number": number, "noise": noise}
                yield tidy_row(named, "coverage", *_mean(inside[who, k]), int(who.sum()))
                yield tidy_row(
                    named, "known", float(told.known[who, k].mean()), None, None, int(who.sum())
                )


def alone_rows(law: Law, settings: Settings) -> Iterator[Row]:
    """What is said to be unknown where every other driver never follows anybody."""
    rng = np.random.default_rng((settings.seed, law.code, 1))
    count = max(settings.drivers // ALONE, 2)
    truth = np.exp(MEDIAN + SPREAD * rng.standard_normal((count, len(NUMBERS))))
    drives = [
        _simulated_drive(law, one, settings.seconds, i % 4 < 2, rng, alone=i % 2 == 0)
        for i, one in enumerate(truth)
    ]
    keys = {
        "part": "alone", "dataset": "", "law": str(law), "number": "", "noise": "", "numbers": "",
    }  # fmt: skip
    yield from _unknown_rows(keys, calibrate(law, drives), drives)


def _unknown_rows(
    keys: dict[str, Any], fitted: Calibration, drives: Sequence[Drive]
) -> Iterator[Row]:
    """Whether a number's posterior is the population's where it is said to be unknown.

    By a longer run of draws of all drivers with a posterior near it: their spread over the
    population's, and how far their mean lies from the population's, in its spreads.
    """
    unknown = ~fitted.known
    shift, width = _from_population(fitted, fitted.logs)
    who = np.flatnonzero((unknown | _near(shift, width, NEAR)).any(axis=1))
    if who.size:
        longer = [_from_population(fitted, drawn_again(fitted, [drives[int(i)]])) for i in who]
        shift, width = (np.concatenate(one) for one in zip(*longer, strict=True))
        same = _near(shift, width, WITHIN)
    for k, number in enumerate(NUMBERS):
        named = {**keys, "number": number}
        yield tidy_row(named, "unknown", *_mean(unknown[:, k]), len(drives))
        if not who.size:
            continue
        here = unknown[who, k]
        for name, values in (
            ("unknown_width", width[here, k]),
            ("unknown_shift", shift[here, k]),
            ("unknown_within", same[here, k]),
            ("found_unknown", here[same[:, k]]),
        ):
            if values.size:
                yield tidy_row(named, name, *_mean(values), values.size)


def _from_population(fitted: Calibration, logs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 5) how far draws' means lie from the population's, and their spreads over its."""
    size = len(NUMBERS)
    mean, spread = fitted.mean[:size], fitted.spread[:size]
    numbers = logs[:, :, :size]
    return (numbers.mean(axis=1) - mean) / spread, numbers.std(axis=1) / spread


def _near(shift: FloatArray, width: FloatArray, within: float) -> BoolArray:
    """(N, 5) whether posteriors are the population's within a share of its spread."""
    return np.asarray((np.abs(shift) <= within) & (np.abs(width - 1.0) <= within))


def _mean(values: FloatArray | BoolArray) -> tuple[float, float, float]:
    """A mean with its 95 % interval, by resampling."""
    return bootstrap(ratio, np.stack([values.astype(np.float64), np.ones(values.size)], axis=1))


def _simulated_drive(
    law: Law, numbers: FloatArray, seconds: float, noisy: bool, rng: np.random.Generator, *,
    alone: bool = False,
) -> Drive:  # fmt: skip
    """A driver behind a leader whose wished speed changes every 4 to 12 s, or alone on the road.

    The laws are written out once more: an error in those that calibrate would not show in drivers
    that were simulated by them.
    """
    count = int(seconds / STEP_S) + 1
    base, speed, accel = rng.uniform(6.0, 25.0), rng.uniform(5.0, 22.0), 0.0
    wanted, until = speed, 0
    leading = np.empty(count)
    for i in range(count):
        if i >= until:
            share = rng.choice((0.0, 0.4, 0.8, 1.0, 1.2), p=(0.1, 0.2, 0.3, 0.3, 0.1))
            wanted, until = base * share, i + int(rng.integers(40, 120))
        accel += (float(np.clip((wanted - speed) / 3.0, -2.5, 1.5)) - accel) * STEP_S / 0.8
        speed = max(speed + accel * STEP_S, 0.0)
        leading[i] = speed
    moved = leading[1:] if law is Law.KRAUSS else 0.5 * (leading[1:] + leading[:-1])
    rear = 60.0 + np.concatenate([[0.0], np.cumsum(moved)]) * STEP_S
    behind = np.full(count, np.inf) if alone else rear
    v0, headway, s0, a, b = numbers
    v = min(leading[0], v0)
    x = rear[0] - (s0 + headway * v) * rng.uniform(1.0, 1.6)
    kept = np.exp(-STEP_S / CORRELATION_S)
    pushed = NOISE_MPS2 * noisy * np.sqrt(1.0 - kept**2) * rng.standard_normal(count)
    residual, place = 0.0, np.empty(count)
    for i in range(count):
        place[i] = x
        gap, u = max(behind[i] - x, 0.1), leading[i]
        residual = kept * residual + pushed[i]
        if law is Law.IDM:
            following = _idm_accel(numbers, v, u, gap)
        else:
            safe = (
                np.sqrt(max(0.0, (b * headway) ** 2 + u * u + 2.0 * b * (gap - s0))) - b * headway
            )
            following = (max(0.0, min(v + a * STEP_S, safe, v0)) - v) / STEP_S
        faster = max(v + STEP_S * (following + residual), 0.0)
        x += STEP_S * (faster if law is Law.KRAUSS else 0.5 * (v + faster))
        v = faster
    errors = rng.normal(0.0, NOISE_M * noisy, (2, count))
    time_s = np.asarray(STEP_S * np.arange(count), dtype=np.float64)
    drive = make_drive([Stretch(time_s, place + errors[0], behind + errors[1])])
    assert drive is not None
    return drive


def _idm_accel(numbers: FloatArray, v: float, u: float, gap: float) -> float:
    """Acceleration of IDM's driver at speed ``v`` behind a leader at speed ``u``, m/s2."""
    v0, headway, s0, a, b = numbers
    wish = s0 + max(0.0, v * headway + v * (v - u) / (2.0 * np.sqrt(a * b)))
    return float(max(a * (1.0 - (v / v0) ** 4 - (wish / gap) ** 2), -9.0))


def recorded_rows(name: str, drives: Sequence[Drive], seed: int) -> Iterator[Row]:
    """Errors of the second halves of a dataset's drives, for each law."""
    cut = [found for drive in drives if (found := halves(drive)) is not None]
    cut = [two for two in cut if two[1].seconds >= LEAST_HALF_S]
    if len(cut) < 2:
        return
    first, second = [two[0] for two in cut], [two[1] for two in cut]
    usual = errors_of(Law.IDM, LITERATURE, second)
    idm_pooled = pooled_driver(Law.IDM, first)
    pooled = errors_of(Law.IDM, idm_pooled, second)
    keys = {"part": "recorded", "dataset": name, "number": "", "noise": ""}
    carried = [foretold_places(Law.IDM, idm_pooled[None], np.ones(1), *two)[None] for two in cut]
    pooled_carried = np.array(
        [gap_errors(one, drive)[0] for one, drive in zip(carried, second, strict=True)]
    )
    for label, errors in (
        ("pooled", pooled),
        ("pooled, carried on", pooled_carried),
        ("literature", usual),
    ):
        yield from _ratio_rows({**keys, "law": "idm", "numbers": label}, errors, pooled, usual)
    for law in Law:
        tried = candidates(law, idm_pooled if law is Law.IDM else pooled_driver(law, first), seed)
        weight = candidate_weights(np.stack([past_errors(law, tried, one) for one in first]))
        order = np.random.default_rng(seed).permutation(len(cut))
        other = np.empty_like(order)
        other[order] = np.roll(order, 1)
        for label, share in (("own", weight), ("permuted", weight[other])):
            told = [foretold_places(law, tried, w, *two) for w, two in zip(share, cut, strict=True)]
            errors = np.array(
                [gap_errors(one[None], drive)[0] for one, drive in zip(told, second, strict=True)]
            )
            touched = [
                bool((one >= drive.rows[3]).any()) for one, drive in zip(told, second, strict=True)
            ]
            named = {**keys, "law": str(law), "numbers": label}
            yield from _ratio_rows(named, errors, pooled, usual)
            yield tidy_row(named, "collisions", float(sum(touched)), None, None, len(touched))


def behind_rows(name: str, drivers: Sequence[Sequence[Stretch]], seed: int) -> Iterator[Row]:
    """What is told of known drivers behind a dataset's leaders; see the module."""
    for label, factors in (("", {}), ("close", CLOSE)):
        rng = np.random.default_rng((seed, len(label)))
        median = MEDIAN + np.log([factors.get(number, 1.0) for number in NUMBERS])
        drives = []
        for parts in drivers:
            numbers = np.exp(median + SPREAD * rng.standard_normal(len(NUMBERS)))
            drive = make_drive(
                [_driven_behind(part, numbers, rng) for part in parts if part.time_s.size > 3]
            )
            if drive is not None and np.isfinite(drive.rows[3]).any():
                drives.append(drive)
        if len(drives) < 2:
            return
        fitted = calibrate(Law.IDM, drives)
        for k, number in enumerate(NUMBERS):
            keys = {
                "part": "behind", "dataset": name, "law": str(Law.IDM), "number": number,
                "noise": label, "numbers": "",
            }  # fmt: skip
            for metric, value in (
                ("told", float(np.exp(fitted.mean[k]))),
                ("true", float(np.exp(median[k]))),
                ("told_spread", float(fitted.spread[k])),
                ("true_spread", float(SPREAD[k])),
            ):
                yield tidy_row(keys, metric, value, None, None, len(drives))


def _driven_behind(part: Stretch, numbers: FloatArray, rng: np.random.Generator) -> Stretch:
    """An IDM driver behind a smoothed leader, shaken as the recorded one; see ``behind``."""
    from graphrqi.calibrate.kernels import local_parabolas

    own, lead = np.empty((4, part.time_s.size)), np.empty((4, part.time_s.size))
    local_parabolas(part.time_s, part.place, part.time_s, SMOOTHED_HALF_S, own)
    lead[0], lead[1] = np.inf, 0.0
    if np.isfinite(part.leader).all():
        local_parabolas(part.time_s, part.leader, part.time_s, SMOOTHED_HALF_S, lead)
    x, v = own[0, 0], max(own[1, 0], 0.0)
    frame_s = float(np.median(np.diff(part.time_s)))
    fine = max(1, round(frame_s / STEP_S))
    h = frame_s / fine
    kept = np.exp(-h / CORRELATION_S)
    residual = NOISE_MPS2 * rng.standard_normal()
    place = np.empty(part.time_s.size)
    for i in range(place.size):
        place[i] = x
        for j in range(fine):
            u = max(lead[1, i], 0.0)
            gap = max(lead[0, i] + u * j * h - x, 0.1)
            accel = _idm_accel(numbers, v, u, gap) + residual
            pushed = NOISE_MPS2 * np.sqrt(1.0 - kept**2) * rng.standard_normal()
            residual = kept * residual + pushed
            faster = max(v + h * accel, 0.0)
            x, v = x + 0.5 * h * (v + faster), faster
    return Stretch(part.time_s, place + part.place - own[0], part.leader)


def _ratio_rows(
    keys: dict[str, Any], found: FloatArray, pooled: FloatArray, usual: FloatArray
) -> Iterator[Row]:
    n = found.size
    yield tidy_row(keys, "gap_rmse_m", *_median(found), n)
    for name, other in (("pooled", pooled), ("literature", usual)):
        yield tidy_row(keys, f"over_{name}", *_median(found / np.maximum(other, 1e-6)), n)
        squares = np.stack([found**2, other**2], axis=1)
        yield tidy_row(keys, f"squares_over_{name}", *bootstrap(ratio, squares), n)


def _median(values: FloatArray) -> tuple[float, float, float]:
    """A median with its 95 % interval, by resampling."""
    drawn = np.random.default_rng(0).choice(values, (RESAMPLES, values.size))
    low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975))
    return float(np.median(values)), float(low), float(high)


BENCH: Final = Bench(
    name="calibration",
    summary="Whether calibrated drivers' intervals hold the truth and foretell their gaps.",
    keys=("part", "dataset", "law", "number", "noise", "numbers"),
    full=Settings(),
    quick=Settings(drivers=16, seconds=15.0),
    measure=measure,
)
