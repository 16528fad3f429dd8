"""inD, rounD and highD: drone recordings as ``XX_tracks.csv`` with metadata files beside them.

inD and rounD give box centres, y up, headings in DEGREES counter-clockwise. highD gives the
UPPER-LEFT corner of each box in an image whose y points down, calls the vehicle's length ``width``
and its width ``height``, and has no headings.

References:
    Krajewski et al. (2018), The highD dataset, ITSC. Bock et al. (2020), The inD dataset, IV.
    Krajewski et al. (2020), The rounD dataset, ITSC.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.csv_columns import Columns, read_columns
from sim.formats.common.packed import beside, plain_name, stem
from sim.formats.common.recording import (
    MOVING_MPS,
    Recording,
    Rows,
    default_size,
    kind_codes,
    recordings,
)
from sim.frames import AgentKind

FRAME_RATE_HZ: Final = 25.0
"""Frames per second where no ``XX_recordingMeta.csv`` says otherwise."""

CLASSES: Final[dict[str, AgentKind]] = {
    "car": AgentKind.CAR,
    "van": AgentKind.CAR,
    "trailer": AgentKind.TRUCK,
    "truck": AgentKind.TRUCK,
    "truck_bus": AgentKind.TRUCK,
    "bus": AgentKind.BUS,
    "motorcycle": AgentKind.MOTORCYCLE,
    "bicycle": AgentKind.BICYCLE,
    "pedestrian": AgentKind.PEDESTRIAN,
}
"""``class`` in ``XX_tracksMeta.csv``, in lower case."""


def _beside(path: Path, what: str) -> Path | None:
    return beside(path, plain_name(path).replace("_tracks.csv", f"_{what}.csv"))


def _frame_rate(path: Path) -> float:
    facts = _beside(path, "recordingMeta")
    if facts is None:
        return FRAME_RATE_HZ
    rates = np.unique(read_columns(facts, ["framerate"]).numbers("framerate"))
    if rates.size > 1:
        raise InputError(
            f"{facts}: column framerate: found {rates[0]:g} and {rates[1]:g}, expected one"
        )
    rate = float(rates[0])
    if not 1 <= rate <= 1000:
        raise InputError(f"{facts}: column framerate: found {rate:g}, expected 1 to 1000")
    return rate


def _agents(
    path: Path, columns: Columns, id_column: str
) -> tuple[NDArray[np.int64], tuple[str, ...], NDArray[np.int64], list[AgentKind], list[str]]:
    """(m,) agent of each row; of each agent its name, first row and kind; and notes."""
    agent, names = columns.names(id_column)
    _, first = np.unique(agent, return_index=True)
    return agent, names, first, *_kinds(path, id_column, names)


def _kinds(path: Path, id_column: str, names: tuple[str, ...]) -> tuple[list[AgentKind], list[str]]:
    facts = _beside(path, "tracksMeta")
    if facts is None:
        missing = plain_name(path).replace("_tracks.csv", "_tracksMeta.csv")
        return [AgentKind.CAR] * len(names), [f"{missing} is not there: all are taken for cars"]
    columns = read_columns(facts, [], [id_column, "class"])
    ids, words = (columns.table.column(name).to_pylist() for name in (id_column, "class"))
    word = dict(zip(ids, words, strict=True))
    if len(word) < len(ids):
        twice = next(name for name, count in Counter(ids).items() if count > 1)
        raise InputError(f"{facts}: found agent {twice!r:.60} more than once, expected it once")
    kinds = []
    for name in names:
        found = word.get(name)
        if found is None:
            raise InputError(f"{facts}: found no row of agent {name}, expected one")
        kind = CLASSES.get(found.lower())
        if kind is None:
            raise InputError(
                f"{facts}: column class: found {found!r:.60}, expected one of {CLASSES}"
            )
        kinds.append(kind)
    return kinds, []


def read_ind(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of inD or rounD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    columns = read_columns(
        path,
        ["frame", "xcenter", "ycenter", "heading", "width", "length", "xvelocity", "yvelocity"],
        ["trackid", "recordingid"],
        optional=["recordingid"],
    )
    if "recordingid" in columns:
        several = pc.unique(columns.table.column("recordingid")).to_pylist()
        if len(several) > 1:  # each recording counts frames and ids from its own start
            raise InputError(
                f"{path}: column recordingid: found {several[0]} and {several[1]}, expected "
                "one recording in a file"
            )
    agent, names, first, kinds, notes = _agents(path, columns, "trackid")
    length, width = columns.numbers("length")[first], columns.numbers("width")[first]
    points = (length == 0) | (width == 0)  # pedestrians and bicycles have no box
    usual = np.array([default_size(kind) for kind in kinds])
    if points.any():
        notes.append("pedestrians and bicycles without a size have the usual one")
    rows = Rows(
        agent=agent,
        names=names,
        time_s=columns.numbers("frame") / _frame_rate(path),
        x=columns.numbers("xcenter"),
        y=columns.numbers("ycenter"),
        heading=np.radians(columns.numbers("heading")),
        speed=np.hypot(columns.numbers("xvelocity"), columns.numbers("yvelocity")),
        length=np.where(points, usual[:, 0], length),
        width=np.where(points, usual[:, 1], width),
        kind=kind_codes(kinds),
    )
    yield from recordings(path, stem(path), rows, notes)


def read_highd(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of highD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording; y is minus the image's, so that it points up.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    columns = read_columns(
        path, ["frame", "x", "y", "width", "height", "xvelocity", "yvelocity"], ["id"]
    )
    agent, names, first, kinds, notes = _agents(path, columns, "id")
    vx, vy = columns.numbers("xvelocity"), -columns.numbers("yvelocity")
    speed = np.hypot(vx, vy)
    rows = Rows(
        agent=agent,
        names=names,
        time_s=columns.numbers("frame") / _frame_rate(path),
        x=columns.numbers("x") + 0.5 * columns.numbers("width"),
        y=-(columns.numbers("y") + 0.5 * columns.numbers("height")),
        heading=np.where(speed >= MOVING_MPS, np.arctan2(vy, vx), np.nan),
        speed=speed,
        length=columns.numbers("width")[first],
        width=columns.numbers("height")[first],
        kind=kind_codes(kinds),
    )
    notes.append("headings are told from velocities")
    yield from recordings(path, stem(path), rows, notes)
