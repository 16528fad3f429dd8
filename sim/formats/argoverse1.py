"""Argoverse 1 motion forecasting: one CSV per 5 s at 10 Hz, centres in metres.

Columns ``TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME``; times in seconds. The format has neither
headings nor speeds nor sizes nor kinds.

References:
    Chang et al. (2019), Argoverse: 3D tracking and forecasting with rich maps, CVPR.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.atomic import write_whole
from sim.formats.csv_columns import read_columns
from sim.formats.recording import CAR_LENGTH_M, CAR_WIDTH_M, Recording, Rows, assemble
from sim.formats.windows import every_tenth, focal_agents, windows
from sim.frames import KINDS, Tracks

STEPS: Final = 50
"""Length of a recording: 20 steps observed, 30 to predict."""

CITY: Final = "PIT"
"""The format allows Pittsburgh and Miami only; what we write is neither."""


def read(path: Path) -> Iterator[Recording]:
    """Read one CSV file.

    Args:
        path: the file.

    Yields:
        One recording; times count from its first row's earliest.

    Raises:
        InputError: if the file is broken; the message names file and column or row.
    """
    columns = read_columns(path, ["timestamp", "x", "y"], ["track_id", "object_type"])
    agent, names = columns.names("track_id")
    time_s = columns.numbers("timestamp")
    unknown = np.full(len(columns), np.nan)
    n = len(names)
    rows = Rows(
        agent=agent,
        names=names,
        time_s=time_s - time_s.min(),
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
            "kinds and sizes are not in this format: cars of 4.5 m are assumed",
            "headings and speeds are told from the motion",
        ),
    )


def write(folder: Path, name: str, tracks: Tracks, road: object = None) -> list[Path]:
    """Write an episode as files of 5 s; behaviours go into a file beside each.

    The vehicle that travels farthest of those seen all the time is the AGENT, the next one the AV.

    Args:
        folder: where; it must exist.
        name: how the files' names begin.
        tracks: the episode, its step a divisor of 0.1 s.
        road: not used; the format has no map.

    Returns:
        The files written.

    Raises:
        InputError: if the step does not fit or no 5 s have an agent that is seen all the time.
    """
    written: list[Path] = []
    for number, window in enumerate(windows(every_tenth(tracks), STEPS)):
        focal = focal_agents(window)
        if not focal:
            continue
        role = dict(zip(focal, ("AGENT", "AV"), strict=False))
        text, labels = io.StringIO(), io.StringIO()
        text.write("TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME\n")
        for step in range(STEPS):
            for row in np.flatnonzero(window.valid[:, step]):
                x, y = window.xy[row, step].tolist()
                kind = role.get(int(row), "OTHERS")
                time_s = float(window.time_s[step])
                text.write(f"{time_s!r},{window.names[row]},{kind},{x!r},{y!r},{CITY}\n")
        labels.write("TRACK_ID,KIND,BEHAVIOR\n")
        for i, label in enumerate(window.names):
            code = -1 if window.behavior is None else int(window.behavior[i])
            word = BEHAVIORS[code].value if code >= 0 else ""
            labels.write(f"{label},{KINDS[window.kind[i]]},{word}\n")
        path = folder / f"{name}-{number:04d}.csv"
        write_whole(path, text.getvalue().encode())
        write_whole(path.with_suffix(".behavior"), labels.getvalue().encode())
        written += [path, path.with_suffix(".behavior")]
    if not written:
        raise InputError(f"{name}: found no 5 s with an agent seen all the time, expected some")
    return written
