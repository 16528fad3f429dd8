"""A recording from elsewhere: rows of any format become `Tracks`, or one clear error.

Every reader gives rows (agent, time, centre, heading, speed, size, kind) in our conventions. What
all readers share is here: order, duplicates, limits, and headings that follow from the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import AgentKind, Tracks
from sim.road import Road
from sim.scenario import DIMENSIONS_M

FloatArray = NDArray[np.float64]

MAX_BYTES: Final = 2**32
"""Largest file that is read (our choice: 4 GiB; the largest NGSIM file has 1.5)."""

MAX_ROWS: Final = 5 * 10**7
"""Most rows of one recording (our choice; NGSIM's largest has 12 million)."""

MAX_NAMES: Final = 10**6
"""Most agents of one recording (our choice)."""

MAX_CELLS: Final = 10**8
"""Most agents times steps as dense arrays (our choice: 3 GB)."""

MAX_MAGNITUDE: Final = 1e9
"""Largest absolute position, time or speed (our choice; beyond any UTM coordinate)."""

MAX_SIDE: Final = 1000.0
"""Longest agent, m (our choice; longer than any train, and than any box in an image, pixels)."""

MOVING_MPS: Final = 0.5
"""From this speed on, the direction of motion is taken for the heading (our choice: noise of some
centimetres at 10 Hz is slower)."""

SHORTEST_S: Final = 1e-6
"""Times closer than this give no velocity, s (our choice: far below any sampling interval)."""

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
    """

    name: str
    tracks: Tracks
    notes: tuple[str, ...] = ()
    road: Path | Road | None = None


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
    """Sort rows into dense arrays.

    Args:
        path: the file that they come from, for messages.
        rows: what was read.

    Returns:
        Tracks; ids are 0, 1, 2, ... in the order of ``rows.names``, numbers before words.

    Raises:
        InputError: if an agent is twice at one time, a number is out of range, or there is more
            than fits.
    """
    if rows.agent.size == 0:
        raise InputError(f"{path}: found no rows, expected at least one")
    if rows.agent.size > MAX_ROWS:
        raise InputError(f"{path}: found {rows.agent.size} rows, expected at most {MAX_ROWS}")
    _check(path, rows)
    time_s = np.unique(np.append(rows.time_s, rows.empty_s))
    step = np.searchsorted(time_s, rows.time_s)
    n, t = len(rows.names), time_s.size
    if n * t > MAX_CELLS:
        raise InputError(
            f"{path}: found {n} agents at {t} times, expected agents times times at most "
            f"{MAX_CELLS}"
        )
    rank = np.argsort(sorted(range(n), key=lambda i: _natural(rows.names[i])))
    cell = rank[rows.agent] * t + step
    counts = np.bincount(cell, minlength=n * t)
    if counts.max() > 1:
        twice = int(np.argmax(counts > 1))
        name = rows.names[int(np.flatnonzero(rank == twice // t)[0])]
        raise InputError(f"{path}: found agent {name} twice at time {time_s[twice % t]:g} s")
    order = np.argsort(rank)
    valid = (counts > 0).reshape(n, t)

    def dense(values: FloatArray) -> FloatArray:
        out = np.full(n * t, np.nan)
        out[cell] = values
        return out.reshape(n, t)

    xy = np.stack([dense(rows.x), dense(rows.y)], axis=2)
    heading, speed = dense(rows.heading), dense(rows.speed)
    if np.isnan(rows.speed).any() or np.isnan(rows.heading).any():
        moved_heading, moved_speed = motion(xy, time_s, rows.rest_heading)
        speed = np.where(np.isnan(speed), moved_speed, speed)
        heading = np.where(np.isnan(heading), moved_heading, heading)
    turned = (heading > np.pi) | (heading <= -np.pi)  # angles in range keep their last digit
    heading = np.where(turned, np.pi - np.mod(np.pi - heading, 2 * np.pi), heading)
    return Tracks(
        ids=np.arange(n),
        names=tuple(rows.names[i] for i in order),
        kind=rows.kind[order],
        length=rows.length[order],
        width=rows.width[order],
        time_s=time_s,
        xy=xy,
        heading=np.where(valid, heading, np.nan),
        speed=np.where(valid, speed, np.nan),
        valid=valid,
        signals=np.empty((0, t), dtype=np.int8),
        behavior=None if rows.behavior is None else rows.behavior[order],
    )


def _natural(name: str) -> tuple[int, int, str]:
    """Sorting key: numbers by value, then words."""
    number = name.removeprefix("-")
    return (0, int(name), "") if number.isdecimal() and len(number) < 19 else (1, 0, name)


def motion(
    xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """Heading and speed from positions.

    The velocity at each time is the difference of the neighbouring valid positions (one-sided at
    the ends). Below ``MOVING_MPS`` the heading is that of the last time it moved, before the first
    such time that of the first, and ``rest_heading`` for those that never move.

    Args:
        xy: (n, t, 2) m; NaN where not valid.
        time_s: (t,) s.
        rest_heading: rad.

    Returns:
        (n, t) heading, rad, and (n, t) speed, m/s.
    """
    valid = np.isfinite(xy[..., 0])
    n, t = valid.shape
    column = np.broadcast_to(np.arange(t), (n, t))
    last = np.maximum.accumulate(np.where(valid, column, -1), axis=1)
    following = np.where(valid, column, t)[:, ::-1]
    following = np.minimum.accumulate(following, axis=1)[:, ::-1]
    before = np.concatenate([np.full((n, 1), -1), last[:, :-1]], axis=1)
    after = np.concatenate([following[:, 1:], np.full((n, 1), t)], axis=1)
    before = np.where(before < 0, column, before)
    after = np.where(after >= t, column, after)
    row = np.arange(n)[:, None]
    passed = time_s[after] - time_s[before]
    moved = xy[row, after] - xy[row, before]
    velocity = np.divide(
        moved, passed[..., None], out=np.zeros_like(moved), where=passed[..., None] > SHORTEST_S
    )
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    direction = np.arctan2(velocity[..., 1], velocity[..., 0])
    return hold_heading(direction, valid & (speed >= MOVING_MPS), rest_heading), speed


def hold_heading(
    direction: FloatArray, moving: NDArray[np.bool_], rest_heading: float
) -> FloatArray:
    """Fill the times without motion with the last heading in motion.

    Args:
        direction: (n, t) rad; meaningful where moving.
        moving: (n, t) where it is.
        rest_heading: for agents that never move, rad.

    Returns:
        (n, t) rad.
    """
    n, t = moving.shape
    column = np.broadcast_to(np.arange(t), (n, t))
    last = np.maximum.accumulate(np.where(moving, column, -1), axis=1)
    first = np.argmax(moving, axis=1)[:, None]
    source = np.where(last < 0, first, last)
    held = np.take_along_axis(direction, source, axis=1)
    moves = np.asarray(moving.any(axis=1))
    return np.where(moves[:, None], held, rest_heading)
