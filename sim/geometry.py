"""Overlap of vehicle outlines: rectangles about their centres, turned by their headings.

Two rectangles are apart if the projections onto one of their four axes are (the separating axis
theorem), so four gaps per pair decide.

References:
    Gottschalk, Lin, Manocha (1996), OBBTree: a hierarchical structure for rapid interference
    detection, SIGGRAPH.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

GRAZE_M: Final = 0.15
"""Outlines may overlap by this much without a contact (a corner rounded with a radius of 0.4 m, as
cars' are, lies 0.4 (sqrt(2) - 1) m inside the rectangle's, and recorded positions are no more
accurate)."""


class Outlines(NamedTuple):
    """Rectangles.

    Attributes:
        centre: (n, 2) m.
        forward: (n, 2) unit vectors along their length.
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

    def rows(self, which: NDArray[np.int64]) -> Outlines:
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
