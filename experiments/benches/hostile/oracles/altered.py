"""What independent readers make of files that are altered samples: plain, slow, one per family.

Each reads with Python's own modules (`ElementTree`, `json`, `tomllib`, `csv`, `zipfile`), or with
openpyxl or pyarrow in a child, what a file says, and refuses what is no file of its kind. Limits
and references are checked by our readers alone, so a reader may refuse what its oracle reads.
"""

from __future__ import annotations

import csv
import gzip
import importlib
import io
import json
import math
import struct
import tomllib
import xml.etree.ElementTree as ET
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from experiments.benches.hostile.oracles.grown import Refused, Unsure, arrow_columns, finite
from experiments.benches.hostile.sample import EPISODE

Lanes = dict[str, tuple[float, ...] | None]
"""First and last point and speed limit of each lane, by its id; None where only the id is told."""

NEAR: Final = 1e-6


def content(path: Path) -> bytes:
    """A file's bytes, unpacked."""
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if path.suffix == ".gz" else data
    except (OSError, EOFError, zlib.error) as error:
        raise Refused(str(error)) from None


def well_formed(path: Path) -> ET.Element:
    """The root of an XML file; names without their namespaces."""
    try:
        root = ET.fromstring(content(path))
    except (ET.ParseError, ValueError, LookupError) as error:
        raise Refused(str(error)) from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def document(path: Path) -> Any:
    """What a JSON file says."""
    try:
        return json.loads(content(path))
    except (ValueError, RecursionError) as error:
        raise Refused(str(error)) from None


def settings(path: Path) -> dict[str, Any]:
    """What a TOML file says."""
    try:
        return tomllib.loads(content(path).decode())
    except (ValueError, RecursionError) as error:
        raise Refused(str(error)) from None


def study(path: Path) -> dict[str, Any]:
    """What a study says; a scenario with a dot or a slash is a file's path from its folder."""
    told = settings(path)
    if isinstance(named := told.get("scenarios"), list):
        told["scenarios"] = [_placed(one, path.parent) for one in named]
    if isinstance(routes := told.get("routes"), str):
        told["routes"] = str(path.parent / routes)
    return told


def _placed(name: Any, folder: Path) -> Any:
    return str(folder / name) if isinstance(name, str) and set(name) & set("./\\") else name


# --- maps ---------------------------------------------------------------------------------------


def _attribute(element: ET.Element, name: str) -> float:
    return finite(element.get(name, ""))


def net_lanes(path: Path) -> Lanes:
    """The lanes of a SUMO net.

    sumolib parses with lxml, whose XML allows some names of attributes that Python's forbids.
    """
    root: Any
    try:
        root = well_formed(path)
    except Refused:
        try:
            etree = importlib.import_module("lxml.etree")
            root = etree.fromstring(content(path), etree.XMLParser(resolve_entities=False))
        except (ImportError, SyntaxError, ValueError) as error:
            raise Refused(str(error)) from None
    found: Lanes = {}
    lanes = (
        lane for edge in root.iter("edge") if edge.get("function", "") in ("", "internal")
        for lane in edge.iterfind("lane")
    )  # fmt: skip
    for lane in lanes:  # those of crossings and walking areas are none
        points = [one.split(",") for one in lane.get("shape", "").split()]
        if len(points) > 1:
            ends = [finite(one) for point in (points[0], points[-1]) for one in point[:2]]
            found.setdefault(lane.get("id", ""), (*ends, _attribute(lane, "speed")))
    return found


def _tags(element: ET.Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def lanelet_lanes(path: Path) -> Lanes:
    """The lanelets of a Lanelet2 map in local metres."""
    root = well_formed(path)
    places = [_tags(node) for node in root.iterfind("node")]
    if places and {"local_x", "local_y"} <= places[0].keys():  # the first says what all have
        for tags in places:
            finite(tags.get("local_x", "")), finite(tags.get("local_y", ""))
    lanelets = (e for e in root.iterfind("relation") if _tags(e).get("type") == "lanelet")
    return {str(whole(one.get("id", ""))): None for one in lanelets}


def whole(text: str) -> int:
    """A whole number as XML writes it."""
    stripped = text.strip(" \t\r\n\f\v")
    digits = stripped[1:] if stripped[:1] in ("-", "+") else stripped
    if not (digits.isascii() and digits.isdigit()):
        raise Refused(f"no whole number: {text!r}")
    return int(stripped[:30])


def commonroad_lanes(path: Path) -> Lanes:
    """The lanelets of a CommonRoad scenario."""
    found: Lanes = {}
    for lane in well_formed(path).iterfind("lanelet"):
        for side in ("leftBound", "rightBound"):
            for point in lane.iterfind(f"{side}/point"):
                for axis in ("x", "y"):
                    finite((point.findtext(axis) or "").strip())
        found[str(whole(lane.get("id", "")))] = None
    return found


def argoverse2_lanes(path: Path) -> Lanes:
    """The lane segments of an Argoverse 2 map."""
    told = document(path)
    if not isinstance(told, dict) or not isinstance(told.get("lane_segments"), dict):
        raise Refused("no lane segments")
    found: Lanes = {}
    for lane in told["lane_segments"].values():
        for side in ("left", "right"):
            for point in lane[f"{side}_lane_boundary"]:
                _plain(point["x"]), _plain(point["y"])
        found[str(int(_plain(lane["id"])))] = None
    return found


def _plain(value: Any) -> float:
    """A number of a JSON file, which is no text."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused(f"no number: {value!r:.40}")
    return float(value)


def stored_lanes(path: Path) -> Lanes:
    """The lanes of a road that a dataset keeps."""
    told = document(path)
    if not isinstance(told, dict) or not isinstance(told.get("lanes"), list):
        raise Refused("no lanes")
    found: Lanes = {}
    for lane in told["lanes"]:
        line, speed = lane["centerline"], lane["speed_limit_mps"]
        ends = [*line[0], *line[-1], math.nan if speed is None else speed]
        found[lane["id"]] = tuple(_plain(one) for one in ends)
    return found


def other_lanes(road: Any, theirs: Lanes) -> str | None:
    """What lanes a road has that its file does not tell so."""
    for lane in road.lanes:
        if lane.id not in theirs:
            return f"lane {lane.id!r:.60}, which the file does not have"
        told = theirs[lane.id]
        if told is None:
            continue
        mine = (*lane.centerline[0], *lane.centerline[-1], lane.speed_limit_mps)
        for one, other in zip(mine, told, strict=True):
            if not (abs(one - other) <= NEAR * max(1.0, abs(other)) or one != one != other):
                return f"lane {lane.id!r:.60}: {mine}, the file has {told}"
    return None


def _other_twice(defects: Any, root: ET.Element, kind: str) -> str | None:
    """Whether the survey counts other elements of a kind whose ids are there twice."""
    names = Counter(str(element.get("id")) for element in root.iter(kind))
    twice = sum(count > 1 for count in names.values())
    if sum(one.kind == f"{kind} twice" for one in defects) != twice:
        return f"{twice} {kind}s are there twice"
    return None


def other_opendrive(read: Any, root: ET.Element) -> str | None:
    """What a survey of an OpenDRIVE file says that the file does not."""
    knows, defects = read
    if said := _other_twice(defects, root, "road"):
        return said
    if knows.signals != any(True for _ in root.iter("signal")):
        return "signals"
    return None


def other_openstreetmap(read: Any, root: ET.Element) -> str | None:
    """What a survey of an OpenStreetMap file says that the file does not."""
    knows, defects = read
    if said := _other_twice(defects, root, "node"):
        return said
    lights = any(_tags(node).get("highway") == "traffic_signals" for node in root.iter("node"))
    return "signals" if knows.signals and not lights else None


def other_routes(flows: Any, root: ET.Element) -> str | None:
    """Whether a route file's rates add to other than the flows'."""
    total, times = 0.0, list[float]()
    for element in root:
        if element.tag in ("vehicle", "trip"):
            times.append(_seconds(element.get("depart", "0")))
        if element.tag == "flow":
            total += _per_hour(element)
    if times:
        total += len(times) * 3600.0 / max(60.0, max(times) - min(times))
    mine = sum(flow.per_hour for flow in flows)
    close = math.isclose(mine, total, rel_tol=1e-6)
    return None if close else f"{mine} vehicles an hour, the file has {total}"


def _seconds(text: str) -> float:
    if text == "triggered":
        return 0.0
    parts = [finite(part) for part in text.split(":")]
    return sum(part * 60.0**k for k, part in enumerate(reversed(parts)))


def _per_hour(flow: ET.Element) -> float:
    given = {key: value for key, value in flow.attrib.items() if value or key != "period"}
    for name in ("vehsPerHour", "perHour"):
        if name in given:
            return _seconds(given[name])
    if "period" in given:
        period = given["period"]
        if period.startswith("exp("):
            return 3600.0 * _seconds(period[4:-1])
        return 3600.0 / _seconds(period)
    if "probability" in given:
        return 3600.0 * _seconds(given["probability"])
    begin, end = _seconds(given.get("begin", "0")), _seconds(given.get("end", "3600"))
    return 3600.0 * _seconds(given.get("number", "0")) / max(60.0, end - begin)


# --- documents ----------------------------------------------------------------------------------


def other_settings(read: Any, theirs: dict[str, Any]) -> str | None:
    """Which field of a configuration is not what its file says."""
    mine = read.model_dump()
    for name, value in theirs.items():
        if name in ("cluster", "net"):
            continue
        if name not in mine:
            return f"{name}, which is no field"
        if not _same(mine[name], value):
            return f"{name}: {mine[name]!r:.80}, the file has {value!r:.80}"
    return None


def other_population(read: Any, theirs: dict[str, Any]) -> str | None:
    """Which number of a population is not in its file; six digits of each are kept."""
    told = {float(f"{number:.6g}") for number in map(float, _numbers(theirs))}
    for name in ("median", "log_spread"):
        for mine in getattr(read, name).ravel().tolist():
            if mine not in told:
                return f"{name}: {mine}, which the file does not have"
    return None


def _numbers(part: Any) -> list[float]:
    if isinstance(part, dict | list):
        inner = part.values() if isinstance(part, dict) else part
        return [number for one in inner for number in _numbers(one)]
    return [part] if isinstance(part, int | float) and not isinstance(part, bool) else []


def _same(one: Any, other: Any) -> bool:
    """Whether two values are one; tuples are lists, and whole numbers may be real."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return all(key in one and _same(one[key], value) for key, value in other.items())
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, int) and not isinstance(other, bool):
        return one == float(other)
    return bool(one == other)


def other_rows(source: Any, theirs: Any) -> str | None:
    """Which rows of a file were read as others."""
    if not isinstance(theirs, list):
        return "read, the file has no list"
    mine = Counter(_line(row) for rows in source.rows.values() for row in rows)
    told = Counter(_line(row) for row in theirs if row.get("value") is not None)
    return None if mine == told else f"{mine - told} instead of {told - mine}"


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps({key: row[key] for key in sorted(row)})


def run_files(folder: Path) -> Any:
    """What the files of a run say; without ``run.json`` only those of rows count."""
    whole_run = (folder / "run.json").is_file()
    names = sorted(path.name for path in folder.glob("*.json"))
    return {name: document(folder / name) for name in names if whole_run or name == "loop.json"}


def other_run(source: Any, theirs: Any) -> str | None:
    """What a run's folder was read as other than its files say."""
    if source.run is None:
        return "no run" if "run.json" in theirs else None
    run = theirs["run.json"]
    for name in ("name", "seed", "dataset", "model", "protocol", "configuration", "confusion"):
        if not _same(getattr(source.run, name), run[name]):
            return f"{name}: {getattr(source.run, name)!r:.80}, the file has {run[name]!r:.80}"
    rows = [row for name in theirs if name not in ("run.json", "metrics.json")
            for row in theirs[name] if row.get("value") is not None]  # fmt: skip
    mine = [row for some in source.rows.values() for row in some]
    lost = Counter(map(_line, rows)) - Counter(map(_line, mine))
    if lost:
        return f"lost: {lost}"
    told = sorted(_values(theirs["metrics.json"]))
    extra = Counter(row["value"] for row in mine) - Counter(row["value"] for row in rows)
    return None if Counter(told) >= extra else f"{extra}, the file has {told}"


def _values(part: Any) -> list[float]:
    if not isinstance(part, dict):
        return []
    if isinstance(part.get("value"), int | float):
        return [float(part["value"])]
    return [value for inner in part.values() for value in _values(inner)]


def tensors(path: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the tensors in a safetensors file."""
    data = content(path)
    try:
        (size,) = struct.unpack("<Q", data[:8])
        header = json.loads(data[8 : 8 + size])
        header.pop("__metadata__", None)
        if any(one["data_offsets"][1] > len(data) - 8 - size for one in header.values()):
            raise Refused("cut")
        return {name: tuple(one["shape"]) for name, one in header.items()}
    except (struct.error, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise Refused(str(error)) from None


def other_model(model: Any, theirs: dict[str, tuple[int, ...]]) -> str | None:
    """Which arrays of a classifier are not those in its file."""
    mine = {name: array.shape for name, array in model.classifier.arrays().items()}
    return None if mine == theirs else f"{mine}, the file has {theirs}"


def other_network(network: Any, theirs: dict[str, tuple[int, ...]]) -> str | None:
    """Which layers of a network are not those in its file."""
    mine = {f"weight_{i}": w.shape for i, w in enumerate(network.weights)}
    told = {name: shape for name, shape in theirs.items() if name.startswith("weight_")}
    return None if mine == told else f"{mine}, the file has {told}"


def sheet_rows(path: Path) -> list[list[str]]:
    """The rows of a workbook's first sheet that have any text."""
    from openpyxl import load_workbook

    try:
        book = load_workbook(io.BytesIO(content(path)), data_only=True)
        rows = [["" if v is None else str(v).strip() for v in row]
                for row in book.worksheets[0].iter_rows(values_only=True)]  # fmt: skip
    except Exception as error:  # openpyxl refuses by errors of many kinds
        raise Refused(str(error)) from None
    return [row for row in rows if any(row)]


def other_sheet(sheet: Any, rows: list[list[str]]) -> str | None:
    """Which agents of a sheet were read otherwise."""
    told = {int(float(row[0])): row for row in rows}
    if told.keys() != {*sheet.traits, *sheet.blank}:
        return f"agents {sorted((*sheet.traits, *sheet.blank))}, the sheet has {sorted(told)}"
    for agent, traits in sheet.traits.items():
        if int(float(told[agent][3])) != len(traits):
            return f"agent {agent}: {len(traits)} traits, the sheet has {told[agent][3]}"
    return None


def csv_rows(path: Path) -> list[list[str]]:
    """The rows of a CSV file that have any cell."""
    try:
        text = content(path).decode("utf-8-sig")
        return [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise Refused(str(error)) from None


def other_count(read: Any, rows: Sequence[Any]) -> str | None:
    """Whether a table has other than one entry for each row below the header."""
    return None if len(read) == len(rows) - 1 else f"{len(read)}, the file has {len(rows) - 1} rows"


# --- Parquet ------------------------------------------------------------------------------------


BEHAVIORS: Final = ("impatient", "reckless", "threatening", "careful", "cautious", "timid")


def arrow(path: Path, columns: Sequence[str]) -> dict[str, list[Any]]:
    """Columns of a Parquet file, read by pyarrow in a child."""
    found = arrow_columns(path, columns)
    if found is None or found.keys() != set(columns):
        raise Refused("pyarrow refuses")
    return found


def told_beliefs(path: Path) -> list[list[float]]:
    """Agent and probabilities in every row of a labels file that speaks of the episode."""
    names = ("episode", "agent", "time_s", *(f"p_{one}" for one in BEHAVIORS))
    rows = zip(*arrow(path, names).values(), strict=True)
    return [[finite(str(one)) for one in row] for episode, *row in rows if episode == EPISODE]


def other_beliefs(beliefs: Any, theirs: list[list[float]]) -> str | None:
    """Which of an episode's beliefs are in no row of the file."""
    for row, agent in enumerate(beliefs.ids.tolist()):
        told = [p for who, _, *p in theirs if who == agent]
        for mine in beliefs.probability[row]:
            known = bool((mine == mine).all())
            if known and not any(abs(mine - p).max() < 1e-5 for p in told):
                return f"agent {agent}: {mine}, the file has {told}"
    return None


def told_places(path: Path) -> Counter[tuple[float, float]]:
    """The places in every row of a predictions file that speaks of the episode."""
    names = ("episode", "predictor", "agent", "time_s", "mode", "probability", "ahead_s")
    rows = zip(*arrow(path, (*names, "x_m", "y_m")).values(), strict=True)
    return Counter(
        (finite(str(x)), finite(str(y))) for episode, *_, x, y in rows if episode == EPISODE
    )


def other_forecasts(read: Any, theirs: Counter[tuple[float, float]]) -> str | None:
    """Which predicted places are in no row of the file."""
    mine = Counter((x, y) for one in read[1] for path in one.xy.tolist() for x, y in path)
    return None if not mine - theirs else f"{mine - theirs}, which the file does not have"


def dataset_rows(folder: Path) -> int:
    """Rows of a dataset's steps; its catalogue is believed about which episodes there are."""
    if len(arrow(folder / "episodes.parquet", ["id"])["id"]) != 1:
        raise Unsure("episodes that are twice in the catalogue, or not at all")
    tables = sorted(folder.glob("steps/*/*/*.parquet"))
    return sum(len(arrow(path, ["x_m"])["x_m"]) for path in tables)


def other_dataset(rows: int, theirs: int) -> str | None:
    """Whether a dataset's episodes have other than the rows of its steps."""
    return None if rows == theirs else f"{rows} rows, the files have {theirs}"
