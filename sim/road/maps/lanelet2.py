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
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from pyproj import Proj

from behaviors.errors import InputError
from sim.frames import FloatArray
from sim.input_files import read_once, read_tree
from sim.road import Road
from sim.road.maps.lanelets import Lanelet, between, read_lanelets, road_of_lanelets
from sim.road.maps.sources import FREE_WORDS, limit_of

Origin = tuple[float, float]
"""Latitude and longitude of a recording's (0, 0), degrees."""

NEAR_ZERO_DEG: Final = 0.2
"""Maps all within this of latitude and longitude 0 have their origin there, as INTERACTION's (22
km)."""

COORDINATES: Final = (("x", "y"), ("local_x", "local_y"), ("lat", "lon"))
"""Attributes or tags of nodes that say where they are; the first ones that there are count."""

WALKING: Final = frozenset({"walkway", "stairs", "shared_walkway"})
CROSSING: Final = "crosswalk"
NOT_FOR_CARS: Final = frozenset({"bicycle_lane", "bikelane", "bus_lane", "rail"})
"""Subtypes of lanelets; all others are driven by cars."""

UNLIMITED: Final = FREE_WORDS | {"signals", "variable"}
"""Limits that are no number."""

Border = tuple[int, ...]
"""The nodes of a lanelet's border in driving direction."""

Places = Mapping[int, FloatArray]
"""x and y of each node, m."""


@read_once
def read_map(path: Path, name: str | None = None, origin: Origin | None = None) -> Road:
    """The road of a map (``.osm`` or ``.osm.gz``); lane ids are those of the file.

    Without an origin, coordinates are local metres, of maps around latitude and longitude 0 metres
    from there, and of others metres of the UTM zone.

    Raises:
        InputError: if the file is broken or has no lanelet.
    """
    root = read_tree(path)
    relations = _relations(root, "lanelet")
    if not relations and root.find("way") is not None:
        raise InputError(
            f"{path}: found OpenStreetMap without lanes, expected a Lanelet2 map: graphrqi road "
            f"{path.name} --out NAME makes a net of it"
        )
    places, yields, stops, signs = _places(root, origin), dict[int, Border](), set[int](), {}
    for rule in _relations(root, "regulatory_element"):
        tags = _tags(rule)
        kind = tags.get("subtype")
        if kind in ("right_of_way", "all_way_stop"):
            waiting = _members(rule, "yield")
            first = _members(rule, "right_of_way")
            yields |= {i: (*yields.get(i, ()), *first) for i in waiting}
            stops.update(waiting if kind == "all_way_stop" else ())
        elif kind == "speed_limit":
            text = tags.get("limit") or tags.get("sign_type", "").rpartition("-")[2]
            signs[int(rule.attrib["id"])] = text
    ways = {
        int(way.attrib["id"]): tuple(int(nd.attrib["ref"]) for nd in way.iterfind("nd"))
        for way in root.iterfind("way")
    }
    ways = {i: way for i, way in ways.items() if len(way) >= 2 and places.keys() >= {*way}}
    borders: dict[int, tuple[Border, Border]] = {}

    def read(identity: int, relation: Element) -> Lanelet:
        borders[identity] = _borders(relation, ways, places)
        lines = (np.array([places[node] for node in side]) for side in borders[identity])
        ruled = [signs[ref] for ref in _members(relation, "regulatory_element") if signs.get(ref)]
        one = _lanelet(identity, _tags(relation), *between(*lines), "".join(ruled[-1:]))
        return replace(
            one,
            must_yield=identity in yields,
            must_stop=identity in stops,
            yields_to=yields.get(identity, ()),
        )

    found, broken = read_lanelets(path, relations, read)
    driven = {i: borders[i] for i, one in found.items() if not (one.walking or one.crossing)}
    found |= _related(found, driven)
    # oncoming lanelets share the border in the middle of the street
    lefts, rights = ({sides[k] for sides in driven.values()} for k in (0, 1))
    oncoming = [sum(one[::-1] in lines for one in lines) for lines in (lefts, rights)]
    left_hand = oncoming[1] > oncoming[0]
    return road_of_lanelets(
        path, name, found, find_junctions=True, priority=bool(yields), left_hand=left_hand,
        broken=broken,
    )  # fmt: skip


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def _relations(root: Element, kind: str) -> list[Element]:
    return [e for e in root.iterfind("relation") if _tags(e).get("type") == kind]


def _members(relation: Element, role: str) -> list[int]:
    """What a relation refers to in a role."""
    return [int(e.attrib["ref"]) for e in relation.iterfind(f"member[@role='{role}']")]


def _places(root: Element, origin: Origin | None) -> Places:
    """Every node's x and y, m."""
    nodes = {int(node.attrib["id"]): node.attrib | _tags(node) for node in root.iterfind("node")}
    if not nodes:
        raise InputError("found no node, expected some")
    first = next(iter(nodes.values()))
    keys = next((keys for keys in COORDINATES if {*keys} <= first.keys()), COORDINATES[-1])
    table = np.array([[float(node[key]) for key in keys] for node in nodes.values()])
    if keys == ("lat", "lon"):
        table = _projected(table, origin)
    return dict(zip(nodes, table, strict=True))


def _projected(degrees: FloatArray, origin: Origin | None) -> FloatArray:
    """(n, 2) m from the origin, in its UTM zone, of (n, 2) latitudes and longitudes.

    Without an origin, they are coordinates of the zone; northings are negative in the south.
    """
    if origin is None and (np.abs(degrees) < NEAR_ZERO_DEG).all():
        origin = (0.0, 0.0)
    longitude = float(np.median(degrees[:, 1])) if origin is None else origin[1]
    zone = Proj(proj="utm", zone=int((longitude + 180.0) // 6.0) % 60 + 1, ellps="WGS84")
    metres = np.stack(zone(degrees[:, 1], degrees[:, 0]), axis=1)
    return metres if origin is None else np.asarray(metres - zone(origin[1], origin[0]))


def _borders(
    relation: Element, ways: Mapping[int, Border], places: Places
) -> tuple[Border, Border]:
    """Left and right border, turned so that left is on the left."""
    sides = []
    for role in ("left", "right"):
        refs = _members(relation, role)
        if not refs or not ways.keys() >= {*refs}:
            raise InputError(f"found no {role} border, expected a way of two nodes")
        sides.append(functools.reduce(_joined, (ways[ref] for ref in refs)))
    left, right = sides
    begin, end = places[left[0]], places[left[-1]]
    crossed, straight = (
        math.dist(begin, places[one]) + math.dist(end, places[other])
        for one, other in ((right[-1], right[0]), (right[0], right[-1]))
    )
    if crossed < straight:
        right = right[::-1]
    x, y = (np.array([places[node] for node in (*left, *right[::-1])]) - begin).T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return (left[::-1], right[::-1]) if area > 0 else (left, right)


def _joined(one: Border, then: Border) -> Border:
    """Two ways that share an end as one."""
    if one[-1] not in (then[0], then[-1]):
        one = one[::-1]
    if one[-1] != then[0]:
        then = then[::-1]
    return (*one, *then[1:])


def _related(
    lanelets: Mapping[int, Lanelet], borders: Mapping[int, tuple[Border, Border]]
) -> dict[int, Lanelet]:
    """The lanelets for vehicles with their successors and neighbours, from shared borders."""
    begins: dict[tuple[int, int], list[int]] = {}
    for i, (left, right) in borders.items():
        begins.setdefault((left[0], right[0]), []).append(i)
    by_left = {left: i for i, (left, _) in borders.items()}
    by_right = {right: i for i, (_, right) in borders.items()}
    return {
        i: replace(
            lanelets[i],
            successors=tuple(j for j in begins.get((left[-1], right[-1]), ()) if j != i),
            left=by_right.get(left),
            right=by_left.get(right),
        )
        for i, (left, right) in borders.items()
    }


def _lanelet(
    identity: int, tags: Mapping[str, str], centerline: FloatArray, width_m: float, rule: str
) -> Lanelet:
    """A lanelet without what others say of it; ``rule`` is the limit of a sign."""
    subtype = tags.get("subtype", "road")
    allowed = {who for who in ("pedestrian", "vehicle", "vehicle:car")
               if tags.get(f"participant:{who}") == "yes"}  # fmt: skip
    only_people = allowed == {"pedestrian"} and "participant:bicycle" not in tags
    walking = subtype in WALKING or only_people
    text = (tags.get("speed_limit") or tags.get("maxspeed") or rule).strip().lower()
    limit = None
    if text and text not in UNLIMITED and not text.startswith("0"):
        limit = limit_of(re.sub(r"^de\s*(?=[0-9])", "", text))
        if limit is None:
            raise InputError(f"speed limit: found {text[:40]!r}, expected as in 50 km/h")
    return Lanelet(
        id=identity,
        centerline=centerline,
        width_m=width_m,
        internal=tags.get("turn_direction") in ("left", "right", "straight"),
        use=subtype if subtype in NOT_FOR_CARS or walking else "",
        limit_mps=math.nan if limit is None else limit,
        walking=walking,
        crossing=subtype == CROSSING,
        cars=not walking and subtype not in NOT_FOR_CARS,
    )
