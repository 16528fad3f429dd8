"""inD, rounD and highD: drone recordings as ``XX_tracks.csv`` with metadata files beside them.

inD and rounD give box centres, y up, headings in DEGREES counter-clockwise. highD gives the
UPPER-LEFT corner of each box in an image whose y points down, calls the vehicle's length ``width``
and its width ``height``, and has no headings.

References:
    Krajewski et al. (2018), The highD dataset, ITSC. Bock et al. (2020), The inD dataset, IV.
    Krajewski et al. (2020), The rounD dataset, ITSC.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.formats.common.columns import Columns
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import read_table
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


IND: Final = Columns(
    id=("trackid",), t="frame", xy=("xcenter", "ycenter"), heading="heading",
    speed=("xvelocity", "yvelocity"), size=("length", "width"), units={"heading": "deg"},
    words=("recordingid",), optional=("recordingid",), empty=("width", "length"),
)  # fmt: skip
HIGHD: Final = Columns(
    id=("id",), t="frame", speed=("xvelocity", "yvelocity"), size=("width", "height")
)
"""Columns of the tracks."""


def read_ind(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of inD or rounD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    table = IND.read(path)
    several = table.codes("recordingid")[1] if "recordingid" in table else []
    if len(several) > 1:  # each recording counts frames and ids from its own start
        raise InputError(
            f"{path}: column recordingid: found {several[0]} and {several[1]}, expected one "
            "recording in a file"
        )
    rows = IND.rows(table, rate_hz=_frame_rate(path))
    kinds, notes = _kinds(path, "trackid", rows.names)
    if rows.sizes is not None and (rows.sizes == 0).any():
        notes.append("pedestrians and bicycles without a size have the usual one")
    yield recorded(path, stem(path), replace(rows, kinds=kinds), notes)


def read_highd(path: Path) -> Iterator[Recording]:
    """Read one ``XX_tracks.csv`` of highD.

    Args:
        path: the file; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` are used if there.

    Yields:
        One recording; y is minus the image's, so that it points up.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    table = HIGHD.read(path)
    rows = HIGHD.rows(table, rate_hz=_frame_rate(path))
    kinds, notes = _kinds(path, "id", rows.names)
    centre = (rows.xy + 0.5 * table.stacked("width", "height")) * np.array([1.0, -1.0])
    heading = None if rows.heading is None else -rows.heading
    rows = replace(rows, xy=centre, heading=heading, kinds=kinds)
    yield recorded(path, stem(path), rows, [*notes, "headings are taken from velocities"])


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


def _kinds(path: Path, id_column: str, names: Sequence[str]) -> tuple[list[AgentKind], list[str]]:
    """The kinds of agents from the metadata, and notes."""
    facts = _beside(path, "tracksMeta")
    if facts is None:
        missing = plain_name(path).replace("_tracks.csv", "_tracksMeta.csv")
        return [AgentKind.CAR] * len(names), [f"{missing} is not there: all are taken for cars"]
    meta = read_table(facts, [], [id_column, "class"])
    agent, words = meta.names(id_column)
    kinds = dict(zip(words, meta.kinds("class", agent, CLASSES), strict=True))
    missing = next((name for name in names if name not in kinds), "")
    if missing:
        raise InputError(f"{facts}: found no row of agent {missing}, expected one")
    return [kinds[name] for name in names], []
