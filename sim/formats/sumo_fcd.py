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
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.files import write_whole
from sim.formats.common.recording import Recording, default_size, recorded
from sim.formats.common.tables import beginning_of, read_table
from sim.frames import PEDESTRIAN, AgentKind, Tracks
from sim.input_files import opened, refuse_declarations, stem

HEAD_BYTES: Final = 2**16
"""Beginning of a file in which declarations are looked for: they come before all elements."""

CLASSES: Final[dict[str, AgentKind]] = {
    "passenger": AgentKind.CAR,
    **{kind.value: kind for kind in AgentKind if kind is not AgentKind.CAR},
    "coach": AgentKind.BUS,
    "trailer": AgentKind.TRUCK,
    "delivery": AgentKind.TRUCK,
    "moped": AgentKind.MOTORCYCLE,
}
"""SUMO's vehicle classes; others are taken for cars."""

TYPES_SUFFIX: Final = ".types.xml"
"""Ending of the file of vTypes that is written beside a recording."""


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


Type = tuple[AgentKind, tuple[float, float]]


def read_types(path: Path) -> dict[str, Type]:
    """Kind, and length and width, m, of every vType in a SUMO file."""
    types = {}
    for element in _elements(path, "vType"):
        kind = CLASSES.get(element.get("vClass", "passenger"), AgentKind.CAR)
        length, width = default_size(kind)
        sides = float(element.get("length", length)), float(element.get("width", width))
        types[element.get("id", "")] = kind, sides
    return types


NUMBERS: Final = ("x", "y", "angle", "speed")
FACTS: Final = ("id", "type", "behavior")
TAGS: Final = ("vehicle", "person", "container")
CLOCK: Final = "timestep_time"
"""Attributes that are read of the elements, and the times of tables; containers are counted."""


def read(path: Path, types: Path | None = None) -> Iterator[Recording]:
    """The recording of one FCD file: XML, or SUMO's own CSV or Parquet.

    The vTypes are by default in the file that ends in ``.types.xml`` beside it, if there is one.
    """
    beside = path.with_name(stem(path) + TYPES_SUFFIX)
    types = types or (beside if beside.is_file() else None)
    known = {} if types is None else read_types(types)
    tabular = CLOCK in beginning_of(path)[1]
    rows, times_s = _rows_of_table(path) if tabular else _rows_of_xml(path)
    yield _recording(stem(path), rows, times_s, known)


def _seconds_of(text: str) -> float:
    """A time of SUMO's, s: a number, or ``[days:]hours:minutes:seconds``."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 3, 4):
        raise InputError(f"timestep: found time {text[:40]!r}, expected seconds or 00:00:00")
    return float(np.dot(parts[::-1], (1.0, 60.0, 3600.0, 86400.0)[: len(parts)]))


def _rows_of_xml(path: Path) -> tuple[pandas.DataFrame, list[float]]:
    """The rows of the agents, with tag, `FACTS` and `NUMBERS`, and the times of the steps, s."""
    index: dict[tuple[str, str], int] = {}
    facts: list[tuple[str, ...]] = []
    times_s: list[float] = []
    agent, values = array("q"), array("d")
    for step in _elements(path, "timestep"):
        now_s = _seconds_of(step.get("time", ""))
        if times_s and not now_s > times_s[-1]:
            raise InputError(f"timestep: found time {now_s:g}, expected one after {times_s[-1]:g}")
        times_s.append(now_s)
        for element in step:
            get = element.get
            key = element.tag, get("id", "")
            row = index.get(key)
            if row is None:
                row = index[key] = len(index)
                facts.append((*key, get("type", ""), get("behavior", "")))
            agent.append(row)
            values.append(now_s)
            values.extend([float(get(name, math.nan)) for name in NUMBERS])
    known = pandas.DataFrame(facts, columns=["tag", *FACTS], dtype="category")
    rows = known.iloc[np.asarray(agent, dtype=int)]
    rows[["t", *NUMBERS]] = np.asarray(values).reshape(-1, 1 + len(NUMBERS))
    return rows[rows["tag"].isin(TAGS)].reset_index(drop=True), times_s


def _rows_of_table(path: Path) -> tuple[pandas.DataFrame, list[float]]:
    """The same of a CSV or Parquet file, whose columns are named ``vehicle_x`` and so on."""
    numbers = [f"{tag}_{name}" for tag in TAGS for name in NUMBERS]
    words = [f"{tag}_{name}" for tag in TAGS for name in FACTS]
    table = read_table(path, numbers, [CLOCK, *words], [*numbers, *words])
    table["t"] = table[CLOCK].map(_seconds_of).astype(float)
    parts = []
    for tag in TAGS:
        part = table.rename(columns={f"{tag}_{name}": name for name in (*FACTS, *NUMBERS)})
        part = part.reindex(columns=[*FACTS, "t", *NUMBERS])
        part[[*FACTS]] = part[[*FACTS]].astype(object).fillna("")
        parts.append(part[part["id"] != ""].assign(tag=tag))
    rows = pandas.concat(parts, ignore_index=True)
    kind = rows["type"].str.lower()  # tables have containers and persons among vehicles
    rows.loc[kind.str.contains("pedtype"), "tag"] = "person"
    rows.loc[kind.str.contains("container"), "tag"] = "container"
    return rows, np.unique(table["t"]).tolist()


def _recording(
    name: str, rows: pandas.DataFrame, times_s: list[float], types: Mapping[str, Type]
) -> Recording:
    """The recording of a file's rows."""
    shared = rows[rows.duplicated(["t", "x", "y"], keep=False)]
    drives = (shared["tag"] == "vehicle").groupby([shared["t"], shared["x"], shared["y"]])
    riding = shared.index[drives.transform("any") & (shared["tag"] == "person")]
    riders = rows["id"][riding].nunique()
    containers = rows["id"][rows["tag"] == "container"].nunique()
    rows = rows.drop(riding)
    rows = rows[rows["tag"] != "container"]
    if rows.empty:
        raise InputError("found no vehicle and no person in a timestep, expected some")
    agent = rows.groupby(["tag", "id"], sort=False, observed=True).ngroup().to_numpy()
    first = rows.iloc[np.unique(agent, return_index=True)[1]]
    found: dict[str, tuple[AgentKind, tuple[float, float]]] = {}
    behaviors: dict[str, str | None] = {}
    for tag, own, word, behavior in first[["tag", *FACTS]].itertuples(index=False):
        while own in found:
            own = f"{tag}-{own}"
        kind = AgentKind.PEDESTRIAN if tag == "person" else _kind_in(word)
        found[own] = types.get(word, (kind, default_size(kind)))
        behaviors[own] = behavior
    made = rows[["t", "x", "y", "speed"]].assign(
        id=pandas.Categorical.from_codes(agent, list(found)),
        heading=np.radians(90.0 - rows["angle"]),
        kind=np.array([kind.code for kind, _ in found.values()])[agent],
    )
    made[["length", "width"]] = np.array([sides for _, sides in found.values()])[agent]
    assumed = int((~first["type"].isin(types)).sum())
    notes = [f"{assumed} agents have no known vType: sizes usual for their kind are assumed"]
    recording = recorded(
        name, made, notes if assumed else (), empty_s=times_s, ahead_lengths=0.5
    ).with_behaviors(behaviors)
    doubts = list(recording.doubts)
    if containers:
        doubts.insert(0, f"{containers} containers are left out: they are no road-agents")
    if riders:
        doubts.append(f"{riders} riders are left out while they are inside a vehicle")
    return replace(recording, doubts=tuple(doubts))


def _kind_in(name: str) -> AgentKind:
    """The kind that a type's name contains; a car if it contains none."""
    lower = name.lower()
    return next((kind for kind in AgentKind if kind.value in lower), AgentKind.CAR)


def write(folder: Path, name: str, tracks: Tracks, road: object = None) -> list[Path]:
    """Write an episode, with its behaviours, and its vTypes beside it; lanes are left out."""
    for label in tracks.names:
        if not label.isprintable():
            raise InputError(f"{name}: found agent {label!r}, expected a name that can be printed")
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    index, heading = tracks.index, tracks.row_heading
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    labels = [f' behavior="{tracks.classes[code]}"' if code >= 0 else "" for code in codes]
    ids = [quoteattr(label) for label in tracks.names]
    types = [quoteattr(f"type-{label}") for label in tracks.names]
    element = ["person" if kind == PEDESTRIAN else "vehicle" for kind in tracks.kind]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    front = tracks.row_xy + 0.5 * tracks.length[index.agent, None] * forward
    lines = [head, "<fcd-export>"]
    for step, time_s in enumerate(tracks.time_s.tolist()):
        lines.append(f'    <timestep time="{time_s!r}">')
        for at in index.at(step).tolist():
            row = int(index.agent[at])
            x, y = front[at].tolist()
            angle = (90.0 - math.degrees(heading[at])) % 360.0
            lines.append(
                f'        <{element[row]} id={ids[row]} x="{x!r}" y="{y!r}" '
                f'angle="{angle!r}" type={types[row]} '
                f'speed="{float(tracks.row_speed[at])!r}"{labels[row]}/>'
            )
        lines.append("    </timestep>")
    usual = {kind.code: name for name, kind in reversed(CLASSES.items())}
    known = [
        f'    <vType id={types[i]} vClass="{usual[kind]}" '
        f'length="{float(tracks.length[i])!r}" width="{float(tracks.width[i])!r}"/>'
        for i, kind in enumerate(tracks.kind.tolist())
    ]
    path, beside = folder / f"{name}.xml", folder / f"{name}{TYPES_SUFFIX}"
    write_whole(path, "\n".join([*lines, "</fcd-export>\n"]).encode())
    write_whole(beside, "\n".join([head, "<additional>", *known, "</additional>\n"]).encode())
    return [path, beside]
