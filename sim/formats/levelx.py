"""inD, rounD and highD: drone recordings as ``XX_tracks.csv`` with metadata files beside them.

inD and rounD give box centres, y up, headings in DEGREES counter-clockwise. highD gives the
UPPER-LEFT corner of each box in an image whose y points down, calls the vehicle's length ``width``
and its width ``height``, and has no headings.

References:
    Krajewski et al. (2018), The highD dataset, ITSC. Bock et al. (2020), The inD dataset, IV.
    Krajewski et al. (2020), The rounD dataset, ITSC.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.motion import MOVING_MPS
from sim.formats.common.recording import Recording, Rows, first_sizes, recorded
from sim.formats.common.tables import Table, read_table
from sim.frames import AgentKind
from sim.input_files import beside, plain_name, stem

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
    """The file of metadata beside the tracks."""
    return beside(path, plain_name(path).replace("_tracks.csv", f"_{what}.csv"))


def _frame_rate(path: Path) -> float:
    """Frames per second, from the metadata."""
    facts = _beside(path, "recordingMeta")
    if facts is None:
        return FRAME_RATE_HZ
    rates = np.unique(read_table(facts, ["framerate"]).numbers("framerate")).tolist()
    if len(rates) > 1 or not 1 <= rates[0] <= 1000:
        found = " and ".join(f"{rate:g}" for rate in rates)
        raise InputError(f"{facts}: column framerate: found {found}, expected one, 1 to 1000")
    return float(rates[0])


def _agents(
    table: Table, id_column: str
) -> tuple[NDArray[np.int64], tuple[str, ...], list[AgentKind], list[str]]:
    """The agent of each row, the agents' names, their kinds from the metadata, and notes."""
    agent, names = table.names(id_column)
    facts = _beside(table.path, "tracksMeta")
    if facts is None:
        missing = plain_name(table.path).replace("_tracks.csv", "_tracksMeta.csv")
        notes = [f"{missing} is not there: all are taken for cars"]
        return agent, names, [AgentKind.CAR] * len(names), notes
    meta = read_table(facts, [], [id_column, "class"])
    code, words = meta.names(id_column)
    kinds = dict(zip(words, meta.kinds("class", code, CLASSES), strict=True))
    missing = next((name for name in names if name not in kinds), "")
    if missing:
        raise InputError(f"{facts}: found no row of agent {missing}, expected one")
    return agent, names, [kinds[name] for name in names], []


def read_ind(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of inD or rounD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    numbers = ("frame", "xcenter", "ycenter", "heading", "width", "length", "xvelocity",
               "yvelocity")  # fmt: skip
    table = read_table(
        path, numbers, ["trackid", "recordingid"], ["recordingid"], empty=["width", "length"]
    )
    if "recordingid" in table:
        several = table.codes("recordingid")[1]
        if len(several) > 1:  # each recording counts frames and ids from its own start
            raise InputError(
                f"{path}: column recordingid: found {several[0]} and {several[1]}, expected "
                "one recording in a file"
            )
    agent, names, kinds, notes = _agents(table, "trackid")
    sizes = first_sizes(agent, table.stacked("length", "width"))
    if (sizes == 0).any():
        notes.append("pedestrians and bicycles without a size have the usual one")
    rows = Rows(
        agent,
        names,
        table.numbers("frame") / _frame_rate(path),
        table.stacked("xcenter", "ycenter"),
        table.measured("heading", "deg"),
        np.hypot(table.measured("xvelocity"), table.measured("yvelocity")),
        kinds,
        sizes,
    )
    yield recorded(path, stem(path), rows, notes)


def read_highd(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of highD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording; y is minus the image's, so that it points up.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    numbers = ("frame", "x", "y", "width", "height", "xvelocity", "yvelocity")
    table = read_table(path, numbers, ["id"])
    agent, names, kinds, notes = _agents(table, "id")
    sides = table.stacked("width", "height")
    corner, velocity = table.stacked("x", "y"), table.stacked("xvelocity", "yvelocity")
    up = np.array([1.0, -1.0])
    vx, vy = (velocity * up).T
    speed = np.hypot(vx, vy)
    rows = Rows(
        agent,
        names,
        table.numbers("frame") / _frame_rate(path),
        (corner + 0.5 * sides) * up,
        np.where(speed >= MOVING_MPS, np.arctan2(vy, vx), np.nan),
        speed,
        kinds,
        first_sizes(agent, sides),
    )
    yield recorded(path, stem(path), rows, [*notes, "headings are taken from velocities"])
