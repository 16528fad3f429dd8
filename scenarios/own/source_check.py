"""What OpenStreetMap and OpenDRIVE files lack and have wrong, as netconvert gets them."""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from scenarios.own.check import LIMITS_MPS, Defect
from sim.road import MapKnowledge
from sim.xml_tree import read_tree

MAY_BE_SLOW: Final = frozenset({"living_street", "service", "track", "pedestrian", "footway"})
"""OpenStreetMap's ways on which people walk or drive at walking pace."""

NO_ROADS: Final = frozenset(
    {"footway", "path", "cycleway", "steps", "pedestrian", "bridleway", "corridor", "proposed",
     "construction", "platform", "elevator", "track"}
)  # fmt: skip
"""OpenStreetMap's kinds of ways that cars do not use."""

WORDS: Final = frozenset({"none", "signals", "variable", "walk", "default"})
"""Words that OpenStreetMap allows as a limit."""

_UNITS_MPS: Final = {"km/h": 1 / 3.6, "mph": 0.44704, "m/s": 1.0, "knots": 0.514444}


def openstreetmap(path: Path) -> tuple[MapKnowledge, list[Defect]]:
    """What an OpenStreetMap file tells, and what is wrong in it.

    Raises:
        InputError: if it is no XML.
    """
    root = read_tree(path)
    nodes = {str(node.get("id")): node for node in root.iter("node")}
    limits = signals = priority = ways = 0
    found: list[Defect] = []
    twice = Counter(str(node.get("id")) for node in root.iter("node"))
    found += [Defect("node twice", f"node {name}", f"found {count} of that id, expected one")
              for name, count in twice.items() if count > 1]  # fmt: skip
    for node in nodes.values():
        found += _of_place(node)
        kind = _tags(node).get("highway")
        signals += kind == "traffic_signals"
        priority += kind in ("stop", "give_way")
    for way in root.iter("way"):
        tags = _tags(way)
        if "highway" not in tags or tags["highway"] in NO_ROADS:
            continue
        ways += 1
        place = f"way {str(way.get('id'))[:40]}"
        limits += "maxspeed" in tags
        if "maxspeed" in tags:
            found += _of_limit(place, tags["maxspeed"], tags["highway"] in MAY_BE_SLOW)
        found += _of_line(place, way, nodes)
        lanes = tags.get("lanes")
        if lanes is not None and not (re.fullmatch("[0-9]{1,4}", lanes) and 1 <= int(lanes) <= 20):
            found.append(Defect("absurd lanes", place, f"found {lanes[:40]!r}, expected 1 to 20"))
    knows = MapKnowledge(
        limits=ways > 0 and limits == ways, signals=signals > 0, priority=priority > 0
    )
    return knows, found


def _tags(element: ET.Element) -> dict[str, str]:
    return {str(tag.get("k")): str(tag.get("v")) for tag in element.iter("tag")}


def _of_place(node: ET.Element) -> Iterator[Defect]:
    place = f"node {str(node.get('id'))[:40]}"
    for name, most in (("lat", 90.0), ("lon", 180.0)):
        value = _real(node.get(name))
        if not abs(value) <= most:
            shown = str(node.get(name))[:40]
            yield Defect("absurd place", place, f"found {name} {shown}, expected degrees")


def _of_limit(place: str, text: str, slow: bool) -> Iterator[Defect]:
    for part in text.split(";"):
        word = part.strip()
        if word in WORDS or ":" in word:
            continue
        number, _, unit = word.partition(" ")
        value = _real(number) * _UNITS_MPS.get(unit.strip() or "km/h", math.nan)
        if not (0.5 if slow else LIMITS_MPS[0]) <= value <= LIMITS_MPS[1]:
            yield Defect("absurd limit", place, f"found maxspeed {text[:40]!r}, expected 4 to 250")
            return


def _of_line(place: str, way: ET.Element, nodes: dict[str, ET.Element]) -> Iterator[Defect]:
    names = [str(ref.get("ref")) for ref in way.iter("nd")]
    if len(names) < 2:
        yield Defect("short way", place, f"found {len(names)} points, expected 2 or more")
    missing = [name for name in names if name not in nodes]
    if missing:
        yield Defect("missing node", place, f"found no node {missing[0][:40]}")
    points = [(nodes[n].get("lat"), nodes[n].get("lon")) for n in names if n in nodes]
    same = sum(one == then for one, then in itertools.pairwise(points))
    if same:
        yield Defect("coinciding points", place, f"found {same} of {len(points)}, expected none")


def opendrive(path: Path) -> tuple[MapKnowledge, list[Defect]]:
    """What an OpenDRIVE file tells, and what is wrong in it.

    Raises:
        InputError: if it is no XML.
    """
    root = read_tree(path)
    for element in root.iter():  # later versions have a namespace
        element.tag = element.tag.rpartition("}")[2]
    roads = list(root.iter("road"))
    names = Counter(str(road.get("id")) for road in roads)
    junctions = {str(junction.get("id")) for junction in root.iter("junction")}
    found = [Defect("road twice", f"road {name[:40]}", f"found {count}, expected one")
             for name, count in names.items() if count > 1]  # fmt: skip
    limited = 0
    for road in roads:
        place = f"road {str(road.get('id'))[:40]}"
        inside = road.get("junction", "-1") != "-1"
        speeds = list(road.iter("speed"))
        limited += bool(speeds) or inside
        found += _of_road(place, road)
        for speed in speeds:
            found += _of_speed(place, speed)
        for way in (*road.findall("link/predecessor"), *road.findall("link/successor")):
            target, kind = str(way.get("elementId")), way.get("elementType", "road")
            if target not in (junctions if kind == "junction" else names):
                found.append(Defect("missing road", place, f"found no {kind} {target[:40]}"))
    signals = any(True for _ in root.iter("signal"))
    priority = any(True for _ in root.iter("priority"))
    knows = MapKnowledge(
        limits=bool(roads) and limited == len(roads), signals=signals, priority=priority
    )
    return knows, found


def _of_road(place: str, road: ET.Element) -> Iterator[Defect]:
    length = _real(road.get("length"))
    if not 0 < length < 1e6:
        yield Defect("absurd length", place, f"found {str(road.get('length'))[:40]} m")
    pieces = list(road.iter("geometry"))
    if not pieces:
        yield Defect("missing line", place, "found no geometry, expected at least one")
    short = sum(not _real(piece.get("length")) > 0 for piece in pieces)
    if short:
        yield Defect("coinciding points", place, f"found {short} pieces without length")
    lanes = [lane for lane in road.iter("lane") if lane.get("type") == "driving"]
    for lane in lanes:
        widths = [_real(width.get("a")) for width in lane.iter("width")]
        if (
            widths
            and not any(0 < width <= 12.0 for width in widths)
            and (all(_real(width.get("b")) == 0 for width in lane.iter("width")))
        ):
            where = f"{place} lane {str(lane.get('id'))[:10]}"
            yield Defect("absurd width", where, f"found {widths[0]:g} m, expected up to 12")


def _of_speed(place: str, speed: ET.Element) -> Iterator[Defect]:
    text, unit = str(speed.get("max")), speed.get("unit", "m/s")
    if text in ("no limit", "undefined"):
        return
    value = _real(text) * _UNITS_MPS.get(unit, math.nan)
    if not LIMITS_MPS[0] <= value <= LIMITS_MPS[1]:
        yield Defect("absurd limit", place, f"found {text[:40]} {unit[:10]}, expected 1 to 70 m/s")


def _real(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
