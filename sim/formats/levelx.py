"""inD, rounD and highD: drone recordings as ``XX_tracks.csv`` with metadata files beside them.

inD and rounD give box centres, y up, headings in DEGREES counter-clockwise. highD gives the
UPPER-LEFT corner of each box in an image whose y points down, calls the vehicle's length ``width``
and its width ``height``, and has no headings. ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv``
are used if they are there.

References:
    Krajewski et al. (2018), The highD dataset, ITSC. Bock et al. (2020), The inD dataset, IV.
    Krajewski et al. (2020), The rounD dataset, ITSC.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import kinds_in, names_in, read_rows, read_table
from sim.frames import AgentKind
from sim.input_files import beside, broken_as_one_line, plain_name, stem

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

IND: Final = {
    "id": "trackid", "t": "frame", "x": "xcenter", "y": "ycenter", "heading": "heading",
    "vx": "xvelocity", "vy": "yvelocity", "length": "length", "width": "width",
}  # fmt: skip
HIGHD: Final = {
    "id": "id", "t": "frame", "x": "x", "y": "y", "vx": "xvelocity", "vy": "yvelocity",
    "length": "width", "width": "height",
}  # fmt: skip
"""Columns of the tracks."""


def read_ind(path: Path) -> Iterator[Recording]:
    """The recording of one ``XX_tracks.csv`` of inD or rounD."""
    rows = read_rows(path, IND, units={"heading": "deg"}, optional=("length", "width"))
    several = read_table(path, (), ("recordingid",), ("recordingid",))
    if "recordingid" in several and several["recordingid"].nunique() > 1:
        found = " and ".join(several["recordingid"].unique()[:2])
        raise InputError(
            f"{path}: column recordingid: found {found}, expected one recording in a file: each "
            "counts frames and ids from its own start"
        )
    notes = _with_metadata(path, rows, "trackid")
    if (rows.filter(["length", "width"]) == 0).any(axis=None):
        notes.append("pedestrians and bicycles without a size have the usual one")
    yield recorded(stem(path), rows, notes)


def read_highd(path: Path) -> Iterator[Recording]:
    """The recording of one ``XX_tracks.csv`` of highD; y is minus the image's, so it points up."""
    rows = read_rows(path, HIGHD)
    notes = _with_metadata(path, rows, "id")
    rows["x"] += 0.5 * rows["length"]
    rows["y"] = -(rows["y"] + 0.5 * rows["width"])
    rows["heading"] *= -1
    yield recorded(stem(path), rows, [*notes, "headings are taken from velocities"])


def _with_metadata(path: Path, rows: pandas.DataFrame, id_column: str) -> list[str]:
    """Frames become times, and agents have kinds, as the files of metadata say; gives notes."""
    facts = beside(path, plain_name(path).replace("_tracks.csv", "_recordingMeta.csv"))
    rate_hz = FRAME_RATE_HZ
    if facts is not None:
        rates = read_table(facts, ["framerate"])["framerate"].unique()
        rate_hz = float(rates[0])
        if len(rates) > 1 or not 1 <= rate_hz <= 1000:
            found = " and ".join(f"{rate:g}" for rate in rates)
            raise InputError(f"{facts}: column framerate: found {found}, expected one, 1 to 1000")
    rows["t"] /= rate_hz
    name = plain_name(path).replace("_tracks.csv", "_tracksMeta.csv")
    facts = beside(path, name)
    if facts is None:
        return [f"{name} is not there: all are taken for cars"]
    with broken_as_one_line(facts, "a table of agents"):
        meta = read_table(facts, (), (id_column, "class"))
        kinds = dict(zip(names_in(meta[id_column]), kinds_in(meta["class"], CLASSES), strict=True))
    missing = next((one for one in rows["id"].cat.categories if one not in kinds), None)
    if missing is not None:
        raise InputError(f"{facts}: found no row of agent {missing}, expected one")
    rows["kind"] = np.array([kinds[one] for one in rows["id"].cat.categories])[rows["id"].cat.codes]
    return []
