"""A Lanelet2 map (``.osm``) as a `Road`: the maps beside INTERACTION recordings.

Nodes are projected latitudes and longitudes (UTM, from the recording's origin) or local metres
(tags ``local_x`` and ``local_y``, or attributes ``x`` and ``y``). Programmes of lights are not in
the format: signals are unknown. Priority is known where the map has right-of-way elements.

References:
    Poggenhans et al. (2018), Lanelet2: a high-definition map framework for the future of automated
    driving, IEEE ITSC.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from behaviors.errors import InputError
from sim.frames import FloatArray
from sim.input_files import read_once
from sim.road import Crossing, Road
from sim.road.maps.lanelets import Lanelet, between, road_of_lanelets, with_junctions
from sim.road.maps.sources import FREE_WORDS, limit_of
from sim.road.maps.transverse_mercator import to_metres, zone_of
from sim.xml_tree import read_tree, whole_number

ROOT: Final = "osm"

Origin = tuple[float, float]
"""Latitude and longitude of a recording's (0, 0), degrees."""

NEAR_ZERO_DEG: Final = 0.2
"""Maps all within this of latitude and longitude 0 have their origin there, as INTERACTION's (22
km)."""

WALKING: Final = frozenset({"walkway", "stairs", "shared_walkway"})
CROSSING: Final = frozenset({"crosswalk"})
NOT_FOR_CARS: Final = frozenset({"bicycle_lane", "bikelane", "bus_lane", "rail"})
"""Subtypes of lanelets; all others are driven by cars."""
UNLIMITED: Final = FREE_WORDS | {"signals", "variable"}
"""Limits that are no number."""


@read_once
def read_map(path: Path, name: str | None = None, origin: Origin | None = None) -> Road:
    """Read a map.

    Args:
        path: the ``.osm`` file, or ``.osm.gz``.
        name: what to call the road; by default the file's name without its ending.
        origin: latitude and longitude of (0, 0), degrees; None for local metres, for maps around
            latitude and longitude 0, and for coordinates of the UTM zone.

    Returns:
        Its lanes, ways and crossings; lane ids are those of the file.

    Raises:
        InputError: if the file is broken or has no lanelet; names the file and the element.
    """
    root = read_tree(path)
    if root.tag != ROOT:
        raise InputError(f"{path}: found element {root.tag[:60]!r}, expected {ROOT}")
    if not _relations(root, "lanelet") and root.find("way") is not None:
        raise InputError(
            f"{path}: found OpenStreetMap without lanes, expected a Lanelet2 map: graphrqi road "
            f"{path.name} --out NAME makes a net of it"
        )
    ways = _ways(path, root, _places(path, root, origin))
    rules = _rules(path, root)
    found: dict[int, Lanelet] = {}
    borders: dict[int, tuple[_Border, _Border]] = {}
    crossings: list[Crossing] = []
    broken: list[str] = []
    for relation in sorted(_relations(root, "lanelet"), key=lambda e: whole_number(path, e, "id")):
        identity = whole_number(path, relation, "id")
        if identity in borders:
            raise InputError(f"{path}: found lanelet {identity} twice, expected it once")
        try:
            borders[identity] = _borders(path, relation, ways)
            lanelet = _lanelet(path, relation, borders[identity], rules)
        except InputError as error:
            broken.append(str(error))
            continue
        if _tags(relation).get("subtype") in CROSSING:
            crossings.append(Crossing(str(identity), lanelet.centerline, lanelet.width_m, ()))
        else:
            found[identity] = lanelet
    found = _related(found, borders)
    if not any(one.internal for one in found.values()):
        found = with_junctions(found)
    driven = [sides for i, sides in borders.items() if i in found and not found[i].walking]
    left_hand = _oncoming(driven, 1) > _oncoming(driven, 0)
    return road_of_lanelets(
        path, name, found, crossings, bool(rules.yields), left_hand=left_hand, broken=broken
    )


def _lanelet(
    path: Path, relation: Element, borders: tuple[_Border, _Border], rules: _Rules
) -> Lanelet:
    """A lanelet without its successors and neighbours."""
    identity, tags = whole_number(path, relation, "id"), _tags(relation)
    centerline, width_m = between(*(border.line for border in borders))
    subtype = tags.get("subtype", "road")
    walking = subtype in WALKING or _only_people(tags)
    return Lanelet(
        id=identity,
        centerline=centerline,
        width_m=width_m,
        successors=(),
        internal=tags.get("turn_direction") in ("left", "right", "straight"),
        use=subtype if subtype in NOT_FOR_CARS or walking else "",
        limit_mps=_limit(path, tags, rules.limits.get(identity)),
        walking=walking,
        cars=not walking and subtype not in NOT_FOR_CARS,
        must_yield=identity in rules.yields,
        must_stop=identity in rules.stops,
        yields_to=rules.yields.get(identity, ()),
    )


def _oncoming(borders: list[tuple[_Border, _Border]], side: int) -> int:
    """How many lanelets have an oncoming one on their left (0) or right (1)."""
    lines = {sides[side].nodes for sides in borders}
    return sum(line[::-1] in lines for line in lines)


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def _relations(root: Element, kind: str) -> list[Element]:
    return [e for e in root.iterfind("relation") if _tags(e).get("type") == kind]


def _places(path: Path, root: Element, origin: Origin | None) -> dict[int, tuple[float, float]]:
    """Every node's x and y, m."""
    nodes = root.findall("node")
    identity = [whole_number(path, node, "id") for node in nodes]
    if not nodes:
        raise InputError(f"{path}: found no node, expected some")
    first = _tags(nodes[0])
    if "x" in nodes[0].attrib and "y" in nodes[0].attrib:
        table = _table(path, [(n.get("x"), n.get("y")) for n in nodes])
    elif "local_x" in first and "local_y" in first:
        tags = [_tags(node) for node in nodes]
        table = _table(path, [(t.get("local_x"), t.get("local_y")) for t in tags])
    else:
        degrees = _table(path, [(n.get("lat"), n.get("lon")) for n in nodes])
        if not ((np.abs(degrees) < (89.0, 361.0)).all()):
            raise InputError(f"{path}: found a node beyond 89 and 360 degrees")
        table = _projected(degrees, origin)
    return dict(zip(identity, ((float(x), float(y)) for x, y in table), strict=True))


def _table(path: Path, pairs: list[tuple[str | None, str | None]]) -> FloatArray:
    """(n, 2) numbers in text."""
    try:
        return np.array([(float(a or ""), float(b or "")) for a, b in pairs])
    except ValueError:
        raise InputError(f"{path}: found a node whose position is not a number") from None


def _projected(degrees: FloatArray, origin: Origin | None) -> FloatArray:
    """(n, 2) m from the origin, in the origin's UTM zone."""
    if origin is None and (np.abs(degrees) < NEAR_ZERO_DEG).all():
        origin = (0.0, 0.0)
    zone = zone_of(float(np.median(degrees[:, 1])) if origin is None else origin[1])
    metres = to_metres(degrees[:, 0], degrees[:, 1], zone)
    if origin is None:
        return metres
    return np.asarray(metres - to_metres(np.array([origin[0]]), np.array([origin[1]]), zone))


@dataclass(frozen=True, eq=False)
class _Border:
    """A border of a lanelet in driving direction."""

    nodes: tuple[int, ...]
    line: FloatArray

    @property
    def turned(self) -> _Border:
        return _Border(self.nodes[::-1], self.line[::-1])


def _ways(
    path: Path, root: Element, places: Mapping[int, tuple[float, float]]
) -> dict[int, _Border]:
    """Every way of two nodes and more, all of which are in the file."""
    found = {}
    for way in root.iterfind("way"):
        nodes = tuple(whole_number(path, nd, "ref") for nd in way.iterfind("nd"))
        if len(nodes) >= 2 and all(node in places for node in nodes):
            line = np.array([places[node] for node in nodes])
            found[whole_number(path, way, "id")] = _Border(nodes, line)
    return found


def _borders(path: Path, relation: Element, ways: Mapping[int, _Border]) -> tuple[_Border, _Border]:
    """Left and right border, turned so that left is on the left."""
    sides = []
    for role in ("left", "right"):
        refs = _members(path, relation, role)
        if not refs or any(ref not in ways for ref in refs):
            raise InputError(
                f"{path}: lanelet {whole_number(path, relation, 'id')}: found no {role} border, "
                "expected a way of two nodes"
            )
        sides.append(functools.reduce(_joined, (ways[ref] for ref in refs)))
    left, right = sides
    ends = left.line[[0, -1]]
    if _apart(ends, right.line[[-1, 0]]) < _apart(ends, right.line[[0, -1]]):
        right = right.turned
    loop = np.concatenate([left.line, right.line[::-1]])
    x, y = loop[:, 0] - loop[0, 0], loop[:, 1] - loop[0, 1]
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return (left.turned, right.turned) if area > 0 else (left, right)


def _apart(one: FloatArray, other: FloatArray) -> float:
    return float(np.hypot(*(one - other).T).sum())


def _joined(one: _Border, then: _Border) -> _Border:
    """Two ways that share an end as one."""
    if one.nodes[-1] not in (then.nodes[0], then.nodes[-1]):
        one = one.turned
    if one.nodes[-1] != then.nodes[0]:
        then = then.turned
    line = np.concatenate([one.line, then.line[1:]])
    return _Border((*one.nodes, *then.nodes[1:]), line)


def _related(
    lanelets: dict[int, Lanelet], borders: Mapping[int, tuple[_Border, _Border]]
) -> dict[int, Lanelet]:
    """The lanelets with their successors and neighbours, from shared borders."""
    driven = [i for i, one in lanelets.items() if not one.walking]
    begins: dict[tuple[int, int], list[int]] = {}
    by_left: dict[tuple[int, ...], int] = {}
    by_right: dict[tuple[int, ...], int] = {}
    for i in driven:
        left, right = borders[i]
        begins.setdefault((left.nodes[0], right.nodes[0]), []).append(i)
        by_left[left.nodes] = i
        by_right[right.nodes] = i
    told = dict(lanelets)
    for i in driven:
        left, right = borders[i]
        following = begins.get((left.nodes[-1], right.nodes[-1]), [])
        told[i] = replace(
            lanelets[i],
            successors=tuple(j for j in following if j != i),
            left=by_right.get(left.nodes),
            right=by_left.get(right.nodes),
        )
    return told


def _only_people(tags: Mapping[str, str]) -> bool:
    walks = tags.get("participant:pedestrian") == "yes"
    drives = any(tags.get(f"participant:{who}") == "yes" for who in ("vehicle", "vehicle:car"))
    return walks and not drives and "participant:bicycle" not in tags


def _limit(path: Path, tags: Mapping[str, str], rule: str | None) -> float:
    """Speed limit of a lanelet, m/s; NaN where there is none."""
    text = (tags.get("speed_limit") or tags.get("maxspeed") or rule or "").strip().lower()
    if not text or text in UNLIMITED or text.startswith("0"):
        return math.nan
    limit = limit_of(re.sub(r"^de\s*(?=[0-9])", "", text))
    if limit is None:
        raise InputError(f"{path}: speed limit: found {text[:40]!r}, expected as in 50 km/h")
    return limit


class _Rules(NamedTuple):
    """Meaning of the regulatory elements for lanelets: priority, stops, limits."""

    yields: dict[int, tuple[int, ...]]
    stops: set[int]
    limits: dict[int, str]


def _rules(path: Path, root: Element) -> _Rules:
    """The rules of a map."""
    yields, stops, signs = dict[int, tuple[int, ...]](), set[int](), dict[int, str]()
    for relation in _relations(root, "regulatory_element"):
        tags = _tags(relation)
        kind = tags.get("subtype")
        first, waiting = (_members(path, relation, role) for role in ("right_of_way", "yield"))
        if kind in ("right_of_way", "all_way_stop"):
            yields |= {i: (*yields.get(i, ()), *first) for i in waiting}
            stops.update(waiting if kind == "all_way_stop" else ())
        elif kind == "speed_limit":
            text = tags.get("limit") or tags.get("sign_type", "").rpartition("-")[2]
            signs |= {whole_number(path, relation, "id"): text} if text else {}
    limits = {
        whole_number(path, relation, "id"): signs[ref]
        for relation in _relations(root, "lanelet")
        for ref in _members(path, relation, "regulatory_element")
        if ref in signs
    }
    return _Rules(yields, stops, limits)


def _members(path: Path, relation: Element, role: str) -> list[int]:
    """What a relation refers to in a role."""
    members = [e for e in relation.iterfind("member") if e.get("role") == role]
    return [whole_number(path, member, "ref") for member in members]
