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
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import (
    beginning_of,
    by_word,
    finite,
    read_table,
    read_text,
    rows_of,
    whole,
)
from sim.frames import AgentKind
from sim.input_files import stem

CLASSES: Final = {1: AgentKind.MOTORCYCLE, 2: AgentKind.CAR, 3: AgentKind.TRUCK}
"""``v_Class``."""

BREAK_MS: Final = 60_000.0
"""After a break longer than this, in all rows or in those of an id, the id is another vehicle
(vehicles are seen without a break, and periods of recording have 15 minutes), ms."""

COLUMNS: Final = {
    "id": "vehicle_id", "t": "global_time", "x": "local_x", "y": "local_y", "speed": "v_vel",
    "length": "v_length", "width": "v_width",
}  # fmt: skip
UNITS: Final = dict.fromkeys(("x", "y", "length", "width"), "ft") | {"speed": "ft/s", "t": "ms"}
NUMBERS: Final = (*COLUMNS.values(), "total_frames", "v_class")
"""Columns that are read."""

TEXT_COLUMNS: Final = (
    "vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x",
    "global_y", "v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id", "preceding",
    "following", "space_headway", "time_headway",
)  # fmt: skip
"""Columns of the text files, in order."""


def read(path: Path) -> Iterator[Recording]:
    """One recording for each location of a file and each period without a long break there."""
    if "vehicle_id" in beginning_of(path)[1]:
        table = read_table(path, NUMBERS, ("location",), ("location",))
    else:
        table = read_text(path, TEXT_COLUMNS, NUMBERS)
    for place, there in sorted(by_word(table, "location")):
        name = f"{stem(path)}-{place}" if place else stem(path)
        time_ms = finite(there, "global_time")
        order = np.argsort(time_ms, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(time_ms[order]) > BREAK_MS) + 1)
        for number, rows in enumerate(parts, 1):
            part_name = name if len(parts) == 1 else f"{name}-{number}"
            yield _recording(part_name, there.iloc[np.sort(rows)])


def _recording(name: str, table: pandas.DataFrame) -> Recording:
    """The recording of one period."""
    rows = rows_of(table, COLUMNS, units=UNITS, from_zero=True)
    rows["id"] = _agents(table)
    kind = table["v_class"].map({code: kind.code for code, kind in CLASSES.items()})
    if kind.isna().any():
        wrong = table["v_class"][kind.isna()].iloc[0]
        raise InputError(f"column v_class: found {wrong:g}, expected 1, 2 or 3")
    rows["kind"] = kind.groupby(rows["id"].cat.codes).transform("first")
    # the heading follows from the motion of the front, the centre from the heading
    return recorded(
        name, rows, ["headings are taken from the motion"], rest_heading=math.pi / 2,
        ahead_lengths=0.5,
    )  # fmt: skip


def _agents(table: pandas.DataFrame) -> pandas.Categorical:
    """The agent of each row.

    Ids are used again for other vehicles: how long each is seen, and long breaks, tell them apart.
    """
    ids, frames = whole(table, "vehicle_id"), whole(table, "total_frames")
    time_ms = finite(table, "global_time")
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
    names = [
        (f"{i}-{n}" if i in several else str(i)) + (f"/{k + 1}" if k else "")
        for i, n, k in zip(first.tolist(), lasts.tolist(), turn.tolist(), strict=True)
    ]
    return pandas.Categorical.from_codes(agent, names)
