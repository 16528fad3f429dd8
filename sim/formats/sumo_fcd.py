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
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.files import write_whole
from sim.formats.common.recording import Recording, Rows, default_size, recorded
from sim.formats.common.tables import column_names, read_table
from sim.frames import KINDS, PEDESTRIAN, AgentKind, Tracks
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

WRITTEN_CLASSES: Final = {AgentKind.CAR: "passenger"}
"""The vehicle class of a kind, where it is called otherwise."""

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


def _numbers(where: str, element: Any, names: tuple[str, ...]) -> tuple[float, ...]:
    """Attributes as numbers."""
    found = []
    for name in names:
        text = element.get(name, math.nan)
        try:
            found.append(float(text))
        except ValueError:
            raise InputError(f"{where}: {name}: found {text!r:.40}, expected a number") from None
    return tuple(found)


Type = tuple[AgentKind, tuple[float, float]]


def read_types(path: Path) -> dict[str, Type]:
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


NUMBERS: Final = ("x", "y", "angle", "speed")
TAGS: Final = ("vehicle", "person")
LEFT_OUT: Final = ("container",)
CLOCK: Final = "timestep_time"
"""Attributes that are read, elements that are read and counted, and the times of tables."""

Step = tuple[float, Iterable[tuple[str, Any]]]
"""A time, s, and what is there: the element of each agent, and its attributes."""


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
    beside = path.with_name(stem(path) + TYPES_SUFFIX)
    types = types or (beside if beside.is_file() else None)
    known = {} if types is None else read_types(types)
    tabular = CLOCK in column_names(path)
    yield _recording(path, _steps_of_table(path) if tabular else _steps_of_xml(path), known)


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


def _steps_of_xml(path: Path) -> Iterator[Step]:
    """The steps of an XML file."""
    last_s = -math.inf
    for step in _elements(path, "timestep"):
        now_s = seconds_of(f"{path}: timestep", step.get("time", ""))
        if not now_s > last_s:
            raise InputError(
                f"{path}: timestep: found time {now_s:g}, expected one after {last_s:g}"
            )
        last_s = now_s
        yield now_s, ((element.tag, element) for element in step)


def _steps_of_table(path: Path) -> Iterator[Step]:
    """The steps of a CSV or Parquet file, whose columns are named ``vehicle_x`` and so on."""
    tags = (*TAGS, *LEFT_OUT)
    numbers = [f"{tag}_{name}" for tag in tags for name in NUMBERS]
    words = [f"{tag}_{name}" for tag in tags for name in ("id", "type", "behavior")]
    table = read_table(path, numbers, [CLOCK, *words], [*numbers, *words], [*numbers, *words])
    code, texts = table.codes(CLOCK)
    times_s = np.array([seconds_of(f"{path}: column {CLOCK}", text) for text in texts])[code]
    columns = table.columns.astype(object).where(table.columns.notna(), None)
    for now_s in np.unique(times_s).tolist():
        rows = columns[times_s == now_s].to_dict("records")
        yield now_s, [agent for row in rows for tag in tags if (agent := _in_row(row, tag))]


def _in_row(row: Mapping[str, Any], tag: str) -> tuple[str, dict[str, Any]] | None:
    """What a row of a table says of an agent of an element; None where there is none."""
    begin = f"{tag}_"
    found = {k.removeprefix(begin): v for k, v in row.items()
             if k.startswith(begin) and v is not None}  # fmt: skip
    if not found.get("id"):
        return None
    kind = found.get("type", "").lower()  # tables have containers and persons among vehicles
    return "container" if "container" in kind else "person" if "pedtype" in kind else tag, found


def _recording(path: Path, steps: Iterable[Step], types: Mapping[str, Type]) -> Recording:
    """The recording of a file's steps."""
    index: dict[tuple[str, str], int] = {}
    stated: list[tuple[str, str]] = []
    empty_s, containers = [], set[str]()
    agent, values, times = array("q"), array("d"), array("d")
    for now_s, elements in steps:
        empty_s.append(now_s)
        for tag, element in elements:
            get = element.get
            key = tag, get("id", "")
            if tag not in TAGS:
                if tag in LEFT_OUT:
                    containers.add(key[1])
                continue
            row = index.get(key)
            if row is None:
                row = index[key] = len(index)
                stated.append((get("type", ""), get("behavior", "")))
            agent.append(row)
            times.append(now_s)
            try:
                values.extend([float(get(name, math.nan)) for name in NUMBERS])
            except ValueError:
                _numbers(f"{path}: time {now_s:g}, {tag} {key[1]:.60}", element, NUMBERS)
    if not index:
        raise InputError(f"{path}: found no vehicle and no person in a timestep, expected some")
    names: dict[str, None] = {}
    kinds, sizes, codes, assumed = [], [], [], 0
    for (tag, name), (kind_name, behavior) in zip(index, stated, strict=True):
        own = name
        while own in names:
            own = f"{tag}-{own}"
        names[own] = None
        if kind_name not in types:
            kind = AgentKind.PEDESTRIAN if tag == "person" else _kind_in(kind_name)
            assumed += 1
        kind, size = types.get(kind_name) or (kind, default_size(kind))
        kinds.append(kind)
        sizes.append(size)
        if behavior and behavior not in BEHAVIORS:
            raise InputError(
                f"{path}: {tag} {name:.60}: behavior: found {behavior[:40]!r}, expected one of "
                f"{', '.join(BEHAVIORS)}"
            )
        codes.append(BEHAVIORS.index(behavior) if behavior else -1)
    table, labelled = np.asarray(values).reshape(-1, len(NUMBERS)), np.array(codes, dtype=np.int8)
    rows = Rows(
        np.asarray(agent), tuple(names), np.asarray(times), table[:, :2],
        np.radians(90.0 - table[:, 2]), table[:, 3], kinds, np.array(sizes),
        behavior=labelled if (labelled >= 0).any() else None, empty_s=empty_s, ahead_lengths=0.5,
    )  # fmt: skip
    notes = [f"{assumed} agents have no known vType: sizes usual for their kind are assumed"]
    recording = recorded(path, stem(path), rows, notes if assumed else ())
    if not containers:
        return recording
    doubt = f"{len(containers)} containers are left out: they are no road-agents"
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
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    labels = [f' behavior="{tracks.classes[code]}"' if code >= 0 else "" for code in codes]
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
    kinds = [KINDS[code] for code in tracks.kind]
    classes = [WRITTEN_CLASSES.get(kind, kind.value) for kind in kinds]
    known = ['<?xml version="1.0" encoding="UTF-8"?>', "<additional>"]
    known += [
        f'    <vType id={types[i]} vClass="{classes[i]}" '
        f'length="{float(tracks.length[i])!r}" width="{float(tracks.width[i])!r}"/>'
        for i in range(len(tracks.names))
    ]
    known.append("</additional>\n")
    path, beside = folder / f"{name}.xml", folder / f"{name}{TYPES_SUFFIX}"
    write_whole(path, "\n".join(lines).encode())
    write_whole(beside, "\n".join(known).encode())
    return [path, beside]
