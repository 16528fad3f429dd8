"""The GraphRQI paper's Argoverse sequences as CSV: ``frame,id,x,y``, metres, 10 Hz assumed.

Coordinates move with the recording vehicle (offset by 1500 m); they are kept as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from sim.formats.csv_columns import read_columns
from sim.formats.recording import CAR_LENGTH_M, CAR_WIDTH_M, Recording, Rows, assemble

FRAME_RATE_HZ: Final = 10.0
"""Frames per second that are assumed (Argoverse's tracking data has 10)."""


def read(path: Path) -> Iterator[Recording]:
    """Read one file.

    Args:
        path: the CSV file.

    Yields:
        One recording.

    Raises:
        InputError: if the file is broken; the message names file and column or row.
    """
    columns = read_columns(path, ["frame", "x", "y"], ["id"])
    agent, names = columns.names("id")
    unknown = np.full(len(columns), np.nan)
    n = len(names)
    rows = Rows(
        agent=agent,
        names=names,
        time_s=columns.numbers("frame") / FRAME_RATE_HZ,
        x=columns.numbers("x"),
        y=columns.numbers("y"),
        heading=unknown,
        speed=unknown,
        length=np.full(n, CAR_LENGTH_M),
        width=np.full(n, CAR_WIDTH_M),
        kind=np.zeros(n, dtype=np.int8),
    )
    yield Recording(
        path.stem,
        assemble(path, rows),
        (
            "positions are in the frame of the recording vehicle, which moves",
            "kinds and sizes are not in this format: cars of 4.5 m are assumed",
        ),
    )
