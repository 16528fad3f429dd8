"""SUMO's floating car data: XML, one element per agent and time step.

Angles are DEGREES CLOCKWISE FROM NORTH; x and y are the centre of the FRONT BUMPER. The format has
no sizes: they come from a file of vTypes, or are assumed.

References:
    Lopez et al. (2018), Microscopic traffic simulation using SUMO, ITSC; FCD output.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from array import array
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from sim.files import write_whole
from sim.formats.common.packed import BROKEN, opened
from sim.formats.common.recording import (
    MAX_BYTES,
    MAX_NAMES,
    MAX_ROWS,
    Recording,
    Rows,
    check_size,
    kind_codes,
    recordings,
)
from sim.formats.common.recording import default_size as usual_size
from sim.frames import KINDS, PEDESTRIAN, AgentKind, Tracks
from sim.written_numbers import real

CHUNK_BYTES: Final = 2**20
MAX_DEPTH: Final = 16
"""Deepest nesting (FCD has 3)."""
MAX_TOKEN_BYTES: Final = 2**23
"""Longest single piece of XML (an element of FCD has some 200 bytes)."""

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


def _parse(
    path: Path,
    start: Callable[[str, Mapping[str, str]], None],
    ended: Callable[[str], None] = lambda name: None,
) -> None:
    """Call ``start`` and ``ended`` for every element; entities, depth and size are bounded."""
    check_size(path)
    parser = xml.parsers.expat.ParserCreate()
    depth = 0

    def started(name: str, attributes: Mapping[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise InputError(
                f"{path}: line {parser.CurrentLineNumber}: found elements {depth} deep, expected "
                f"at most {MAX_DEPTH}"
            )
        try:
            start(name, attributes)
        except InputError as error:
            raise InputError(f"{path}: line {parser.CurrentLineNumber}: {error}") from None

    def closed(name: str) -> None:
        nonlocal depth
        depth -= 1
        ended(name)

    def refused(*declaration: object) -> None:
        raise InputError(
            f"{path}: line {parser.CurrentLineNumber}: found an entity declaration, expected none"
        )

    parser.StartElementHandler = started
    parser.EndElementHandler = closed
    parser.EntityDeclHandler = refused
    read = 0
    try:
        with opened(path) as file:
            while chunk := file.read(CHUNK_BYTES):
                read += len(chunk)
                if read > MAX_BYTES:
                    raise InputError(f"{path}: found more than {MAX_BYTES} bytes inside")
                parser.Parse(chunk, False)
                if read - parser.CurrentByteIndex > MAX_TOKEN_BYTES:
                    raise InputError(
                        f"{path}: line {parser.CurrentLineNumber}: found no end of an element "
                        f"within {MAX_TOKEN_BYTES} bytes"
                    )
            parser.Parse(b"", True)
    except xml.parsers.expat.ExpatError as error:
        raise InputError(f"{path}: {error}") from None
    except BROKEN as error:
        raise InputError(f"{path}: {error}") from None
    except (UnicodeError, ValueError, LookupError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: {error}") from None


def _number(attributes: Mapping[str, str], name: str) -> float:
    text = attributes.get(name)
    if text is None:
        raise InputError(f"found no {name}, expected a number")
    try:
        value = real(text)
    except ValueError:
        raise InputError(f"{name}: found {text[:40]!r}, expected a number") from None
    if not math.isfinite(value):
        raise InputError(f"{name}: found {text[:40]!r}, expected a finite number")
    return value


def read_types(path: Path) -> dict[str, tuple[AgentKind, float, float]]:
    """Kind, length and width, m, of every vType in a SUMO file.

    Raises:
        InputError: if the file is broken.
    """
    types: dict[str, tuple[AgentKind, float, float]] = {}

    def start(name: str, attributes: Mapping[str, str]) -> None:
        if name == "vType" and "id" in attributes:
            kind = CLASSES.get(attributes.get("vClass", "passenger"), AgentKind.CAR)
            length, width = usual_size(kind)
            types[attributes["id"]] = (
                kind,
                _number(attributes, "length") if "length" in attributes else length,
                _number(attributes, "width") if "width" in attributes else width,
            )

    _parse(path, start)
    return types


class _Collector:
    """Gathers the agents of a recording while it is parsed."""

    def __init__(self) -> None:
        self.time_s: float | None = None
        self.last = -math.inf
        self.index: dict[tuple[str, str], int] = {}  # vehicles and persons may share a name
        self.names: dict[str, None] = {}
        self.times_s: list[float] = []
        self.types: list[str] = []
        self.walks: list[bool] = []
        self.behaviors: list[int] = []
        self.agent = array("q")
        self.columns = {name: array("d") for name in ("time", "x", "y", "angle", "speed")}

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        """One element."""
        if name == "timestep":
            if self.time_s is not None:
                raise InputError("found a timestep inside of a timestep")
            self.time_s = _number(attributes, "time")
            if self.time_s <= self.last:
                raise InputError(f"found time {self.time_s:g}, expected one after {self.last:g}")
            self.last = self.time_s
            self.times_s.append(self.time_s)
        elif name in ("vehicle", "person"):
            if self.time_s is None:
                raise InputError(f"found a {name} outside of a timestep")
            identity = attributes.get("id")
            if not identity:
                raise InputError(f"found a {name} without an id")
            row = self.index.get((name, identity))
            if row is None:
                row = self._new(name, identity, attributes)
            if len(self.agent) >= MAX_ROWS:
                raise InputError(f"found more than {MAX_ROWS} agents and time steps")
            self.agent.append(row)
            self.columns["time"].append(self.time_s)
            for column in ("x", "y", "angle", "speed"):
                self.columns[column].append(_number(attributes, column))

    def end(self, name: str) -> None:
        """The end of an element."""
        if name == "timestep":
            self.time_s = None

    def _new(self, element: str, identity: str, attributes: Mapping[str, str]) -> int:
        if len(self.index) >= MAX_NAMES:
            raise InputError(f"found more than {MAX_NAMES} agents")
        behavior = attributes.get("behavior", "")
        if behavior and behavior not in set(Behavior):
            raise InputError(f"behavior: found {behavior[:40]!r}, expected one of {list(Behavior)}")
        self.index[element, identity] = len(self.types)
        name = identity
        while name in self.names:
            name = f"{element}-{name}"
        self.names[name] = None
        self.types.append(attributes.get("type", ""))
        self.walks.append(element == "person")
        self.behaviors.append(Behavior(behavior).code if behavior else -1)
        return len(self.types) - 1


def read(path: Path, types: Path | None = None) -> Iterator[Recording]:
    """Read one FCD file (``.xml`` or ``.xml.gz``).

    Args:
        path: the file.
        types: a file with the vTypes; by default the one that ends in ``.types.xml`` beside it,
            if there is one.

    Yields:
        One recording, labelled where vehicles carry a ``behavior``.

    Raises:
        InputError: if a file is broken; the message names file and line.
    """
    stem = path.name.removesuffix(".gz").removesuffix(".xml")
    beside = path.with_name(stem + TYPES_SUFFIX)
    types = types or (beside if beside.is_file() else None)
    known = {} if types is None else read_types(types)
    found = _Collector()
    _parse(path, found.start, found.end)
    if not found.types:
        raise InputError(f"{path}: found no vehicle and no person, expected some")
    kinds: list[AgentKind] = []
    sizes: list[tuple[float, float]] = []
    assumed = 0
    for name, walks in zip(found.types, found.walks, strict=True):
        kind = AgentKind.PEDESTRIAN if walks else _kind_in(name)
        size = usual_size(kind)
        if name in known:
            kind, *given = known[name]
            size = (given[0], given[1])
        else:
            assumed += 1
        kinds.append(kind)
        sizes.append(size)
    length = np.array([size[0] for size in sizes])
    column = {name: np.array(values) for name, values in found.columns.items()}
    agent = np.array(found.agent, dtype=np.int64)
    heading = np.radians(90.0 - column["angle"])
    back = 0.5 * length[agent]
    behavior = np.array(found.behaviors, dtype=np.int8)
    rows = Rows(
        agent=agent,
        names=tuple(found.names),
        time_s=column["time"],
        x=column["x"] - back * np.cos(heading),
        y=column["y"] - back * np.sin(heading),
        heading=heading,
        speed=column["speed"],
        length=length,
        width=np.array([size[1] for size in sizes]),
        kind=kind_codes(kinds),
        behavior=behavior if (behavior >= 0).any() else None,
        empty_s=tuple(set(found.times_s) - set(column["time"].tolist())),
    )
    notes = (
        (f"{assumed} agents have no known vType: sizes usual for their kind are assumed (4.5 m)",)
        if assumed
        else ()
    )
    yield from recordings(path, stem, rows, notes)


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
    seen = tracks.as_rows()
    front = seen.xy + 0.5 * tracks.length[seen.index.agent, None] * np.stack(
        [np.cos(seen.heading), np.sin(seen.heading)], axis=1
    )
    for step, time_s in enumerate(tracks.time_s.tolist()):
        lines.append(f'    <timestep time="{time_s!r}">')
        for at in seen.at(step).tolist():
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
