"""A recording from elsewhere: rows of any format become `Tracks`, or one clear error.

Every reader gives rows (agent, time, centre, heading, speed, size, kind) in our conventions. What
all readers share is here: order, duplicates, limits, and headings that follow from the motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import Style
from behaviors.row_index import RowIndex
from sim.formats.common.label_file import DriverLabel, relabelled
from sim.frames import MAX_MAGNITUDE, AgentKind, Tracks
from sim.road import Road
from sim.scenario import DIMENSIONS_M
from sim.track_rows import TrackRows

FloatArray = NDArray[np.float64]

MAX_BYTES: Final = 2**32
"""Largest file that is read (4 GiB; the largest NGSIM file has 1.5)."""

MAX_ROWS: Final = 2 * 10**7
"""Most rows of one recording (NGSIM's largest has 12 million)."""

MAX_NAMES: Final = 10**6
"""Most agents of one recording."""

MAX_PARTS: Final = 1000
"""Most recordings that one file may hold or be cut into (NGSIM has up to three at each place,
INTERACTION hundreds of cases)."""

MAX_SIDE: Final = 1000.0
"""Longest agent, m (longer than any train, and than any box in an image, pixels)."""

MOVING_MPS: Final = 0.5
"""From this speed on, the direction of motion is taken for the heading (noise of some centimetres
at 10 Hz is slower)."""

SHORTEST_S: Final = 1e-6
"""Times closer than this give no velocity, s (far below any sampling interval)."""

CAR_LENGTH_M: Final = 4.5
CAR_WIDTH_M: Final = 1.8
"""Size of a car where a format does not say it (a European median)."""

CARS_ASSUMED: Final = "kinds and sizes are not in this format: cars of 4.5 m are assumed"
"""The note of recordings made with `Rows.of_positions`."""


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
    def of_positions(
        cls,
        agent: NDArray[np.int64],
        names: tuple[str, ...],
        time_s: FloatArray,
        x: FloatArray,
        y: FloatArray,
        behavior: NDArray[np.int8] | None = None,
    ) -> Rows:
        """Rows of a format that has positions only: everyone is taken for a car.

        Args:
            agent: as in `Rows`, like the others.
            names: the source's own ids.
            time_s: s.
            x: m.
            y: m.
            behavior: codes, or None.
        """
        unknown, n = np.full(x.size, np.nan), len(names)
        return cls(
            agent, names, time_s, x, y, unknown, unknown, np.full(n, CAR_LENGTH_M),
            np.full(n, CAR_WIDTH_M), np.zeros(n, dtype=np.int8), behavior=behavior,
        )  # fmt: skip

    def part(self, rows: NDArray[np.int64]) -> Rows:
        """Some of the rows, and the agents that are in them.

        Args:
            rows: indices, ascending.
        """
        kept, agent = np.unique(self.agent[rows], return_inverse=True)
        time_s = self.time_s[rows]
        return Rows(
            agent=agent.ravel(),
            names=tuple(self.names[i] for i in kept.tolist()),
            time_s=time_s,
            x=self.x[rows],
            y=self.y[rows],
            heading=self.heading[rows],
            speed=self.speed[rows],
            length=self.length[kept],
            width=self.width[kept],
            kind=self.kind[kept],
            rest_heading=self.rest_heading,
            behavior=None if self.behavior is None else self.behavior[kept],
            empty_s=tuple(t for t in self.empty_s if time_s.min() < t < time_s.max()),
            ahead_lengths=self.ahead_lengths,
        )


def check_size(path: Path) -> None:
    """Refuse what is not a file or is too large to read.

    Raises:
        InputError: naming the file.
    """
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a recording")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_BYTES}")


def kind_codes(kinds: Sequence[AgentKind]) -> NDArray[np.int8]:
    """(n,) codes into ``KINDS``."""
    return np.array([kind.code for kind in kinds], dtype=np.int8)


def default_size(kind: AgentKind) -> tuple[float, float]:
    """Length and width of a kind where a format does not say them, m."""
    if kind is AgentKind.CAR:
        return CAR_LENGTH_M, CAR_WIDTH_M
    length, width, _ = DIMENSIONS_M[kind]
    return length, width


def _check(path: Path, rows: Rows) -> None:
    if rows.agent.size == 0:
        raise InputError(f"{path}: found no rows, expected at least one")
    if rows.agent.size > MAX_ROWS:
        raise InputError(f"{path}: found {rows.agent.size} rows, expected at most {MAX_ROWS}")
    for name in ("time_s", "x", "y", "heading", "speed"):
        values = getattr(rows, name)
        optional = name in ("heading", "speed")
        bad = ~(np.abs(values) <= MAX_MAGNITUDE)
        if optional:
            bad &= ~np.isnan(values)
        if bad.any():
            at = int(np.flatnonzero(bad)[0])
            raise InputError(
                f"{path}: {name} of {rows.names[rows.agent[at]]}: found {values[at]}, expected a "
                f"number up to {MAX_MAGNITUDE:g}"
            )
    for name in ("length", "width"):
        values = getattr(rows, name)
        bad_size = ~((values > 0) & (values <= MAX_SIDE))
        if bad_size.any():
            at = int(np.flatnonzero(bad_size)[0])
            raise InputError(
                f"{path}: {name} of {rows.names[at]}: found {values[at]}, "
                f"expected more than 0 and up to {MAX_SIDE:g}"
            )


def assemble(path: Path, rows: Rows) -> Tracks:
    """Sort rows by agent and time.

    Args:
        path: the file that they come from, for messages.
        rows: what was read.

    Returns:
        Tracks; ids are 0, 1, 2, ... in the order of ``rows.names``, numbers before words.

    Raises:
        InputError: if an agent is twice at one time, a number is out of range, or there are more
            rows than fit.
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


def recordings(
    path: Path,
    name: str,
    rows: Rows,
    notes: Sequence[str] = (),
    road: Path | Road | None = None,
    max_cells: int | None = None,
) -> Iterator[Recording]:
    """The recording that rows make, or several where all agents are looked at together.

    Of positions in images, scale and camera motion are found in arrays of agents times times. Rows
    that would need more than ``max_cells`` are halved in time until each part fits.

    Args:
        path: the file that they come from, for messages.
        name: of the recording; the parts are numbered.
        rows: what was read.
        notes: what had to be assumed.
        road: as in `Recording`.
        max_cells: most agents times times of one; None for any number.

    Yields:
        Recordings, in order of time.

    Raises:
        InputError: as `assemble`, or if there would be more than ``MAX_PARTS``.
    """
    _check(path, rows)
    if max_cells is None or len(rows.names) * _times(rows).size <= max_cells:
        yield Recording(name, assemble(path, rows), tuple(notes), road)
        return
    order = np.argsort(rows.time_s, kind="stable")
    parts = _in_time(path, order, rows.time_s, rows.agent, max_cells)
    cut = f"cut into {len(parts)} recordings in time, as arrays of all would not fit into memory"
    for number, part in enumerate(parts, 1):
        few = rows.part(np.sort(part))
        yield Recording(f"{name}-{number}", assemble(path, few), (*notes, cut), road)


def _in_time(
    path: Path,
    order: NDArray[np.int64],
    time: FloatArray,
    agent: NDArray[np.generic],
    max_cells: int,
) -> list[NDArray[np.int64]]:
    """Rows in order of time, halved in time until agents times times are few enough.

    Args:
        path: the file, for messages.
        order: (k,) the rows to cut, in order of time.
        time: (m,) of each row.
        agent: (m,) of each row.
        max_cells: most agents times times of a part.

    Returns:
        The rows of each part, in order of time.

    Raises:
        InputError: if there would be more than ``MAX_PARTS``.
    """
    waiting, parts = [order], list[NDArray[np.int64]]()
    while waiting:
        rows = waiting.pop()
        times = np.unique(time[rows])
        if np.unique(agent[rows]).size * times.size <= max_cells or times.size < 2:
            parts.append(rows)
        else:
            middle = int(np.searchsorted(time[rows], times[times.size // 2]))
            waiting += [rows[middle:], rows[:middle]]
        if len(parts) + len(waiting) > MAX_PARTS:
            raise InputError(
                f"{path}: found agents and times for more than {MAX_PARTS} recordings of "
                f"{max_cells} agents times times each, expected fewer"
            )
    return parts


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


def motion(
    xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """Heading and speed from positions, as `row_motion` has them.

    Args:
        xy: (n, t, 2) m; NaN where not valid.
        time_s: (t,) s.
        rest_heading: rad.

    Returns:
        (n, t) heading, rad, and (n, t) speed, m/s; NaN where not valid.
    """
    agent, step = np.nonzero(np.isfinite(xy[..., 0]))
    found = row_motion(agent, xy[agent, step], time_s[step], rest_heading)
    heading, speed = np.full(xy.shape[:2], np.nan), np.full(xy.shape[:2], np.nan)
    heading[agent, step], speed[agent, step] = found
    return heading, speed


def row_motion(
    agent: NDArray[np.int64], xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """Heading and speed from positions.

    The velocity at each time is the difference of the neighbouring positions of the agent
    (one-sided at the ends). Below ``MOVING_MPS`` the heading is that of the last time it moved,
    before the first such time that of the first, and ``rest_heading`` for those that never move.

    Args:
        agent: (m,) ascending.
        xy: (m, 2) m.
        time_s: (m,) s, ascending for each agent.
        rest_heading: rad.

    Returns:
        (m,) heading, rad, and (m,) speed, m/s.
    """
    m = agent.size
    row = np.arange(m)
    same = agent[1:] == agent[:-1]
    before, after = row.copy(), row.copy()
    before[1:][same] -= 1
    after[:-1][same] += 1
    passed = time_s[after] - time_s[before]
    moved = xy[after] - xy[before]
    velocity = np.divide(
        moved, passed[:, None], out=np.zeros_like(moved), where=passed[:, None] > SHORTEST_S
    )
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    return hold_heading(agent, direction, speed >= MOVING_MPS, rest_heading), speed


def hold_heading(
    agent: NDArray[np.int64],
    direction: FloatArray,
    moving: NDArray[np.bool_],
    rest_heading: float,
) -> FloatArray:
    """Fill the times without motion with the last heading in motion.

    Args:
        agent: (m,) ascending.
        direction: (m,) rad; meaningful where moving.
        moving: (m,) where it is.
        rest_heading: for agents that never move, rad.

    Returns:
        (m,) rad.
    """
    m = agent.size
    row = np.arange(m)
    begin = np.searchsorted(agent, agent)  # of its agent's rows
    last = np.maximum.accumulate(np.where(moving, row, -1))
    following = np.minimum.accumulate(np.where(moving, row, m)[::-1])[::-1]
    source = np.where(last >= begin, last, following)
    end = np.searchsorted(agent, agent, side="right")
    return np.where(source < end, direction[np.minimum(source, m - 1)], rest_heading)
