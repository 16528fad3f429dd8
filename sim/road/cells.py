"""Square cells over a road, so that a search near a place looks only at what lies near it.

`cells_of` sorts boxes into the cells that they touch. Building costs time and memory in proportion
to the boxes, and a look-up costs what its cell holds, however large the road is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.frames import FloatArray, IntArray

MOST_CELLS_PER_BOX: Final = 64
"""Bound on the number of cells: where few boxes are scattered over a wide area, cells are made
larger."""


class Cells(NamedTuple):
    """Items by square cell; cells are numbered row by row from the south-west.

    Attributes:
        x0, y0: western and southern edge, m.
        size: width of a cell, m.
        columns, rows: how many there are.
        first: (columns rows + 1,) where the items of each cell begin in ``items``.
        items: the items of all cells, ascending within a cell.
    """

    x0: float
    y0: float
    size: float
    columns: int
    rows: int
    first: IntArray
    items: NDArray[np.int32]


def members(first: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Members of n lists that lie in one array: the list of each, and where each lies.

    Examples:
        >>> members(np.array([0, 7]), np.array([1, 2]))
        (array([0, 1, 1]), array([0, 7, 8]))
    """
    which = np.repeat(np.arange(count.size), count)
    return which, np.arange(which.size) + np.repeat(first - np.cumsum(count) + count, count)


def cells_of(boxes: FloatArray, item: IntArray, size_m: float) -> Cells:
    """Sort items into the cells that their boxes touch.

    Boxes are (n, 4) smallest x, smallest y, largest x and largest y, m; an item may have several.
    A place inside a box lies in a cell that lists its item. Cells are at least ``size_m`` wide.

    Examples:
        >>> boxes = np.array([[0.0, 0.0, 9.0, 1.0], [8.0, 0.0, 8.5, 1.0]])
        >>> cells = cells_of(boxes, np.arange(2), 5.0)
        >>> cells.first.tolist(), cells.items.tolist()
        ([0, 1, 3], [0, 0, 1])
    """
    if not len(boxes):
        return Cells(0.0, 0.0, size_m, 1, 1, np.zeros(2, np.int64), np.empty(0, np.int32))
    x0, y0 = boxes[:, :2].min(axis=0)
    width, height = boxes[:, 2:].max(axis=0) - (x0, y0)
    while (width / size_m + 1.0) * (height / size_m + 1.0) > MOST_CELLS_PER_BOX * len(boxes) + 16:
        size_m *= 2.0
    columns, rows = int(width / size_m) + 1, int(height / size_m) + 1
    low = ((boxes[:, :2] - (x0, y0)) / size_m).astype(np.int64)
    high = ((boxes[:, 2:] - (x0, y0)) / size_m).astype(np.int64)
    wide, tall = (high - low + 1).T
    box, number = members(np.zeros_like(wide), wide * tall)
    row, column = low[box, 1] + number // wide[box], low[box, 0] + number % wide[box]
    most = int(item.max()) + 1
    keys = np.sort((row * columns + column) * most + item[box])
    keys = keys[np.append(True, keys[1:] != keys[:-1])]  # numpy's unique hashes, which is slower
    first = np.searchsorted(keys, np.arange(columns * rows + 1) * most)
    return Cells(
        float(x0), float(y0), float(size_m), columns, rows, first.astype(np.int64),
        (keys % most).astype(np.int32),
    )  # fmt: skip


def near_pairs(boxes: FloatArray, others: FloatArray, size_m: float) -> IntArray:
    """Pairs of boxes (n, 4) and others (m, 4) that touch, found in cells of some width, m.

    Returns (P, 2) indices into both, in ascending order.

    Examples:
        >>> near_pairs(np.array([[0.0, 0, 1, 1], [5.0, 5, 6, 6]]), np.array([[1.0, 1, 5, 5]]), 2.0)
        array([[0, 0],
               [1, 0]])
    """
    n, m = len(boxes), len(others)
    if not n or not m:
        return np.empty((0, 2), np.int64)
    cells = cells_of(np.concatenate([boxes, others]), np.arange(n + m), size_m)
    cell = np.repeat(np.arange(cells.first.size - 1), np.diff(cells.first))
    items = cells.items.astype(np.int64)
    mine = items < n
    count = np.bincount(cell[~mine], minlength=cells.first.size - 1)
    which, at = members((np.cumsum(count) - count)[cell[mine]], count[cell[mine]])
    one, other = items[mine][which], items[~mine][at] - n
    touch = (boxes[one, :2] <= others[other, 2:]).all(axis=1)
    touch &= (others[other, :2] <= boxes[one, 2:]).all(axis=1)
    pairs = np.unique(one[touch] * m + other[touch])
    return np.stack([pairs // m, pairs % m], axis=1)


def boxes_of(lines: Sequence[FloatArray], margin_m: float) -> FloatArray:
    """(n, 4) the box round each line (P, 2), with a margin, m."""
    low = np.reshape([np.min(line, axis=0) for line in lines], (-1, 2)) - margin_m
    high = np.reshape([np.max(line, axis=0) for line in lines], (-1, 2)) + margin_m
    return np.concatenate([low, high], axis=1)
