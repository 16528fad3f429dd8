"""A recording from elsewhere: rows of any format become a `Recording`, or one clear error.

Every reader gives rows (agent, time, centre, heading, speed, size, kind) in our conventions. What
all readers share is here: order, rows that repeat, agents whose numbers are broken, limits, and
headings and speeds that follow from the motion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import Style
from behaviors.row_index import RowIndex
from sim.formats.common.doubts import doubts_of, inside_vehicles
from sim.formats.common.label_file import DriverLabel
from sim.formats.common.motion import row_motion
from sim.frames import MAX_MAGNITUDE, AgentKind, FloatArray, TrackRows, Tracks
from sim.road import Road
from sim.scenario import DIMENSIONS_M

MAX_SIDE: Final = 1000.0
"""Longest agent, m (longer than any train, and than any box in an image, pixels)."""

CAR_LENGTH_M: Final = 4.5
CAR_WIDTH_M: Final = 1.8
"""Size of a car where a format does not say it (a European median)."""

CARS_ASSUMED: Final = "kinds and sizes are not in this format: cars of 4.5 m are assumed"
"""The note of recordings of formats that have positions only."""

MAX_REPEATED: Final = 0.02
"""Share of rows that may repeat an agent at one time with other numbers (a tracker that splits
vehicles makes some .5 %): the first counts. With more, ids or times are wrong."""

MOST_SEEN_ONCE: Final = 100
"""More agents than this that are all seen once have the numbers of rows for their ids."""

MAX_BROKEN: Final = 0.5
"""Share of agents or rows that may be left out because their numbers are broken."""


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
        doubts: what contradicts itself, or looked like data and was left out, one sentence each.
        own_road: whether the road belongs to the recording by its id, or is in the same file.
    """

    name: str
    tracks: Tracks
    notes: tuple[str, ...] = ()
    road: Path | Road | None = None
    origin: tuple[float, float] | None = None
    styles: Mapping[str, Style] = field(default_factory=dict)
    file: str = ""
    doubts: tuple[str, ...] = ()
    own_road: bool = False

    def labelled(self, labels: Sequence[DriverLabel | None]) -> Recording:
        """The same recording with labels.

        Args:
            labels: of each agent; None leaves what is known of it.

        Returns:
            The recording.
        """
        known = self.tracks.behavior
        codes = np.full(len(labels), -1, dtype=np.int8) if known is None else known.copy()
        styles = dict(self.styles)
        for row, (name, label) in enumerate(zip(self.tracks.names, labels, strict=True)):
            if label is None:
                continue
            codes[row] = -1 if label.behavior is None else label.behavior.code
            styles.pop(name, None)
            if label.behavior is None:
                styles[name] = label.style
        return replace(self, tracks=self.tracks.with_behavior(codes), styles=styles)


@dataclass
class Rows:
    """What a reader found: one entry per agent and time, in any order of rows.

    Attributes:
        agent: (m,) index of the agent in ``names``.
        names: the source's own ids.
        time_s: (m,) s.
        xy: (m, 2) of the agent's centre, m; NaN where it is not known: such rows are left out.
        heading: (m,) rad; None, or NaN, where it is taken from the motion.
        speed: (m,) m/s; None, or NaN, where it is taken from the motion.
        kinds: (len(names),) None for cars.
        sizes: (len(names), 2) lengths and widths, m; those that are not positive, and None, are the
            ones usual for the kind.
        rest_heading: heading of agents that never move, rad.
        behavior: (len(names),) codes into ``BEHAVIORS`` (-1: none), or None.
        empty_s: times at which nobody was seen, s, in any order.
        ahead_lengths: how far positions are ahead of the centre, in lengths of the vehicle: 0.5
            where they are its front.
        in_metres: whether positions and sizes are metres; else nothing is doubted.
    """

    agent: NDArray[np.int64]
    names: Sequence[str]
    time_s: FloatArray
    xy: FloatArray
    heading: FloatArray | None = None
    speed: FloatArray | None = None
    kinds: Sequence[AgentKind] | None = None
    sizes: FloatArray | None = None
    rest_heading: float = 0.0
    behavior: NDArray[np.int8] | None = None
    empty_s: Sequence[float] = ()
    ahead_lengths: float = 0.0
    in_metres: bool = True


def left_out(words: Collection[str]) -> list[str]:
    """The note on objects that are no road-agents, if there are any."""
    if not words:
        return []
    return [f"left out, because they are not road-agents: {', '.join(sorted(words))}"]


def default_size(kind: AgentKind) -> tuple[float, float]:
    """Length and width of a kind where a format does not say them, m."""
    if kind is AgentKind.CAR:
        return CAR_LENGTH_M, CAR_WIDTH_M
    length, width, _ = DIMENSIONS_M[kind]
    return length, width


def first_sizes(agent: NDArray[np.int64], sides: FloatArray) -> FloatArray:
    """(n, 2) the first length and width of each agent that are positive, else its first ones.

    Args:
        agent: (m,) of each row; all of 0 to n - 1 occur.
        sides: (m, 2) of each row, m.
    """
    found = sides[np.unique(agent, return_index=True)[1]]
    known = np.flatnonzero((sides > 0).all(axis=1))
    who, first = np.unique(agent[known], return_index=True)
    found[who] = sides[known[first]]
    return found


def recorded(
    path: Path,
    name: str,
    rows: Rows,
    notes: Sequence[str] = (),
    road: Path | Road | None = None,
    origin: tuple[float, float] | None = None,
    own_road: bool = False,
) -> Recording:
    """A recording of rows.

    Args:
        path: the file that they come from, for messages.
        name: of the recording.
        rows: what was read.
        notes: what had to be assumed.
        road: that came with it.
        origin: latitude and longitude of (0, 0), degrees.
        own_road: whether the road belongs to it by its id.

    Returns:
        The recording; ids are 0, 1, 2, ... in the order of ``rows.names``, numbers before words.
        Rows that repeat, riders in vehicles and agents with broken numbers are left out, and
        counted among the doubts.

    Raises:
        InputError: if there are no rows, or more are broken or repeated than may be left out.
    """
    doubts: list[str] = []
    kinds = [AgentKind.CAR] * len(rows.names) if rows.kinds is None else rows.kinds
    sizes = _sizes(path, rows, kinds, doubts)
    tracks, stated = _tracks(path, rows, _sound(path, rows, doubts), kinds, sizes, doubts)
    if rows.in_metres:
        doubts += doubts_of(tracks, stated, sizes=rows.sizes is not None)
        inside = inside_vehicles(tracks)
        if inside.any():
            riders = np.unique(tracks.rows.index.agent[inside]).size
            doubts.append(f"{riders} riders are left out while they are inside a vehicle")
            tracks = _without(tracks, inside)
    return Recording(
        name, tracks, tuple(notes), road, origin, doubts=tuple(doubts), own_road=own_road
    )


def _sizes(path: Path, rows: Rows, kinds: Sequence[AgentKind], doubts: list[str]) -> FloatArray:
    """(n, 2) the size of each agent, m: as stated where an agent can have it, else as usual."""
    n = len(rows.names)
    usual = np.array([default_size(kind) for kind in kinds]).reshape(-1, 2)
    if rows.sizes is None:
        return usual
    sizes = np.nan_to_num(rows.sizes, nan=0.0)
    odd = ~((sizes >= 0) & (sizes <= MAX_SIDE)).all(axis=1)
    if odd.any():
        who = int(np.flatnonzero(odd)[0])
        found = f"found {sizes[who, 0]:g} by {sizes[who, 1]:g}, expected 0 to {MAX_SIDE:g}"
        if odd.sum() > MAX_BROKEN * n:
            raise InputError(f"{path}: length and width of {rows.names[who]:.60}: {found}")
        doubts.append(f"{odd.sum()} of {n} agents have the size usual for their kind: {found}")
    return np.where((odd | (sizes == 0).any(axis=1))[:, None], usual, sizes)


def _sound(path: Path, rows: Rows, doubts: list[str]) -> pandas.DataFrame:
    """The rows without those that no recording can have."""
    columns = {"agent": rows.agent, "time_s": rows.time_s, "x": rows.xy[:, 0], "y": rows.xy[:, 1]}
    table = pandas.DataFrame(columns | {"heading": rows.heading, "speed": rows.speed})
    lost = table[["time_s", "x", "y"]].isna().any(axis=1)
    if lost.all():
        raise InputError(f"{path}: found no rows, expected at least one")
    numbers = table.iloc[:, 1:].astype(float)
    beyond = numbers.abs() > MAX_MAGNITUDE
    n, who = len(rows.names), table["agent"][beyond.any(axis=1)].unique()
    if who.size:
        what = beyond.columns[beyond.any()][0]
        row = beyond[what].idxmax()
        found = (
            f"{what} of {rows.names[table['agent'][row]]:.60}: found {numbers[what][row]:g}, "
            f"expected a number up to {MAX_MAGNITUDE:g}"
        )
        if who.size > MAX_BROKEN * n or table["agent"][~lost].isin(who).all():
            cause = ", as if nanoseconds had been taken for seconds" if what == "time_s" else ""
            raise InputError(f"{path}: {found}{cause}")
        doubts.append(f"{who.size} of {n} agents are left out: {found}")
    if lost.any():
        doubts.append(f"{lost.sum()} of {lost.size} rows are left out: they have no position")
    numbers.insert(0, "agent", table["agent"])
    return numbers[~lost & ~table["agent"].isin(who)]


def _tracks(
    path: Path, rows: Rows, table: pandas.DataFrame, kinds: Sequence[AgentKind],
    sizes: FloatArray, doubts: list[str],
) -> tuple[Tracks, FloatArray]:  # fmt: skip
    """The rows by agent and time, and the headings that the file states, rad."""
    present = sorted(table["agent"].unique().tolist(), key=lambda i: _natural(rows.names[i]))
    time_s = np.unique(np.append(table["time_s"], rows.empty_s))
    n, t = len(present), time_s.size
    if n == len(table) > MOST_SEEN_ONCE and t > 1:
        raise InputError(
            f"{path}: found {n} agents that are seen once each, expected several times of an agent "
            "(is the column of ids that of row numbers?)"
        )
    rank = np.full(len(rows.names), -1)
    rank[present] = np.arange(n)
    table = table.assign(
        agent=rank[table["agent"]], step=np.searchsorted(time_s, table["time_s"])
    ).sort_values(["agent", "step"], kind="stable")
    again = table.duplicated(["agent", "step"])
    same = table.duplicated()
    if (again & ~same).sum() > MAX_REPEATED * len(table):
        one = table[again & ~same].iloc[0]
        raise InputError(
            f"{path}: found agent {rows.names[present[int(one['agent'])]]} twice at time "
            f"{one['time_s']:g} s with other numbers, expected it once"
        )
    if same.any():
        doubts.append(f"{same.sum()} rows are left out that are there twice, exactly the same")
    if (again & ~same).any():
        doubts.append(f"{(again & ~same).sum()} rows left out that have an agent twice at one time")
    table = table[~again]
    agent, step = table["agent"].to_numpy(), table["step"].to_numpy()
    xy, heading, speed = (table[c].to_numpy() for c in (["x", "y"], "heading", "speed"))
    stated = heading
    if np.isnan(heading).any() or np.isnan(speed).any():
        moved = row_motion(agent, xy, time_s[step], rows.rest_heading)
        heading = np.where(np.isnan(heading), moved[0], heading)
        speed = np.where(np.isnan(speed), moved[1], speed)
    turned = (heading > np.pi) | (heading <= -np.pi)  # angles in range keep their last digit
    heading = np.where(turned, np.pi - np.mod(np.pi - heading, 2 * np.pi), heading)
    if rows.ahead_lengths:
        ahead_m = rows.ahead_lengths * sizes[present][agent, 0]
        xy = xy - ahead_m[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    tracks = Tracks(
        rows=TrackRows(RowIndex.of_rows(agent, step, n, t), xy, heading, speed),
        ids=np.arange(n),
        names=tuple(rows.names[i] for i in present),
        kind=np.array([kinds[i].code for i in present], dtype=np.int8),
        length=sizes[present, 0],
        width=sizes[present, 1],
        time_s=time_s,
        signals=np.empty((0, t), dtype=np.int8),
        behavior=None if rows.behavior is None else rows.behavior[present],
    )
    return tracks, stated


def _without(tracks: Tracks, dropped: NDArray[np.bool_]) -> Tracks:
    """The tracks without some rows, and without agents that have no others."""
    index, n, t = tracks.rows.index, len(tracks.names), tracks.time_s.size
    kept = np.flatnonzero(~dropped)
    index = RowIndex.of_rows(index.agent[kept], index.step[kept], n, t)
    fewer = replace(tracks, rows=tracks.rows.taken(kept, index))
    return fewer.part(np.unique(index.agent), slice(None))


def _natural(name: str) -> tuple[int, int, str]:
    """Sorting key: numbers by value, then words."""
    number = name.removeprefix("-")
    return (0, int(name), "") if number.isdecimal() and len(number) < 19 else (1, 0, name)
