"""A recording from elsewhere: rows of any format become `Tracks`, or one clear error.

Every reader gives rows (agent, time, centre, heading, speed, size, kind) in our conventions. What
all readers share is here: order, duplicates, limits, and headings that follow from the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import Style
from behaviors.row_index import RowIndex
from sim.formats.common.label_file import DriverLabel, relabelled
from sim.formats.common.motion import row_motion
from sim.frames import MAX_MAGNITUDE, AgentKind, Tracks
from sim.road import Road
from sim.scenario import DIMENSIONS_M
from sim.track_rows import TrackRows

FloatArray = NDArray[np.float64]

MAX_SIDE: Final = 1000.0
"""Longest agent, m (longer than any train, and than any box in an image, pixels)."""

CAR_LENGTH_M: Final = 4.5
CAR_WIDTH_M: Final = 1.8
"""Size of a car where a format does not say it (a European median)."""

CARS_ASSUMED: Final = "kinds and sizes are not in this format: cars of 4.5 m are assumed"
"""The note of recordings of formats that have positions only."""


@dataclass(frozen=True)
class Recording:
    """One recording, read.

    Attributes:
        name: the recording's own name.
        tracks: what was recorded; without labels unless the format carries them.
        notes: what had to be assumed or was left out, one sentence each.
        road: the road that came with it, or its file as `sim.road.files.read_road_file` takes it;
            None where there is none.
        origin: latitude and longitude of (0, 0), degrees; None where not known.
        styles: by name, of the drivers of whom the style is known but not the behaviour.
        file: the file that it was read from, from the folder on that was read; "" where not known.
    """

    name: str
    tracks: Tracks
    notes: tuple[str, ...] = ()
    road: Path | Road | None = None
    origin: tuple[float, float] | None = None
    styles: Mapping[str, Style] = field(default_factory=dict)
    file: str = ""

    def labelled(self, labels: Sequence[DriverLabel | None]) -> Recording:
        """The same recording with labels.

        Args:
            labels: of each agent; None leaves what is known of it.

        Returns:
            The recording.
        """
        behavior, styles = relabelled(self.tracks, self.styles, labels)
        return replace(self, tracks=self.tracks.with_behavior(behavior), styles=styles)


@dataclass(frozen=True)
class Rows:
    """What a reader found: one entry per agent and time, in any order of rows.

    Attributes:
        agent: (m,) index of the agent in ``names``.
        names: the source's own ids.
        time_s: (m,) s.
        x: (m,) of the vehicle's centre, m.
        y: (m,) of the vehicle's centre, m.
        heading: (m,) rad; NaN where `assemble` takes it from the motion.
        speed: (m,) m/s; NaN where `assemble` takes it from the motion.
        length: (len(names),) m.
        width: (len(names),) m.
        kind: (len(names),) codes into ``sim.frames.KINDS``.
        rest_heading: heading of agents that never move, rad.
        behavior: (len(names),) codes into ``BEHAVIORS`` (-1: none), or None.
        empty_s: times at which nobody was seen, s, in any order.
        ahead_lengths: how far x and y are ahead of the centre, in lengths of the vehicle: 0.5 where
            they are its front and the heading is taken from the motion.
    """

    agent: NDArray[np.int64]
    names: tuple[str, ...]
    time_s: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    length: FloatArray
    width: FloatArray
    kind: NDArray[np.int8]
    rest_heading: float = 0.0
    behavior: NDArray[np.int8] | None = None
    empty_s: tuple[float, ...] = ()
    ahead_lengths: float = 0.0

    @classmethod
    def of(
        cls,
        agent: NDArray[np.int64],
        names: Sequence[str],
        time_s: FloatArray,
        xy: FloatArray,
        heading: FloatArray | None = None,
        speed: FloatArray | None = None,
        kinds: Sequence[AgentKind] | None = None,
        sizes: FloatArray | None = None,
        **more: Any,
    ) -> Rows:
        """Rows of a format that may lack something.

        Args:
            agent: as in `Rows`.
            names: the source's own ids.
            time_s: (m,) s.
            xy: (m, 2) m.
            heading: (m,) rad; None to take it from the motion.
            speed: (m,) m/s; None to take it from the motion.
            kinds: (len(names),) None for cars.
            sizes: (len(names), 2) lengths and widths, m; of those that are 0, and where there are
                none, the ones that are usual for the kind are taken.
            more: further attributes of `Rows`.
        """
        unknown = np.full(agent.size, np.nan)
        kinds = [AgentKind.CAR] * len(names) if kinds is None else kinds
        usual = np.array([default_size(kind) for kind in kinds]).reshape(-1, 2)
        if sizes is not None:
            unsized = (sizes == 0).any(axis=1, keepdims=True)
            usual = np.where(unsized, usual, sizes)
        return cls(
            agent, tuple(names), time_s, xy[:, 0], xy[:, 1],
            unknown if heading is None else heading, unknown if speed is None else speed,
            usual[:, 0], usual[:, 1], np.array([k.code for k in kinds], dtype=np.int8), **more,
        )  # fmt: skip


def default_size(kind: AgentKind) -> tuple[float, float]:
    """Length and width of a kind where a format does not say them, m."""
    if kind is AgentKind.CAR:
        return CAR_LENGTH_M, CAR_WIDTH_M
    length, width, _ = DIMENSIONS_M[kind]
    return length, width


def _check(path: Path, rows: Rows) -> None:
    """Refuse numbers that no position, time, heading, speed or size can have."""
    if rows.agent.size == 0:
        raise InputError(f"{path}: found no rows, expected at least one")
    for name in ("time_s", "x", "y", "heading", "speed", "length", "width"):
        values = getattr(rows, name)
        if name in ("length", "width"):
            bad, expected = ~((values > 0) & (values <= MAX_SIDE)), f"0 to {MAX_SIDE:g}"
        else:
            bad, expected = ~(np.abs(values) <= MAX_MAGNITUDE), f"a number up to {MAX_MAGNITUDE:g}"
        if name in ("heading", "speed"):
            bad &= ~np.isnan(values)
        if bad.any():
            at = int(np.flatnonzero(bad)[0])
            who = rows.names[at if name in ("length", "width") else rows.agent[at]]
            raise InputError(
                f"{path}: {name} of {who:.60}: found {values[at]:g}, expected {expected}"
            )


def assemble(path: Path, rows: Rows) -> Tracks:
    """Sort rows by agent and time.

    Args:
        path: the file that they come from, for messages.
        rows: what was read.

    Returns:
        Tracks; ids are 0, 1, 2, ... in the order of ``rows.names``, numbers before words.

    Raises:
        InputError: if there are no rows, an agent is twice at one time, or a number is out of
            range.
    """
    _check(path, rows)
    time_s = _times(rows)
    n, t = len(rows.names), time_s.size
    order = np.array(sorted(range(n), key=lambda i: _natural(rows.names[i])))
    rank = np.empty(n, dtype=np.int64)
    rank[order] = np.arange(n)
    cell = rank[rows.agent] * t + np.searchsorted(time_s, rows.time_s)
    sorting = np.argsort(cell, kind="stable")
    cell = cell[sorting]
    again = np.flatnonzero(cell[1:] == cell[:-1])
    if again.size:
        twice = int(cell[again[0]])
        name = rows.names[order[twice // t]]
        raise InputError(f"{path}: found agent {name} twice at time {time_s[twice % t]:g} s")
    agent, step = np.divmod(cell, t)
    xy = np.stack([rows.x[sorting], rows.y[sorting]], axis=1)
    heading, speed = _heading_and_speed(rows, sorting, agent, xy)
    if rows.ahead_lengths:
        ahead_m = rows.ahead_lengths * rows.length[order][agent]
        xy[:, 0] -= ahead_m * np.cos(heading)
        xy[:, 1] -= ahead_m * np.sin(heading)

    return Tracks.of_rows(
        TrackRows(RowIndex.of_rows(agent, step, n, t), xy, heading, speed),
        ids=np.arange(n),
        names=tuple(rows.names[i] for i in order),
        kind=rows.kind[order],
        length=rows.length[order],
        width=rows.width[order],
        time_s=time_s,
        signals=np.empty((0, t), dtype=np.int8),
        behavior=None if rows.behavior is None else rows.behavior[order],
    )


def _times(rows: Rows) -> FloatArray:
    return np.unique(np.append(rows.time_s, rows.empty_s))


def _heading_and_speed(
    rows: Rows, sorting: NDArray[np.int64], agent: NDArray[np.int64], xy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Heading in (-pi, pi] and speed of the sorted rows, from the motion where not given."""
    heading, speed = rows.heading[sorting], rows.speed[sorting]
    if np.isnan(speed).any() or np.isnan(heading).any():
        moved_heading, moved_speed = row_motion(agent, xy, rows.time_s[sorting], rows.rest_heading)
        speed = np.where(np.isnan(speed), moved_speed, speed)
        heading = np.where(np.isnan(heading), moved_heading, heading)
    turned = (heading > np.pi) | (heading <= -np.pi)  # angles in range keep their last digit
    return np.where(turned, np.pi - np.mod(np.pi - heading, 2 * np.pi), heading), speed


def _natural(name: str) -> tuple[int, int, str]:
    """Sorting key: numbers by value, then words."""
    number = name.removeprefix("-")
    return (0, int(name), "") if number.isdecimal() and len(number) < 19 else (1, 0, name)
