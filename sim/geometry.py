"""Lines of points, (P, 2) m, and the outlines of vehicles, in numpy.

The compiled counterparts for loops are in `sim.road.lane_search`. Outlines are rectangles
about the vehicles' centres, turned by their headings. Two are apart if their projections onto one
of the four axes are (separating axis theorem).

References:
    Gottschalk, Lin, Manocha (1996), OBBTree: a hierarchical structure for rapid interference
    detection, SIGGRAPH.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sim.frames import FloatArray, IntArray

GRAZE_M: Final = 0.15
"""Overlap of outlines without a contact, m, since cars' corners are rounded and recorded positions
are inexact."""

LEAST_PIECE_M: Final = 1e-9
"""Shorter pieces of a line have no direction, m."""


class Pieces(NamedTuple):
    """The straight pieces of a line; points that coincide make none.

    Attributes:
        start, direction: (G, 2) where each begins, m, and unit vectors.
        length, at: (G,) m, and the distance along the line at which each begins, m.
    """

    start: FloatArray
    direction: FloatArray
    length: FloatArray
    at: FloatArray


def pieces_of(line: FloatArray) -> Pieces:
    """The straight pieces of a line (P, 2), m.

    Examples:
        >>> pieces_of(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 4.0]])).length.tolist()
        [4.0]
    """
    step = np.diff(line, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    kept = size > LEAST_PIECE_M
    step, size = step[kept], size[kept]
    return Pieces(line[:-1][kept], step / size[:, None], size, np.cumsum(size) - size)


def distances_along(line: FloatArray) -> FloatArray:
    """(P,) distance along a line (P, 2) at which each of its points lies, m."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def points_at(line: FloatArray, along_m: FloatArray) -> FloatArray:
    """(n, 2) points at distances (n,) along a line, m; its ends for distances beyond them."""
    at = distances_along(line)
    return np.stack([np.interp(along_m, at, line[:, axis]) for axis in (0, 1)], axis=1)


def offset_line(line: FloatArray, left_m: float) -> FloatArray:
    """A line moved to its left by a distance, m, at each point along the mean of both normals."""
    step = np.diff(line, axis=0)
    direction = step / np.maximum(np.hypot(step[:, 0], step[:, 1]), LEAST_PIECE_M)[:, None]
    mean = np.concatenate([direction[:1], direction[:-1] + direction[1:], direction[-1:]])
    mean = mean / np.maximum(np.hypot(mean[:, 0], mean[:, 1]), LEAST_PIECE_M)[:, None]
    return line + np.stack([-mean[:, 1], mean[:, 0]], axis=1) * left_m


def borders(line: FloatArray, width_m: float) -> tuple[FloatArray, FloatArray]:
    """The left and right border (P, 2) of a band along a line (P, 2), m."""
    return offset_line(line, width_m / 2), offset_line(line, -width_m / 2)


def to_own_frame(xy: FloatArray, origin: FloatArray, heading: FloatArray) -> FloatArray:
    """Places as distances ahead of agents and to their left, m.

    Args:
        xy: (n, ..., 2) places, m.
        origin: (n, 2) where the agents are, m.
        heading: (n,) rad.

    Examples:
        >>> place, agent = np.array([[3.0, 5.0]]), np.array([[3.0, 1.0]])
        >>> to_own_frame(place, agent, np.array([np.pi / 2])).round(6)
        array([[4., 0.]])
    """
    shape = (-1,) + (1,) * (xy.ndim - 2)
    return turned(xy - origin.reshape((*shape, 2)), -heading.reshape(shape))


def from_own_frame(own: FloatArray, origin: FloatArray, heading: FloatArray) -> FloatArray:
    """(n, ..., 2) places, m, of distances ahead of agents and to their left; see `to_own_frame`."""
    shape = (-1,) + (1,) * (own.ndim - 2)
    out = turned(own, heading.reshape(shape))
    for axis in (0, 1):  # axes of two are slow to add to
        out[..., axis] += origin[:, axis].reshape(shape)
    return out


def turned(xy: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned to the left by angles (...), rad."""
    cos, sin, x, y = np.cos(angle), np.sin(angle), xy[..., 0], xy[..., 1]
    out = np.empty(xy.shape)
    np.subtract(x * cos, y * sin, out=out[..., 0])
    np.add(x * sin, y * cos, out=out[..., 1])
    return out


class Meeting(NamedTuple):
    """Where two lines meet: the distances along both, m, and the sine of the angle between them."""

    along: float
    along_other: float
    sine: float


def meeting(line: FloatArray, other: FloatArray) -> Meeting | None:
    """Where a line (P, 2) meets another (Q, 2), m; None where it does not, or they are parallel.

    Of several places it is the first along the other line; of those on one piece of it the first
    along the line.

    Examples:
        >>> meeting(np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([[1.0, -2.0], [1.0, 2.0]]))
        Meeting(along=1.0, along_other=2.0, sine=1.0)
    """
    step, step_other = np.diff(line, axis=0), np.diff(other, axis=0)
    size, size_other = np.hypot(*step.T), np.hypot(*step_other.T)
    both = size * size_other[:, None]
    (dx, dy), (ex, ey) = step.T, step_other.T[:, :, None]
    x, y = np.moveaxis(other[:-1, None] - line[None, :-1], -1, 0)
    det = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        t, u = (x * ey - y * ex) / det, (x * dy - y * dx) / det
    hit = (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    hit &= np.abs(det) >= 1e-9 * np.maximum(both, 1e-9)
    if not hit.any():
        return None
    j, i = np.unravel_index(int(np.argmax(hit)), hit.shape)
    begin, begin_other = np.cumsum(size)[i] - size[i], np.cumsum(size_other)[j] - size_other[j]
    return Meeting(
        float(begin + t[j, i] * size[i]),
        float(begin_other + u[j, i] * size_other[j]),
        float(abs(det[j, i]) / both[j, i]),
    )


class Outlines(NamedTuple):
    """Rectangles.

    Attributes:
        centre, forward: (n, 2) m, and unit vectors along their length.
        half: (n, 2) half the length and half the width, m.
    """

    centre: FloatArray
    forward: FloatArray
    half: FloatArray

    @classmethod
    def of(
        cls, xy: FloatArray, heading: FloatArray, length: FloatArray, width: FloatArray
    ) -> Outlines:
        """The outlines of vehicles at (n, 2) centres, m, with (n,) headings, rad, and sizes, m."""
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return cls(xy, forward, np.stack([length, width], axis=1) / 2.0)

    def rows(self, which: IntArray) -> Outlines:
        """The outlines at the given rows, in that order; a row may be given more than once."""
        return Outlines(self.centre[which], self.forward[which], self.half[which])


def separation(first: Outlines, second: Outlines, moved: FloatArray | None = None) -> FloatArray:
    """The largest gap between two rectangles along one of their axes.

    Args:
        first: p rectangles.
        second: p others; each is compared with the first one of its row.
        moved: (p, 2) how far the first ones will move relative to the second ones, m: the
            separation then holds before, during and after that move.

    Returns:
        (p,) m; negative where they overlap, and then minus the way by which one of them would have
        to be moved to be free.

    Examples:
        >>> cars = Outlines.of(np.array([[0.0, 0.0], [4.0, 0.5], [9.0, 0.0]]), np.zeros(3),
        ...                    np.full(3, 5.0), np.full(3, 2.0))
        >>> separation(cars.rows(np.array([0, 0])), cars.rows(np.array([1, 2]))).tolist()
        [-1.0, 4.0]
    """
    between = first.centre - second.centre
    sides = [
        (along, np.stack([-along[:, 1], along[:, 0]], axis=1))
        for along in (first.forward, second.forward)
    ]
    best = np.full(len(between), -np.inf)
    for axis in (*sides[0], *sides[1]):
        reach = np.zeros(len(between))
        for (ahead, aside), half in zip(sides, (first.half, second.half), strict=True):
            reach += np.abs((ahead * axis).sum(axis=1)) * half[:, 0]
            reach += np.abs((aside * axis).sum(axis=1)) * half[:, 1]
        gap = np.abs((between * axis).sum(axis=1)) - reach
        if moved is not None:
            gap -= np.abs((moved * axis).sum(axis=1))
        best = np.maximum(best, gap)
    return best
