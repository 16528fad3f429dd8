"""The lanelets of a CommonRoad scenario (XML, versions 2017a to 2020a) as a `Road`.

Limits are an element of the lanelet until 2018b and a traffic sign from 2020a on, m/s in both.
Signals, signs and intersections exist from 2020a on; in earlier versions signals and priority are
unknown, and junctions follow from crossing centre lines.

References:
    Althoff, Koschi, Manzinger (2017), CommonRoad: composable benchmarks for motion planning on
    roads, IEEE IV; its XML documentation, 2020a.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from behaviors.errors import InputError
from sim.frames import FloatArray, Signal
from sim.input_files import read_tree
from sim.road import Road, SignalPlan
from sim.road.maps.lanelets import Lanelet, between, read_lanelets, road_of_lanelets

LIMIT_SIGNS: Final = frozenset(
    {"274", "274.1", "R2-1", "B14", "C43", "R15", "R-32", "B31", "50", "3.24", "r301"}
)
"""Signs whose value is a speed limit: Germany, USA, France, Belgium, Argentina, Greece, Croatia,
Italy, Russia and Spain, as CommonRoad numbers them."""

STOP_SIGNS: Final = frozenset({"206", "R1-1"})
YIELD_SIGNS: Final = frozenset({"205", "R1-2"}) | STOP_SIGNS
PRIORITY_SIGNS: Final = frozenset({"301", "306"})

NOT_FOR_CARS: Final = frozenset(
    {"sidewalk", "crosswalk", "busLane", "bicycleLane", "busStop", "shoulder", "border", "parking"}
)
"""Types of lanelet that cars do not drive along."""

CAR_USERS: Final = frozenset({"vehicle", "car", "taxi"})
"""Users of a lanelet that make it one for cars."""

COLORS: Final = {
    "red": Signal.RED,
    "redYellow": Signal.RED,
    "yellow": Signal.YELLOW,
    "green": Signal.GREEN,
    "inactive": Signal.OFF,
}

LEAST_S: Final = {Signal.YELLOW: 1.0, Signal.GREEN: 2.0}
"""A programme with a shorter yellow or green has a wrong unit and is ignored, s (codes of practice
ask for a yellow of 3 s)."""

Signs = Mapping[int, tuple[frozenset[str], float]]
"""The kinds of the signs at each post, by its id, and the limit that they give, m/s, or NaN."""


def read_map(path: Path, name: str | None = None) -> Road:
    """The road of a scenario (``.xml`` or ``.xml.gz``); lane ids are those of the file.

    Raises:
        InputError: if the file is broken or has no lanelet.
    """
    road = road_of(path, read_tree(path), name)
    if road is None:
        raise InputError(f"{path}: found no lanelet, expected at least one")
    return road


def road_of(path: Path, root: Element, name: str | None = None) -> Road | None:
    """The road of a scenario that is already parsed; None where it has no lanelets."""
    elements = root.findall("lanelet")
    if not elements:
        return None
    signs, lights = _signs(root), _lights(root)
    ways = [f"successors{way}" for way in ("Left", "Straight", "Right")]
    inside = {i for one in root.iterfind("intersection/incoming") for i in _refs(one, *ways)}

    def read(identity: int, element: Element) -> Lanelet:
        one = _lanelet(identity, element, signs, lights)
        return replace(one, internal=one.internal or identity in inside)

    found, broken = read_lanelets(path, elements, read)
    left, right = (
        len(root.findall(f"lanelet/adjacent{side}[@drivingDir='opposite']"))
        for side in ("Left", "Right")
    )
    priority = any(kinds & (YIELD_SIGNS | PRIORITY_SIGNS) for kinds, _ in signs.values())
    for intersection in root.iterfind("intersection") if priority else ():
        coming = [found[i] for i in _refs(intersection, "incoming/incomingLanelet") if i in found]
        first = tuple(one.id for one in coming if not one.must_yield)
        found |= {one.id: replace(one, yields_to=first) for one in coming if one.must_yield}
    return road_of_lanelets(
        path,
        name,
        found,
        find_junctions=True,
        priority=priority,
        signal_groups=tuple(plan.id for plan in lights),
        signal_plans=lights,
        left_hand=right > left,
        broken=broken,
    )


def _refs(element: Element, *tags: str) -> list[int]:
    """What elements below one refer to."""
    return [int(one.attrib["ref"]) for tag in tags for one in element.iterfind(tag)]


def _texts(element: Element, tag: str) -> frozenset[str]:
    return frozenset((one.text or "").strip() for one in element.iterfind(tag))


def _line(element: Element, side: str) -> FloatArray:
    """(P, 2) the points of a border, m."""
    points = element.iterfind(f"{side}/point")
    places = [[float(one.findtext(axis, "")) for axis in "xy"] for one in points]
    return np.reshape(places, (-1, 2))


def _signs(root: Element) -> Signs:
    """Every traffic sign by its id."""
    found = {}
    for sign in root.iterfind("trafficSign"):
        kinds, limit = set[str](), math.nan
        for part in sign.iterfind("trafficSignElement"):
            kind = part.findtext("trafficSignID", "").strip()
            kinds.add(kind)
            if kind in LIMIT_SIGNS and (text := part.findtext("additionalValue")):
                limit = float(text)
        found[int(sign.attrib["id"])] = frozenset(kinds), limit
    return found


def _lights(root: Element) -> tuple[SignalPlan, ...]:
    """The lights of a scenario; none where any light's programme is missing or odd."""
    step_s = float(root.attrib["timeStepSize"])
    plans = list[SignalPlan]()
    for light in root.iterfind("trafficLight"):
        cycle = light.findall("cycle/cycleElement")
        states = [COLORS[one.findtext("color", "").strip()] for one in cycle]
        durations = [float(one.findtext("duration", "")) * step_s for one in cycle]
        off = light.findtext("active", "").strip() == "false"
        odd = any(d < LEAST_S.get(s, 0.0) for d, s in zip(durations, states, strict=True))
        if not states or off or odd:
            return ()
        offset_s = float(light.findtext("cycle/timeOffset") or "0") * step_s
        codes = tuple((state.code,) for state in states)
        identity, group = light.attrib["id"].strip(), (len(plans),)
        plans.append(SignalPlan(identity, group, (0,), tuple(durations), codes, offset_s))
    return tuple(plans)


def _lanelet(
    identity: int, element: Element, signs: Signs, lights: tuple[SignalPlan, ...]
) -> Lanelet:
    """A lanelet."""
    centerline, width_m = between(_line(element, "leftBound"), _line(element, "rightBound"))
    types, users = _texts(element, "laneletType"), _texts(element, "userOneWay")
    at_end = _refs(element, "trafficSignRef", "stopLine/trafficSignRef")
    seen = [signs[i] for i in at_end if i in signs]
    kinds = frozenset[str]().union(*(kind for kind, _ in seen))
    own = element.findtext("speedLimit")
    limits = [limit for _, limit in seen] + ([] if own is None else [float(own)])
    group = {plan.id: plan.groups[0] for plan in lights}
    lit = map(str, _refs(element, "trafficLightRef", "stopLine/trafficLightRef"))
    left, right = (
        next(iter(_refs(element, f"adjacent{side}[@drivingDir='same']")), None)
        for side in ("Left", "Right")
    )
    return Lanelet(
        id=identity,
        centerline=centerline,
        width_m=width_m,
        successors=tuple(_refs(element, "successor")),
        predecessors=tuple(_refs(element, "predecessor")),
        internal="intersection" in types,
        left=left,
        right=right,
        use=",".join(sorted(types & NOT_FOR_CARS)),
        limit_mps=min((one for one in limits if math.isfinite(one)), default=math.nan),
        walking="sidewalk" in types,
        crossing="crosswalk" in types,
        cars=not types & NOT_FOR_CARS and (not users or bool(users & CAR_USERS)),
        signal=next((group[i] for i in lit if i in group), -1),
        must_stop=bool(kinds & STOP_SIGNS),
        must_yield=bool(kinds & YIELD_SIGNS),
    )
