"""Pairs of a follower and its leader along a lane, as car-following models are fitted to.

CSV with the columns ``t, x_follower, v_follower, x_leader, v_leader``, in seconds, and optionally
``leader_length`` and names (``pair, period, follower, leader``). Positions are along the lane,
those of both fronts; where the leader's length is zero or missing, that of its rear. Lengths are
metres, unless those of the leaders are as long as cars are in feet: then everything is in feet, as
in the recordings of NGSIM that such files are cut from. Each pair is a recording of two vehicles on
a line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import CAR_LENGTH_M, CAR_WIDTH_M, Recording, recorded
from sim.formats.common.tables import finite, read_table
from sim.input_files import stem
from sim.units import in_si

LENGTH_IN_FEET: Final = 9.0
"""Leaders with a median length above this are measured in feet (a car is 4 to 5 m or 13 to 17 feet
long)."""

_NUMBERS: Final = ("t", "x_follower", "v_follower", "x_leader", "v_leader", "leader_length")
_WORDS: Final = ("pair", "period", "follower", "leader")


def read(path: Path) -> Iterator[Recording]:
    """A recording for each pair of a file: leader and follower, x along the lane and y 0."""
    table = read_table(path, _NUMBERS, _WORDS, ("leader_length", *_WORDS))
    if "leader_length" not in table:
        table["leader_length"] = 0.0
    lengths = finite(table, "leader_length")
    feet = bool((lengths > 0).any()) and float(np.median(lengths[lengths > 0])) > LENGTH_IN_FEET
    notes = ["places are along the lane only; the follower's length and both widths are assumed"]
    if feet:
        notes.append("lengths are taken for feet: leaders are as long as cars are in feet")
    keys = [name for name in _WORDS[:2] if name in table]
    pairs = list(table.groupby(keys, observed=True, dropna=False)) if keys else [((), table)]
    count = Counter(names[:1] for names, _ in pairs)
    for names, part in pairs:
        said = map(str, names if count[names[:1]] > 1 else names[:1])
        yield recorded("-".join([stem(path), *said]), _rows(part, "ft" if feet else ""), notes)


def _rows(table: pandas.DataFrame, unit: str) -> pandas.DataFrame:
    """Rows of one pair: the follower's, then the leader's."""
    names = []
    for role in _WORDS[2:]:
        called = table[role].unique() if role in table else [role]
        if len(called) > 1 or str(called[0]) in names:
            found = " and ".join(map(str, called[:2]))
            raise InputError(
                f"column {role}: found {found}, expected one name in a pair, another than that of "
                "the follower"
            )
        names.append(str(called[0]))
    length = in_si(finite(table, "leader_length"), unit)
    leader_m = float(length[0]) if length[0] > 0.0 else CAR_LENGTH_M
    x, v, leader_x, leader_v = (in_si(finite(table, name), unit) for name in _NUMBERS[1:5])
    places = x - 0.5 * CAR_LENGTH_M, leader_x - length + 0.5 * leader_m
    each = zip(names, places, (v, leader_v), (CAR_LENGTH_M, leader_m), strict=True)
    rows = [
        pandas.DataFrame(
            {"id": name, "t": finite(table, "t"), "x": x, "y": 0.0, "heading": 0.0,
             "speed": np.maximum(speed, 0.0), "length": length_m, "width": CAR_WIDTH_M}
        )
        for name, x, speed, length_m in each
    ]  # fmt: skip
    return pandas.concat(rows)
