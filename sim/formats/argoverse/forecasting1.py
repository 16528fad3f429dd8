"""Argoverse 1 motion forecasting: one CSV per 5 s at 10 Hz, centres in metres.

Columns ``TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME``; times in seconds. The format has neither
headings nor speeds nor sizes nor kinds. Behaviours are in a ``.behavior`` file of ours beside it.

References:
    Chang et al. (2019), Argoverse: 3D tracking and forecasting with rich maps, CVPR.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.files import write_whole
from sim.formats.common.recording import CARS_ASSUMED, Recording, recorded
from sim.formats.common.tables import read_rows
from sim.formats.common.windows import behavior_words, focal_windows, labels_beside
from sim.frames import KINDS, Tracks
from sim.input_files import stem

COLUMNS: Final = {"id": "track_id", "t": "timestamp", "x": "x", "y": "y"}

STEPS: Final = 50
"""Length of a recording: 20 steps observed, 30 to predict."""

LABELS_SUFFIX: Final = ".behavior"
"""Ending of the file beside each recording that holds the behaviours, which the format cannot
hold."""

FORMULA: Final = "=+-@"
"""First characters of what spreadsheets take for a formula."""

CITY: Final = "PIT"
"""The format allows Pittsburgh and Miami only; what we write is neither."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file, with the labels beside it; its first time is 0."""
    rows = read_rows(path, COLUMNS, from_zero=True)
    notes = (CARS_ASSUMED, "headings and speeds are taken from the motion")
    labels = labels_beside(path.with_suffix(LABELS_SUFFIX))
    yield recorded(stem(path), rows, notes).with_codes(labels)


def _is_number(label: str) -> bool:
    """Whether a spreadsheet takes a text for a number."""
    try:
        float(label)
    except ValueError:
        return False
    return True


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
        NoWindowError: if no 5 s without a gap have a vehicle that is seen all the time.
        InputError: if the step does not fit, or an agent has a name that CSV files should not hold.
    """
    for label in tracks.names:
        if not label.isprintable() or (label[:1] in FORMULA and not _is_number(label)):
            raise InputError(
                f"{name}: found agent {label!r:.60}, which a spreadsheet could run or a reader not "
                "read back, expected a plain id"
            )
    written: list[Path] = []
    for number, window, focal in focal_windows(name, tracks, STEPS):
        step, row = np.nonzero(window.valid.T)
        role = np.full(len(window.names), "OTHERS")
        role[focal[:2]] = ("AGENT", "AV")[: len(focal)]
        x, y = window.xy[row, step].T
        labels = np.array(window.names, dtype=object)
        text = pandas.DataFrame(
            {"TIMESTAMP": window.time_s[step], "TRACK_ID": labels[row], "OBJECT_TYPE": role[row],
             "X": x, "Y": y, "CITY_NAME": CITY}
        ).to_csv(index=False, lineterminator="\n")  # fmt: skip
        kinds = [KINDS[kind].value for kind in window.kind]
        known = pandas.DataFrame(
            {"TRACK_ID": labels, "KIND": kinds, "BEHAVIOR": behavior_words(window)}
        )
        path = folder / f"{name}-{number:04d}.csv"
        write_whole(path, text.encode())
        beside = known.to_csv(index=False, lineterminator="\n")
        write_whole(path.with_suffix(LABELS_SUFFIX), beside.encode())
        written += [path, path.with_suffix(LABELS_SUFFIX)]
    return written
