"""Tables of recorded traffic: NGSIM, inD, rounD, highD, INTERACTION, pairs of cars, and one's own.

NGSIM has FEET, feet per second and milliseconds, and positions of the FRONT centre: as CSV with a
header (upper and lower case vary), or as the highway text files, white space, no header, 18
columns. ``Local_X`` points to the right across the road, ``Local_Y`` along it, so x and y here are
those in metres.

inD and rounD (``XX_tracks.csv``) have box centres, y up, headings in DEGREES counter-clockwise.
highD has the UPPER-LEFT corner of each box in an image whose y points down, calls the vehicle's
length ``width`` and its width ``height``, and has no headings. ``XX_tracksMeta.csv`` and
``XX_recordingMeta.csv`` are used if they are there.

INTERACTION (``vehicle_tracks_NNN.csv`` with ``pedestrian_tracks_NNN.csv`` beside it, 10 Hz) has box
centres in metres, headings in radians, times in milliseconds. Pedestrians and bicycles have neither
heading nor size. A file with a column ``case_id`` holds many short recordings, each with ids and
times of its own.

Pairs of a follower and its leader, as car-following models are fitted to, are CSV with the columns
``t, x_follower, v_follower, x_leader, v_leader``, in seconds, and optionally ``leader_length`` and
names (``pair, period, follower, leader``). Positions are along the lane, those of both fronts;
where the leader's length is zero or missing, that of its rear. Lengths are metres, unless those of
the leaders are as long as cars are in feet: then everything is in feet, as in the recordings of
NGSIM that such files are cut from. Each pair is a recording of two vehicles on a line.

A table of one's own is any CSV, Parquet or Feather file whose columns the user names.

References:
    U.S. Department of Transportation, Federal Highway Administration (2006), Next Generation
    Simulation (NGSIM) vehicle trajectories.
    Krajewski et al. (2018), The highD dataset, ITSC. Bock et al. (2020), The inD dataset, IV.
    Krajewski et al. (2020), The rounD dataset, ITSC.
    Zhan et al. (2019), INTERACTION dataset, arXiv:1910.03088.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import CAR_LENGTH_M, CAR_WIDTH_M, Recording, recorded
from sim.formats.common.tables import (
    NEEDED,
    beginning_of,
    by_word,
    check_there,
    finite,
    kinds_in,
    read_columns,
    read_table,
    read_text,
    rows_of,
    whole,
    words_in,
)  # fmt: skip
from sim.frames import AgentKind
from sim.input_files import beside, broken_as_one_line, plain_name, stem
from sim.road.road_files import read_road_file
from sim.units import PARTS, in_si

# --- NGSIM ----------------------------------------------------------------------------------------

NGSIM_CLASSES: Final = {1: AgentKind.MOTORCYCLE, 2: AgentKind.CAR, 3: AgentKind.TRUCK}
"""``v_Class``."""

BREAK_MS: Final = 60_000.0
"""After a break longer than this, in all rows or in those of an id, the id is another vehicle
(vehicles are seen without a break, and periods of recording have 15 minutes), ms."""

NGSIM: Final = {
    "id": "vehicle_id", "t": "global_time", "x": "local_x", "y": "local_y", "speed": "v_vel",
    "length": "v_length", "width": "v_width",
}  # fmt: skip
_FEET: Final = dict.fromkeys(("x", "y", "length", "width"), "ft")
NGSIM_UNITS: Final = {**_FEET, "speed": "ft/s", "t": "ms"}
NGSIM_NUMBERS: Final = (*NGSIM.values(), "total_frames", "v_class")
"""Columns that are read."""

TEXT_COLUMNS: Final = (
    "vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x",
    "global_y", "v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id", "preceding",
    "following", "space_headway", "time_headway",
)  # fmt: skip
"""Columns of the text files, in order."""


def read_ngsim(path: Path) -> Iterator[Recording]:
    """One recording for each location of a file and each period without a long break there."""
    if "vehicle_id" in beginning_of(path)[1]:
        table = read_table(path, NGSIM_NUMBERS, ("location",), ("location",))
    else:
        table = read_text(path, TEXT_COLUMNS, NGSIM_NUMBERS)
    for place, there in sorted(by_word(table, "location")):
        name = f"{stem(path)}-{place}" if place else stem(path)
        time_ms = finite(there, "global_time")
        order = np.argsort(time_ms, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(time_ms[order]) > BREAK_MS) + 1)
        for number, rows in enumerate(parts, 1):
            part_name = name if len(parts) == 1 else f"{name}-{number}"
            yield _of_ngsim(part_name, there.iloc[np.sort(rows)])


def _of_ngsim(name: str, table: pandas.DataFrame) -> Recording:
    """The recording of one period."""
    rows = rows_of(table, NGSIM, NGSIM_UNITS, from_zero=True)
    rows["id"] = _agents(table)
    kind = table["v_class"].map({code: kind.code for code, kind in NGSIM_CLASSES.items()})
    if kind.isna().any():
        wrong = table["v_class"][kind.isna()].iloc[0]
        raise InputError(f"column v_class: found {wrong:g}, expected 1, 2 or 3")
    rows["kind"] = kind.groupby(rows["id"].cat.codes).transform("first")
    # the heading follows from the motion of the front, the centre from the heading
    return recorded(
        name, rows, ["headings are taken from the motion"], rest_heading=math.pi / 2,
        ahead_lengths=0.5,
    )  # fmt: skip


def _agents(table: pandas.DataFrame) -> pandas.Categorical:
    """The agent of each row.

    Ids are used again for other vehicles: how long each is seen, and long breaks, tell them apart.
    """
    rows = pandas.DataFrame(
        {"id": whole(table, "vehicle_id"), "frames": whole(table, "total_frames"),
         "time_ms": finite(table, "global_time")}
    ).sort_values(["id", "frames", "time_ms"])  # fmt: skip
    passed_ms = rows.groupby(["id", "frames"])["time_ms"].diff()
    rows["turn"] = (passed_ms > BREAK_MS).groupby([rows["id"], rows["frames"]]).cumsum()
    keys = ["id", "frames", "turn"]
    agents = rows[keys].drop_duplicates()
    several = agents.groupby("id")["frames"].transform("nunique") > 1
    names = [
        (f"{i}-{frames}" if again else str(i)) + (f"/{turn + 1}" if turn else "")
        for (i, frames, turn), again in zip(agents.to_numpy().tolist(), several, strict=True)
    ]
    return pandas.Categorical.from_codes(rows.groupby(keys).ngroup().sort_index(), names)


# --- inD, rounD and highD -------------------------------------------------------------------------

FRAME_RATE_HZ: Final = 25.0
"""Frames per second where no ``XX_recordingMeta.csv`` says otherwise."""

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
    table = read_columns(path, IND, ("recordingid",), ("recordingid", "length", "width"))
    if "recordingid" in table and table["recordingid"].nunique() > 1:
        found = " and ".join(table["recordingid"].unique()[:2])
        raise InputError(
            f"{path}: column recordingid: found {found}, expected one recording in a file: each "
            "counts frames and ids from its own start"
        )
    rows = rows_of(table, IND, {"heading": "deg"})
    notes = _with_metadata(path, rows, "trackid")
    if (rows.filter(["length", "width"]) == 0).any(axis=None):
        notes.append("pedestrians and bicycles without a size have the usual one")
    yield recorded(stem(path), rows, notes)


def read_highd(path: Path) -> Iterator[Recording]:
    """The recording of one ``XX_tracks.csv`` of highD; y is minus the image's, so it points up."""
    rows = rows_of(read_columns(path, HIGHD), HIGHD)
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
        kinds = dict(zip(words_in(meta[id_column]), kinds_in(meta["class"]), strict=True))
    rows["kind"] = rows["id"].astype(object).map(kinds)
    if (missing := rows["kind"].isna()).any():
        raise InputError(f"{facts}: found no row of agent {rows['id'][missing].iloc[0]}, "
                         "expected one")  # fmt: skip
    return []


# --- INTERACTION ----------------------------------------------------------------------------------

INTERACTION: Final = {
    "id": "track_id", "t": "timestamp_ms", "x": "x", "y": "y", "heading": "psi_rad", "vx": "vx",
    "vy": "vy", "length": "length", "width": "width", "kind": "agent_type",
}  # fmt: skip
_OPTIONAL: Final = ("psi_rad", "length", "width", "case_id")
"""Columns of both files, and those that may be missing."""


def read_interaction(path: Path) -> Iterator[Recording]:
    """The recording of one file of vehicles, with the pedestrians recorded with them.

    A file of the multi-agent challenge, ``..._train.csv``, has a recording for each case.
    """
    walkers = beside(path, plain_name(path).replace("vehicle_tracks", "pedestrian_tracks"))
    files = [path] if walkers is None else [path, walkers]
    tables = [read_columns(file, INTERACTION, ("case_id",), _OPTIONAL) for file in files]
    table = tables[0] if walkers is None else pandas.concat(tables, ignore_index=True)
    found, origin = map_beside(path), _origin(path)
    road = None if found is None else read_road_file(found, origin=origin)
    for case, part in by_word(table, "case_id"):
        rows = rows_of(part, INTERACTION, {"t": "ms"})
        rows["id"] = _told_apart(part)
        notes = []
        sizes = rows.reindex(columns=["length", "width"])
        if walkers is not None or sizes.isna().any(axis=None):
            notes.append("those without a size have the one usual for their kind")
        name = f"{stem(path)}-{case}" if case else stem(path)
        yield recorded(name, rows, notes, road, origin)


def _told_apart(table: pandas.DataFrame) -> pandas.Series:
    """Names of agents; those of one id and two types are two agents."""
    name, kind = table["track_id"].astype(str), table["agent_type"].astype(str)
    several = kind.groupby(name).transform("nunique") > 1
    return name.where(~several, name + "-" + kind)


def map_beside(path: Path) -> Path | None:
    """The map of a recording, by its name.

    It is ``map_NNN.xml`` beside ``vehicle_tracks_NNN.csv`` (SinD), the only
    ``log_map_archive_*.json`` there (Argoverse 2 sensor logs), the only ``.osm`` there, or the
    ``.osm`` in a folder ``maps`` nearby that is called like the recording's folder (INTERACTION).
    """
    number = stem(path).rpartition("tracks_")[2]
    found = beside(path, f"map_{number}.xml")
    if found is not None:
        return found
    home = path.absolute().parent
    for pattern in ("log_map_archive_*.json", "*.osm", "*.osm.gz"):
        maps = sorted(home.glob(pattern))
        if len(maps) == 1:
            return maps[0]
    folders = (home / "maps", home.parent / "maps", home.parent.parent / "maps")
    files = (f / f"{home.name}{end}" for f in folders for end in (".osm", ".osm.gz", ".osm_xy"))
    return next((file for file in files if file.is_file()), None)


def _origin(path: Path) -> tuple[float, float] | None:
    """Latitude and longitude of (0, 0) from ``meta_data.csv`` beside a recording, degrees."""
    facts = beside(path, "meta_data.csv")
    if facts is None:
        return None
    names = ["originlat", "originlon"]
    table = read_table(facts, names, optional=names)
    if not set(names) <= set(table):
        return None
    latitude, longitude = table[names].iloc[0].tolist()
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        raise InputError(f"{facts}: found origin {latitude:g}, {longitude:g}, expected degrees")
    return latitude, longitude


# --- pairs ----------------------------------------------------------------------------------------

LENGTH_IN_FEET: Final = 9.0
"""Leaders with a median length above this are measured in feet (a car is 4 to 5 m or 13 to 17 feet
long)."""

_PAIR: Final = ("t", "x_follower", "v_follower", "x_leader", "v_leader", "leader_length")
_ROLES: Final = ("pair", "period", "follower", "leader")


def read_pairs(path: Path) -> Iterator[Recording]:
    """A recording for each pair of a file: leader and follower, x along the lane and y 0."""
    table = read_table(path, _PAIR, _ROLES, ("leader_length", *_ROLES))
    if "leader_length" not in table:
        table["leader_length"] = 0.0
    lengths = finite(table, "leader_length")
    feet = bool((lengths > 0).any()) and float(np.median(lengths[lengths > 0])) > LENGTH_IN_FEET
    notes = ["places are along the lane only; the follower's length and both widths are assumed"]
    if feet:
        notes.append("lengths are taken for feet: leaders are as long as cars are in feet")
    keys = [name for name in _ROLES[:2] if name in table]
    pairs = list(table.groupby(keys, observed=True, dropna=False)) if keys else [((), table)]
    count = Counter(names[:1] for names, _ in pairs)
    for names, part in pairs:
        said = map(str, names if count[names[:1]] > 1 else names[:1])
        yield recorded("-".join([stem(path), *said]), _of_pair(part, "ft" if feet else ""), notes)


def _of_pair(table: pandas.DataFrame, unit: str) -> pandas.DataFrame:
    """Rows of one pair: the follower's, then the leader's."""
    names: list[str] = []
    for role in _ROLES[2:]:
        called = table[role].unique() if role in table else [role]
        if len(called) > 1 or str(called[0]) in names:
            found = " and ".join(map(str, called[:2]))
            raise InputError(
                f"column {role}: found {found}, expected one name in a pair, another than that of "
                "the follower"
            )
        names.append(str(called[0]))
    t, *values = (finite(table, name) for name in _PAIR)
    x, v, leader_x, leader_v, length = (in_si(each, unit) for each in values)
    leader_m = float(length[0]) if length[0] > 0.0 else CAR_LENGTH_M
    rows = [
        pandas.DataFrame(
            {"id": name, "t": t, "x": place, "y": 0.0, "heading": 0.0,
             "speed": np.maximum(speed, 0.0), "length": length_m, "width": CAR_WIDTH_M}
        )
        for name, place, speed, length_m in (
            (names[0], x - 0.5 * CAR_LENGTH_M, v, CAR_LENGTH_M),
            (names[1], leader_x - length + 0.5 * leader_m, leader_v, leader_m),
        )
    ]  # fmt: skip
    return pandas.concat(rows)


# --- a table of one's own -------------------------------------------------------------------------

WORDS: Final = ("id", "kind")
NUMBERS: Final = ("t", "x", "y", "heading", "speed", "vx", "vy", "length", "width")
"""What columns may be."""

METRES: Final = {"m": "", "km": "km", "ft": "ft"}
SPEEDS: Final = {"m/s": "", "km/h": "km/h", "mph": "mph", "ft/s": "ft/s"}
UNITS: Final[dict[str, dict[str, str]]] = {
    "t": {"s": "", **{unit: unit for unit in PARTS}},
    "heading": {"rad": "", "deg": "deg"},
    **dict.fromkeys(("x", "y", "length", "width"), METRES),
    **dict.fromkeys(("speed", "vx", "vy"), SPEEDS),
}
"""The units that each column may have, as `sim.units.in_si` takes them; the first is its usual."""


def check_columns(columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Refuse columns that are not known or missing, and units that a column cannot have.

    Columns are the names in the file of some of ``WORDS`` and ``NUMBERS``.
    """
    for key in columns:
        if key not in (*WORDS, *NUMBERS):
            known = ", ".join((*WORDS, *NUMBERS))
            raise InputError(f"columns: found {key[:60]!r}, expected one of {known}")
    for key in NEEDED:
        if key not in columns:
            raise InputError(f"columns: found no {key}, expected {key}=NAME as in the file")
    for key, unit in units.items():
        if key not in columns or key in WORDS:
            raise InputError(f"units: found {key[:60]!r}, expected one of the numbers in columns")
        if unit not in UNITS[key]:
            known = ", ".join(UNITS[key])
            raise InputError(f"units: {key}: found {unit[:60]!r}, expected one of {known}")


def read_own(
    path: Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> Iterator[Recording]:
    """Read a table of one's own; headings, speeds and sizes that it lacks are computed or assumed.

    Columns and units are as `check_columns` takes them; by default ``id``, ``t``, ``x`` and ``y``
    in SI units, and radians from +x.
    """
    columns, units = columns or {key: key for key in NEEDED}, units or {}
    check_columns(columns, units)
    names = {key: name.strip().lower() for key, name in columns.items()}
    if "speed" in names:
        names = {key: name for key, name in names.items() if key not in ("vx", "vy")}
    if in_file := beginning_of(path)[1]:
        check_there(in_file, names.values())
    known = {key: UNITS[key][unit] for key, unit in units.items()}
    optional = [name for key, name in names.items() if key not in NEEDED]
    rows = rows_of(read_columns(path, names, (), optional), names, known, from_zero=True)
    missing = [key for key in ("heading", "speed", "kind", "length") if key not in columns]
    notes = [f"not in the table, taken from the motion or assumed: {', '.join(missing)}"]
    yield recorded(stem(path), rows, notes if missing else ())
