"""Files of recordings grown from the grammars of their formats, with errors in all places.

At every production something may go wrong: a field is hostile, a separator doubled, a row repeated,
moved or cut. Nothing here is taken from the readers.
"""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

HOSTILE: Final = (
    "", " ", "-", "nan", "NaN", "inf", "-inf", "1e400", "-1e400", "1e-400", "0x10", "1_0", "1,5",
    "\uff11", "\u0661", "1e9", "1000000100", "-0", "0.0", "1e5", " 7", "7 ", "9" * 25, "a", "\x00",
    '"', '""', '"1"', "'", "1;2", "\t", "<", "&", "=1+1", "\u202e", "\x1b[2J", "None", "true", "5.",
    ".5", "1e", "--1", "1d3",
)  # fmt: skip
"""Fields that readers have misread somewhere."""


@dataclass(frozen=True)
class Table:
    """The grammar of a CSV format and how an oracle reads its rows.

    Attributes:
        file: name of the file.
        columns: every column and how a field of it is made, from agent and step.
        numbers: the columns that are read as numbers.
        words: the columns that are read as text.
        agent: the column with the agent.
        place: time and place of an agent, from a row's numbers by column.
        sizes: the columns with lengths of an agent, m.
        kinds: the words that may stand in a column, by the column.
        from_zero: whether times are counted from the first one.
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
    "highd": Table(
        "01_tracks.csv",
        {
            "frame": lambda a, k: str(k), "id": lambda a, k: str(a + 1), "x": _decimal,
            "y": lambda a, k: f"{2 * a + 5}", "width": lambda a, k: "4.5",
            "height": lambda a, k: "1.9", "xVelocity": lambda a, k: "25.5",
            "yVelocity": lambda a, k: "-0.25",
        },
        ("frame", "x", "y", "width", "height", "xvelocity", "yvelocity"), ("id",), "id",
        lambda v: (v["frame"] / 25.0, v["x"] + v["width"] / 2, -(v["y"] + v["height"] / 2)),
        ("width", "height"),
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


STEPS: Final = 12
"""Times of recordings that are whole."""


def grown(table: Table) -> bytes:
    """A CSV file without mistakes, of three agents."""
    rows = [
        ",".join(make(a, k) for make in table.columns.values())
        for k in range(STEPS) for a in range(3)
    ]  # fmt: skip
    return "\n".join([",".join(table.columns), *rows, ""]).encode()


def _mistakes(choose: random.Random) -> Callable[[], bool]:
    """Says at each production of one file whether something goes wrong there."""
    odds = choose.choice([0.0, 0.005, 0.02, 0.1])
    return lambda: choose.random() < odds


def grow_table(table: Table, choose: random.Random) -> bytes:
    """A CSV file, mostly well formed."""
    wrong = _mistakes(choose)

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
    wrong = _mistakes(choose)

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
    wrong = _mistakes(choose)

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


FILES: Final = {
    **{name: table.file for name, table in TABLES.items()},
    "sumo-fcd": "a.xml", "traf": "a_gt.txt", "argoverse2": "scenario_s.parquet",
}  # fmt: skip
"""The name of each family's file."""


def grow(family: str, number: int) -> bytes:
    """The input of a family and number: the same wherever it is made.

    Args:
        family: a key of ``FILES``.
        number: which.
    """
    choose = random.Random(f"{family}:{number}")
    if family in TABLES:
        return grow_table(TABLES[family], choose)
    makers = {"sumo-fcd": grow_fcd, "traf": grow_traf, "argoverse2": grow_argoverse2}
    return makers[family](choose)
