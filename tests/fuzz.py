"""Hostile recordings by the thousand, read by graphrqi and by slow independent readers.

    python tests/fuzz.py --inputs 100000 --seed 0 [--family sumo-fcd]

A file is grown from the grammar of its format; at every production something may go wrong: a field
is hostile, a separator doubled, a row repeated, moved or cut. An oracle that shares no code with
the reader (Python's `csv`, `ElementTree`, and pyarrow in a child process) reads the same bytes.
Both must accept or both refuse, and rows and values must agree. An input is told by family and
number: ``--only FAMILY:NUMBER`` makes it again.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import random
import re
import resource
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.formats import get_reader

Rows = dict[tuple[str, float], tuple[float, float]]
"""Place of each agent at each time, as a reader found it."""

HOSTILE: Final = (
    "", " ", "-", "nan", "NaN", "inf", "-inf", "1e400", "-1e400", "1e-400", "0x10", "1_0", "1,5",
    "\uff11", "\u0661", "1e9", "1000000100", "-0", "0.0", "1e5", " 7", "7 ", "9" * 25, "a", "\x00",
    '"', '""', '"1"', "'", "1;2", "\t", "<", "&", "=1+1", "\u202e", "\x1b[2J", "None", "true", "5.",
    ".5", "1e", "--1", "1d3",
)  # fmt: skip
"""Fields that readers have misread somewhere."""

NUMBER: Final = re.compile(r"[-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
LARGEST: Final = 1e9


class Refused(Exception):
    """The oracle's answer to a file that is broken."""


@dataclass(frozen=True)
class Table:
    """The grammar of a CSV format and how an oracle reads its rows.

    Attributes:
        file: name of the file.
        columns: every column and how a field of it is made, from agent and step.
        numbers: the columns that are read as numbers.
        words: the columns that are read as text.
        agent: the column with the agent.
        place: agent's place at a time, from a row's fields by column.
        kinds: words that ``kind`` may be, by the column; empty for any.
    """

    file: str
    columns: dict[str, Callable[[int, int], str]]
    numbers: tuple[str, ...]
    words: tuple[str, ...]
    agent: str
    place: Callable[[dict[str, float]], tuple[float, float, float]]
    sizes: tuple[str, ...] = ()
    kinds: dict[str, frozenset[str]] = field(default_factory=dict)
    from_zero: bool = False


def _decimal(a: int, k: int) -> str:
    return f"{3.25 * k + 11 * a:.3f}"


TABLES: Final = {
    "argoverse1": Table(
        "a.csv",
        {
            "TIMESTAMP": lambda a, k: f"{315970000 + k / 10:.1f}", "TRACK_ID": lambda a, k: f"t{a}",
            "OBJECT_TYPE": lambda a, k: "OTHERS", "X": _decimal, "Y": lambda a, k: f"{2 * a}",
            "CITY_NAME": lambda a, k: "PIT",
        },
        ("timestamp", "x", "y"), ("track_id", "object_type"), "track_id",
        lambda v: (v["timestamp"], v["x"], v["y"]), from_zero=True,
    ),
    "interaction": Table(
        "vehicle_tracks_000.csv",
        {
            "track_id": lambda a, k: str(a + 1), "frame_id": lambda a, k: str(k + 1),
            "timestamp_ms": lambda a, k: str(100 * k + 100), "agent_type": lambda a, k: "car",
            "x": _decimal, "y": lambda a, k: f"{2 * a}", "vx": lambda a, k: "32.5",
            "vy": lambda a, k: "0", "psi_rad": lambda a, k: "0.01", "length": lambda a, k: "4.5",
            "width": lambda a, k: "1.9",
        },
        ("timestamp_ms", "x", "y", "vx", "vy", "psi_rad", "length", "width"),
        ("track_id", "agent_type"), "track_id",
        lambda v: (v["timestamp_ms"] / 1000.0, v["x"], v["y"]), ("length", "width"),
        {"agent_type": frozenset({"car", "bus", "truck", "motorcycle", "bicycle", "pedestrian",
                                  "pedestrian/bicycle"})},
    ),
    "ind": Table(
        "00_tracks.csv",
        {
            "trackId": lambda a, k: str(a), "frame": lambda a, k: str(k), "xCenter": _decimal,
            "yCenter": lambda a, k: f"{2 * a}", "heading": lambda a, k: "12.5",
            "width": lambda a, k: "1.9", "length": lambda a, k: "4.5",
            "xVelocity": lambda a, k: "9", "yVelocity": lambda a, k: "0.5",
            "lonVelocity": lambda a, k: "9",
        },
        ("frame", "xcenter", "ycenter", "heading", "width", "length", "xvelocity", "yvelocity"),
        ("trackid",), "trackid", lambda v: (v["frame"] / 25.0, v["xcenter"], v["ycenter"]),
        ("width", "length"),
    ),
}  # fmt: skip


# --- mutators: written from the grammars --------------------------------------------------------


def grow_table(table: Table, choose: random.Random) -> bytes:
    """A CSV file, mostly well formed."""
    odds = choose.choice([0.0, 0.005, 0.02, 0.1])

    def wrong() -> bool:
        return choose.random() < odds

    names = list(table.columns)
    if wrong():
        choose.shuffle(names)
    header = [
        choose.choice([n.lower(), n.upper(), f'"{n}"', f" {n}", n + "x"]) if wrong() else n
        for n in names
    ]
    if wrong():
        header.append(choose.choice([*names, "extra", ""]))
    agents, steps = choose.randint(1, 4), choose.randint(1, 6)
    rows = []
    for k in range(steps):
        for a in range(agents):
            fields = [table.columns[n](a, k) for n in names]
            fields = [choose.choice(HOSTILE) if wrong() else one for one in fields]
            fields = [f'"{one}"' if wrong() else one for one in fields]
            if wrong():
                fields.append(choose.choice(["", "1", "x"]))
            if wrong():
                fields.pop(choose.randrange(len(fields)))
            rows.append(",".join(fields))
    for _ in range(3):
        if wrong() and rows:
            rows.insert(choose.randrange(len(rows)), choose.choice([*rows, "", " ", ",", "\x0c"]))
        if wrong() and rows:
            del rows[choose.randrange(len(rows))]
    if wrong():
        choose.shuffle(rows)
    end = choose.choice(["\r\n", "\r", "\n\n"]) if wrong() else "\n"
    data = (end.join([",".join(header), *rows]) + ("" if wrong() else end)).encode()
    return _bytes_wrong(data, choose, wrong)


def _bytes_wrong(data: bytes, choose: random.Random, wrong: Callable[[], bool]) -> bytes:
    if wrong():
        data = b"\xef\xbb\xbf" + data
    if wrong() and data:
        data = data[: choose.randrange(len(data))]
    if wrong() and data:
        at = choose.randrange(len(data))
        data = data[:at] + bytes([choose.randrange(256)]) + data[at + 1 :]
    return data


def grow_fcd(choose: random.Random) -> bytes:
    """An FCD file, mostly well formed."""
    odds = choose.choice([0.0, 0.005, 0.02, 0.1])

    def wrong() -> bool:
        return choose.random() < odds

    def attribute(name: str, value: str) -> str:
        if wrong():
            value = choose.choice(HOSTILE)
        if wrong():
            name = choose.choice(["id", "x", "time", name.upper(), "n"])
        value = value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
        return "" if wrong() else f' {name}="{value}"'

    parts = ['<?xml version="1.0" encoding="UTF-8"?>' if choose.random() < 0.7 else ""]
    if wrong():
        parts.append(choose.choice(['<!DOCTYPE a [<!ENTITY b "c">]>', "<!-- x -->", "<?p q?>"]))
    parts.append("<fcd-export>")
    for k in range(choose.randint(1, 5)):
        step = f"<timestep{attribute('time', str(k * 0.5))}>"
        inside = [
            f"<{'person' if a == 3 else 'vehicle'}{attribute('id', f'v{a}')}"
            f"{attribute('x', str(5.5 * k + a))}{attribute('y', str(2 * a))}"
            f"{attribute('angle', '90')}{attribute('speed', '11')}{attribute('type', 'car')}/>"
            for a in range(choose.randint(0, 4))
        ]
        if wrong():
            odd = ["<param/>", "text", "<timestep/>", "</timestep>"]
            inside.append(choose.choice([*inside, *odd]))
        parts += [step, *inside, "" if wrong() else "</timestep>"]
    if wrong():
        parts.insert(choose.randrange(len(parts)), choose.choice(parts))
    parts.append("" if wrong() else "</fcd-export>")
    return _bytes_wrong("\n".join(parts).encode(), choose, wrong)


def grow_traf(choose: random.Random) -> bytes:
    """A TRAF file, mostly well formed; ids are used once in a frame."""
    odds = choose.choice([0.0, 0.005, 0.02, 0.1])

    def wrong() -> bool:
        return choose.random() < odds

    def whole(value: int) -> str:
        return choose.choice(HOSTILE) if wrong() else str(value)

    lines = []
    for k in range(choose.randint(1, 6)):
        agents = [a for a in range(4) if choose.random() < 0.8]
        fields = [whole(k), whole(len(agents))]
        for a in agents:
            fields += [whole(10 + 3 * k), whole(20 + a), whole(8), whole(5), whole(a)]
        if wrong():
            fields.pop()
        lines.append(choose.choice([",", ", "]).join(fields))
    if wrong():
        lines.insert(choose.randrange(len(lines)), choose.choice([*lines, "", " "]))
    return _bytes_wrong(("\n".join(lines) + "\n").encode(), choose, wrong)


def grow_argoverse2(choose: random.Random) -> bytes:
    """A scenario's Parquet file, its bytes altered mostly in headers."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    agents, steps = choose.randint(1, 3), choose.randint(1, 4)
    rows = [(a, k) for k in range(steps) for a in range(agents)]
    table = pa.table(
        {
            "track_id": [f"t{a}" for a, _ in rows], "object_type": ["vehicle"] * len(rows),
            "timestep": [k for _, k in rows], "position_x": [3.0 * k + a for a, k in rows],
            "position_y": [2.0 * a for a, _ in rows], "heading": [0.1] * len(rows),
            "velocity_x": [30.0] * len(rows), "velocity_y": [0.5] * len(rows),
        }
    )  # fmt: skip
    sink = io.BytesIO()
    pq.write_table(
        table, sink, compression=choose.choice(["none", "snappy", "zstd", "gzip"]),
        row_group_size=choose.choice([2, 100]), use_dictionary=choose.random() < 0.5,
        data_page_version=choose.choice(["1.0", "2.0"]), store_schema=choose.random() < 0.3,
        write_page_index=choose.random() < 0.3,
    )  # fmt: skip
    data = bytearray(sink.getvalue())
    begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    for _ in range(choose.choice([0, 1, 1, 2, 8])):
        low = begin if choose.random() < 0.7 else 0
        at = choose.randrange(low, len(data))
        how = choose.random()
        if how < 0.7:
            data[at] ^= choose.choice([1, 2, 4, 8, 16, 32, 64, 128, 255])
        elif how < 0.85:
            data.insert(at, choose.randrange(256))
        else:
            del data[at]
    return bytes(data)


# --- oracles: they share no code with the readers -----------------------------------------------


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
    lines = [line for line in re.split(r"\r\n|\n|\r", text.removeprefix("\ufeff"))]
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
        if any(abs(v) > LARGEST for n, v in values.items() if n not in ("timestamp", "heading")):
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
                raise Refused("twins")  # the reader gives the second a name of its own
            found[str(agent), last / 25.0] = (x + w / 2, 480 - (y + h / 2))
    if not found:
        raise Refused("no boxes")
    return found


CHILD: Final = """
import json, sys, pyarrow.parquet as pq
try:
    t = pq.read_table(sys.argv[1], partitioning=None, use_threads=False)
    t.validate(full=True)
    keep = ("track_id", "object_type", "timestep", "position_x", "position_y")
    print(json.dumps([t.column(c).to_pylist() for c in keep]))
except Exception as error:
    print("null")
"""


def read_argoverse2(data: bytes) -> Rows | None:
    """What pyarrow reads in a process of its own; None where it refuses or dies."""
    with tempfile.NamedTemporaryFile(suffix=".parquet") as file:
        file.write(data)
        file.flush()
        done = subprocess.run(
            [sys.executable, "-c", CHILD, file.name], capture_output=True, text=True, check=False
        )
    columns = json.loads(done.stdout or "null")
    if columns is None:
        return None
    kinds = ("vehicle", "bus", "motorcyclist", "cyclist", "pedestrian")
    rows = zip(*columns, strict=True)
    return {(t, k / 10.0): (x, y) for t, kind, k, x, y in rows if kind in kinds}


# --- comparing ----------------------------------------------------------------------------------


def ours(family: str, path: Path) -> Rows:
    """What graphrqi reads."""
    found: Rows = {}
    for recording in get_reader(family)(path):
        t = recording.tracks
        for row, column in zip(*np.nonzero(t.valid), strict=True):
            x, y = t.xy[row, column].tolist()
            if family == "sumo-fcd":  # back to the front of the vehicle
                x += 0.5 * t.length[row] * math.cos(t.heading[row, column])
                y += 0.5 * t.length[row] * math.sin(t.heading[row, column])
            found[t.names[row], float(t.time_s[column])] = (x, y)
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


FILES: Final = {
    **{name: table.file for name, table in TABLES.items()},
    "sumo-fcd": "a.xml", "traf": "a_gt.txt", "argoverse2": "scenario_s.parquet",
}  # fmt: skip


def grow(family: str, number: int) -> bytes:
    """The input of a family and number."""
    choose = random.Random(f"{family}:{number}")
    if family in TABLES:
        return grow_table(TABLES[family], choose)
    makers = {"sumo-fcd": grow_fcd, "traf": grow_traf, "argoverse2": grow_argoverse2}
    return makers[family](choose)


def oracle(family: str, data: bytes) -> Rows | None:
    """What the independent reader says; None where it refuses."""
    try:
        if family in TABLES:
            return read_table(TABLES[family], data)
        return {"sumo-fcd": read_fcd, "traf": read_traf, "argoverse2": read_argoverse2}[family](
            data
        )
    except Refused:
        return None


def check(family: str, number: int, folder: Path) -> tuple[str, str]:
    """Try one input.

    Returns:
        "read", "refused", "stricter" (Arrow reads a forged file that we refuse), "disagree" or
        "crash", and why.
    """
    data = grow(family, number)
    path = folder / FILES[family]
    path.write_bytes(data)
    try:
        mine: Rows | None = ours(family, path)
        why = ""
    except InputError as error:
        mine, why = None, str(error)
        if "\n" in why:
            return "disagree", f"a message of several lines: {why}"
    except Exception as error:
        return "crash", f"{type(error).__name__}: {error}"
    if family == "argoverse2" and number % 20:  # the child takes long: it looks at one in twenty
        return ("read" if why == "" else "refused"), why
    theirs = oracle(family, data)
    if mine is None:
        if theirs is None:
            return "refused", why
        return ("stricter" if family == "argoverse2" else "disagree"), f"refused: {why}"
    if theirs is None:
        if family == "traf" and any("-" in name[1:] for name, _ in mine):
            return "read", ""  # twins: the oracle has no names for them
        return "disagree", "read, the oracle refuses"
    difference = differ(mine, theirs)
    return ("read", "") if difference is None else ("disagree", difference)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="the first number")
    parser.add_argument("--family", choices=sorted(FILES))
    parser.add_argument("--only", metavar="FAMILY:NUMBER")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="graphrqi-fuzz-") as scratch:
        folder = Path(scratch)
        if options.only:
            family, _, number = options.only.partition(":")
            print(grow(family, int(number)))
            print(check(family, int(number), folder))
            return
        families = [options.family] if options.family else sorted(FILES)
        counts: dict[str, Counter[str]] = {family: Counter() for family in families}
        slowest = 0.0
        for i in range(options.inputs):
            family, number = families[i % len(families)], options.seed + i // len(families)
            began = time.perf_counter()
            state, why = check(family, number, folder)
            slowest = max(slowest, time.perf_counter() - began)
            counts[family][state] += 1
            if state in ("disagree", "crash"):
                print(f"{family}:{number}: {state}: {why:.300}", flush=True)
    for family, count in counts.items():
        print(family, dict(count))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{options.inputs} inputs, slowest {slowest:.2f} s, peak {peak:.2f} GB")


if __name__ == "__main__":
    main()
