"""Where vehicles were seen at one moment, and who is near whom."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from behaviors.errors import InputError

MAX_COORDINATE_M = 1e9
"""Positions beyond this are refused: doubles there are 0.1 um apart."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """Vehicles at one moment; make one with `of`, which checks them.

    The nearest neighbours are searched once; a later call for fewer of them returns the first ones.

    Attributes:
        ids: (n,) different ids.
        xy: (n, 2) positions, m, read-only.

    Examples:
        >>> seen = Sighting.of([3, 1, 2], [[0.0, 0.0], [1.0, 0.0], [9.0, 0.0]])
        >>> seen.nearest(1).tolist()
        [[1], [0], [1]]
    """

    ids: NDArray[np.int64]
    xy: NDArray[np.float64]
    _searched: list[NDArray[np.int32]] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def of(cls, ids: ArrayLike, xy: ArrayLike) -> Sighting:
        """Check what was seen.

        Args:
            ids: (n,) different whole numbers.
            xy: (n, 2) finite positions, m.

        Raises:
            InputError: for repeated ids, positions that are not finite, or wrong shapes.
        """
        new_ids = checked_ids(ids)
        ordered = np.sort(new_ids)
        twice = ordered[:-1][ordered[1:] == ordered[:-1]]
        if twice.size:
            raise InputError(f"ids: found {twice[0]} twice, expected each vehicle once")
        try:
            positions = np.array(xy, dtype=np.float64, order="C")  # the caller may reuse its array
        except (TypeError, ValueError) as error:
            raise InputError(f"xy: found {xy!r:.60}, expected numbers ({error})") from error
        if positions.size == 0 and new_ids.size == 0:
            positions = np.empty((0, 2))
        if positions.shape != (new_ids.size, 2):
            raise InputError(f"xy: found shape {positions.shape}, expected ({new_ids.size}, 2)")
        if not (np.abs(positions) <= MAX_COORDINATE_M).all():
            row = int(np.flatnonzero(~(np.abs(positions) <= MAX_COORDINATE_M).all(axis=1))[0])
            raise InputError(
                f"xy: found {positions[row].tolist()} for vehicle {new_ids[row]}, "
                f"expected finite metres below {MAX_COORDINATE_M:g}"
            )
        positions.flags.writeable = False
        return cls(new_ids, positions)

    def nearest(self, neighbors: int) -> NDArray[np.int32]:
        """The nearest others of every vehicle, by distance, then by id.

        Args:
            neighbors: how many; n - 1 where fewer exist.

        Returns:
            (n, k) rows of the neighbours, nearest first.
        """
        from graphrqi.graph.kernels import nearest_neighbors

        k = max(min(neighbors, self.ids.size - 1), 0)
        if not self._searched or self._searched[-1].shape[1] < k:
            self._searched.append(nearest_neighbors(self.ids, self.xy, k))
        return np.ascontiguousarray(self._searched[-1][:, :k])


def checked_ids(ids: ArrayLike, what: str = "ids") -> NDArray[np.int64]:
    """A copy as (n,) whole numbers.

    Raises:
        InputError: naming ``what``, if it is anything else.
    """
    try:
        found = np.asarray(ids)
    except ValueError as error:  # lists of different lengths
        raise InputError(f"{what}: found {ids!r:.60}, expected an array ({error})") from error
    if found.ndim != 1:
        raise InputError(f"{what}: found shape {found.shape}, expected one id per vehicle")
    if found.size == 0:
        return np.empty(0, np.int64)
    if found.dtype.kind not in "iu":
        raise InputError(f"{what}: found {found.dtype} values, expected whole numbers")
    return found.astype(np.int64)
