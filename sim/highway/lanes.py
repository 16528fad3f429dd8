"""highway-env's lanes and network as this engine makes them: lanes along any line of points."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane, LineType
from highway_env.road.road import RoadNetwork

from sim.frames import FloatArray
from sim.highway.tables import BLEND_M, PIECE, TURN, project_on

LaneIndex: TypeAlias = tuple[str, str, int]
"""A lane in highway-env: the nodes that it leads from and to, and its place from the left."""

Stretch: TypeAlias = tuple[str, str]
"""Lanes side by side: the nodes that they lead from and to."""

STRAIGHT_TOLERANCE_M: Final = 1e-6
"""A line whose points are all this close to its chord is straight."""

LEAST_LENGTH_M: Final = 0.01
"""A line whose points are all this close together is drawn out to this length along +x, m."""

UNPAINTED: Final = (LineType.NONE, LineType.NONE)
"""What is painted on the left and on the right of a lane without lines."""


def is_wrong_side(lane: LaneIndex) -> bool:
    """Whether a lane runs over one of the opposite direction; see `HighwayNetwork.wrong_side`."""
    return lane[0].startswith("~")


class PolylineLane(AbstractLane):  # type: ignore[misc]
    """A lane of constant width along a line of points.

    Before its first point and after its last it goes on straight.

    Args:
        points: (P, 2) centre line in highway-env's axes, m.
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
        line_types: tuple[int, int] = UNPAINTED,
        speed_limit: float = 20.0,
        forbidden: bool = False,
        priority: int = 0,
    ) -> None:
        self.points = _simplest(np.asarray(points, dtype=np.float64))
        step = np.diff(self.points, axis=0)
        size = np.hypot(step[:, 0], step[:, 1])
        ahead = step / size[:, None]
        begin = np.cumsum(size) - size
        before, after = ahead[:-1], ahead[1:]
        turn = before[:, 1] * after[:, 0] - before[:, 0] * after[:, 1]
        sharp = (before * after).sum(axis=1) < 0.0
        pieces = self.pieces = np.zeros(len(size), PIECE)
        pieces["x"], pieces["y"] = self.points[:-1].T
        pieces["dx"], pieces["dy"] = ahead.T
        pieces["size"], pieces["begin"] = size, begin
        pieces["outside"][1:] = np.where(sharp, np.copysign(1.0, turn), 0.0)
        pieces["outside_end"][:-1] = pieces["outside"][1:]
        self.length = float(size.sum())
        self.width, self.line_types, self.speed_limit = width, line_types, speed_limit
        self.forbidden, self.priority = forbidden, priority
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        blend = np.minimum(np.minimum(size[:-1], size[1:]) / 2, BLEND_M)
        inside = np.column_stack([begin[1:] - blend, begin[1:] + blend]).ravel()
        self.turns = np.zeros(2 * len(size), TURN)
        self.turns["at"] = np.concatenate([[0.0], inside, [self.length]])
        self.turns["heading"] = np.repeat(heading, 2)

    def local_coordinates(self, position: FloatArray) -> tuple[float, float]:
        """Distance along the lane and to the right of it, m."""
        x, y = position
        return project_on(float(x), float(y), 0, len(self.pieces), self.pieces)[:2]

    def positions(self, along: FloatArray, lateral: float = 0.0) -> FloatArray:
        """(n, 2) the places at (n,) distances along the lane and so far to the right of it, m."""
        i = np.maximum(np.searchsorted(self.pieces["begin"], along, side="right") - 1, 0)
        x, y, dx, dy, begin = (self.pieces[name][i] for name in ("x", "y", "dx", "dy", "begin"))
        beyond = along - begin
        return np.stack([x + beyond * dx - lateral * dy, y + beyond * dy + lateral * dx], axis=-1)

    def position(self, longitudinal: float, lateral: float) -> FloatArray:
        """The place at a distance along the lane and to the right of it, m."""
        place: FloatArray = self.positions(np.array([longitudinal]), lateral)[0]
        return place

    def heading_at(self, longitudinal: float) -> float:
        """The lane's heading, rad, clockwise from +x as seen from above."""
        return float(np.interp(longitudinal, self.turns["at"], self.turns["heading"]))

    def width_at(self, longitudinal: float) -> float:
        """The lane's width, m."""
        return self.width

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> PolylineLane:
        """The lane that `to_config` described."""
        return cls(**config)

    def to_config(self) -> dict[str, Any]:
        """Not offered: networks are made from roads."""
        raise NotImplementedError


def _simplest(points: FloatArray) -> FloatArray:
    """A line without points that are twice there, or between the ends of a straight one."""
    if np.hypot(*(points - points[0]).T).max() <= LEAST_LENGTH_M:  # no direction of its own
        return np.stack([points[0], points[0] + np.array([LEAST_LENGTH_M, 0.0])])
    chord, off = points[-1] - points[0], points - points[0]
    size = float(np.hypot(*chord))
    across = (off[:, 1] * chord[0] - off[:, 0] * chord[1]) / max(size, 1e-9)
    if size > 0 and np.abs(across).max() < STRAIGHT_TOLERANCE_M:
        return np.stack([points[0], points[-1]])
    keep = np.hypot(*np.diff(points, axis=0).T) > 1e-9
    return np.concatenate([points[:-1][keep], points[-1:]])


class NearLanesNetwork(RoadNetwork):  # type: ignore[misc]
    """highway-env's network; it finds the closest lane without measuring those that are far away.

    All lanes have to be there before the first search.

    Examples:
        >>> network = NearLanesNetwork()
        >>> for y in (0.0, 4.0, 400.0):
        ...     lane = PolylineLane(np.array([[0.0, y], [50.0, y]]), 4.0)
        ...     network.add_lane("a", "b", lane)
        >>> network.get_closest_lane_index(np.array([20.0, 3.0]), 0.0)
        ('a', 'b', 1)
    """

    @cached_property
    def _circles(self) -> tuple[list[tuple[LaneIndex, PolylineLane]], FloatArray, FloatArray]:
        """All lanes, and a circle round each: middle and radius, m."""
        found = list(self.lanes_dict().items())
        boxes = np.array([(p.min(axis=0), p.max(axis=0)) for p in (n.points for _, n in found)])
        radius = np.hypot(*(boxes[:, 1] - boxes[:, 0]).T) / 2 + STRAIGHT_TOLERANCE_M
        return found, boxes.mean(axis=1), radius

    def get_closest_lane_index(
        self, position: FloatArray, heading: float | None = None
    ) -> LaneIndex:
        """The lane closest to a place, m, for a heading, rad; of equal ones the first."""
        lanes, centre, radius = self._circles
        at_least = np.hypot(*(centre - position).T) - radius
        best = (math.inf, -1)
        for i in np.argsort(at_least, kind="stable").tolist():
            if at_least[i] > best[0]:
                break
            best = min(best, (lanes[i][1].distance_with_heading(position, heading), i))
        return lanes[best[1]][0]
