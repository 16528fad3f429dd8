"""A highway-env lane along any line of points, with a heading that turns smoothly.

highway-env's own spline lane samples its curve and is slow to project on; junction paths have a
handful of points, so a loop over their pieces is quicker and exact.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LaneIndex: TypeAlias = tuple[str, str, int]
"""A lane in highway-env: the nodes that it leads from and to, and its place from the left."""

STRAIGHT_TOLERANCE_M: Final = 1e-6
"""A line whose points are all this close to its chord is straight."""

LEAST_LENGTH_M: Final = 0.01
"""A line whose points are all this close together is drawn out to this length along +x, m."""

BLEND_M: Final = 2.0
"""The heading turns from one piece's to the next's within this distance of the corner (half a
wheelbase)."""


def is_wrong_side(lane: LaneIndex) -> bool:
    """Whether a lane runs over one of the opposite direction; see `HighwayNetwork.wrong_side`."""
    return lane[0].startswith("~")


class PolylineLane(AbstractLane):  # type: ignore[misc]
    """A lane of constant width along a line of points.

    Before its first point and after its last it goes on straight.

    Args:
        points: (P, 2) centre line in highway-env's axes, m; at least two different points.
        width: m.
        line_types: what is painted on the left and on the right.
        speed_limit: m/s.

    Examples:
        >>> lane = PolylineLane(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]), 3.2)
        >>> lane.length, lane.local_coordinates(np.array([9.0, 4.0]))
        (20.0, (14.0, 1.0))
    """

    def __init__(
        self,
        points: FloatArray,
        width: float,
        line_types: tuple[int, int] = (LineType.NONE, LineType.NONE),
        speed_limit: float = 20.0,
        forbidden: bool = False,
        priority: int = 0,
    ) -> None:
        points = np.asarray(points, dtype=np.float64)
        step = np.diff(points, axis=0)
        size = np.hypot(step[:, 0], step[:, 1])
        keep = size > 1e-9
        self.points = np.concatenate([points[:-1][keep], points[-1:]])
        step, size = step[keep], size[keep]
        self.starts: list[tuple[float, float]] = [(float(x), float(y)) for x, y in self.points[:-1]]
        self.directions: list[tuple[float, float]] = [
            (float(x / d), float(y / d)) for (x, y), d in zip(step, size, strict=True)
        ]
        self.sizes: list[float] = size.tolist()
        self.begins: list[float] = (np.cumsum(size) - size).tolist()
        self.outsides: list[float] = [
            math.copysign(1.0, dy * ex - dx * ey) if dx * ex + dy * ey < 0.0 else 0.0
            for (dx, dy), (ex, ey) in itertools.pairwise(self.directions)
        ]  # of corners sharper than 90 degrees: the side on which the far side of the corner lies
        self.length = float(size.sum())
        self.width = width
        self.line_types = line_types
        self.speed_limit = speed_limit
        self.forbidden = forbidden
        self.priority = priority
        self.turn_at, self.turn_heading = self._turns(
            np.unwrap(np.arctan2(step[:, 1], step[:, 0])), size
        )

    def _turns(self, heading: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances and headings between which the heading is interpolated."""
        at, value = [0.0], [float(heading[0])]
        for i in range(1, len(size)):
            blend = min(BLEND_M, size[i - 1] / 2, size[i] / 2)
            corner = self.begins[i]
            at += [corner - blend, corner + blend]
            value += [float(heading[i - 1]), float(heading[i])]
        return np.array([*at, self.length]), np.array([*value, float(heading[-1])])

    def local_coordinates(self, position: FloatArray) -> tuple[float, float]:
        """Distance along the lane and to the right of it, m."""
        x, y = float(position[0]), float(position[1])
        last = len(self.sizes) - 1
        best, longitudinal, lateral = math.inf, 0.0, 0.0
        for i, ((x0, y0), (dx, dy), size) in enumerate(
            zip(self.starts, self.directions, self.sizes, strict=True)
        ):
            along = (x - x0) * dx + (y - y0) * dy
            across = (y - y0) * dx - (x - x0) * dy
            clipped, side = along, across
            if along < 0.0 and i > 0:
                clipped, side = 0.0, self.outsides[i - 1] or across
            elif along > size and i < last:
                clipped, side = size, self.outsides[i] or across
            distance = math.hypot(across, along - clipped)
            if distance < best:
                best = distance
                longitudinal, lateral = self.begins[i] + clipped, math.copysign(distance, side)
        return longitudinal, lateral

    def position(self, longitudinal: float, lateral: float) -> FloatArray:
        """The place at a distance along the lane and to the right of it, m."""
        i = 0
        while i + 1 < len(self.begins) and self.begins[i + 1] <= longitudinal:
            i += 1
        (x0, y0), (dx, dy) = self.starts[i], self.directions[i]
        along = longitudinal - self.begins[i]
        return np.array([x0 + along * dx - lateral * dy, y0 + along * dy + lateral * dx])

    def heading_at(self, longitudinal: float) -> float:
        """The lane's heading, rad, clockwise from +x as seen from above."""
        return float(np.interp(longitudinal, self.turn_at, self.turn_heading))

    def curvature_at(self, longitudinal: float) -> float:
        """How fast the heading turns over `BLEND_M` around a place, rad/m."""
        before, after = longitudinal - BLEND_M / 2, longitudinal + BLEND_M / 2
        return (self.heading_at(after) - self.heading_at(before)) / BLEND_M

    def width_at(self, longitudinal: float) -> float:
        """The lane's width, m."""
        return self.width

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> PolylineLane:
        """The lane that `to_config` described."""
        return cls(**{**config, "points": np.array(config["points"])})

    def to_config(self) -> dict[str, Any]:
        """What `highway_env.road.lane.lane_from_config` needs to make it again."""
        return {
            "class_path": f"{type(self).__module__}.{type(self).__qualname__}",
            "config": {
                "points": self.points.tolist(),
                "width": self.width,
                "line_types": self.line_types,
                "speed_limit": self.speed_limit,
                "forbidden": self.forbidden,
                "priority": self.priority,
            },
        }


def make_lane(
    points: FloatArray,
    width: float,
    line_types: tuple[int, int],
    speed_limit: float,
) -> StraightLane | PolylineLane:
    """The simplest highway-env lane along a line of points in its axes.

    Args:
        points: (P, 2) m.
        width: m.
        line_types: what is painted on the left and on the right.
        speed_limit: m/s.

    Returns:
        A straight lane if the line is straight, else a polyline.
    """
    if np.hypot(*(points - points[0]).T).max() <= LEAST_LENGTH_M:  # no direction of its own
        points = np.stack([points[0], points[0] + np.array([LEAST_LENGTH_M, 0.0])])
    chord = points[-1] - points[0]
    size = float(np.hypot(*chord))
    off = points - points[0]
    across = (off[:, 1] * chord[0] - off[:, 0] * chord[1]) / max(size, 1e-9)
    if size > 0 and np.abs(across).max() < STRAIGHT_TOLERANCE_M:
        return StraightLane(
            points[0], points[-1], width=width, line_types=line_types, speed_limit=speed_limit
        )
    return PolylineLane(points, width, line_types, speed_limit)


def places_along(lane: AbstractLane, along: FloatArray) -> FloatArray:
    """The places at distances along a lane's centre line, as ``lane.position`` gives each.

    Args:
        lane: made by `make_lane`.
        along: (n,) m.

    Returns:
        (n, 2) m.
    """
    if not isinstance(lane, PolylineLane):
        return np.asarray(lane.start + along[:, None] * lane.direction)
    begins = np.array(lane.begins)
    piece = np.maximum(np.searchsorted(begins, along, side="right") - 1, 0)
    beyond = (along - begins[piece])[:, None]
    places: FloatArray = np.array(lane.starts)[piece] + beyond * np.array(lane.directions)[piece]
    return places


def corners(lanes: Sequence[AbstractLane]) -> list[FloatArray]:
    """The centre line of each lane as points, in highway-env's axes."""
    return [
        lane.points
        if isinstance(lane, PolylineLane)
        else np.stack([lane.start, lane.end]).astype(np.float64)
        for lane in lanes
    ]


class NearLanesNetwork(RoadNetwork):  # type: ignore[misc]
    """highway-env's network; it finds the closest lane without measuring those that are far away.

    Examples:
        >>> network = NearLanesNetwork()
        >>> for y in (0.0, 4.0, 400.0):
        ...     network.add_lane("a", "b", StraightLane([0.0, y], [50.0, y]))
        >>> network.get_closest_lane_index(np.array([20.0, 3.0]), 0.0)
        ('a', 'b', 1)
    """

    _circles: tuple[list[tuple[str, str, int]], list[AbstractLane], FloatArray, FloatArray] | None
    _circles = None

    def add_lane(self, _from: str, _to: str, lane: AbstractLane) -> None:
        """Add a lane between two nodes."""
        self._circles = None
        super().add_lane(_from, _to, lane)

    def get_closest_lane_index(
        self, position: FloatArray, heading: float | None = None
    ) -> tuple[str, str, int]:
        """The lane closest to a place, m, for a heading, rad; of equal ones the first."""
        if self._circles is None:
            found = dict(self.lanes_dict())
            lines = corners(list(found.values()))
            centre = np.array([(line.min(axis=0) + line.max(axis=0)) / 2 for line in lines])
            radius = np.array(
                [np.hypot(*(line - c).T).max() for line, c in zip(lines, centre, strict=True)]
            )
            self._circles = list(found), list(found.values()), centre, radius
        keys, lanes, centre, radius = self._circles
        at_least = np.hypot(*(centre - position).T) - radius - STRAIGHT_TOLERANCE_M
        choice = int(np.argmin(at_least))
        least = lanes[choice].distance_with_heading(position, heading)
        near = np.flatnonzero(at_least <= least)
        for i in near[np.argsort(at_least[near], kind="stable")].tolist():
            if at_least[i] > least:
                break
            distance = lanes[i].distance_with_heading(position, heading)
            if distance < least or (distance == least and i < choice):
                choice, least = i, distance
        return keys[choice]
