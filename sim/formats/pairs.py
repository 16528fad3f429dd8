"""Pairs of a follower and its leader along a lane, as car-following models are fitted to.

CSV with the columns ``t, x_follower, v_follower, x_leader, v_leader``, in seconds, and optionally
``leader_length`` and names (``pair, period, follower, leader``). Positions are along the lane,
those of both fronts; where the leader's length is zero or missing, that of its rear. Lengths are
metres, unless those of the leaders are as long as cars are in feet: then everything is in feet, as
in the recordings of NGSIM that such files are cut from. Each pair is a recording of two vehicles on
a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.formats.common.csv_columns import read_columns
from sim.formats.common.packed import stem
from sim.formats.common.recording import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    FloatArray,
    Recording,
    Rows,
    recordings,
)

FOOT_M: Final = 0.3048

LENGTH_IN_FEET: Final = 9.0
"""Leaders with a median length above this are measured in feet (a car is 4 to 5 m or 13 to 17 feet
long)."""

_NUMBERS: Final = ("t", "x_follower", "v_follower", "x_leader", "v_leader")
_WORDS: Final = ("pair", "period", "follower", "leader")


def read(path: Path) -> Iterator[Recording]:
    """Read one file.

    Args:
        path: the file.

    Yields:
        One recording for each pair: leader and follower, x along the lane and y 0.

    Raises:
        InputError: if the file is broken; the message names file and column or row.
    """
    columns = read_columns(path, [*_NUMBERS, "leader_length"], _WORDS, ["leader_length", *_WORDS])
    m = len(columns)
    numbers = {name: columns.numbers(name) for name in _NUMBERS}
    length = columns.numbers("leader_length") if "leader_length" in columns else np.zeros(m)
    if m and (length.min() < 0.0):
        row = int(length.argmin())
        raise InputError(
            f"{path}: column leader_length, row {row + 2}: found {length[row]}, expected 0 or more"
        )
    known = length[length > 0.0]
    feet = bool(known.size) and float(np.median(known)) > LENGTH_IN_FEET
    unit_m = FOOT_M if feet else 1.0
    notes = ["places are along the lane only; the follower's length and both widths are assumed"]
    if feet:
        notes.append("lengths are taken for feet: leaders are as long as cars are in feet")
    keys = [name for name in ("pair", "period") if name in columns]
    pair, names = columns.names(*keys) if keys else (np.zeros(m, dtype=np.int64), ("",))
    who = [
        columns.only(name, pair) if name in columns else [name] * len(names)
        for name in ("follower", "leader")
    ]
    order = np.argsort(pair, kind="stable")
    begins = np.searchsorted(pair[order], np.arange(len(names) + 1))
    for index, name in enumerate(names):
        chosen = order[begins[index] : begins[index + 1]]
        here = {key: values[chosen] for key, values in numbers.items()}
        follower, leader = str(who[0][index]), str(who[1][index])
        if follower == leader:
            raise InputError(
                f"{path}: column leader: found {leader}, which is the follower of pair {name} too, "
                "expected another"
            )
        rows = _rows(here, unit_m, unit_m * length[chosen], (follower, leader))
        label = f"{stem(path)}-{name}" if name else stem(path)
        yield from recordings(path, label, rows, notes)


def _rows(
    numbers: dict[str, FloatArray], unit_m: float, length_m: FloatArray, names: tuple[str, str]
) -> Rows:
    """Rows of one pair: the follower's, then the leader's."""
    m = length_m.size
    leader_m = float(length_m[0]) if m and length_m[0] > 0.0 else CAR_LENGTH_M
    centres = (
        unit_m * numbers["x_follower"] - 0.5 * CAR_LENGTH_M,
        unit_m * numbers["x_leader"] - length_m + 0.5 * leader_m,
    )
    speeds = (unit_m * numbers["v_follower"], unit_m * numbers["v_leader"])
    return Rows(
        agent=np.repeat(np.arange(2), m),
        names=names,
        time_s=np.tile(numbers["t"], 2),
        x=np.concatenate(centres),
        y=np.zeros(2 * m),
        heading=np.zeros(2 * m),
        speed=np.maximum(np.concatenate(speeds), 0.0),
        length=np.array([CAR_LENGTH_M, leader_m]),
        width=np.full(2, CAR_WIDTH_M),
        kind=np.zeros(2, dtype=np.int8),
    )
