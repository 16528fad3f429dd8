"""Where a replay differs from the data: moments of near misses, and sizes in images."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from sim.frames import Event, EventKind, FloatArray, Tracks

NEAR_BEFORE_S, NEAR_AFTER_S = 0.5, 4.0
"""Around a near miss the smallest distance is looked for, s (a near miss begins at a time to
collision of 1.5 s, and is over some seconds later)."""

PARKED_M: Final = 1.0
"""A vehicle that is never seen farther than this from its middle place is parked, m (more than the
noise of recordings)."""

CAR_SHAPE: Final = 2.5
"""Length over width of a vehicle that is drawn for a box in an image (a car's)."""

FREE_SHARE: Final = 0.8
"""Longest drawn vehicle in an image, as a share of the usual distance to the nearest other one
(then most do not touch)."""

FRAMES_MEASURED: Final = 50
"""Frames of which distances to the nearest other are taken."""


def shown_events(tracks: Tracks) -> tuple[Event, ...]:
    """The events of an episode, with near misses at the moment of the smallest distance.

    Near misses with a parked vehicle are left out: passing it closely is no conflict.

    Args:
        tracks: an episode with its events.

    Returns:
        Events in order of time.
    """
    parked = _parked(tracks)
    found = []
    for event in tracks.events:
        rows = [_row(tracks, agent) for agent in (event.agent, event.other)]
        if event.kind is not EventKind.NEAR_MISS or None in rows:
            found.append(event)
            continue
        one, other = (row for row in rows if row is not None)
        if not parked[one] and not parked[other]:
            found.append(dataclasses.replace(event, time_s=_closest_s(tracks, event, one, other)))
    return tuple(sorted(found, key=lambda event: event.time_s))


def _row(tracks: Tracks, agent: int | None) -> int | None:
    if agent is None:
        return None
    row = int(np.searchsorted(tracks.ids, agent))
    return row if row < tracks.ids.size and tracks.ids[row] == agent else None


def _parked(tracks: Tracks) -> list[bool]:
    """Whether each vehicle is parked: it is never seen to move."""
    found = []
    rows = tracks.rows
    for agent in range(tracks.ids.size):
        seen = rows.xy[rows.index.rows(agent)]
        away = np.hypot(*(seen - np.median(seen, axis=0)).T) if len(seen) else np.zeros(1)
        found.append(bool(away.max() < PARKED_M))
    return found


def _closest_s(tracks: Tracks, event: Event, one: int, other: int) -> float:
    """When the centres of two agents are nearest to each other around an event, s."""
    after_s = tracks.time_s - event.time_s
    near = np.flatnonzero((after_s >= -NEAR_BEFORE_S) & (after_s <= NEAR_AFTER_S))
    if not near.size:
        return event.time_s
    begin, end = int(near[0]), int(near[-1]) + 1
    rows = tracks.rows
    places = [rows.index.over(rows.xy, row, begin, end, np.nan) for row in (one, other)]
    distance_m = np.hypot(*(places[0] - places[1]).T)
    if np.isnan(distance_m).all():
        return event.time_s
    return float(tracks.time_s[begin + int(np.nanargmin(distance_m))])


def with_drawn_sizes(tracks: Tracks) -> Tracks:
    """The tracks of an image's boxes with sizes that can be drawn from above.

    A box in an image is upright and as large as the perspective makes it. Turned into the driving
    direction, boxes of dense traffic would cover each other, so all are drawn as cars of one size.

    Args:
        tracks: a recording in pixels.

    Returns:
        The same with other lengths and widths.
    """
    sides = np.sqrt(tracks.length * tracks.width)
    length = min(float(np.median(sides)), FREE_SHARE * _free_distance(tracks))
    many = tracks.ids.size
    return dataclasses.replace(
        tracks, length=np.full(many, length), width=np.full(many, length / CAR_SHAPE)
    )


def _free_distance(tracks: Tracks) -> float:
    """Median distance to the nearest other agent, over some frames; infinite if all are alone."""
    found: list[FloatArray] = []
    steps = np.unique(np.linspace(0, tracks.time_s.size - 1, FRAMES_MEASURED).astype(int))
    for step in steps:
        xy = tracks.rows.xy[tracks.rows.index.at(step)]
        if len(xy) > 1:
            apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
            np.fill_diagonal(apart, np.inf)
            found.append(apart.min(axis=1))
    return float(np.median(np.concatenate(found))) if found else np.inf
