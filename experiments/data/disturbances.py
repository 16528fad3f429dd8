"""Errors of sensors and trackers: noise, other frame rates, lost frames and tracks.

Each takes tracks, a level and a generator, and returns other tracks; labels stay with the ids.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from behaviors.elementwise import exponential
from sim.frames import BoolArray, IntArray, Tracks

Disturbance = Callable[[Tracks, float, np.random.Generator], Tracks]

GAP_S: Final = 1.5
"""Average time for which trackers lose an agent, s (our choice)."""


def position_noise(tracks: Tracks, deviation_m: float, rng: np.random.Generator) -> Tracks:
    """Independent Gaussian errors of every position, in x and in y."""
    return tracks.with_dense(xy=tracks.xy + rng.normal(0.0, deviation_m, tracks.xy.shape))


def correlated_noise(
    tracks: Tracks, deviation_m: float, rng: np.random.Generator, correlation_s: float = 0.5
) -> Tracks:
    """Gaussian errors of positions that fade slowly, as those of trackers and filters do.

    The errors of each agent in x and in y are an Ornstein-Uhlenbeck process of constant deviation,
    whose correlation falls to 1/e after ``correlation_s``.
    """
    error = rng.normal(0.0, deviation_m, tracks.xy.shape)
    kept = exponential(-np.diff(tracks.time_s) / correlation_s)
    for step, share in enumerate(kept, start=1):
        error[:, step] = share * error[:, step - 1] + (1 - share**2) ** 0.5 * error[:, step]
    return tracks.with_dense(xy=tracks.xy + error)


def frame_rate(tracks: Tracks, rate_hz: float, rng: np.random.Generator) -> Tracks:
    """The recording at another frame rate: of a whole fraction of its own, every so many frames.

    At other rates, positions lie on a cubic spline through those that were recorded.
    """
    every = 1.0 / (rate_hz * tracks.step_s)
    if every >= 0.999 and abs(every - round(every)) < 1e-6:
        return _at_times(tracks, np.arange(0, tracks.time_s.size, round(every)))
    begin_s, end_s = tracks.time_s[[0, -1]]
    time_s = begin_s + np.arange(int((end_s - begin_s) * rate_hz + 1e-6) + 1) / rate_hz
    motion = np.full((tracks.ids.size, time_s.size, 4), np.nan)  # x, y, heading, speed
    for run in tracks.index.runs(np.ones(tracks.row_speed.size, dtype=bool), 2):
        known_s = tracks.time_s[tracks.index.step[run]]
        inside = (time_s >= known_s[0] - 1e-9) & (time_s <= known_s[-1] + 1e-9)
        heading = np.unwrap(tracks.row_heading[run])
        known = np.column_stack([tracks.row_xy[run], heading, tracks.row_speed[run]])
        agent = tracks.index.agent[run.start]
        motion[agent, inside] = CubicSpline(known_s, known)(time_s[inside])
    before = np.searchsorted(tracks.time_s, time_s + 1e-9, side="right") - 1
    turned = np.pi - np.mod(np.pi - motion[..., 2], 2 * np.pi)
    return tracks.with_dense(
        time_s=time_s, xy=motion[..., :2], heading=turned, speed=motion[..., 3],
        valid=np.isfinite(motion[..., 0]), signals=tracks.signals[:, before],
    )  # fmt: skip


def dropped_frames(tracks: Tracks, share: float, rng: np.random.Generator) -> Tracks:
    """A share of the frames is missing; the first and the last are kept."""
    keep = rng.random(tracks.time_s.size) >= share
    keep[[0, -1]] = True
    return _at_times(tracks, np.flatnonzero(keep))


def _at_times(tracks: Tracks, columns: IntArray) -> Tracks:
    """All agents and events at some of the times."""
    part = tracks.part(np.arange(tracks.ids.size), columns)
    return dataclasses.replace(part, events=tracks.events)


def lost_detections(tracks: Tracks, share: float, rng: np.random.Generator) -> Tracks:
    """A share of all detections is missing, each independently; tracks keep their ids."""
    return tracks.with_dense(valid=tracks.valid & (rng.random(tracks.valid.shape) >= share))


def lost_tracks(tracks: Tracks, per_minute: float, rng: np.random.Generator) -> Tracks:
    """Agents are lost ``per_minute`` times on average, and found again under the same id.

    They are unseen for an exponential time of `GAP_S` on average.
    """
    return tracks.with_dense(valid=tracks.valid & ~_gaps(tracks, per_minute, rng))


def renamed_tracks(tracks: Tracks, per_minute: float, rng: np.random.Generator) -> Tracks:
    """As `lost_tracks`, but an agent that is found again has a new id."""
    gaps = _gaps(tracks, per_minute, rng)
    begins = gaps & ~np.pad(gaps, ((0, 0), (1, 0)))[:, :-1]
    number = np.where(tracks.valid & ~gaps, np.cumsum(begins, axis=1), -1)
    found = [(row, i) for row, own in enumerate(number) for i in np.unique(own[own >= 0])]
    source, piece = np.array(found, dtype=np.int64).reshape(-1, 2).T
    return pieces(tracks, source, number[source] == piece[:, None])


def pieces(tracks: Tracks, rows: IntArray, valid: BoolArray) -> Tracks:
    """Tracks of new agents, one for each of the rows (n,), at the times of ``valid`` (n, T)."""
    names = ("kind", "length", "width", "xy", "heading", "speed")
    return tracks.with_dense(
        **{name: getattr(tracks, name)[rows] for name in names},
        ids=np.arange(rows.size), valid=valid, events=(),
        names=tuple(f"{tracks.names[row]}/{i}" for i, row in enumerate(rows)),
        behavior=None if tracks.behavior is None else tracks.behavior[rows],
    )  # fmt: skip


def _gaps(tracks: Tracks, per_minute: float, rng: np.random.Generator) -> BoolArray:
    """(N, T) when each agent is lost."""
    begins = rng.random(tracks.valid.shape) < per_minute / 60.0 * tracks.step_s
    length_s = rng.exponential(GAP_S, tracks.valid.shape)
    end_s = np.where(begins, tracks.time_s + length_s, -np.inf)
    return np.asarray(np.maximum.accumulate(end_s, axis=1) > tracks.time_s)
