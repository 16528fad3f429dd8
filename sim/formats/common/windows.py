"""What forecasting formats share: short windows at 10 Hz, and labels in a file beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from sim.formats.common.tables import read_table
from sim.frames import PEDESTRIAN, Tracks

PERIOD_S: Final = 0.1
"""Time between two steps of the forecasting formats, s."""

TOLERANCE_S: Final = 1e-3
"""How far two steps may be from 0.1 s apart, s (the rounding of clocks)."""


class NoWindowError(InputError):
    """An episode that has no window of the format's length: it may be skipped."""


def windows(tracks: Tracks, steps: int) -> Iterator[Tracks]:
    """Consecutive windows that do not overlap, each of times 0.1 s apart.

    A new window begins after a gap; the incomplete windows before a gap and at the end are dropped.

    Args:
        tracks: an episode, its step a divisor of 0.1 s.
        steps: length of a window.

    Yields:
        Each window with the agents seen in it.

    Raises:
        InputError: if the step is not a divisor of 0.1 s.
    """
    if tracks.time_s.size < 2:
        return  # too short for a window, and without a step
    stride = PERIOD_S / tracks.step_s
    if stride < 0.999 or abs(stride - round(stride)) > 1e-3:
        raise InputError(
            f"step_s: found {tracks.step_s:g}, expected a divisor of {PERIOD_S} for this format"
        )
    following = _following(tracks.time_s)
    index = tracks.rows.index
    column, window = 0, list[int]()
    while column < tracks.time_s.size:
        window.append(column)
        if len(window) == steps:
            seen = np.unique(np.concatenate([index.agent[index.at(step)] for step in window]))
            yield tracks.part(seen, np.array(window))
            window = []
        if following[column] < 0:  # a gap: the next time begins a new window
            window = []
            column += 1
        else:
            column = int(following[column])


def _following(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """(T,) index of the time that is nearest to 0.1 s after each; -1 where there is none."""
    wanted = time_s + PERIOD_S
    after = np.minimum(np.searchsorted(time_s, wanted), time_s.size - 1)
    nearer_before = wanted - time_s[after - 1] < time_s[after] - wanted
    nearest = np.where(nearer_before, after - 1, after)
    return np.where(np.abs(time_s[nearest] - wanted) <= TOLERANCE_S, nearest, -1)


def focal_agents(window: Tracks) -> list[int]:
    """Rows of the vehicles seen in every step, the one that travels farthest first."""
    rows = np.flatnonzero(window.valid.all(axis=1) & (window.kind != PEDESTRIAN))
    way = np.hypot(*np.moveaxis(window.xy[rows, -1] - window.xy[rows, 0], -1, 0))
    return [int(r) for r in rows[np.argsort(-way, kind="stable")]]


def labels_beside(path: Path, names: Sequence[str]) -> NDArray[np.int8] | None:
    """The behaviours of a recording's agents, from the table of labels beside it.

    Args:
        path: the table, with the columns ``track_id`` and ``behavior``.
        names: the recording's agents.

    Returns:
        (len(names),) codes into ``BEHAVIORS`` (-1: none); None where no agent has one, or there is
        no such file.

    Raises:
        InputError: if an agent is in the file twice or a word is no behaviour.
    """
    if not path.is_file():
        return None
    table = read_table(path, (), ("track_id", "behavior"), empty=("behavior",))
    known: dict[str, int] = {}
    for name, word in zip(table.words("track_id"), table.words("behavior"), strict=True):
        if name in known or (word and word not in BEHAVIORS):
            found = f"behavior {word!r:.60}" if name not in known else "it twice"
            raise InputError(
                f"{path}: agent {name!r:.60}: found {found}, expected one of {', '.join(BEHAVIORS)}"
            )
        known[name] = Behavior(word).code if word else -1
    codes = np.array([known.get(name, -1) for name in names], dtype=np.int8)
    return codes if (codes >= 0).any() else None


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
        InputError: if the step is not a divisor of 0.1 s.
    """
    found = False
    for number, window in enumerate(windows(tracks, steps)):
        focal = focal_agents(window)
        if focal:
            found = True
            yield number, window, focal
    if not found:
        raise NoWindowError(
            f"{name}: found no {steps / 10:g} s with an agent seen all the time, expected some"
        )


def behavior_words(tracks: Tracks) -> list[str | None]:
    """The behaviour of each agent as a word; None where it has none."""
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    return [BEHAVIORS[code].value if code >= 0 else None for code in codes]
