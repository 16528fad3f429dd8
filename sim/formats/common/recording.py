"""A recording from elsewhere: rows of any format become a `Recording`, or one clear error.

Every reader gives rows in our conventions. What all readers share is here: order, rows that
repeat, agents whose numbers are broken, and headings and speeds that follow from the motion.
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
from behaviors.labels import BEHAVIORS, Style
from behaviors.row_index import RowIndex
from sim.formats.common.doubts import doubts_of
from sim.formats.common.label_file import DriverLabel
from sim.formats.common.tables import MOVING_MPS
from sim.frames import KINDS, MAX_MAGNITUDE, AgentKind, FloatArray, Tracks
from sim.road import Road
from sim.scenario import DIMENSIONS_M

MAX_SIDE: Final = 1000.0
"""Longest agent, m (longer than any train, and than any box in an image, pixels)."""

CAR_LENGTH_M: Final = 4.5
CAR_WIDTH_M: Final = 1.8
"""Size of a car where a format does not say it (a European median)."""

CARS_ASSUMED: Final = "kinds and sizes are not in this format: cars of 4.5 m are assumed"
"""The note of recordings of formats that have positions only."""

BEHAVIOR_CODES: Final[dict[str | None, int]] = {
    "": -1,
    None: -1,
    **{str(behavior): behavior.code for behavior in BEHAVIORS},
}
"""Code of each behaviour that a format names; -1 for none."""

MAX_REPEATED: Final = 0.02
"""Share of rows that may repeat an agent at one time with other numbers (a tracker that splits
vehicles makes some .5 %): the first counts. With more, ids or times are wrong."""

MOST_SEEN_ONCE: Final = 100
"""More agents than this that are all seen once have the numbers of rows for their ids."""

MAX_BROKEN: Final = 0.5
"""Share of agents or rows that may be left out because their numbers are broken."""

SHORTEST_S: Final = 1e-6
"""Times closer than this give no velocity, s (far below any sampling interval)."""


@dataclass(frozen=True)
class Recording:
    """One recording, read.

    Attributes:
        name: the recording's own name.
        tracks: what was recorded; without labels unless the format carries them.
        notes: what had to be assumed or was left out, one sentence each.
        road: the road that came with it, or its file as `sim.road.road_files.read_road_file` takes
            it; None where there is none.
        origin: latitude and longitude of (0, 0), degrees; None where not known.
        styles: by name, of the drivers whose style is known but not their behaviour.
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
        """The same recording with a label of each agent; None leaves what is known of it."""
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
        return replace(self, tracks=replace(self.tracks, behavior=codes), styles=styles)

    def with_behaviors(self, words: Mapping[str, str | None]) -> Recording:
        """The same recording with behaviours by an agent's name; one's own become unknown."""
        given = [words.get(name) for name in self.tracks.names]
        found = np.array([BEHAVIOR_CODES.get(word, -1) for word in given], dtype=np.int8)
        doubts, tracks = self.doubts, self.tracks
        if other := sum(isinstance(word, str) and word not in BEHAVIOR_CODES for word in given):
            doubts += (f"{other} agents have other behaviours than the six, which become unknown",)
        if (found >= 0).any():
            tracks = replace(tracks, behavior=found)
        return replace(self, tracks=tracks, doubts=doubts)


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


def recorded(
    name: str,
    rows: pandas.DataFrame,
    notes: Sequence[str] = (),
    road: Path | Road | None = None,
    origin: tuple[float, float] | None = None,
    *,
    own_road: bool = False,
    empty_s: Sequence[float] = (),
    rest_heading: float = 0.0,
    ahead_lengths: float = 0.0,
    in_metres: bool = True,
) -> Recording:
    """A recording of rows.

    Args:
        name: of the recording.
        rows: one of each agent and time, in any order. Columns are ``id``, the source's own;
            ``t``, s; ``x`` and ``y`` of the centre, m. There may be ``heading``, rad, and
            ``speed``, m/s, else they follow from the motion; ``kind``, a code into ``KINDS``, else
            all are cars; ``length`` and ``width``, m, else they are the ones usual for the kind.
            NaN stands for what is not known.
        notes: what had to be assumed.
        road: that came with it.
        origin: latitude and longitude of (0, 0), degrees.
        own_road: whether the road belongs to it by its id.
        empty_s: times at which nobody may have been seen, s.
        rest_heading: heading of agents that never move, rad.
        ahead_lengths: how far positions are ahead of the centre, in lengths of the vehicle: 0.5
            where they are its front.
        in_metres: whether positions and sizes are metres; else nothing is doubted.

    Returns:
        The recording; ids are 0, 1, 2, ... in the order of the names, numbers before words.
        Rows that repeat and agents with broken numbers are left out, and counted among the doubts.

    Raises:
        InputError: if there are no rows, or more are broken or repeated than may be left out.
    """
    doubts: list[str] = []
    code, found = pandas.factorize(rows["id"])
    names = sorted(map(str, found), key=_natural)
    place = {label: i for i, label in enumerate(names)}
    table = rows.reindex(columns=["t", "x", "y", "heading", "speed", "length", "width", "kind"])
    table = table.astype(float).reset_index(drop=True)
    table.insert(0, "agent", np.array([place[str(label)] for label in found], dtype=int)[code])
    kind = _kinds(table, names)
    sizes = _sizes(table, names, kind, doubts)
    table = _sound(table.drop(columns=["length", "width", "kind"]), names, doubts)
    present = np.unique(table["agent"])
    table["agent"] = np.searchsorted(present, table["agent"])
    time_s = np.unique(np.append(table["t"], empty_s))
    names, sizes = [names[i] for i in present], sizes[present]
    table = _each_once(table, names, time_s, doubts)
    n, agent, step = len(names), table["agent"].to_numpy(), table["step"].to_numpy()
    xy, stated, speed = (table[c].to_numpy() for c in (["x", "y"], "heading", "speed"))
    heading = stated
    if np.isnan(heading).any() or np.isnan(speed).any():
        moved = row_motion(agent, xy, time_s[step], rest_heading)
        heading = np.where(np.isnan(heading), moved[0], heading)
        speed = np.where(np.isnan(speed), moved[1], speed)
    turned = (heading > np.pi) | (heading <= -np.pi)  # angles in range keep their last digit
    heading = np.where(turned, np.pi - np.mod(np.pi - heading, 2 * np.pi), heading)
    if ahead_lengths:
        ahead_m = ahead_lengths * sizes[agent, 0]
        xy = xy - ahead_m[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    tracks = Tracks(
        index=RowIndex.of_rows(agent, step, n, time_s.size), row_xy=xy, row_heading=heading,
        row_speed=speed, ids=np.arange(n), names=tuple(names), kind=kind[present],
        length=sizes[:, 0], width=sizes[:, 1], time_s=time_s,
        signals=np.empty((0, time_s.size), dtype=np.int8),
    )  # fmt: skip
    if in_metres:
        doubts += doubts_of(tracks, stated, sizes="length" in rows)
    return Recording(
        name, tracks, tuple(notes), road, origin, doubts=tuple(doubts), own_road=own_road
    )


def _kinds(table: pandas.DataFrame, names: Sequence[str]) -> NDArray[np.int8]:
    """(n,) the kind of each agent, which all of its rows have."""
    kinds = table["kind"].fillna(AgentKind.CAR.code).groupby(table["agent"]).agg(["min", "max"])
    low, high = (np.asarray(kinds[end], dtype=np.int8) for end in ("min", "max"))
    if (low != high).any():
        who = int((low != high).argmax())
        raise InputError(
            f"found agent {names[who]:.60} as {KINDS[low[who]]} and {KINDS[high[who]]}, "
            "expected one kind"
        )
    return low


def _sizes(
    table: pandas.DataFrame, names: Sequence[str], kind: NDArray[np.int8], doubts: list[str]
) -> FloatArray:
    """(n, 2) the size of each agent, m: the first one stated, else the usual one."""
    usual = np.array([default_size(KINDS[k]) for k in kind]).reshape(-1, 2)
    sides = table[["length", "width"]]
    known = sides.where((sides > 0).all(axis=1)).groupby(table["agent"]).first()
    first = sides.iloc[np.unique(table["agent"], return_index=True)[1]].set_axis(known.index)
    sizes = known.fillna(first).fillna(0.0).to_numpy()
    odd = ~((sizes >= 0) & (sizes <= MAX_SIDE)).all(axis=1)
    if odd.any():
        one, n = int(odd.argmax()), len(names)
        found = f"found {sizes[one, 0]:g} by {sizes[one, 1]:g}, expected 0 to {MAX_SIDE:g}"
        if odd.sum() > MAX_BROKEN * n:
            raise InputError(f"length and width of {names[one]:.60}: {found}")
        doubts.append(f"{odd.sum()} of {n} agents have the size usual for their kind: {found}")
    return np.where((odd | (sizes == 0).any(axis=1))[:, None], usual, sizes)


def _sound(table: pandas.DataFrame, names: Sequence[str], doubts: list[str]) -> pandas.DataFrame:
    """The rows without those that no recording can have."""
    lost = table[["t", "x", "y"]].isna().any(axis=1)
    if lost.all():
        raise InputError("found no rows, expected at least one")
    beyond = table.iloc[:, 1:].abs() > MAX_MAGNITUDE
    broken = table["agent"][beyond.any(axis=1)].unique()
    if broken.size:
        what = beyond.columns[beyond.any()][0]
        row = beyond[what].idxmax()
        found = (
            f"{what} of {names[table['agent'][row]]:.60}: found {table[what][row]:g}, "
            f"expected a number up to {MAX_MAGNITUDE:g}"
        )
        if broken.size > MAX_BROKEN * len(names) or table["agent"][~lost].isin(broken).all():
            cause = ", as if nanoseconds had been taken for seconds" if what == "t" else ""
            raise InputError(f"{found}{cause}")
        doubts.append(f"{broken.size} of {len(names)} agents are left out: {found}")
    if lost.any():
        doubts.append(f"{lost.sum()} of {lost.size} rows are left out: they have no position")
    return table[~lost & ~table["agent"].isin(broken)].copy()


def _each_once(
    table: pandas.DataFrame, names: Sequence[str], time_s: FloatArray, doubts: list[str]
) -> pandas.DataFrame:
    """The rows by agent and time, each once, with the index of their time as ``step``."""
    if len(names) == len(table) > MOST_SEEN_ONCE and time_s.size > 1:
        raise InputError(
            f"found {len(names)} agents that are seen once each, expected several times of an "
            "agent (is the column of ids that of row numbers?)"
        )
    table["step"] = np.searchsorted(time_s, table["t"])
    table = table.sort_values(["agent", "step"], kind="stable")
    again, same = table.duplicated(["agent", "step"]), table.duplicated()
    other = again & ~same
    if other.sum() > MAX_REPEATED * len(table):
        one = table[other].iloc[0]
        raise InputError(
            f"found agent {names[int(one['agent'])]} twice at time {one['t']:g} s with other "
            "numbers, expected it once"
        )
    if same.any():
        doubts.append(f"{same.sum()} rows are left out that are there twice, exactly the same")
    if other.any():
        doubts.append(f"{other.sum()} rows left out that have an agent twice at one time")
    return table[~again]


def _natural(name: str) -> tuple[int, int, str]:
    """Sorting key: numbers by value, then words."""
    number = name.removeprefix("-")
    return (0, int(name), "") if number.isdecimal() and len(number) < 19 else (1, 0, name)


# --- motion -------------------------------------------------------------------------------------


def row_motion(
    agent: NDArray[np.int64], xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """(m,) heading, rad, and (m,) speed, m/s, from positions.

    The velocity at each time is the difference of the neighbouring positions of the agent
    (one-sided at the ends). Below ``MOVING_MPS`` the heading is that of the last time in motion;
    before the first such time it is that of the first, and ``rest_heading`` if there is none. Rows
    are in order of agent (m,), then of time (m,).
    """
    same = agent[1:] == agent[:-1]
    before = np.arange(agent.size) - np.append(np.zeros(min(agent.size, 1), bool), same)
    after = np.arange(agent.size) + np.append(same, np.zeros(min(agent.size, 1), bool))
    passed = (time_s[after] - time_s[before])[:, None]
    moved = xy[after] - xy[before]
    velocity = np.divide(moved, passed, out=np.zeros_like(moved), where=passed > SHORTEST_S)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = pandas.Series(direction).where(speed >= MOVING_MPS)
    held = moving.groupby(agent).ffill().groupby(agent).bfill().fillna(rest_heading)
    return held.to_numpy(), speed


def with_motion(tracks: Tracks, rest_heading: float = 0.0) -> Tracks:
    """The tracks with headings and speeds that follow from their positions."""
    index = tracks.index
    heading, speed = row_motion(index.agent, tracks.row_xy, tracks.time_s[index.step], rest_heading)
    return replace(tracks, row_heading=heading, row_speed=speed)


def at_rate(tracks: Tracks, rate_hz: float) -> Tracks:
    """The tracks, of two times at least, with times stretched to another rate.

    Speeds that are those of the motion are taken from it again; stated ones stay.
    """
    first, stated = tracks.time_s[0], tracks.row_speed
    slower = replace(tracks, time_s=first + (tracks.time_s - first) / (rate_hz * tracks.step_s))
    before, after = with_motion(tracks).row_speed, with_motion(slower).row_speed
    return replace(slower, row_speed=np.where(np.isclose(stated, before, rtol=1e-9), after, stated))
