"""Recordings without labels: do beliefs about drivers say what they do later?

Each driver's track is halved. The belief at the end of the first half is compared with how the
driver follows in the second. It is also compared with the belief at the end of the second half,
where the driver counts as new. Nothing is true or false here: a belief that says something about a
driver is one that comes again and that goes with its driving.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from behaviors.errors import InputError
from experiments.data.disturbances import pieces
from experiments.data.parallel import in_parallel
from experiments.score.labels import beliefs
from experiments.score.rows import Cell, Row, tidy_row
from experiments.training.recordings import RecordedPlace, by_dataset
from graphrqi.model_files import load_model
from graphrqi.posterior import aggressive_share
from graphrqi.predict.recorded.features import inferred_leaders
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import PEDESTRIAN, FloatArray, IntArray, Tracks

LEAST_TRACK_S, LEAST_SEEN_S = 10.0, 3.0
"""The halves of shorter tracks are too short; drivers seen for less do not count in shares."""

MOVING_MPS, LONGEST_HEADWAY_S, EVERY_S = 2.0, 10.0, 1.0
"""Slower drivers have no time headway, and those with longer ones do not follow; headways are
measured at this interval, s."""

LEAST_DRIVERS, RESAMPLES = 10, 500
"""Fewer drivers make no correlation; bootstrap resamples of drivers."""


def _last_beliefs(tracks: Tracks) -> tuple[FloatArray, FloatArray]:
    """(N,) last probability of the aggressive style, NaN if unknown, and whether it is labelled."""
    style, labelled = np.full(tracks.ids.size, np.nan), np.zeros(tracks.ids.size)
    _, last = _ends(tracks)
    model, stops = load_model(DEFAULT_MODEL), (last + 1).tolist()
    for stop, posterior in beliefs(tracks, model, stops, traffic="recorded").items():
        leaving = np.flatnonzero((last == stop - 1) & tracks.valid[:, stop - 1])
        here = leaving[np.isin(tracks.ids[leaving], posterior.ids)]
        at = np.searchsorted(posterior.ids, tracks.ids[here])
        style[here] = aggressive_share(posterior.probability[at])
        labelled[here] = posterior.labelled[at]
    return style, labelled


def _ends(tracks: Tracks) -> tuple[IntArray, IntArray]:
    """(N,) the first and the last column of each agent."""
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    return np.asarray(tracks.valid.argmax(axis=1)), np.asarray(last)


def _drivers_of(one: RecordedPlace) -> tuple[FloatArray, FloatArray]:
    """Beliefs about the drivers of one recording, and their motion.

    (n, 3) aggressive style after each half, and later headway, of halved agents; (m, 2) final style
    and whether it is known, of agents seen for `LEAST_SEEN_S`.
    """
    tracks = one.tracks
    if tracks.time_s.size < 2:
        return np.zeros((0, 3)), np.zeros((0, 2))
    first, last = (tracks.time_s[column] for column in _ends(tracks))
    long = tracks.valid.any(axis=1) & (tracks.kind != PEDESTRIAN)
    rows = np.flatnonzero(long & (last - first >= LEAST_TRACK_S - 1e-6))
    halves = np.zeros((0, 3))
    if rows.size:  # their second halves are new drivers in the same scene
        middle = np.searchsorted(tracks.time_s, 0.5 * (first + last)[rows])
        late = np.zeros(tracks.valid.shape, dtype=bool)
        late[rows] = np.arange(tracks.time_s.size) >= middle[:, None]
        everyone = np.arange(tracks.ids.size)
        valid = np.concatenate([tracks.valid & ~late, (tracks.valid & late)[rows]])
        style, _ = _last_beliefs(pieces(tracks, np.concatenate([everyone, rows]), valid))
        headway_s = _later_headways(tracks, rows, middle)
        halves = np.column_stack([style[rows], style[everyone.size :], headway_s])
    style, labelled = _last_beliefs(tracks)
    seen_s = tracks.valid.sum(axis=1) * tracks.step_s
    shown = np.isfinite(style) & (seen_s >= LEAST_SEEN_S - 1e-6)
    return halves, np.column_stack([style, labelled])[shown]


def _later_headways(tracks: Tracks, rows: IntArray, middle: IntArray) -> FloatArray:
    """(n,) mean time headway of drivers from their middles on, s; NaN where they follow none."""
    seen = []
    for column in range(0, tracks.time_s.size, max(1, round(EVERY_S / tracks.step_s))):
        leader, gap = inferred_leaders(tracks, column)
        speed = np.nan_to_num(tracks.speed[rows, column])
        headway = np.maximum(gap[rows], 0.0) / np.maximum(speed, MOVING_MPS)
        counts = tracks.valid[rows, column] & (column >= middle) & (leader[rows] >= 0)
        counts &= (speed > MOVING_MPS) & (headway < LONGEST_HEADWAY_S)
        seen.append(np.where(counts, headway, np.nan))
    return np.asarray(pd.DataFrame(seen).mean(), dtype=np.float64)


def _spearman(one: FloatArray, other: FloatArray) -> tuple[float, float, float]:
    """Rank correlation with its 95 % interval over resampled drivers; NaN where one is constant."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return np.nan, np.nan, np.nan
    drawn = np.random.default_rng(0).integers(0, one.size, (RESAMPLES, one.size))
    values = [spearmanr(one[i], other[i]).statistic for i in drawn]
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(spearmanr(one, other).statistic), float(low), float(high)


def measure(data: Path, jobs: int | None = None) -> Iterator[list[Row]]:
    """Rows of each dataset of recordings in a folder, or of one: shares and correlations."""
    places = by_dataset([data], maps=False)
    if not places:
        raise InputError(f"{data}: found no recording, expected at least 1")
    for name in sorted(places):
        found = list(in_parallel(_drivers_of, [(one,) for one in places[name]], jobs))
        halves, whole = (np.concatenate(each) for each in zip(*found, strict=True))
        keys: dict[str, Cell] = {"dataset": name, "protocol": "recorded", "method": DEFAULT_MODEL}
        yield list(_rows(keys, halves, whole))


def _rows(keys: dict[str, Cell], halves: FloatArray, whole: FloatArray) -> Iterator[Row]:
    """The figures of a dataset."""
    answered = whole[whole[:, 1] > 0.5, 0]
    for metric, values in (
        ("share_unknown", 1.0 - whole[:, 1]), ("share_aggressive", (answered > 0.5).astype(float))
    ):  # fmt: skip
        if values.size:
            error = 1.96 * float(values.std()) / np.sqrt(values.size)
            mean = float(values.mean())
            yield tidy_row(
                keys, metric, mean, max(mean - error, 0.0), min(mean + error, 1.0), values.size
            )
    for metric, column in (("spearman_split_half", 1), ("spearman_later_headway", 2)):
        both = halves[np.isfinite(halves[:, 0]) & np.isfinite(halves[:, column])]
        if len(both) >= LEAST_DRIVERS:
            yield tidy_row(keys, metric, *_spearman(both[:, 0], both[:, column]), len(both))
