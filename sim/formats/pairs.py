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
from sim.formats.common.recording import CAR_LENGTH_M, CAR_WIDTH_M, Recording, Rows, recorded
from sim.formats.common.tables import Table, read_table
from sim.input_files import stem

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
    table = read_table(path, [*_NUMBERS, "leader_length"], _WORDS, ["leader_length", *_WORDS])
    length = table.numbers("leader_length") if "leader_length" in table else np.zeros(len(table))
    feet = bool((length > 0).any()) and float(np.median(length[length > 0])) > LENGTH_IN_FEET
    notes = ["places are along the lane only; the follower's length and both widths are assumed"]
    if feet:
        notes.append("lengths are taken for feet: leaders are as long as cars are in feet")
    keys = [name for name in ("pair", "period") if name in table]
    pair, names = table.names(*keys) if keys else (np.zeros(len(table), dtype=np.int64), ("",))
    order = np.argsort(pair, kind="stable")
    ends = np.cumsum(np.bincount(pair))[:-1]
    for name, chosen in zip(names, np.split(order, ends), strict=True):
        label = f"{stem(path)}-{name}" if name else stem(path)
        rows = _rows(table.part(chosen), "ft" if feet else "")
        yield recorded(path, label, rows, notes)


def _rows(table: Table, unit: str) -> Rows:
    """Rows of one pair: the follower's, then the leader's."""
    m = len(table)
    follower, leader = (
        str(table.only(name, np.zeros(m, dtype=np.int64))[0]) if name in table else name
        for name in ("follower", "leader")
    )
    if follower == leader:
        raise InputError(
            f"{table.path}: column leader: found {leader}, which is the follower of its pair too, "
            "expected another"
        )
    length = table.numbers("leader_length", unit) if "leader_length" in table else np.zeros(m)
    leader_m = float(length[0]) if length[0] > 0.0 else CAR_LENGTH_M
    x = np.concatenate(
        [
            table.numbers("x_follower", unit) - 0.5 * CAR_LENGTH_M,
            table.numbers("x_leader", unit) - length + 0.5 * leader_m,
        ]
    )
    speed = np.concatenate([table.numbers(name, unit) for name in ("v_follower", "v_leader")])
    return Rows(
        np.repeat(np.arange(2), m),
        (follower, leader),
        np.tile(table.numbers("t"), 2),
        np.stack([x, np.zeros(2 * m)], axis=1),
        np.zeros(2 * m),
        np.maximum(speed, 0.0),
        sizes=np.array([[CAR_LENGTH_M, CAR_WIDTH_M], [leader_m, CAR_WIDTH_M]]),
    )
