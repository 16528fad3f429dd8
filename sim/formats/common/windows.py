"""What forecasting formats share: short windows at 10 Hz, and labels in a file beside them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.formats.common.tables import read_table, words_in
from sim.frames import PEDESTRIAN, Tracks

PERIOD_S: Final = 0.1
"""Time between two steps of the forecasting formats, s."""

TOLERANCE_S: Final = 1e-3
"""How far two steps may be from 0.1 s apart, s (the rounding of clocks)."""


class NoWindowError(InputError):
    """An episode that has no window of the format's length: it may be skipped."""


def windows(tracks: Tracks, steps: int) -> Iterator[Tracks]:
    """Consecutive windows of so many times 0.1 s apart, with the agents seen in each.

    A new window begins after a gap; the incomplete windows before a gap and at the end are dropped.

    Raises:
        InputError: if the step of the tracks is not a divisor of 0.1 s.
    """
    if tracks.time_s.size < 2:
        return  # too short for a window, and without a step
    stride = PERIOD_S / tracks.step_s
    if stride < 0.999 or abs(stride - round(stride)) > 1e-3:
        raise InputError(
            f"step_s: found {tracks.step_s:g}, expected a divisor of {PERIOD_S} for this format"
        )
    time_s, index = tracks.time_s, tracks.rows.index
    wanted = time_s + PERIOD_S
    after = np.minimum(np.searchsorted(time_s, wanted), time_s.size - 1)
    nearest = after - (wanted - time_s[after - 1] < time_s[after] - wanted)
    follows = np.abs(time_s[nearest] - wanted) <= TOLERANCE_S
    column, window = 0, list[int]()
    while column < time_s.size:
        window.append(column)
        if len(window) == steps:
            seen = np.unique(np.concatenate([index.agent[index.at(step)] for step in window]))
            yield tracks.part(seen, np.array(window))
            window = []
        if not follows[column]:  # a gap: the next time begins a new window
            window = []
        column = int(nearest[column]) if follows[column] else column + 1


def focal_windows(name: str, tracks: Tracks, steps: int) -> Iterator[tuple[int, Tracks, list[int]]]:
    """The windows of an episode in which a vehicle is seen in every step.

    Args:
        name: of the episode, for messages.
        tracks: the episode, its step a divisor of 0.1 s.
        steps: length of a window.

    Yields:
        Each window's number, the window, and those vehicles, the one that travels farthest first.

    Raises:
        NoWindowError: if there is none.
    """
    found = False
    for number, window in enumerate(windows(tracks, steps)):
        rows = np.flatnonzero(window.valid.all(axis=1) & (window.kind != PEDESTRIAN))
        way = np.hypot(*np.moveaxis(window.xy[rows, -1] - window.xy[rows, 0], -1, 0))
        if rows.size:
            found = True
            yield number, window, rows[np.argsort(-way, kind="stable")].tolist()
    if not found:
        raise NoWindowError(
            f"{name}: found no {steps / 10:g} s with an agent seen all the time, expected some"
        )


def labels_beside(path: Path) -> dict[str, int]:
    """Codes into ``BEHAVIORS`` by an agent's name, from the table of labels beside a recording.

    Args:
        path: the table, with the columns ``track_id`` and ``behavior``; it may be missing.

    Raises:
        InputError: if an agent is in the file twice or a word is no behaviour.
    """
    if not path.is_file():
        return {}
    table = read_table(path, (), ("track_id", "behavior"), ("behavior",))
    codes: dict[str, int] = {}
    for name, word in zip(words_in(table["track_id"]), words_in(table["behavior"]), strict=True):
        if not name or name in codes or (word and word not in BEHAVIORS):
            found = f"behavior {word!r:.60}" if name not in codes else "it twice"
            raise InputError(
                f"{path}: agent {name!r:.60}: found {found}, expected one of {', '.join(BEHAVIORS)}"
            )
        codes[name] = BEHAVIORS.index(word) if word else -1
    return codes


def behavior_words(tracks: Tracks) -> list[str | None]:
    """The behaviour of each agent as a word; None where it has none."""
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    return [str(tracks.classes[code]) if code >= 0 else None for code in codes]
