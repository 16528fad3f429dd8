"""What independent readers find in recordings that are altered samples.

Formats with a grammar are read by its oracle; of the others the oracle tells who is seen when, or
how often, from the file's own lines, elements or records.
"""

from __future__ import annotations

import csv
import io
import math
import pickle
import re
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from experiments.benches.hostile.grammars import TABLES
from experiments.benches.hostile.oracles import grown
from experiments.benches.hostile.oracles.altered import content, well_formed, whole
from experiments.benches.hostile.oracles.grown import Refused, Rows, finite

SAME: Final = {"round": "ind"}
"""Formats with the grammar of another."""

Seen = Counter[tuple[str, float]]
"""How often who is seen when, or with which speed."""


def rows_told(key: str, path: Path) -> Any:
    """What a recording's file tells.

    Args:
        key: of its format.
        path: the file.
    """
    name = SAME.get(key, key)
    if name in TABLES:
        return grown.read_table(TABLES[name], content(path))
    if name == "argoverse2":
        found = grown.read_argoverse2(path)
        if found is None:
            raise Refused("pyarrow refuses")
        return found
    if name == "argoverse2-log":
        return grown.read_sensor_log(path)
    if name in ("sumo-fcd", "traf"):
        return {"sumo-fcd": grown.read_fcd, "traf": grown.read_traf}[name](content(path))
    return SEEN[name](path)


def other_rows(key: str, recordings: list[Any], theirs: Any) -> str | None:
    """What was read of a recording other than its file tells."""
    name = SAME.get(key, key)
    if name in SEEN:
        mine = MINE[name](recordings)
        if name == "commonroad":
            return None if not theirs - mine else f"lost {theirs - mine}"
        return None if mine == theirs else f"{mine - theirs} instead of {theirs - mine}"
    rows = rows_of(key, recordings)
    if name == "interaction":  # a second file has those who walk
        told = {agent for agent, _ in theirs}
        rows = {one: xy for one, xy in rows.items() if one[0] in told}
    return grown.differ(rows, theirs)


def rows_of(key: str, recordings: Iterable[Any]) -> Rows:
    """Place of each agent at each time, as graphrqi reads a recording.

    Args:
        key: of its format.
        recordings: what was read.
    """
    found: Rows = {}
    for recording in recordings:
        tracks = recording.tracks
        seen = tracks.as_rows()
        for row in range(seen.speed.size):
            agent, step = seen.index.agent[row], seen.index.step[row]
            x, y = seen.xy[row].tolist()
            if key == "sumo-fcd":  # back to the front of the vehicle
                x += 0.5 * tracks.length[agent] * math.cos(seen.heading[row])
                y += 0.5 * tracks.length[agent] * math.sin(seen.heading[row])
            found[tracks.names[agent], float(tracks.time_s[step])] = (x, y)
    return found


def _when(recordings: Iterable[Any]) -> Seen:
    """Who is seen when."""
    return Counter(
        (one.tracks.names[agent], round(float(one.tracks.time_s[step]), 3))
        for one in recordings for rows in [one.tracks.as_rows()]
        for agent, step in zip(rows.index.agent, rows.index.step, strict=True)
    )  # fmt: skip


def _speeds(recordings: Iterable[Any]) -> Seen:
    """How often each speed is driven."""
    return Counter(
        ("", round(float(speed), 4))
        for one in recordings for speed in one.tracks.as_rows().speed
    )  # fmt: skip


def _rows(recordings: Iterable[Any]) -> Seen:
    """How many rows there are."""
    return Counter({("", 0.0): sum(one.tracks.as_rows().speed.size for one in recordings)})


# --- one reader per format ----------------------------------------------------------------------


csv.field_size_limit(2**31 - 1)


def _table(path: Path, header: list[str] | None = None) -> list[dict[str, str]]:
    try:
        text = content(path).decode("utf-8-sig", "surrogateescape")
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except csv.Error as error:
        raise Refused(str(error)) from None
    if not rows:
        raise Refused("nothing")
    names = header or [name.strip().lower() for name in rows.pop(0)]
    if any(len(row) != len(names) for row in rows):
        raise Refused("fields")
    return [dict(zip(names, row, strict=True)) for row in rows]


def _ngsim(path: Path) -> Seen:
    """Speeds in m/s, from feet."""
    if path.suffix == ".txt":
        lines = [line.split() for line in content(path).split(b"\n")]
        speeds = [line[11].decode("latin-1") for line in lines if len(line) > 11]
    else:
        speeds = [row.get("v_vel", "") for row in _table(path)]
    return Counter(("", round(finite(one) * 0.3048, 4)) for one in speeds)


def _argo(path: Path) -> Seen:
    return Counter((row["id"], round(finite(row["frame"]) / 10.0, 3)) for row in _table(path))


def _pairs(path: Path) -> Seen:
    """A row of the follower and one of the leader for each line."""
    lines = _table(path)
    for line in lines:
        for name in ("t", "x_follower", "v_follower", "x_leader", "v_leader"):
            finite(line.get(name, ""))
    return Counter({("", 0.0): 2 * len(lines)})


def _kitti(path: Path) -> Seen:
    """Who is labelled in which frame; the recording car is in every frame of its poses."""
    found: Seen = Counter()
    for line in content(path).split(b"\n"):
        fields = line.split()
        if fields and fields[2] not in (b"DontCare", b"Misc"):
            for one in fields[13:17]:
                finite(one.decode("latin-1"))
            found[fields[1].decode(), round(0.1 * whole(fields[0].decode("latin-1")), 3)] += 1
    poses = content(path.parent.parent / "oxts" / path.name).split(b"\n")
    for frame in range(sum(bool(line.split()) for line in poses)):
        found["ego", round(0.1 * frame, 3)] += 1
    return found


def _commonroad(path: Path) -> Seen:
    """The states of trucks that move; others stand at every time."""
    root = well_formed(path)
    found: Seen = Counter()
    unit = finite(root.get("timeStepSize", ""))
    for kind in ("dynamicObstacle", "obstacle"):
        for obstacle in root.iterfind(kind):
            if (obstacle.findtext("type") or "").strip() != "truck":
                continue  # others may be of kinds that are left out, and said to be
            name = str(whole(obstacle.get("id", "")))
            for state in obstacle.iter():
                if state.tag in ("initialState", "state"):
                    at = state.findtext("time/exact")
                    found[name, round(unit * finite((at or "").strip()), 3)] += 1
    return found


def _womd(path: Path) -> Seen:
    """How many records there are; each has the checksums that it tells."""
    import google_crc32c

    data, at, records = content(path), 0, 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 8], "little")
        parts = (data[at : at + 8], data[at + 12 : at + 12 + size])
        told = (data[at + 8 : at + 12], data[at + 12 + size : at + 16 + size])
        for part, crc in zip(parts, told, strict=True):
            plain = google_crc32c.value(part)
            masked = ((plain >> 15 | plain << 17 & 0xFFFFFFFF) + 0xA282EAD8) & 0xFFFFFFFF
            if len(crc) != 4 or int.from_bytes(crc, "little") != masked:
                raise Refused("checksum")
        at, records = at + 16 + size, records + 1
    return Counter({("", 0.0): records})


def _names(recordings: Iterable[Any]) -> Seen:
    """How many scenarios there are; one may be read as several recordings."""
    return Counter({("", 0.0): len({re.sub(r"-part\d+$", "", one.name) for one in recordings})})


class _Anything:
    """What stands for objects that are not plain data; it takes every call."""

    def __new__(cls, *given: Any, **named: Any) -> _Anything:
        return super().__new__(cls)

    def __setstate__(self, state: Any) -> None:
        pass


PLAIN: Final = ("_reconstruct", "scalar", "_frombuffer", "ndarray", "dtype")
"""Names of numpy without which its arrays and numbers are not built."""


class _Unpickler(pickle._Unpickler):
    """Python's own machine, to which no other name is told.

    That in Python: that in C takes memory for all numbers up to the greatest that is remembered.
    """

    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] == "numpy" and name in PLAIN:
            return super().find_class(module, name)
        return _Anything

    def _build(self: Any) -> None:
        """Numpy itself breaks where a type's flags are not those of its kind."""
        built, state = self.stack[-2:]
        if isinstance(built, np.dtype) and state[7] != built.flags:
            raise Refused("a type of numpy's with forged flags")
        pickle._Unpickler.dispatch[pickle.BUILD[0]](self)

    def _bytearray(self: Any) -> None:
        """Python takes memory for as many bytes as are told, be they there or not."""
        size = int.from_bytes(self.read(8), "little")
        found = bytearray(self.read(size))
        if len(found) != size:
            raise Refused("cut off")
        self.append(found)

    dispatch: ClassVar[dict[int, Any]] = {
        **pickle._Unpickler.dispatch,
        pickle.BUILD[0]: _build,
        pickle.BYTEARRAY8[0]: _bytearray,
    }


def _scenarionet(path: Path) -> Seen:
    """How many rows there are: steps at which a road-agent is valid."""
    try:
        found = _Unpickler(io.BytesIO(content(path))).load()
        rows = 0
        for track in found["tracks"].values():
            if track["type"] in ("VEHICLE", "PEDESTRIAN", "CYCLIST"):
                rows += int(np.count_nonzero(track["state"]["valid"]))
    except Refused:
        raise
    except Exception as error:  # a machine that runs anything fails in any way
        raise Refused(type(error).__name__) from None
    return Counter({("", 0.0): rows})


SEEN: Final[dict[str, Callable[[Path], Seen]]] = {
    "ngsim": _ngsim, "argo": _argo, "pairs": _pairs, "kitti": _kitti, "commonroad": _commonroad,
    "womd": _womd, "scenarionet": _scenarionet,
}  # fmt: skip
"""What a format's file tells."""

MINE: Final[dict[str, Callable[[Iterable[Any]], Seen]]] = {
    "ngsim": _speeds, "argo": _when, "pairs": _rows, "kitti": _when, "commonroad": _when,
    "womd": _names, "scenarionet": _rows,
}  # fmt: skip
"""The same of what was read."""
