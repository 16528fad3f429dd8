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
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import Signal
from sim.road import Crossing, Road, SignalPlan
from sim.road.maps.lanelets import (
    MAX_COORDINATE_M,
    Lanelet,
    between,
    road_of_lanelets,
    with_junctions,
)
from sim.xml_tree import read_tree, whole_number

ROOT: Final = "commonRoad"

LIMIT_SIGNS: Final = frozenset(
    {"274", "274.1", "R2-1", "B14", "C43", "R15", "R-32", "B31", "50", "3.24", "r301"}
)
"""Signs whose value is a speed limit: Germany, USA, France, Belgium, Argentina, Greece, Croatia,
Italy, Russia and Spain, as CommonRoad numbers them."""

STOP_SIGNS: Final = frozenset({"206", "R1-1"})
YIELD_SIGNS: Final = frozenset({"205", "R1-2"})
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

SHORTEST_YELLOW_S: Final = 1.0
"""A programme with a shorter yellow, or a green below twice that, has a wrong unit and is ignored
(codes of practice ask for 3 s)."""


def read_map(path: Path, name: str | None = None) -> Road:
    """Read the road of a scenario.

    Args:
        path: a CommonRoad ``.xml`` or ``.xml.gz``.
        name: what to call the road; by default the file's name without its ending.

    Returns:
        Its lanes, ways, crossings and lights; lane ids are those of the file.

    Raises:
        InputError: if the file is broken or has no lanelet; names the file and the element.
    """
    road = road_of(path, read_tree(path), name)
    if road is None:
        raise InputError(f"{path}: found no lanelet, expected at least one")
    return road


def road_of(path: Path, root: Element, name: str | None = None) -> Road | None:
    """The road of a scenario that is already parsed.

    Args:
        path: the file, for messages.
        root: its ``commonRoad`` element.
        name: what to call the road; by default the file's name without its ending.

    Returns:
        The road; None where the scenario has no lanelets.

    Raises:
        InputError: as `read_map`.
    """
    if root.tag != ROOT:
        raise InputError(f"{path}: found element {root.tag[:60]!r}, expected {ROOT}")
    elements = root.findall("lanelet")
    if not elements:
        return None
    signs = _signs(path, root)
    lights = _lights(path, root)
    found: dict[int, Lanelet] = {}
    crossings: list[Crossing] = []
    inside = _inside(path, root)
    broken: list[str] = []
    for element in sorted(elements, key=lambda e: whole_number(path, e, "id")):
        try:
            lanelet, types = _lanelet(path, element, signs, lights, inside)
        except InputError as error:
            broken.append(str(error))
            continue
        if lanelet.id in found:
            raise InputError(f"{path}: found lanelet {lanelet.id} twice, expected it once")
        if "crosswalk" in types:
            crossings.append(Crossing(str(lanelet.id), lanelet.centerline, lanelet.width_m, ()))
        else:
            found[lanelet.id] = lanelet
    found = _with_predecessors(path, elements, found)
    if not any(one.internal for one in found.values()):
        found = with_junctions(found)
    priority = _yielding(path, root, found, signs)
    left, right = (
        len(root.findall(f"lanelet/adjacent{side}[@drivingDir='opposite']"))
        for side in ("Left", "Right")
    )
    return road_of_lanelets(
        path, name, found, crossings, priority, lights.groups, lights.plans, right > left, broken
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
        raise InputError(
            f"{path}: {what}: found {value}, expected a number up to {MAX_COORDINATE_M:g}"
        )
    return value


def line_of(path: Path, element: Element | None, what: str) -> NDArray[np.float64]:
    """(P, 2) the ``point`` elements of an element, m.

    Raises:
        InputError: if there are fewer than two, or a coordinate is missing or no number.
    """
    points = [] if element is None else list(element.iter("point"))
    if len(points) < 2:
        raise InputError(f"{path}: {what}: found {len(points)} points, expected 2 or more")
    told = [[point.findtext(axis) or "" for axis in "xy"] for point in points]
    try:
        return np.array(told, dtype=np.float64)
    except ValueError:
        raise InputError(f"{path}: {what}: found a point that is not a number") from None


class _Sign(NamedTuple):
    """Meaning of a traffic sign."""

    limit_mps: float = math.nan
    stop: bool = False
    yields: bool = False
    goes_first: bool = False


def _signs(path: Path, root: Element) -> dict[int, _Sign]:
    """Every traffic sign by its id."""
    found = {}
    for sign in root.iterfind("trafficSign"):
        parts = [((e.findtext("trafficSignID") or "").strip(), e.findtext("additionalValue"))
                 for e in sign.iterfind("trafficSignElement")]  # fmt: skip
        kinds = {kind for kind, _ in parts}
        limits = [_limit(path, text) for kind, text in parts if text and kind in LIMIT_SIGNS]
        found[whole_number(path, sign, "id")] = _Sign(
            limits[-1] if limits else math.nan,
            stop=bool(kinds & STOP_SIGNS),
            yields=bool(kinds & (YIELD_SIGNS | STOP_SIGNS)),
            goes_first=bool(kinds & PRIORITY_SIGNS),
        )
    return found


def _limit(path: Path, text: str) -> float:
    value = real(path, text, "speed limit")
    if value <= 0:
        raise InputError(f"{path}: speed limit: found {value:g}, expected more than 0")
    return value


class _Lights(NamedTuple):
    """Traffic lights with a plausible programme, and the group of each by its id."""

    groups: tuple[str, ...] = ()
    plans: tuple[SignalPlan, ...] = ()
    group_of: Mapping[int, int] = {}


def _lights(path: Path, root: Element) -> _Lights:
    """The lights of a scenario; none where any light's programme is missing or odd."""
    step_s = real(path, root.get("timeStepSize"), "timeStepSize")
    plans, group_of = list[SignalPlan](), dict[int, int]()
    for light in root.iterfind("trafficLight"):
        identity = whole_number(path, light, "id")
        phases = _phases(path, light, step_s)
        if phases is None or identity in group_of:
            return _Lights()
        offset_s = real(path, light.findtext("cycle/timeOffset") or "0", "timeOffset") * step_s
        group = group_of[identity] = len(plans)
        plans.append(SignalPlan(str(identity), (group,), (0,), *phases, offset_s))
    return _Lights(tuple(plan.id for plan in plans), tuple(plans), group_of)


def _phases(
    path: Path, light: Element, step_s: float
) -> tuple[tuple[float, ...], tuple[tuple[int, ...], ...]] | None:
    """Lengths, s, and states of a light's phases; None where they are missing or too short."""
    elements = light.findall("cycle/cycleElement")
    if (light.findtext("active") or "true").strip() == "false" or not elements:
        return None
    durations, states = list[float](), list[Signal]()
    for element in elements:
        color = (element.findtext("color") or "").strip()
        if color not in COLORS:
            raise InputError(f"{path}: color: found {color[:40]!r}, expected one of {list(COLORS)}")
        duration = real(path, element.findtext("duration"), "duration") * step_s
        if duration <= 0:
            raise InputError(f"{path}: duration: found {duration:g} s, expected more than 0")
        durations.append(duration)
        states.append(COLORS[color])
    least = {Signal.YELLOW: SHORTEST_YELLOW_S, Signal.GREEN: 2 * SHORTEST_YELLOW_S}
    if any(d < least.get(s, 0.0) for d, s in zip(durations, states, strict=True)):
        return None
    return tuple(durations), tuple((state.code,) for state in states)


def _inside(path: Path, root: Element) -> frozenset[int]:
    """Ids of the lanelets that cross an intersection, as the scenario says."""
    return frozenset(
        whole_number(path, element, "ref")
        for incoming in root.iterfind("intersection/incoming")
        for element in incoming
        if element.tag in ("successorsLeft", "successorsStraight", "successorsRight")
    )


def _refs(path: Path, element: Element, *tags: str) -> tuple[int, ...]:
    return tuple(whole_number(path, e, "ref") for tag in tags for e in element.iterfind(tag))


def _lanelet(
    path: Path,
    element: Element,
    signs: Mapping[int, _Sign],
    lights: _Lights,
    inside: frozenset[int],
) -> tuple[Lanelet, frozenset[str]]:
    """A lanelet, and its types."""
    identity = whole_number(path, element, "id")
    left = line_of(path, element.find("leftBound"), f"lanelet {identity} leftBound")
    right = line_of(path, element.find("rightBound"), f"lanelet {identity} rightBound")
    centerline, width_m = between(left, right)
    types = frozenset((e.text or "").strip() for e in element.iterfind("laneletType"))
    users = {(e.text or "").strip() for e in element.iter("userOneWay")}
    limit = element.findtext("speedLimit")
    limits = [] if limit is None else [_limit(path, limit)]
    at_end = _refs(path, element, "trafficSignRef", "stopLine/trafficSignRef")
    seen = [signs[i] for i in at_end if i in signs]
    limits += [sign.limit_mps for sign in seen if math.isfinite(sign.limit_mps)]
    lit = _refs(path, element, "trafficLightRef", "stopLine/trafficLightRef")
    groups = [lights.group_of[i] for i in lit if i in lights.group_of]
    return Lanelet(
        id=identity,
        centerline=centerline,
        width_m=width_m,
        successors=tuple(dict.fromkeys(_refs(path, element, "successor"))),
        internal=identity in inside or "intersection" in types,
        left=_neighbour(path, element, "adjacentLeft"),
        right=_neighbour(path, element, "adjacentRight"),
        use=",".join(sorted(types & NOT_FOR_CARS)),
        limit_mps=min(limits, default=math.nan),
        walking="sidewalk" in types,
        cars=not types & NOT_FOR_CARS and (not users or bool(users & CAR_USERS)),
        signal=groups[0] if groups else -1,
        must_stop=any(sign.stop for sign in seen),
        must_yield=any(sign.yields for sign in seen),
    ), types


def _neighbour(path: Path, element: Element, tag: str) -> int | None:
    """Id of the neighbour on a side, if it goes the same way."""
    beside = element.find(tag)
    if beside is None or beside.get("drivingDir") == "opposite":
        return None
    return whole_number(path, beside, "ref")


def _with_predecessors(
    path: Path, elements: list[Element], lanelets: dict[int, Lanelet]
) -> dict[int, Lanelet]:
    """The lanelets, those that only their successors name as predecessors included."""
    further: dict[int, list[int]] = {}
    for element in elements:
        identity = whole_number(path, element, "id")
        for before in _refs(path, element, "predecessor"):
            if before in lanelets and identity not in lanelets[before].successors:
                further.setdefault(before, []).append(identity)
    return {
        i: replace(one, successors=(*one.successors, *dict.fromkeys(further.get(i, ()))))
        for i, one in lanelets.items()
    }


def _yielding(
    path: Path, root: Element, lanelets: dict[int, Lanelet], signs: Mapping[int, _Sign]
) -> bool:
    """Set the priorities at intersections with signs; whether any are known."""
    if not any(sign.yields or sign.goes_first for sign in signs.values()):
        return False
    for intersection in root.iterfind("intersection"):
        coming = _refs(path, intersection, "incoming/incomingLanelet")
        coming = tuple(i for i in coming if i in lanelets)
        first = tuple(i for i in coming if not lanelets[i].must_yield)
        for i in coming:
            if lanelets[i].must_yield:
                lanelets[i] = replace(lanelets[i], yields_to=first)
    return True
