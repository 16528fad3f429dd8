"""Cuts an episode into the short windows at 10 Hz that forecasting formats are made of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import PEDESTRIAN, Tracks

PERIOD_S: Final = 0.1
"""Time between two steps of the forecasting formats, s."""


def _columns(tracks: Tracks, columns: slice) -> Tracks:
    """Some time steps of tracks, with the agents that are seen in them."""
    return tracks.part(np.flatnonzero(tracks.valid[:, columns].any(axis=1)), columns)


def every_tenth(tracks: Tracks) -> Tracks:
    """The same tracks every 0.1 s.

    Raises:
        InputError: if their own step is not a divisor of 0.1 s.
    """
    stride = PERIOD_S / tracks.step_s
    if stride < 0.999 or abs(stride - round(stride)) > 1e-3:
        raise InputError(
            f"step_s: found {tracks.step_s:g}, expected a divisor of {PERIOD_S} for this format"
        )
    return _columns(tracks, slice(0, None, round(stride)))


def windows(tracks: Tracks, steps: int) -> Iterator[Tracks]:
    """Consecutive windows that do not overlap; what is left at the end is dropped.

    Args:
        tracks: at 10 Hz.
        steps: length of a window.

    Yields:
        Each window with the agents seen in it.
    """
    for start in range(0, tracks.time_s.size - steps + 1, steps):
        yield _columns(tracks, slice(start, start + steps))


def focal_agents(window: Tracks) -> list[int]:
    """Rows of the vehicles seen all the time, those that travel farthest first."""
    rows = np.flatnonzero(window.valid.all(axis=1) & (window.kind != PEDESTRIAN))
    way = np.hypot(*np.moveaxis(window.xy[rows, -1] - window.xy[rows, 0], -1, 0))
    return [int(r) for r in rows[np.argsort(-way, kind="stable")]]
