"""The road: lanes, how they connect, where one must stop, where people cross.

One geometry serves every engine, the predictors, the trait detectors and the pictures. It is read
from a SUMO net by `sim.road.net.read_road`, or from a recording's own map.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError, counted
from sim.frames import FloatArray, IntArray, Signal

MAX_COORDINATE_M: Final = 1e9
"""Largest absolute coordinate of a map (beyond any UTM coordinate)."""

MAX_LENGTH_M, MAX_WIDTH_M = 1e7, 1000.0
"""Longest that all lanes and crossings of a map may be together, m (a city's streets are some
thousand km), and the widest lane, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """One lane, or one path across a junction.

    Attributes:
        id: unique name.
        edge: the edge (stretch of road in one direction) it belongs to.
        index: place on its edge, 0 rightmost.
        centerline: (P, 2) points in driving direction, m.
        width_m: m.
        speed_limit_mps: m/s; NaN where unknown.
        walking: whether it is a sidewalk (pedestrians only).
        internal: whether it crosses a junction.
        opposite: id of the neighbouring lane of the other direction; "" if there is none that may
            be used for overtaking.
        cars: whether cars may drive on it; a lane for bicycles, buses or trams only is none of
            theirs.
    """

    id: str
    edge: str
    index: int
    centerline: FloatArray
    width_m: float
    speed_limit_mps: float
    walking: bool = False
    internal: bool = False
    opposite: str = ""
    cars: bool = True

    @property
    def length_m(self) -> float:
        """Length of the centre line, m."""
        return float(np.hypot(*np.diff(self.centerline, axis=0).T).sum())


@dataclass(frozen=True, slots=True)
class Connection:
    """A way from the end of one lane to the start of another.

    Attributes:
        from_lane: id of the lane that ends.
        to_lane: id of the lane that begins.
        via: ids of the internal lanes in between, in order.
        direction: "straight", "left", "right" or "turnaround".
        signal: index of the signal group that controls it, -1 if none.
        must_yield: whether other vehicles have priority over it (pedestrians: see `Crossing`).
        must_stop: whether it has a stop sign.
        yields_to: indices into ``Road.connections`` of those that have priority over it.
    """

    from_lane: str
    to_lane: str
    via: tuple[str, ...]
    direction: str
    signal: int = -1
    must_yield: bool = False
    must_stop: bool = False
    yields_to: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """Where pedestrians cross the road.

    Attributes:
        id: unique name.
        centerline: (P, 2) points along the walking direction, m.
        width_m: m.
        edges: ids of the road edges that it crosses.
        signal: index of the signal group that controls it, -1 if none.
        priority: whether pedestrians have priority over vehicles.
    """

    id: str
    centerline: FloatArray
    width_m: float
    edges: tuple[str, ...]
    signal: int = -1
    priority: bool = True


@dataclass(frozen=True, slots=True)
class SignalPlan:
    """The fixed-time programme of one set of traffic lights.

    Attributes:
        id: the traffic lights' id in the net.
        groups: indices of the signal groups that it controls.
        links: for each of those groups, one of its links' index in the programme's state strings.
        duration_s: (P,) length of each phase, s.
        states: per phase, the code into ``SIGNALS`` of each of its groups.
        offset_s: how far into the programme time 0 is, s, negated as SUMO has it.
    """

    id: str
    groups: tuple[int, ...]
    links: tuple[int, ...]
    duration_s: tuple[float, ...]
    states: tuple[tuple[int, ...], ...]
    offset_s: float = 0.0

    def state_at(self, time_s: float) -> tuple[int, ...]:
        """Codes into ``SIGNALS`` of ``groups`` at a time.

        Examples:
            >>> plan = SignalPlan("t", (0,), (0,), (30.0, 30.0), ((2,), (0,)))
            >>> plan.state_at(29.9), plan.state_at(30.0), plan.phase_at(25.0)
            ((2,), (0,), ((2,), 5.0))
        """
        return self.phase_at(time_s)[0]

    def phase_at(self, time_s: float) -> tuple[tuple[int, ...], float]:
        """Codes as of `state_at`, and how long the phase still lasts, s."""
        into = (time_s - self.offset_s) % sum(self.duration_s)
        for duration, state in zip(self.duration_s, self.states, strict=True):
            into -= duration
            if into < -1e-9:
                return state, -into
        return self.states[0], self.duration_s[0]


@dataclass(frozen=True, slots=True)
class LanePosition:
    """Points in lane coordinates.

    Attributes:
        lane: (n,) index into ``Road.lanes``.
        s: (n,) distance along the lane's centre line, m.
        offset: (n,) signed distance to the left of the centre line, m.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray


@dataclass(frozen=True, slots=True)
class MapKnowledge:
    """Facts that a map provides; all others are unknown.

    Attributes:
        limits: whether it has speed limits.
        signals: whether it says where lights stand and what they show.
        priority: whether it says who has to let whom go first.
        limits_rule: whether traffic follows the limits; False where recorded traffic is much
            slower or faster.
    """

    limits: bool = True
    signals: bool = True
    priority: bool = True
    limits_rule: bool = True

    @property
    def unknown(self) -> tuple[str, ...]:
        """The facts that it does not provide, in words: ("signals",)."""
        return tuple(name for name in ("limits", "signals", "priority") if not getattr(self, name))


@dataclass(frozen=True)
class Road:
    """A road network.

    Attributes:
        name: what it is called.
        lanes: all lanes, junction paths and sidewalks.
        connections: ways between lanes (vehicles only).
        crossings: where pedestrians cross.
        signal_groups: names of the groups whose states `Frame.signals` gives, in that order.
        source: the file it was read from.
        signal_plans: the programmes behind the signal groups, at most one for each group.
        knows: facts that its map provides; a SUMO net provides all.
        left_hand: whether traffic drives on the left; a lane's index 0 is then the leftmost.
        doubts: what of its map is left out because it is broken, a sentence each.
    """

    name: str
    lanes: tuple[Lane, ...]
    connections: tuple[Connection, ...]
    crossings: tuple[Crossing, ...]
    signal_groups: tuple[str, ...]
    source: Path
    signal_plans: tuple[SignalPlan, ...] = ()
    knows: MapKnowledge = MapKnowledge()
    left_hand: bool = False
    doubts: tuple[str, ...] = ()

    def __hash__(self) -> int:
        """A cheap hash: caches per road are looked up at every frame."""
        return hash((self.name, self.source, len(self.lanes), len(self.connections), self.knows))

    def __repr__(self) -> str:
        """How many lanes of each use it has, their length, and its extent."""
        lanes = [lane for lane in self.lanes if not (lane.internal or lane.walking)]
        walking = sum(lane.walking for lane in self.lanes)
        counts = {
            "junction path": len(self.lanes) - len(lanes) - walking,
            "sidewalk": walking,
            "connection": len(self.connections),
            "crossing": len(self.crossings),
            "signal group": len(self.signal_groups),
        }
        length_km = sum(lane.length_m for lane in lanes) / 1000
        said = [f"{counted(len(lanes), 'lane')} ({length_km:.2f} km in all)"]
        said += [counted(count, what) for what, count in counts.items()]
        x0, y0, x1, y1 = self.bounds if self.lanes else (0.0,) * 4
        more = f" in {x1 - x0:.0f} m x {y1 - y0:.0f} m" if self.lanes else ""
        if self.knows.unknown:
            more += f"; unknown: {', '.join(self.knows.unknown)}"
        if self.knows.limits and not self.knows.limits_rule:
            more += "; its limits do not rule"
        return f"Road({self.name:.60}: {', '.join(said)}{more})"

    def svg(self, edge_colors: Mapping[str, str] | None = None) -> str:
        """A picture of the centre lines, as wide as lanes are; paths of junctions lie below.

        Args:
            edge_colors: colours of the vehicles' lanes by edge, instead of grey.
        """
        x0, y0, x1, y1 = self.bounds
        x, y, wide, high = x0 - 10.0, -y1 - 10.0, x1 - x0 + 20.0, y1 - y0 + 20.0  # a white margin
        lines = []
        for lane in sorted(self.lanes, key=lambda one: not one.internal):
            color = "#d9d4c7" if lane.walking else "#a9b1bb" if lane.internal else "#5b6470"
            if edge_colors and not lane.walking:
                color = edge_colors.get(lane.edge, color)
            lines.append((lane.centerline, 0.85 * lane.width_m, color))
        lines += [(crossing.centerline, crossing.width_m, "#e8c468") for crossing in self.crossings]
        parts = [
            '<svg xmlns="http://www.w3.org/2000/svg" width="1000" '
            f'viewBox="{x:.1f} {y:.1f} {wide:.1f} {high:.1f}" '
            f'height="{max(1000 * high / wide, 80):.0f}" style="background: white">',
            f"<title>{html.escape(self.name)}</title>",
        ]
        for line, width_m, color in lines:
            points = " ".join(f"{x:.2f},{-y:.2f}" for x, y in line)
            style = f'fill="none" stroke="{color}" stroke-width="{width_m:.2f}"'
            parts.append(f'<polyline {style} points="{points}"/>')
        return "\n".join([*parts, "</svg>\n"])

    def _repr_html_(self) -> str:
        """A picture and a summary, for notebooks."""
        if not self.lanes:
            return f"<p>{html.escape(repr(self))}</p>"
        caption = html.escape(repr(self))
        return f"<figure>{self.svg()}<figcaption>{caption}</figcaption></figure>"

    @cached_property
    def mirrored(self) -> Road:
        """The road in a mirror along the x axis: traffic on the left is then on the right."""
        road = self.with_lines(lambda line: line * [1.0, -1.0])
        swapped = {"left": "right", "right": "left"}
        connections = tuple(
            replace(one, direction=swapped.get(one.direction, one.direction))
            for one in self.connections
        )
        return replace(road, connections=connections, left_hand=not self.left_hand)

    def with_lines(self, change: Callable[[FloatArray], FloatArray]) -> Road:
        """The road with every centre line changed, as by a shift."""
        lanes = tuple(replace(one, centerline=change(one.centerline)) for one in self.lanes)
        crossings = tuple(replace(one, centerline=change(one.centerline)) for one in self.crossings)
        return replace(self, lanes=lanes, crossings=crossings)

    def checked(self) -> Road:
        """The road itself; an `InputError` that names its file if its parts make no road."""

        def require(holds: object, what: str, expected: str) -> None:
            if not holds:
                raise InputError(f"{self.source}: {what}: found others, expected {expected}")

        lines = [lane.centerline for lane in self.lanes]
        lines += [crossing.centerline for crossing in self.crossings]
        require(all(len(line) >= 2 for line in lines), "lines", "2 points or more")
        near = all((np.abs(line) <= MAX_COORDINATE_M).all() for line in lines)
        require(near, "points", f"metres, up to {MAX_COORDINATE_M:g}")
        size_m = sum(float(np.hypot(*np.diff(line, axis=0).T).sum()) for line in lines)
        require(0 < size_m <= MAX_LENGTH_M, f"{size_m:.3g} m of lanes", f"up to {MAX_LENGTH_M:g}")
        require(len(self.lane_index) == len(self.lanes), "lanes", "each id once")
        widths = [0 <= lane.width_m <= MAX_WIDTH_M for lane in self.lanes]
        require(all(widths), "lanes", f"a width up to {MAX_WIDTH_M:g} m")
        named = {id for one in self.connections for id in (one.from_lane, *one.via, one.to_lane)}
        require(named <= self.lane_index.keys(), "connections", "lanes of the road")
        groups = [group for plan in self.signal_plans for group in plan.groups]
        once = len({*groups}) == len(groups) and {*groups} <= {*range(len(self.signal_groups))}
        require(once, "signal_plans", "each group once")
        for plan in self.signal_plans:
            fits = len(plan.duration_s) == len(plan.states) and min(plan.duration_s) >= 0
            fits &= 0 < sum(plan.duration_s) < np.inf and abs(plan.offset_s) < np.inf
            require(fits, "signal_plans", "seconds of each phase")
        return self

    @cached_property
    def lane_index(self) -> dict[str, int]:
        """Index into ``lanes`` of each lane id."""
        return {lane.id: i for i, lane in enumerate(self.lanes)}

    @cached_property
    def connection_of_lane(self) -> IntArray:
        """(L + 1,) index of the connection that each lane is part of; -1 outside junctions.

        The last entry is -1, so that lane -1 (no lane) has no connection either.
        """
        found = np.full(len(self.lanes) + 1, -1, dtype=np.int64)
        for index, link in reversed(list(enumerate(self.connections))):
            found[[self.lane_index[name] for name in link.via]] = index
        return found

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x and y and largest x and y of any centre line, m."""
        points = np.concatenate([lane.centerline for lane in self.lanes])
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    def green_together(self, one: int, other: int) -> bool:
        """Whether two signal groups ever let go at the same time; -1, no signal, always does."""
        if one < 0 or other < 0:
            return True
        green = Signal.GREEN.code
        for plan in self.signal_plans:
            if one in plan.groups and other in plan.groups:
                first, second = plan.groups.index(one), plan.groups.index(other)
                return any(states[first] == green == states[second] for states in plan.states)
        return False

    def first_come(self, one: int, two: int) -> bool:
        """Whether neither of two connections has priority: the vehicle that comes first goes first.

        This holds where signals never let both go, and where each yields to the other (all-way
        stops).
        """
        first, second = self.connections[one], self.connections[two]
        if not self.green_together(first.signal, second.signal):
            return True
        return two in first.yields_to and one in second.yields_to
