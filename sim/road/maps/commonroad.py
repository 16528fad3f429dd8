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
from sim.road import MAX_COORDINATE_M, Road, SignalPlan
from sim.road.maps.lanelets import Lanelet, between, read_lanelets, road_of_lanelets
from sim.xml_tree import read_tree, whole_number

ROOT: Final = "commonRoad"

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
        InputError: if the file is broken or has no lanelet; names the file and the element.
    """
    road = road_of(path, read_tree(path), name)
    if road is None:
        raise InputError(f"{path}: found no lanelet, expected at least one")
    return road


def road_of(path: Path, root: Element, name: str | None = None) -> Road | None:
    """The road of a scenario that is already parsed; None where it has no lanelets.

    Raises:
        InputError: as `read_map`.
    """
    if root.tag != ROOT:
        raise InputError(f"{path}: found element {root.tag[:60]!r}, expected {ROOT}")
    elements = root.findall("lanelet")
    if not elements:
        return None
    signs, lights = _signs(path, root), _lights(path, root)
    ways = [f"successors{way}" for way in ("Left", "Straight", "Right")]
    inside = {i for one in root.iterfind("intersection/incoming") for i in _refs(path, one, *ways)}

    def read(identity: int, element: Element) -> Lanelet:
        one = _lanelet(path, identity, element, signs, lights)
        return replace(one, internal=one.internal or identity in inside)

    found, broken = read_lanelets(path, elements, read)
    left, right = (
        len(root.findall(f"lanelet/adjacent{side}[@drivingDir='opposite']"))
        for side in ("Left", "Right")
    )
    return road_of_lanelets(
        path,
        name,
        found,
        find_junctions=True,
        priority=_add_priority(path, root, found, signs),
        signal_groups=tuple(plan.id for plan in lights),
        signal_plans=lights,
        left_hand=right > left,
        broken=broken,
    )


def real(path: Path, text: str | None, what: str) -> float:
    """A finite number in an element's text.

    Raises:
        InputError: naming the file and what the number is.
    """
    try:
        value = float(text or "")
    except ValueError:
        raise InputError(f"{path}: {what}: found {str(text)[:40]!r}, expected a number") from None
    if not abs(value) <= MAX_COORDINATE_M:
        most = f"expected a number up to {MAX_COORDINATE_M:g}"
        raise InputError(f"{path}: {what}: found {value}, {most}")
    return value


def _above_zero(path: Path, text: str | None, what: str) -> float:
    value = real(path, text, what)
    if value <= 0:
        raise InputError(f"{path}: {what}: found {value:g}, expected more than 0")
    return value


def _refs(path: Path, element: Element, *tags: str) -> list[int]:
    return [whole_number(path, e, "ref") for tag in tags for e in element.iterfind(tag)]


def _texts(element: Element, tag: str) -> frozenset[str]:
    return frozenset((e.text or "").strip() for e in element.iterfind(tag))


def _line(path: Path, element: Element | None, what: str) -> FloatArray:
    """(P, 2) the points of a border, m."""
    points = [] if element is None else list(element.iter("point"))
    if len(points) < 2:
        raise InputError(f"{path}: {what}: found {len(points)} points, expected 2 or more")
    return np.array([[real(path, one.findtext(axis), what) for axis in "xy"] for one in points])


def _signs(path: Path, root: Element) -> Signs:
    """Every traffic sign by its id."""
    found = {}
    for sign in root.iterfind("trafficSign"):
        kinds, limit = set[str](), math.nan
        for part in sign.iterfind("trafficSignElement"):
            kind = (part.findtext("trafficSignID") or "").strip()
            kinds.add(kind)
            if kind in LIMIT_SIGNS and (text := part.findtext("additionalValue")):
                limit = _above_zero(path, text, "speed limit")
        found[whole_number(path, sign, "id")] = frozenset(kinds), limit
    return found


def _lights(path: Path, root: Element) -> tuple[SignalPlan, ...]:
    """The lights of a scenario; none where any light's programme is missing or odd."""
    step_s = real(path, root.get("timeStepSize"), "timeStepSize")
    plans = dict[int, SignalPlan]()
    for light in root.iterfind("trafficLight"):
        identity = whole_number(path, light, "id")
        durations, states = list[float](), list[Signal]()
        for element in light.iterfind("cycle/cycleElement"):
            color = (element.findtext("color") or "").strip()
            if color not in COLORS:
                expected = f"expected one of {list(COLORS)}"
                raise InputError(f"{path}: color: found {color[:40]!r}, {expected}")
            states.append(COLORS[color])
            duration = _above_zero(path, element.findtext("duration"), "duration")
            durations.append(duration * step_s)
        works = bool(states) and (light.findtext("active") or "true").strip() != "false"
        odd = any(d < LEAST_S.get(s, 0.0) for d, s in zip(durations, states, strict=True))
        if not works or odd or identity in plans:
            return ()
        offset_s = real(path, light.findtext("cycle/timeOffset") or "0", "timeOffset") * step_s
        codes = tuple((state.code,) for state in states)
        group = (len(plans),)
        plans[identity] = SignalPlan(str(identity), group, (0,), tuple(durations), codes, offset_s)
    return tuple(plans.values())


def _lanelet(
    path: Path, identity: int, element: Element, signs: Signs, lights: tuple[SignalPlan, ...]
) -> Lanelet:
    """A lanelet."""
    left, right = (
        _line(path, element.find(side), f"lanelet {identity} {side}")
        for side in ("leftBound", "rightBound")
    )
    centerline, width_m = between(left, right)
    types, users = _texts(element, "laneletType"), _texts(element, "userOneWay")
    at_end = _refs(path, element, "trafficSignRef", "stopLine/trafficSignRef")
    seen = [signs[i] for i in at_end if i in signs]
    kinds = frozenset[str]().union(*(kind for kind, _ in seen))
    limits = [limit for _, limit in seen if math.isfinite(limit)]
    own = element.findtext("speedLimit")
    if own is not None:
        limits.append(_above_zero(path, own, "speed limit"))
    group = {plan.id: plan.groups[0] for plan in lights}
    lit = _refs(path, element, "trafficLightRef", "stopLine/trafficLightRef")
    beside = {
        side: next(iter(_refs(path, element, f"adjacent{side}[@drivingDir='same']")), None)
        for side in ("Left", "Right")
    }
    return Lanelet(
        id=identity,
        centerline=centerline,
        width_m=width_m,
        successors=tuple(_refs(path, element, "successor")),
        predecessors=tuple(_refs(path, element, "predecessor")),
        internal="intersection" in types,
        left=beside["Left"],
        right=beside["Right"],
        use=",".join(sorted(types & NOT_FOR_CARS)),
        limit_mps=min(limits, default=math.nan),
        walking="sidewalk" in types,
        crossing="crosswalk" in types,
        cars=not types & NOT_FOR_CARS and (not users or bool(users & CAR_USERS)),
        signal=next((group[str(i)] for i in lit if str(i) in group), -1),
        must_stop=bool(kinds & STOP_SIGNS),
        must_yield=bool(kinds & YIELD_SIGNS),
    )


def _add_priority(path: Path, root: Element, lanelets: dict[int, Lanelet], signs: Signs) -> bool:
    """Set the priorities at intersections with signs; whether any are known."""
    if not any(kinds & (YIELD_SIGNS | PRIORITY_SIGNS) for kinds, _ in signs.values()):
        return False
    for intersection in root.iterfind("intersection"):
        named = _refs(path, intersection, "incoming/incomingLanelet")
        coming = [lanelets[i] for i in named if i in lanelets]
        first = tuple(one.id for one in coming if not one.must_yield)
        for one in coming:
            if one.must_yield:
                lanelets[one.id] = replace(one, yields_to=first)
    return True
