"""Slow independent readers of the families of `grammars`: they share no code with ours.

Python's `csv` and `ElementTree`, and pyarrow in a process of its own, read the same bytes; scipy
turns what was seen from a car.
"""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.benches.hostile.grammars import Table

Rows = dict[tuple[str, float], tuple[float, float]]
"""Place of each agent at each time, as a reader found it."""

NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
LARGEST: Final = 1e9

NOT_PLACES: Final = ("timestamp", "timestamp_ms", "frame", "heading")
"""Columns in other units than m, m/s and rad: limits hold for what they become."""


class Refused(Exception):
    """The oracle's answer to a file that is broken."""


class Unsure(Exception):
    """The oracle's answer where it cannot know."""


def finite(text: str) -> float:
    """A number of a file, within what may be."""
    stripped = text.strip(" \t")
    if not NUMBER.fullmatch(stripped):
        raise Refused(f"no number: {text!r}")
    value = float(stripped)
    if not math.isfinite(value):
        raise Refused("not finite")
    return value


def _fields(line: str) -> list[str]:
    """The fields of one line; quotation marks enclose whole fields, doubled ones stand for one."""
    if '"' in line:
        plain = line.replace('""', "")
        if plain.count('"') % 2 or re.search(r'[^,"]"[^,"]', plain):
            raise Refused("quotation marks")
    return next(csv.reader([line]))


def read_table(table: Table, data: bytes) -> Rows:
    """What a CSV file says."""
    if b"\0" in data:
        raise Refused("NUL")
    text = data.decode("utf-8", "surrogateescape")
    lines = re.split(r"\r\n|\n|\r", text.removeprefix("\ufeff"))
    header = [name.strip().strip('"').lower() for name in lines[0].split(",")]
    if not lines[0].isprintable() and any("\udc80" <= one <= "\udcff" for one in lines[0]):
        raise Refused("header is not UTF-8")
    required = [*table.numbers, *table.words]
    optional = {"psi_rad", "length", "width"} if "agent_type" in table.words else set[str]()
    for name in required:
        if header.count(name) > 1 or (name not in header and name not in optional):
            raise Refused(f"column {name}")
    found: Rows = {}
    first: dict[str, dict[str, str]] = {}
    _fields(lines[0])
    for line in lines[1:]:
        if not line:
            continue
        fields = _fields(line)
        if len(fields) != len(header):
            raise Refused("fields")
        row = dict(zip(header, fields, strict=True))
        values = {name: finite(row[name]) for name in table.numbers if name in row}
        for name in table.words:
            if any("\udc80" <= one <= "\udcff" for one in row[name]):
                raise Refused("not UTF-8")
        places = {n: v for n, v in values.items() if n not in (*NOT_PLACES, *table.sizes)}
        speeds = [v for n, v in places.items() if "v" in n]
        turn = math.radians(values.get("heading", 0.0))
        if any(abs(v) > LARGEST for v in (*places.values(), turn, math.hypot(*speeds))):
            raise Refused("too large")
        agent = row[table.agent]
        before = first.setdefault(agent, row)
        for name, allowed in table.kinds.items():
            if row[name].lower() not in allowed or before[name] != row[name]:
                raise Refused("kind")
        if before is row and any(not 0 <= values.get(n, 1) <= 1000 for n in table.sizes):
            raise Refused("size")
        if before is row and "trackid" not in row and any(values.get(n) == 0 for n in table.sizes):
            raise Refused("size")
        moment, x, y = table.place(values)
        if (agent, moment) in found:
            raise Refused("twice")
        if max(abs(x), abs(y)) > LARGEST:
            raise Refused("too large")
        found[agent, moment] = (x, y)
    if not found:
        raise Refused("no rows")
    if table.from_zero:
        start = min(moment for _, moment in found)
        found = {(agent, moment - start): xy for (agent, moment), xy in found.items()}
    if any(abs(moment) > LARGEST for _, moment in found):
        raise Refused("too late")
    return found


def read_fcd(data: bytes) -> Rows:
    """What an FCD file says, by ElementTree."""
    if b"<!ENTITY" in data:
        raise Refused("entity")
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise Refused(str(error)) from None
    found: Rows = {}
    names: dict[tuple[str, str], str] = {}
    last = -math.inf

    def agents(element: ET.Element, now: float | None) -> None:
        nonlocal last
        for child in element:
            inside = now
            if child.tag == "timestep":
                if now is not None:
                    raise Refused("timestep in a timestep")
                inside = finite(child.get("time", ""))
                if inside <= last:
                    raise Refused("time")
                last = inside
            elif child.tag in ("vehicle", "person"):
                if now is None or not child.get("id"):
                    raise Refused("no id or time")
                key = (child.tag, child.get("id", ""))
                name = names.get(key)
                if name is None:
                    name = key[1]
                    while name in names.values():
                        name = f"{child.tag}-{name}"
                    names[key] = name
                x, y, angle, speed = (
                    finite(child.get(n, "")) for n in ("x", "y", "angle", "speed")
                )
                if (name, now) in found or max(map(abs, (x, y, speed, angle / 57.29))) > LARGEST:
                    raise Refused("twice or too large")
                found[name, now] = (x, y)
            agents(child, inside)

    agents(root, None)
    if not found or abs(last) > LARGEST:
        raise Refused("nobody, or too late")
    return found


def read_traf(data: bytes) -> Rows:
    """What a TRAF file says."""
    found: Rows = {}
    last = -1
    for line in data.split(b"\n"):
        if not line.strip():
            continue
        fields = []
        for one in line.split(b","):
            if not re.fullmatch(rb"[ \t\r\f\v]*[+-]?[0-9]{1,4000}[ \t\r\f\v]*", one):
                raise Refused("no whole number")
            fields.append(int(one))
        if len(fields) < 2 or fields[1] < 0 or len(fields) != 2 + 5 * fields[1]:
            raise Refused("fields")
        if not last < fields[0] <= 10**9:
            raise Refused("frame")
        last = fields[0]
        for at in range(2, len(fields), 5):
            x, y, w, h, agent = fields[at : at + 5]
            if w <= 0 or h <= 0 or max(map(abs, (x, y, w, h, agent))) > 10**6:
                raise Refused("box")
            if (str(agent), last / 25.0) in found:
                raise Unsure("the reader gives the second box of an id a name of its own")
            found[str(agent), last / 25.0] = (x + w / 2, 480 - (y + h / 2))
    if not found:
        raise Refused("no boxes")
    return found


CHILD: Final = """
import json, sys, pyarrow.feather as pf, pyarrow.parquet as pq
def spelt(value):
    return value.decode() if isinstance(value, bytes) else str(value)
for line in sys.stdin:
    try:
        path, columns = json.loads(line)
        if path.endswith(".feather"):
            t = pf.read_table(path, columns=columns, use_threads=False)
        else:
            t = pq.read_table(path, columns=columns, partitioning=None, use_threads=False)
        t.validate(full=True)
        told = json.dumps({c: t.column(c).to_pylist() for c in t.column_names}, default=spelt)
    except Exception:  # pyarrow refuses by errors of many kinds
        told = "null"
    print(told, flush=True)
"""

_child: list[subprocess.Popen[str]] = []
"""The process with pyarrow, once there is one."""


def arrow_columns(path: Path, columns: Sequence[str]) -> dict[str, list[Any]] | None:
    """What pyarrow reads of columns in a process of its own; None where it refuses or dies.

    Args:
        path: a Parquet or Feather file.
        columns: which of its columns; those that are not there are left out.
    """
    if not _child:
        _child.append(
            subprocess.Popen(
                [sys.executable, "-c", CHILD],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        )
    child = _child[0]
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        child.stdin.write(json.dumps([str(path), list(columns)]) + "\n")
        child.stdin.flush()
        told = child.stdout.readline()
    except BrokenPipeError:
        told = ""
    if not told:
        _child.clear()
        child.kill()
        child.communicate()
        return None
    found: dict[str, list[Any]] | None = json.loads(told)
    return found


def read_argoverse2(path: Path) -> Rows | None:
    """What pyarrow reads of an Argoverse 2 scenario; None where it refuses."""
    names = ("track_id", "object_type", "timestep", "position_x", "position_y")
    columns = arrow_columns(path, (*names, "heading", "velocity_x", "velocity_y"))
    if columns is None or not set(names) <= columns.keys():
        return None
    kinds = ("vehicle", "bus", "motorcyclist", "cyclist", "pedestrian")
    rows = zip(*(columns[name] for name in names), strict=True)
    return {(t, k / 10.0): (x, y) for t, kind, k, x, y in rows if kind in kinds}


RIDERS: Final = ("MOTORCYCLIST", "BICYCLIST", "WHEELED_RIDER", "PEDESTRIAN", "OFFICIAL_SIGNALER")
VEHICLES: Final = (
    "REGULAR_VEHICLE", "LARGE_VEHICLE", "TRUCK", "BOX_TRUCK", "TRUCK_CAB", "BUS", "SCHOOL_BUS",
    "ARTICULATED_BUS", "RAILED_VEHICLE",
)  # fmt: skip
"""Categories of a sensor log that take part in traffic."""


def read_sensor_log(path: Path) -> Rows:
    """What pyarrow and scipy read of an Argoverse 2 sensor log."""
    turn, place = ("qx", "qy", "qz", "qw"), ("tx_m", "ty_m", "tz_m")
    boxes = arrow_columns(path, ("timestamp_ns", "track_uuid", "category", *turn, *place))
    poses = arrow_columns(
        path.with_name("city_SE3_egovehicle.feather"), ("timestamp_ns", *turn, *place)
    )
    if boxes is None or poses is None:
        raise Refused("pyarrow refuses")

    def each(table: dict[str, list[Any]], names: Sequence[str]) -> list[tuple[Any, ...]]:
        return list(zip(*(table[name] for name in names), strict=True))

    turns = zip(poses["timestamp_ns"], each(poses, turn), each(poses, place), strict=True)
    at = {stamp: (Rotation.from_quat(q), np.array(p)) for stamp, q, p in turns}
    start, found = min(boxes["timestamp_ns"]), dict[tuple[str, float], tuple[float, float]]()
    with np.errstate(invalid="ignore"):  # what is not finite is refused
        for stamp, name, category, where in zip(
            *(boxes[one] for one in ("timestamp_ns", "track_uuid", "category")), each(boxes, place),
            strict=True,
        ):  # fmt: skip
            rotation, origin = at[stamp]
            time_s = (stamp - start) / 1e9
            x, y, _ = rotation.apply((1.34, 0.0, 0.0)) + origin
            found["AV", time_s] = (x, y)
            if category in (*VEHICLES, *RIDERS):
                x, y, _ = rotation.apply(where) + origin
                found[name, time_s] = (x, y)
    return found


def differ(one: Rows, other: Rows) -> str | None:
    """What two readers do not agree on."""
    key = {(name, round(moment, 6)): xy for (name, moment), xy in one.items()}
    if len(one) != len(other):
        return f"{len(one)} rows, the oracle has {len(other)}"
    for (name, moment), xy in other.items():
        mine = key.get((name, round(moment, 6)))
        if mine is None:
            return f"no row of {name!r} at {moment}"
        if any(abs(a - b) > 1e-6 * max(1.0, abs(b)) for a, b in zip(mine, xy, strict=True)):
            return f"{name!r} at {moment}: {mine}, the oracle has {xy}"
    return None
