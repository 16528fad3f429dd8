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
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.columns import Columns
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import Table, column_names, read_text
from sim.frames import AgentKind
from sim.input_files import stem

CLASSES: Final[dict[int, AgentKind]] = {
    1: AgentKind.MOTORCYCLE,
    2: AgentKind.CAR,
    3: AgentKind.TRUCK,
}
"""``v_Class``."""

BREAK_MS: Final = 60_000.0
"""After a break longer than this, in all rows or in those of an id, the id is another vehicle
(vehicles are seen without a break, and periods of recording have 15 minutes), ms."""

_FEET: Final = ("local_x", "local_y", "v_length", "v_width")
COLUMNS: Final = Columns(
    id=("vehicle_id",), t="global_time", xy=("local_x", "local_y"), speed=("v_vel",),
    size=("v_length", "v_width"), from_zero=True, numbers=("vehicle_id", "total_frames", "v_class"),
    units=dict.fromkeys(_FEET, "ft") | {"v_vel": "ft/s", "global_time": "ms"},
    words=("location",), optional=("location",),
)  # fmt: skip
"""Columns that are read."""

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
    if "vehicle_id" in column_names(path):
        table = COLUMNS.read(path)
    else:
        table = read_text(path, TEXT_COLUMNS, COLUMNS.measured)
    for place, part in sorted(table.by_word("location")):
        yield from _recordings(f"{stem(path)}-{place}" if place else stem(path), part)


def _recordings(name: str, table: Table) -> Iterator[Recording]:
    """The recordings of one place: one for each period without a long break."""
    time_ms = table.numbers("global_time")
    order = np.argsort(time_ms, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(time_ms[order]) > BREAK_MS) + 1)
    for number, rows in enumerate(parts, 1):
        part_name = name if len(parts) == 1 else f"{name}-{number}"
        yield _recording(part_name, table.part(np.sort(rows)))


def _agents(table: Table) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """The agent of each row, and the agents' names.

    Ids are used again for other vehicles: how long each is seen, and long breaks, tell them apart.
    """
    ids, frames = table.whole("vehicle_id"), table.whole("total_frames")
    time_ms = table.numbers("global_time")
    order = np.lexsort((time_ms, frames, ids))
    other = np.ones(order.size, dtype=bool)
    other[1:] = (np.diff(ids[order]) != 0) | (np.diff(frames[order]) != 0)
    begins = other | (np.diff(time_ms[order], prepend=np.inf) > BREAK_MS)
    agent = np.empty_like(ids)
    agent[order] = np.cumsum(begins) - 1

    first, lasts = ids[order[begins]], frames[order[begins]]
    place = np.arange(first.size)
    turn = place - np.maximum.accumulate(np.where(other[begins], place, 0))
    known, counts = np.unique(first[other[begins]], return_counts=True)
    several = set(known[counts > 1].tolist())
    names = tuple(
        (f"{i}-{n}" if i in several else str(i)) + (f"/{k + 1}" if k else "")
        for i, n, k in zip(first.tolist(), lasts.tolist(), turn.tolist(), strict=True)
    )
    return agent, names


def _recording(name: str, table: Table) -> Recording:
    """The recording of one period."""
    agent, names = _agents(table)
    _, first = np.unique(agent, return_index=True)
    codes = table.whole("v_class")[first].tolist()
    unknown = set(codes) - set(CLASSES)
    if unknown:
        raise InputError(f"{table.path}: column v_class: found {unknown.pop()}, expected 1, 2 or 3")
    # the heading follows from the motion of the front, the centre from the heading
    rows = replace(
        COLUMNS.rows(table, (agent, names)),
        kinds=[CLASSES[code] for code in codes],
        rest_heading=math.pi / 2,
        ahead_lengths=0.5,
    )
    return recorded(table.path, name, rows, ["headings are taken from the motion"])
