"""Formats of recordings that other tools write and read, by name.

A reader yields `Recording`s from one file; a writer puts an episode into a folder. Each format has
a module of its own that is loaded on first use. A reader refuses a broken file with one
`behaviors.errors.InputError` that names the file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from behaviors.errors import InputError
from behaviors.registry import Registry, loaded
from sim.input_files import broken_as_one_line, plain_name

if TYPE_CHECKING:
    from sim.formats.common.recording import Recording
    from sim.frames import Tracks
    from sim.road import Road

    Reader = Callable[..., Iterator[Recording]]
    Writer = Callable[[Path, str, Tracks, Road | None], list[Path]]

SHOWN: Final = 120
"""How much of the first line of an unknown file is shown."""

NOTHING: Final = re.compile(rb"(?!)")


@dataclass(frozen=True, slots=True)
class Format:
    """One format.

    Attributes:
        files: patterns of the names of its files.
        head: what the beginning of a file looks like (lower case).
        reader: "module:function", or None where it is only written.
        writer: "module:function", or None where it is only read.
        index: "module:class" of the files that say what all written files hold, if there are any.
        unit: what its lengths are in: "m", or "px" where there is no scale.
        clock: whether its times are a clock's; else they may be frames counted at a wrong rate.
        own_names: whether no other format names its files so; then every file of such a name is
            read, whatever it looks like.
        beside: patterns of the names of files that only accompany its files.
        example: a small file of this format, which the contract tests read.
        columns: columns that make a table one of this format, whatever its head.
        one: whether a folder's files are copies of the same: the first name is read.
    """

    files: tuple[str, ...]
    head: re.Pattern[bytes] = NOTHING
    reader: str | None = None
    writer: str | None = None
    index: str | None = None
    unit: str = "m"
    clock: bool = False
    own_names: bool = False
    beside: tuple[str, ...] = ()
    example: bytes = b""
    columns: tuple[tuple[str, ...], ...] = ()
    one: bool = False

    def recognises(self, path: Path) -> bool:
        """Whether a file's columns or its beginning are those of this format."""
        from sim.formats.common.tables import beginning_of

        head, there = beginning_of(path)
        known = any(set(columns) <= set(there) for columns in self.columns)
        return known or self.head.search(head.lower()) is not None


_LEVELX: Final[dict[str, Any]] = {
    "own_names": True,
    "beside": ("*_tracksmeta.csv", "*_recordingmeta.csv"),
}
"""The tracks of inD, rounD and highD, and the tables that accompany them."""

IND: Final = Format(
    ("*_tracks.csv",), reader="sim.formats.recorded_tables:read_ind",
    columns=(("trackid", "xcenter", "ycenter", "heading"),), **_LEVELX,
)  # fmt: skip
"""inD and rounD, which look the same."""

FORMATS: Final[Registry[Format]] = Registry(
    "format",
    "graphrqi.formats",
    {
        "argoverse2": Format(
            ("scenario_*.parquet",), reader="sim.formats.argoverse:read_scenario",
            writer="sim.formats.argoverse:write_scenarios", own_names=True,
            beside=("log_map_archive_*.json", "behavior_*.parquet"),
            columns=(("track_id", "object_type", "timestep", "position_x"),),
        ),
        "argoverse2-log": Format(
            ("annotations.feather", "annotations_with_ego.feather"),
            reader="sim.formats.sensor_logs:read_argoverse2", clock=True, own_names=True, one=True,
            beside=("map/*.json", "log_map_archive_*.json"),
            columns=(("timestamp_ns", "track_uuid", "category"),),
        ),
        "argoverse1": Format(
            ("*.csv", "*.parquet"), reader="sim.formats.argoverse:read_csv",
            writer="sim.formats.argoverse:write_csv",
            columns=(("timestamp", "track_id", "object_type", "x", "y"),),
        ),
        "ngsim": Format(
            ("*.csv", "*.txt", "*.parquet"),
            re.compile(rb"^\s*(?:-?[\d.e+]+[ \t]+){17}-?[\d.e+]+[ \t]*\r?\n"),
            "sim.formats.recorded_tables:read_ngsim", clock=True,
            columns=(("vehicle_id", "local_x", "local_y"),),
        ),
        "ind": IND,
        "round": IND,
        "highd": Format(
            ("*_tracks.csv",), reader="sim.formats.recorded_tables:read_highd",
            columns=(("frame", "id", "width", "height", "xvelocity"),), **_LEVELX,
        ),
        "interaction": Format(
            ("vehicle_tracks_*.csv", "*_train.csv", "*_val.csv", "*_obs.csv"),
            reader="sim.formats.recorded_tables:read_interaction", own_names=True,
            beside=("pedestrian_tracks_*.csv", "map_*.xml", "meta_data.csv", "signal_phases_*.csv",
                    "log_map_archive_*.json"),
            columns=(("track_id", "timestamp_ms", "agent_type"),),
        ),
        "sumo-fcd": Format(
            ("*.xml", "*.csv", "*.parquet"), re.compile(rb"<fcd-export"),
            "sim.formats.sumo_fcd:read", "sim.formats.sumo_fcd:write", beside=("*.types.xml",),
            columns=(("timestep_time", "vehicle_id"), ("timestep_time", "person_id")),
        ),
        "commonroad": Format(
            ("*.xml",), re.compile(rb"<commonroad\b"), "sim.formats.commonroad:read"
        ),
        "traf": Format(
            ("*.txt",),
            re.compile(rb"^\d+[ \t]*,[ \t]*\d+(?:[ \t]*,[ \t]*-?\d+)*[ \t,-]*(?:\r?\n|\Z)"),
            "sim.formats.traf:read", unit="px",
        ),
        "kitti": Format(
            ("*.txt",),
            re.compile(
                rb"^\d+ (?:-1|\d+) "
                rb"(?:car|van|truck|tram|cyclist|pedestrian|person|person_sitting|misc|dontcare) "
            ),
            "sim.formats.sensor_logs:read_kitti", beside=("oxts/*.txt", "calib/*.txt"),
        ),
        "argo": Format(
            ("*.csv",), re.compile(rb'^"?frame"?[,;\t]"?id"?[,;\t]"?x"?[,;\t]"?y"?\s*\n'),
            "sim.formats.argo:read", beside=("*_labels.csv",),
        ),
        "pairs": Format(
            ("*.csv",), reader="sim.formats.recorded_tables:read_pairs",
            columns=(("t", "x_follower", "v_follower", "x_leader", "v_leader"),),
        ),
        "womd": Format(
            ("*.tfrecord*", "*.json"),
            re.compile(
                rb"(?s)^.{4}\0{4}.{4}[\t\n\x12\x22\x2a\x30\x32\x3a\x42\x50\x5a\x62\x70\x7a]"
                rb'|^\s*\{.*"(?:objects|tracks|timestamps_?seconds|map_?features)"\s*:\s*\['
            ),
            "sim.formats.waymo:read",
        ),
        "scenarionet": Format(
            ("*.pkl",),
            re.compile(rb"(?s)^\x80[\x02-\x05].*(?:tracks|metadata|version|map_features)"),
            "sim.formats.scenarionet:read", "sim.formats.scenarionet:write",
            "sim.formats.scenarionet:Index", beside=("dataset_summary.pkl", "dataset_mapping.pkl"),
        ),
        "table": Format(
            ("*.csv", "*.txt", "*.tsv", "*.parquet", "*.feather"),
            reader="sim.formats.recorded_tables:read_own", columns=(("id", "t", "x", "y"),),
            example=b"id,t,x,y\n1,0.0,0.0,0.0\n1,0.1,1.0,0.0\n2,0.0,9.0,4.0\n2,0.1,9.0,4.0\n",
        ),
        "openscenario": Format(("*.xosc",), writer="sim.formats.asam.openscenario:write"),
    },
)  # fmt: skip
"""Every format by name."""

OTHERS: Final = (
    (re.compile(rb"^par1|^arrow1|^fea1"), "no known format in a table with the columns"),
    (re.compile(rb"^\s*<(?:!doctype )?html", re.DOTALL), "a web page, no download"),
    (
        re.compile(rb"^pk\x03\x04"),
        "a ZIP archive to be unpacked, or an Excel workbook to be saved as CSV",
    ),
    (re.compile(rb"^\x1f\x8b"), "a gzipped file whose name does not end in .gz"),
    (re.compile(rb"^\x89hdf"), "an HDF5 file"),
    (re.compile(rb"^sqlite format 3"), "an SQLite database"),
    (re.compile(rb"^#rosbag|^\x89mcap"), "a ROS bag"),
    (re.compile(rb"^\xff\xd8\xff|^\x89png|^%pdf|^.{4}ftyp", re.DOTALL), "a picture or a video"),
    (re.compile(rb"(?s)^.{4}\0{4}"), "a TFRecord of something else than Waymo's scenarios"),
    (re.compile(rb"^\s*[{\[]"), "JSON that is no scenario"),
    (re.compile(rb"<(?:osm|net|opendrive)\b"), "a map, no recording: see graphrqi road"),
    (re.compile(rb"^\s*<\?xml|^\s*<\w"), "XML that is no recording"),
)
"""Kinds of other files, by their beginnings (lower case)."""


def get_reader(name: str) -> Reader:
    """The reader of a format; one that is only written is refused."""
    source = FORMATS[name].reader
    if source is None:
        raise InputError(f"format {name}: found no reader, expected one that can be read")
    reader = cast("Reader", loaded(source))

    def read(path: Path, **options: object) -> Iterator[Recording]:
        with broken_as_one_line(path, f"a file of the format {name}"):
            yield from reader(path, **options)

    return read


def get_writer(name: str) -> Writer:
    """The writer of a format; one that is only read is refused."""
    source = FORMATS[name].writer
    if source is None:
        able = ", ".join(key for key, entry in FORMATS.items() if entry.writer)
        raise InputError(f"format {name}: found no writer, expected one of {able}")
    return cast("Writer", loaded(source))


def new_index(name: str) -> Any:
    """An empty index for files of a format, such as `scenarionet.Index`; None if it needs none."""
    source = FORMATS[name].index
    return None if source is None else loaded(source)()


def _files(path: Path, patterns: Sequence[str]) -> list[Path]:
    """The file itself, or a folder's files whose names match."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"{path}: found nothing, expected a recording or a folder of recordings")
    return sorted(file for file in path.rglob("*") if _named(file, patterns) and file.is_file())


def _named(file: Path, patterns: Sequence[str]) -> bool:
    """Whether a file's name matches a pattern; upper case and packed files count, too.

    A pattern with a slash is one of the file's folder and name.
    """
    name = plain_name(file).lower()
    within = f"{file.parent.name.lower()}/{name}"
    return any(fnmatchcase(within if "/" in pattern else name, pattern) for pattern in patterns)


def _beside(names: Iterable[str]) -> list[str]:
    """The patterns of files that accompany those of some formats."""
    return [pattern for name in names for pattern in FORMATS[name].beside]


def recognise(path: Path) -> str:
    """The format of a file, or the first one of those in a folder, as `formats_in` tells them."""
    return formats_in(path)[0]


def formats_in(path: Path) -> list[str]:
    """Every format of a file or of the files in a folder, told from columns and beginnings.

    They are keys of ``FORMATS`` in their order. A file that looks like several has the first of
    them: ``ind`` for rounD too. If there is none, an error says what a file is instead.
    """
    found: list[str] = []
    known: set[Path] = set()
    for name, entry in FORMATS.items():
        accompanying = _beside(found) if path.is_dir() else ()
        files = (file for file in _files(path, entry.files) if not _named(file, accompanying))
        if here := {file for file in files if file not in known and entry.recognises(file)}:
            found.append(name)
            known |= here
    if not found:
        raise InputError(
            f"{path}: found {_what_it_is(path)}, expected one of "
            f"{', '.join(name for name, entry in FORMATS.items() if entry.reader is not None)}; "
            "a table of your own is read with import --columns id=...,t=...,x=...,y=..."
        )
    return found


def _what_it_is(path: Path) -> str:
    """What a file or folder is that no reader knows."""
    from sim.formats.common.tables import beginning_of

    if path.is_dir():
        return "no known format" if any(path.iterdir()) else "an empty folder"
    head, names = beginning_of(path)
    if not head:
        return "nothing in it" if path.stat().st_size == 0 else "a file that gzip cannot unpack"
    other = next((text for look, text in OTHERS if look.search(head.lower())), None)
    if other is not None:
        return f"{other} {', '.join(names):.{SHOWN}}" if other.endswith("columns") else other
    line = b"".join(head.splitlines()[:1]).decode("utf-8", "replace")
    if line and line.replace("\t", " ").isprintable():
        return f"no known format in its first line {line[:SHOWN]!r}"
    return "no known format"


def left_out_files(path: Path, names: Sequence[str]) -> list[Path]:
    """Files in a folder that are named like recordings, but not read as formats of these names.

    Files that accompany recordings of these formats are not among them.
    """
    if path.is_file():
        return []
    read = {file for name in names for file in recording_files(path, name)}
    patterns = [pattern for entry in FORMATS.values() for pattern in entry.files]
    others = (file for file in _files(path, patterns) if file not in read)
    return [file for file in others if not _named(file, _beside(names))]


def recording_files(path: Path, name: str) -> list[Path]:
    """The files of a format in a folder, at least one, by name; a file is itself."""
    entry = FORMATS[name]
    files = _files(path, entry.files)
    if path.is_dir():
        files = [f for f in files if not _named(f, entry.beside) and _belongs(f, entry)]
        if entry.one:
            files = sorted({file.parent: file for file in reversed(files)}.values())
    if not files:
        raise InputError(f"{path}: found no {name} file ({', '.join(entry.files)})")
    return files


def _belongs(file: Path, entry: Format) -> bool:
    """Whether a file that is named like those of a format is one.

    A file with the format's own name is one even if it is broken, but not if it is another's.
    """
    if entry.recognises(file) or (entry.head is NOTHING and not entry.columns):
        return True
    return entry.own_names and not any(
        _named(file, one.files) and one.recognises(file) for one in FORMATS.values()
    )


def read_recordings(path: Path, name: str | None = None, **options: Any) -> Iterator[Recording]:
    """Read a recording, or all recordings of one format in a folder.

    Args:
        path: a file or a folder.
        name: a key of ``FORMATS``; None to tell it from the content.
        options: as of `read_formats`; with ``columns``, a table of one's own is read.

    Yields:
        The recordings, one at a time, in order of the files' names; see `recording_files` for
        what is left out. Files of one name in several folders make recordings that are called by
        their folders, too: ``north/vehicle_tracks_000``. One that is called like its file's own
        folder keeps its name.
    """
    name = "table" if options.get("columns") else name or recognise(path)
    for item in read_formats(path, [name], **options):
        if not isinstance(item, Path):
            yield item[1]


def read_formats(
    path: Path,
    names: Sequence[str],
    types: Path | None = None,
    rate_hz: float | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Iterator[tuple[str, Recording] | Path]:
    """As `read_recordings`, of several formats; each file's path comes before its recordings.

    Args:
        path: a file or a folder.
        names: keys of ``FORMATS``.
        types: a SUMO file with the vTypes of ``sumo-fcd`` recordings, for kinds and sizes.
        rate_hz: frames per second that the recordings really have; None for what they say.
        columns: what the columns of a table of one's own are, as `check_columns` takes them.
        units: of these columns.
    """
    from sim.formats.common.recording import at_rate

    if types is not None and "sumo-fcd" not in names:
        raise InputError(f"types: found format {names[0]}, expected sumo-fcd: only it needs them")
    given: dict[str, dict[str, object]] = {
        "sumo-fcd": {"types": types}, "table": {"columns": columns, "units": units},
    }  # fmt: skip
    for name in names:
        files = recording_files(path, name)
        alike = Counter(file.name for file in files)
        for file in files:
            yield file
            called = (file.relative_to(path) if path.is_dir() else Path(file.name)).as_posix()
            folder = called.removesuffix(file.name) if alike[file.name] > 1 else ""
            for recording in get_reader(name)(file, **given.get(name, {})):
                tracks = recording.tracks
                if rate_hz is not None and tracks.time_s.size > 1:
                    tracks = at_rate(tracks, rate_hz)
                own_name = folder.removesuffix(f"{recording.name}/") + recording.name
                yield name, replace(recording, name=own_name, tracks=tracks, file=called)
