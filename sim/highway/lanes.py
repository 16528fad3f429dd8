"""highway-env's lanes as this engine makes them, along any line of points."""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane

from sim.frames import FloatArray
from sim.highway.places import BLEND_M, project_on
from sim.highway.state import PIECE, TURN, Records

LaneIndex: TypeAlias = tuple[str, str, int]
"""A lane in highway-env: the nodes that it leads from and to, and its place from the left."""

Stretch: TypeAlias = tuple[str, str]
"""Lanes side by side: the nodes that they lead from and to."""

STRAIGHT_TOLERANCE_M: Final = 1e-6
"""A line whose points are all this close to its chord is straight."""

LEAST_LENGTH_M: Final = 0.01
"""A line whose points are all this close together is drawn out to this length along +x, m."""


class PolylineLane(AbstractLane):  # type: ignore[misc]
    """A lane of constant width along a line of points.

    Before its first point and after its last it goes on straight.

    Args:
        points: (P, 2) centre line in highway-env's axes, m.
        width: m.
        speed_limit: m/s.
        forbidden: whether vehicles of highway-env may not change to it.

    Examples:
        >>> lane = PolylineLane(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]), 3.2)
        >>> lane.length, lane.local_coordinates(np.array([9.0, 4.0]))
        (20.0, (14.0, 1.0))
    """

    def __init__(
        self,
        points: FloatArray,
        width: float,
        speed_limit: float = 20.0,
        forbidden: bool = False,
    ) -> None:
        self.points = _simplest(np.asarray(points, dtype=np.float64))
        pieces = self.pieces = straight_pieces(self.points)
        size, begin, step = pieces["size"], pieces["begin"], np.diff(self.points, axis=0)
        ahead = np.stack([pieces["dx"], pieces["dy"]], axis=1)
        before, after = ahead[:-1], ahead[1:]
        turn = before[:, 1] * after[:, 0] - before[:, 0] * after[:, 1]
        sharp = (before * after).sum(axis=1) < 0.0
        pieces["outside"][1:] = np.where(sharp, np.copysign(1.0, turn), 0.0)
        pieces["outside_end"][:-1] = pieces["outside"][1:]
        self.length = float(size.sum())
        self.width, self.speed_limit, self.forbidden = width, speed_limit, forbidden
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        blend = np.minimum(np.minimum(size[:-1], size[1:]) / 2, BLEND_M)
        inside = np.column_stack([begin[1:] - blend, begin[1:] + blend]).ravel()
        self.turns = np.zeros(2 * len(size), TURN)
        self.turns["begin"] = np.concatenate([[0.0], inside, [self.length]])
        self.turns["heading"] = np.repeat(heading, 2)

    def local_coordinates(self, position: FloatArray) -> tuple[float, float]:
        """Distance along the lane and to the right of it, m."""
        x, y = position
        return project_on(float(x), float(y), 0, len(self.pieces), self.pieces)[:2]

    def position(self, longitudinal: Any, lateral: float) -> FloatArray:
        """(2,) or (n, 2) places at a distance or (n,) along the lane and to the right of it, m."""
        i = np.maximum(np.searchsorted(self.pieces["begin"], longitudinal, side="right") - 1, 0)
        x, y, dx, dy, begin = (self.pieces[name][i] for name in ("x", "y", "dx", "dy", "begin"))
        beyond = longitudinal - begin
        return np.stack([x + beyond * dx - lateral * dy, y + beyond * dy + lateral * dx], axis=-1)

    def heading_at(self, longitudinal: float) -> float:
        """The lane's heading, rad, clockwise from +x as seen from above."""
        return float(np.interp(longitudinal, self.turns["begin"], self.turns["heading"]))

    def width_at(self, longitudinal: float) -> float:
        """The lane's width, m."""
        return self.width


def straight_pieces(points: FloatArray) -> Records:
    """(P - 1,) rows of `PIECE` along a line (P, 2), m, without sharp corners."""
    step = np.diff(points, axis=0)
    pieces, size = np.zeros(len(step), PIECE), np.hypot(step[:, 0], step[:, 1])
    pieces["x"], pieces["y"] = points[:-1].T
    pieces["dx"], pieces["dy"] = (step / size[:, None]).T
    pieces["size"], pieces["begin"] = size, np.cumsum(size) - size
    return pieces


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
