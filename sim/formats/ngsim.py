"""NGSIM vehicle trajectories: FEET, feet per second, milliseconds; positions of the FRONT centre.

Either the CSV with its header (upper and lower case vary, some columns may be missing) or the
highway text files: white space, no header, 18 columns. ``Local_X`` points to the right across the
road, ``Local_Y`` along it, so x and y here are those in metres.

References:
    U.S. Department of Transportation, Federal Highway Administration (2006), Next Generation
    Simulation (NGSIM) vehicle trajectories.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.csv_columns import Columns, read_columns, read_fields, read_header
from sim.formats.common.packed import stem
from sim.formats.common.recording import (
    Recording,
    Rows,
    assemble,
    check_size,
    kind_codes,
)
from sim.frames import AgentKind

FOOT_M: Final = 0.3048
"""The international foot, m."""

CLASSES: Final[dict[int, AgentKind]] = {
    1: AgentKind.MOTORCYCLE,
    2: AgentKind.CAR,
    3: AgentKind.TRUCK,
}
"""``v_Class``."""

BREAK_S: Final = 60.0
"""After a break longer than this, in all rows or in those of an id, the id is another vehicle
(vehicles are seen without a break, and periods of recording have 15 minutes)."""

MAX_PERIODS: Final = 1000
"""Most periods of recording at one place (NGSIM has up to three)."""

MAX_PLACES: Final = 100
"""Most places of recording in a file (NGSIM has four)."""

NUMBERS: Final = (
    "vehicle_id", "total_frames", "global_time", "local_x", "local_y", "v_length", "v_width",
    "v_class", "v_vel",
)  # fmt: skip

TEXT_COLUMNS: Final = (
    "vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x",
    "global_y", "v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id", "preceding",
    "following", "space_headway", "time_headway",
)  # fmt: skip
"""Columns of the text files, in order."""


def read(path: Path) -> Iterator[Recording]:
    """Read one file.

    Args:
        path: the CSV or the text file.

    Yields:
        One recording for each location and each period without a long break there.

    Raises:
        InputError: if the file is broken; the message names file and column or line.
    """
    check_size(path)
    if "vehicle_id" not in read_header(path):
        yield from _recordings(path, stem(path), read_fields(path, TEXT_COLUMNS, NUMBERS))
        return
    columns = read_columns(path, NUMBERS, ["location"], optional=["location"])
    if "location" not in columns:
        yield from _recordings(path, stem(path), columns)
        return
    places = columns.table.column("location")
    names = sorted(pc.unique(places).to_pylist())
    if len(names) > MAX_PLACES:
        raise InputError(
            f"{path}: column location: found {len(names)} places, expected at most {MAX_PLACES}"
        )
    for place in names:
        part = Columns(path, columns.table.filter(pc.equal(places, pa.scalar(place))))
        yield from _recordings(path, f"{stem(path)}-{place}", part)


def _recordings(path: Path, name: str, columns: Columns) -> Iterator[Recording]:
    """The recordings of one place: one for each period without a long break."""
    time_ms = columns.numbers("global_time")
    order = np.argsort(time_ms, kind="stable")
    breaks = np.flatnonzero(np.diff(time_ms[order]) > BREAK_S * 1000.0) + 1
    if breaks.size >= MAX_PERIODS:
        raise InputError(
            f"{path}: column global_time: found {breaks.size} breaks of more than {BREAK_S:g} s, "
            f"expected fewer than {MAX_PERIODS}"
        )
    parts = np.split(order, breaks)
    for number, rows in enumerate(parts, 1):
        part_name = name if len(parts) == 1 else f"{name}-{number}"
        yield _recording(
            path, part_name, Columns(path, columns.table.take(pa.array(np.sort(rows))))
        )


def _whole(path: Path, column: str, values: NDArray[np.float64]) -> pa.Array:
    """A column as whole numbers."""
    bad = np.flatnonzero((np.abs(values) > 2**53) | (values != np.rint(values)))
    if bad.size:
        raise InputError(f"{path}: column {column}: found {values[bad[0]]}, expected whole numbers")
    return pa.array(values.astype(np.int64))


def _without_breaks(
    agent: NDArray[np.int64], names: tuple[str, ...], time_ms: NDArray[np.float64]
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Agents and their names; an id that returns after a long break is another agent."""
    order = np.lexsort((time_ms, agent))
    same = np.diff(agent[order], prepend=-1) == 0
    again = same & (np.diff(time_ms[order], prepend=np.inf) > BREAK_S * 1000.0)
    begins = np.flatnonzero(~same | again)
    whose = agent[order[begins]]
    earlier = np.arange(whose.size) - np.searchsorted(whose, whose)
    told = tuple(
        names[who] if turn == 0 else f"{names[who]}/{turn + 1}"
        for who, turn in zip(whose.tolist(), earlier.tolist(), strict=True)
    )
    split = np.empty_like(agent)
    split[order] = np.cumsum(~same | again) - 1
    return split, told


def _recording(path: Path, name: str, columns: Columns) -> Recording:
    values = {column: columns.numbers(column) for column in NUMBERS}
    whole = pa.table({c: _whole(path, c, values[c]) for c in ("vehicle_id", "total_frames")})
    # Ids are used again for other vehicles; how long each is seen tells them apart.
    agent, names = Columns(path, whole).names("vehicle_id", "total_frames")
    agent, names = _without_breaks(agent, names, values["global_time"])
    _, first = np.unique(agent, return_index=True)
    kinds = []
    for code in values["v_class"][first].tolist():
        if code not in CLASSES:
            raise InputError(f"{path}: column v_class: found {code:g}, expected 1, 2 or 3")
        kinds.append(CLASSES[int(code)])
    length = values["v_length"][first] * FOOT_M
    time_ms = values["global_time"] - values["global_time"].min()
    nothing = np.full(len(columns), np.nan)
    # the heading follows from the motion of the front, the centre from the heading
    rows = Rows(
        agent=agent,
        names=names,
        time_s=time_ms / 1000.0,
        x=values["local_x"] * FOOT_M,
        y=values["local_y"] * FOOT_M,
        heading=nothing,
        speed=values["v_vel"] * FOOT_M,
        length=length,
        width=values["v_width"][first] * FOOT_M,
        kind=kind_codes(kinds),
        rest_heading=math.pi / 2,
        ahead_lengths=0.5,
    )
    return Recording(name, assemble(path, rows), ("headings are told from the motion",))
