"""OpenStreetMap and OpenDRIVE files as netconvert understands them: limits and the side of traffic.

netconvert reads one plain number as a limit. Maps have lists, zones, limits implied by a country,
units, and (OpenDRIVE) limits of whole roads. They are written out here as numbers; where a road has
none, netconvert assumes one by the road's kind, and a warning says so.

References:
    OpenStreetMap wiki, Key:maxspeed. ASAM OpenDRIVE 1.7, sections 8.3 and 9.5 (speed), 8 (rule).
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from sim.input_files import broken_as_one_line
from sim.units import in_si

FREE_MPS: Final = 130 / 3.6
"""Speed on a road without a limit, m/s (the speed recommended in Germany)."""

WALK_MPS: Final = 7 / 3.6
"""Walking speed, m/s, as courts have it."""

UNITS: Final = {
    "": "km/h", "km/h": "km/h", "kmh": "km/h", "kph": "km/h", "kmph": "km/h", "mph": "mph",
    "mi/h": "mph", "m/s": "", "mps": "", "knots": "knots",
}  # fmt: skip
"""Units of limits as they are written, as `sim.units.in_si` takes them."""

IMPLIED_KMH: Final = {
    "urban": 50, "rural": 90, "trunk": 100, "motorway": 130, "expressway": 100,
    "living_street": 10, "bicycle_road": 30, "school": 30, "zone": 30,
}  # fmt: skip
"""Limits of kinds of places where a country says no other, km/h."""

OF_COUNTRY_KMH: Final[dict[str, dict[str, float]]] = {
    "de": {"rural": 100, "living_street": 7}, "at": {"rural": 100}, "fr": {"rural": 80},
    "ch": {"rural": 80, "motorway": 120, "living_street": 20}, "nl": {"rural": 80, "motorway": 100},
    "be": {"rural": 70, "motorway": 120}, "es": {"motorway": 120}, "pt": {"motorway": 120},
    "ru": {"urban": 60, "motorway": 110, "living_street": 20},
    "ua": {"living_street": 20}, "pl": {"motorway": 140, "living_street": 20},
    "it": {"trunk": 110}, "se": {"rural": 70, "motorway": 110},
    "no": {"rural": 80, "motorway": 110},
    "gb": {
        "urban": 48.28, "rural": 96.56, "motorway": 112.65, "nsl_single": 96.56,
        "nsl_dual": 112.65, "nsl_restricted": 48.28,
    },
    "ie": {"rural": 80, "motorway": 120},
}  # fmt: skip
"""Limits that countries have otherwise, km/h."""

FREE_WORDS: Final = frozenset({"none", "unlimited", "no limit", "no_limit"})

_NUMBER: Final = re.compile(r"(?:[a-z]{2}:)?(?:zone:?)?\s*([0-9]{1,3}(?:[.,][0-9]+)?)\s*([a-z/]*)")
_PLACE: Final = re.compile(r"([a-z]{2})(?:-[a-z]+)?:(?:[a-z]{3}:)?([a-z_]+)(?::?([0-9]{1,3}))?")


def limit_of(text: str) -> float | None:
    """A limit as OpenStreetMap writes it, m/s; None where it says none that can be known.

    The lowest of several limits counts. Limits at certain times only, and signs that change, are
    unknown.

    Args:
        text: the value of ``maxspeed`` or a tag like it.

    Examples:
        >>> [round(limit_of(text) * 3.6) for text in ("50;30", "DE:zone:20", "30 mph;20 mph")]
        [30, 20, 32]
        >>> limit_of("signals") is None
        True
    """
    found = [_single(part.strip().lower()) for part in re.split(r"[;|,/](?!h\b|s\b)", text)]
    known = [one for one in found if one is not None]
    return min(known, default=None)


def _single(text: str) -> float | None:
    """One limit, m/s."""
    if text in FREE_WORDS:
        return FREE_MPS
    if text == "walk" or text.endswith(":walk"):
        return WALK_MPS
    number = _NUMBER.fullmatch(text)
    if number and number[2] in UNITS:
        limit = in_si(float(number[1].replace(",", ".")), UNITS[number[2]])
        return limit if limit > 0 else None
    place = _PLACE.fullmatch(text)
    if place and place[3]:
        return in_si(float(place[3]), "mph" if place[1] == "gb" else "km/h")
    if place:
        kmh = OF_COUNTRY_KMH.get(place[1], {}).get(place[2], IMPLIED_KMH.get(place[2]))
        return None if kmh is None else kmh / 3.6
    return None


Found = tuple[list[bool], bool, list[str]]
"""Whether each road has a limit, whether traffic drives on the left, and assumptions."""


@dataclass(frozen=True)
class Source:
    """A map as netconvert takes it.

    Attributes:
        content: the file.
        left_hand: whether traffic drives on the left.
        warnings: assumptions, a sentence each.
        unlimited: how many roads have no limit in the map.
    """

    content: bytes
    left_hand: bool = False
    warnings: tuple[str, ...] = ()
    unlimited: int = 0


def prepared(path: Path, kind: str, content: bytes, left_hand: bool | None = None) -> Source:
    """A map as netconvert takes it.

    Args:
        path: its file, for messages.
        kind: "openstreetmap" or "opendrive"; other kinds stay as they are.
        content: what it holds.
        left_hand: whether traffic of OpenStreetMap drives on the left; None for what the map says.
    """
    if kind not in ("openstreetmap", "opendrive"):
        return Source(content)
    with broken_as_one_line(path, "XML"):
        root = ET.fromstring(content)
        found = _drive(root) if kind == "opendrive" else _street_map(root, left_hand)
        limited, on_left, warnings = found
        unlimited = limited.count(False)
        if unlimited:
            assumed = f"limits of {unlimited} of {len(limited)} roads are not in the map: assumed"
            warnings.append(assumed)
        written = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return Source(written, on_left, tuple(warnings), unlimited)


# --- OpenStreetMap ------------------------------------------------------------------------------

DRIVEN: Final = frozenset(
    f"{name}{end}"
    for name in ("motorway", "trunk", "primary", "secondary", "tertiary", "unclassified",
                 "residential", "living_street", "service", "road")
    for end in ("", "_link")
)  # fmt: skip
"""Values of ``highway`` that cars drive on."""

LIMITS: Final = (
    "maxspeed", "source:maxspeed", "maxspeed:type", "zone:maxspeed", "zone:traffic",
)  # fmt: skip
DIRECTED: Final = ("maxspeed:forward", "maxspeed:backward")
"""Keys of limits: of both directions, the first one that says any, and of each."""

LEFT: Final = (
    (49.9, 61.0, -11.0, 1.40), (51.2, 53.0, 1.39, 1.80), (30.0, 45.6, 129.4, 146.0),
    (24.0, 29.0, 123.0, 131.0), (-44.0, -10.0, 112.0, 154.0), (-48.0, -34.0, 166.0, 179.0),
    (6.0, 28.0, 68.5, 89.0), (28.0, 35.0, 70.0, 78.5), (22.0, 26.5, 88.0, 92.5),
    (24.0, 36.0, 62.0, 74.0), (6.0, 16.0, 99.0, 101.5), (1.0, 6.4, 99.8, 104.5),
    (-9.0, 5.0, 95.0, 119.0), (22.15, 22.55, 113.85, 114.4), (-35.0, -18.0, 16.0, 36.0),
    (-26.0, -9.0, 30.5, 41.0), (-11.0, 4.0, 30.0, 41.5), (35.7, 36.1, 14.1, 14.6),
    (34.5, 35.7, 32.2, 34.6), (17.6, 18.6, -78.5, -76.1),
)  # fmt: skip
"""South, north, west and east of regions where traffic drives on the left, degrees."""


def _street_map(root: ET.Element, left_hand: bool | None) -> Found:
    """Write plain limits into OpenStreetMap."""
    limited, warnings, sides = list[bool](), list[str](), set[str]()
    for way in root.iterfind("way"):
        tags = {tag.get("k", ""): tag for tag in way.iterfind("tag")}
        said = {key: tag.get("v", "") for key, tag in tags.items()}
        sides.add(said.get("driving_side", ""))
        if said.get("highway") not in DRIVEN:
            continue
        written = {key: limit_of(said[key]) for key in (*LIMITS, *DIRECTED) if key in said}
        limits = {key: limit for key, limit in written.items() if limit}
        limit = next((limits[key] for key in LIMITS if key in limits), None)
        limit = limit or min((limits[key] for key in DIRECTED if key in limits), default=None)
        limited.append(limit is not None)
        if limit is not None:
            limits["maxspeed"] = limit
        for key in ("maxspeed", *DIRECTED):
            if key in tags:
                way.remove(tags[key])
            if value := limits.get(key):
                ET.SubElement(way, "tag", k=key, v=f"{value * 3.6:.6g}")
    if left_hand is None and "left" not in sides:
        places = [(float(n.attrib["lat"]), float(n.attrib["lon"])) for n in root.iter("node")]
        if places and drives_left(*np.median(places, axis=0).tolist()):
            warnings.append(
                "found a place where traffic drives on the left, taken as driving on the right: "
                "--left-hand, or --set left_hand=true, mirrors it"
            )
    return limited, "left" in sides if left_hand is None else left_hand, warnings


def drives_left(latitude: float, longitude: float) -> bool:
    """Whether traffic drives on the left at a position, by the regions of `LEFT`.

    Examples:
        >>> drives_left(51.5, -0.12), drives_left(52.5, 13.4), drives_left(48.86, 2.35)
        (True, False, False)
    """
    return any(s <= latitude <= n and w <= longitude <= e for s, n, w, e in LEFT)


# --- OpenDRIVE ----------------------------------------------------------------------------------


def _drive(root: ET.Element) -> Found:
    """Write a limit to each lane of OpenDRIVE."""
    limited, warnings, length_m = list[bool](), list[str](), {True: 0.0, False: 0.0}
    for road in root.iterfind("road"):
        size = float(road.get("length", 0.0))
        length_m[road.get("rule", "").upper() == "LHT"] += size
        sections = sorted(road.iterfind("lanes/laneSection"), key=_begin)
        if not sections:
            continue
        types = sorted(road.iterfind("type"), key=_begin)
        limits = [(_begin(one), _limit(one.find("speed"))) for one in types]
        ends = [*map(_begin, sections[1:]), size]
        limited.append(all([_limit_lanes(*p, limits) for p in zip(sections, ends, strict=True)]))
        if any(limit == math.inf for _, limit in limits):
            name = road.get("id", "")[:60]
            warnings.append(f"road {name}: found no limit: {FREE_MPS:.2f} m/s are assumed")
    if min(length_m.values()) > 0:
        warnings.append("found roads of both rules, LHT and RHT: the one of more length counts")
    return limited, length_m[True] > length_m[False], warnings


def _limit_lanes(section: ET.Element, end: float, limits: list[tuple[float, float | None]]) -> bool:
    """Write the limits of a road to a section's lanes; whether all for cars have one."""
    begin, known = _begin(section), True
    inside = [
        (max(s - begin, 0.0), limit)
        for i, (s, limit) in enumerate(limits)
        if s < end and (i + 1 == len(limits) or limits[i + 1][0] > begin)
    ]
    for lane in (one for one in section.iter("lane") if one.get("id") != "0"):
        written = lane.findall("speed")
        own = [(float(one.get("sOffset", 0.0)), _limit(one)) for one in written]
        own = [one for one in own if one[1] is not None]
        for speed in written:
            lane.remove(speed)
        for offset, limit in own or inside:
            if limit is not None:
                values = {"sOffset": f"{offset:.4f}", "unit": "m/s"}
                ET.SubElement(lane, "speed", values, max=f"{min(limit, FREE_MPS):.4f}")
        if not own and lane.get("type") in ("driving", "bidirectional", "entry", "exit", "onRamp"):
            known &= bool(inside) and all(limit is not None for _, limit in inside)
    return known


def _limit(speed: ET.Element | None) -> float | None:
    """A limit of OpenDRIVE, m/s; infinite where it says that there is none, None if unknown."""
    if speed is None:
        return None
    text = speed.get("max", "").strip().lower()
    if text in FREE_WORDS:
        return math.inf
    return _single(f"{text} {(speed.get('unit') or 'm/s').strip().lower()}")


def _begin(element: ET.Element) -> float:
    """Where a part of a road begins, m along it."""
    return float(element.get("s", 0.0))
