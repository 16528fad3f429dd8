"""SUMO's floating car data: XML, one element per agent and time step.

Angles are DEGREES CLOCKWISE FROM NORTH; x and y are the centre of the FRONT BUMPER. The format has
no sizes: they come from a file of vTypes, or are assumed.

References:
    Lopez et al. (2018), Microscopic traffic simulation using SUMO, ITSC; FCD output.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from sim.files import write_whole
from sim.formats.common.recording import Recording, Rows, default_size, recorded
from sim.formats.common.tables import column_names, read_table
from sim.frames import KINDS, PEDESTRIAN, AgentKind, FloatArray, IntArray, Tracks
from sim.input_files import opened, stem
from sim.xml_tree import refuse_declarations

HEAD_BYTES: Final = 2**16
"""Beginning of a file in which declarations are looked for: they come before all elements."""

CLASSES: Final[dict[str, AgentKind]] = {
    "passenger": AgentKind.CAR,
    "private": AgentKind.CAR,
    "taxi": AgentKind.CAR,
    "bus": AgentKind.BUS,
    "coach": AgentKind.BUS,
    "truck": AgentKind.TRUCK,
    "trailer": AgentKind.TRUCK,
    "delivery": AgentKind.TRUCK,
    "motorcycle": AgentKind.MOTORCYCLE,
    "moped": AgentKind.MOTORCYCLE,
    "bicycle": AgentKind.BICYCLE,
    "pedestrian": AgentKind.PEDESTRIAN,
}
"""SUMO's vehicle classes; others are taken for cars."""

WRITTEN_CLASSES: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "passenger",
    AgentKind.BUS: "bus",
    AgentKind.TRUCK: "truck",
    AgentKind.MOTORCYCLE: "motorcycle",
    AgentKind.BICYCLE: "bicycle",
    AgentKind.PEDESTRIAN: "pedestrian",
}
"""The vehicle class of each kind."""

TYPES_SUFFIX: Final = ".types.xml"
"""Ending of the file of vTypes that is written beside a recording."""


def angle_of(heading: float) -> float:
    """Heading as SUMO's angle, degrees in [0, 360).

    Examples:
        >>> angle_of(0.0), angle_of(math.pi / 2)
        (90.0, 0.0)
    """
    return (90.0 - math.degrees(heading)) % 360.0


def _elements(path: Path, tag: str) -> Iterator[ET.Element]:
    """Every element of a name, one at a time: the whole file never is in memory."""
    with opened(path) as file:
        refuse_declarations(path, file.read(HEAD_BYTES))
        file.seek(0)
        try:
            for _, element in ET.iterparse(file):
                if element.tag == tag:
                    yield element
                    element.clear()
        except ET.ParseError as error:
            raise InputError(f"{path}: {error}, expected XML") from None


def _numbers(where: str, element: ET.Element, names: tuple[str, ...]) -> tuple[float, ...]:
    """Attributes as numbers."""
    found = []
    for name in names:
        text = element.get(name, "")
        try:
            found.append(float(text))
        except ValueError:
            raise InputError(f"{where}: {name}: found {text[:40]!r}, expected a number") from None
    return tuple(found)


def read_types(path: Path) -> dict[str, tuple[AgentKind, tuple[float, float]]]:
    """Kind, and length and width, m, of every vType in a SUMO file.

    Raises:
        InputError: if the file is broken.
    """
    types = {}
    for element in _elements(path, "vType"):
        kind = CLASSES.get(element.get("vClass", "passenger"), AgentKind.CAR)
        length, width = default_size(kind)
        usual = {"length": str(length), "width": str(width)}
        sides = ET.Element("vType", usual | element.attrib)
        name = element.get("id", "")
        length, width = _numbers(f"{path}: vType {name:.60}", sides, ("length", "width"))
        types[name] = kind, (length, width)
    return types


_COLUMNS: Final = ("x", "y", "angle", "speed")
TAGS: Final = ("vehicle", "person")
LEFT_OUT: Final = ("container",)


@dataclass
class _Found:
    """What was read of a file: agents by element and id, times, and rows of `_COLUMNS`."""

    agents: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    time_s: list[float] | FloatArray = field(default_factory=list)
    agent: list[int] | IntArray = field(default_factory=list)
    values: list[float] | FloatArray = field(default_factory=list)
    left_out: set[str] = field(default_factory=set)


def read(path: Path, types: Path | None = None) -> Iterator[Recording]:
    """Read one FCD file: XML, or SUMO's own CSV or Parquet.

    Args:
        path: the file; gzipped where its name ends in ``.gz``. Speeds and angles that it does not
            have are taken from the motion.
        types: a file with the vTypes; by default the one that ends in ``.types.xml`` beside it,
            if there is one.

    Yields:
        One recording, labelled where vehicles carry a ``behavior``.

    Raises:
        InputError: if a file is broken; the message names the file, the time and the agent.
    """
    name = stem(path)
    beside = path.with_name(name + TYPES_SUFFIX)
    types = types or (beside if beside.is_file() else None)
    known = {} if types is None else read_types(types)
    tabular = "timestep_time" in column_names(path)
    found = _from_table(path) if tabular else _from_xml(path)
    if not found.agents:
        raise InputError(f"{path}: found no vehicle and no person in a timestep, expected some")
    yield _recording(path, name, found, known)


def seconds_of(where: str, text: str) -> float:
    """A time of SUMO's, s: a number, or as people read it.

    Args:
        where: it is, for the message.
        text: seconds, or ``[days:]hours:minutes:seconds``.

    Raises:
        InputError: if it is neither.

    Examples:
        >>> seconds_of("here", "01:00:02.50"), seconds_of("here", "1:00:00:00"), seconds_of("", "7")
        (3602.5, 86400.0, 7.0)
    """
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 3, 4):
        raise InputError(f"{where}: found time {text[:40]!r}, expected seconds or 00:00:00")
    return float(np.dot(parts[::-1], (1.0, 60.0, 3600.0, 86400.0)[: len(parts)]))


def _from_xml(path: Path) -> _Found:
    """The rows of an XML file."""
    found = _Found()
    index: dict[tuple[str, str], int] = {}
    agent, values, times = array("q"), array("d"), array("d")
    nan = math.nan
    for step in _elements(path, "timestep"):
        now = seconds_of(f"{path}: timestep", step.get("time", ""))
        if found.times and not now > found.times[-1]:
            raise InputError(
                f"{path}: timestep: found time {now:g}, expected one after {found.times[-1]:g}"
            )
        found.times.append(now)
        for element in step:
            get = element.get
            key = element.tag, get("id", "")
            if element.tag not in TAGS:
                if element.tag in LEFT_OUT:
                    found.left_out.add(key[1])
                continue
            row = index.get(key)
            if row is None:
                row = index[key] = len(index)
                found.agents[key] = get("type", ""), get("behavior", "")
            agent.append(row)
            times.append(now)
            try:
                values.extend([float(get(column, nan)) for column in _COLUMNS])
            except ValueError:
                _numbers(f"{path}: time {now:g}, {key[0]} {key[1]:.60}", element, _COLUMNS)
    found.time_s, found.agent = np.asarray(times), np.asarray(agent)
    found.values = np.asarray(values).reshape(-1, 4)
    return found


def _from_table(path: Path) -> _Found:
    """The rows of a CSV or Parquet file, whose columns are named ``vehicle_x`` and so on."""
    names = column_names(path)
    clock = "timestep_time"
    numbers = [f"{tag}_{c}" for tag in TAGS for c in _COLUMNS]
    words = [
        clock,
        *(f"{tag}_{c}" for tag in (*TAGS, *LEFT_OUT) for c in ("id", "type", "behavior")),
    ]
    table = read_table(path, numbers, words, [*numbers, *words[1:]], [*numbers, *words])
    found, index = _Found(), dict[tuple[str, str], int]()
    codes, texts = table.codes(clock)
    clocks = np.array([seconds_of(f"{path}: column {clock}", text) for text in texts])
    found.times = np.unique(clocks).tolist()
    agent, rows, values = list[int](), list[int](), list[FloatArray]()
    for tag in (*TAGS, *LEFT_OUT):
        if f"{tag}_id" not in names:
            continue
        said = {c: table.words(f"{tag}_{c}") if f"{tag}_{c}" in names else [""] * len(table)
                for c in ("id", "type", "behavior")}  # fmt: skip
        columns = table.stacked(*(f"{tag}_{c}" for c in _COLUMNS))
        for row, (identity, kind, behavior) in enumerate(zip(*said.values(), strict=True)):
            if not identity:
                continue
            lower = (kind or "").lower()
            if tag in LEFT_OUT or "container" in lower:
                found.left_out.add(identity)
                continue
            key = "person" if "pedtype" in lower else tag, identity
            if key not in index:
                index[key] = len(index)
                found.agents[key] = kind or "", behavior or ""
            agent.append(index[key])
            rows.append(row)
        values.append(columns[[r for r in rows[sum(map(len, values)) :]]])
    found.time_s, found.agent = clocks[codes[rows]], np.array(agent, dtype=np.int64)
    found.values = np.concatenate(values) if values else np.empty((0, 4))
    return found


def _recording(
    path: Path, name: str, found: _Found, types: dict[str, tuple[AgentKind, tuple[float, float]]]
) -> Recording:
    """The recording of what was gathered."""
    names: dict[str, None] = {}
    kinds, sizes, codes, assumed = [], [], [], 0
    for (element, identity), (kind_name, behavior) in found.agents.items():
        own = identity
        while own in names:
            own = f"{element}-{own}"
        names[own] = None
        if kind_name in types:
            kind, size = types[kind_name]
        else:
            kind = AgentKind.PEDESTRIAN if element == "person" else _kind_in(kind_name)
            size, assumed = default_size(kind), assumed + 1
        kinds.append(kind)
        sizes.append(size)
        if behavior and behavior not in set(Behavior):
            raise InputError(
                f"{path}: {element} {identity:.60}: behavior: found {behavior[:40]!r}, expected "
                f"one of {', '.join(BEHAVIORS)}"
            )
        codes.append(Behavior(behavior).code if behavior else -1)
    values, labelled = np.asarray(found.values), np.array(codes, dtype=np.int8)
    heading = np.radians(90.0 - values[:, 2])
    rows = Rows(
        np.asarray(found.agent), tuple(names), np.asarray(found.time_s), values[:, :2], heading,
        values[:, 3], kinds, np.array(sizes),
        behavior=labelled if (labelled >= 0).any() else None, empty_s=found.times,
        ahead_lengths=0.5,
    )  # fmt: skip
    notes = [f"{assumed} agents have no known vType: sizes usual for their kind are assumed"]
    recording = recorded(path, name, rows, notes if assumed else ())
    if not found.left_out:
        return recording
    doubt = f"{len(found.left_out)} containers are left out: they are no road-agents"
    return replace(recording, doubts=(doubt, *recording.doubts))


def _kind_in(name: str) -> AgentKind:
    """The kind that a type's name contains; a car if it contains none."""
    lower = name.lower()
    return next((kind for kind in AgentKind if kind.value in lower), AgentKind.CAR)


def write(folder: Path, name: str, tracks: Tracks, road: object = None) -> list[Path]:
    """Write an episode, with its behaviours, and its vTypes beside it.

    Args:
        folder: where; it must exist.
        name: the file's name without its ending.
        tracks: the episode.
        road: not used; lanes are left out.

    Returns:
        The files written.

    Raises:
        InputError: if an agent has a name that XML cannot hold.
    """
    for label in tracks.names:
        if not label.isprintable():
            raise InputError(f"{name}: found agent {label!r}, expected a name that can be printed")
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<fcd-export>"]
    labels = [
        "" if tracks.behavior is None or code < 0 else f' behavior="{BEHAVIORS[code].value}"'
        for code in (np.full(len(tracks.names), -1) if tracks.behavior is None else tracks.behavior)
    ]
    ids = [quoteattr(label) for label in tracks.names]
    types = [quoteattr(f"type-{label}") for label in tracks.names]
    element = ["person" if kind == PEDESTRIAN else "vehicle" for kind in tracks.kind]
    seen = tracks.rows
    front = seen.xy + 0.5 * tracks.length[seen.index.agent, None] * np.stack(
        [np.cos(seen.heading), np.sin(seen.heading)], axis=1
    )
    for step, time_s in enumerate(tracks.time_s.tolist()):
        lines.append(f'    <timestep time="{time_s!r}">')
        for at in seen.index.at(step).tolist():
            row = int(seen.index.agent[at])
            x, y = front[at].tolist()
            lines.append(
                f'        <{element[row]} id={ids[row]} x="{x!r}" y="{y!r}" '
                f'angle="{angle_of(float(seen.heading[at]))!r}" type={types[row]} '
                f'speed="{float(seen.speed[at])!r}"{labels[row]}/>'
            )
        lines.append("    </timestep>")
    lines.append("</fcd-export>\n")
    known = ['<?xml version="1.0" encoding="UTF-8"?>', "<additional>"]
    known += [
        f'    <vType id={types[i]} vClass="{WRITTEN_CLASSES[KINDS[tracks.kind[i]]]}" '
        f'length="{float(tracks.length[i])!r}" width="{float(tracks.width[i])!r}"/>'
        for i in range(len(tracks.names))
    ]
    known.append("</additional>\n")
    path, beside = folder / f"{name}.xml", folder / f"{name}{TYPES_SUFFIX}"
    write_whole(path, "\n".join(lines).encode())
    write_whole(beside, "\n".join(known).encode())
    return [path, beside]
