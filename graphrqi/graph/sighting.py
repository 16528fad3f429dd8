"""Where vehicles were seen at one moment, and who is near whom."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

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
        >>> [part.tolist() for part in seen.nearest(1)]
        [[0, 1, 2, 3], [1, 0, 1]]
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
        positions = np.array(checked_floats(xy, "xy"), order="C")  # the caller may reuse its array
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
        positions.flags.writeable = False  # always: kernels would be compiled for either
        return cls(new_ids, positions)

    def nearest(self, neighbors: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The nearest others of every vehicle, by distance, then by id.

        Args:
            neighbors: how many; n - 1 where fewer exist.

        Returns:
            (n + 1,) where each vehicle's begin, and (n k,) the rows of the neighbours.
        """
        from graphrqi.graph import cell_grid

        n = self.ids.size
        k = max(min(neighbors, n - 1), 0)
        if not self._searched or self._searched[-1].shape[1] < k:
            grid = cell_grid.cell_grid(self.xy, 0.0)
            found = cell_grid.nearest_neighbors(self.ids, self.xy, k, grid)
            self._searched.append(found.reshape(n, k))
        rows = self._searched[-1][:, :k]
        return k * np.arange(n + 1, dtype=np.int32), rows.ravel()

    def within(self, radius_m: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """All others within a distance of every vehicle.

        Args:
            radius_m: the distance, included.

        Returns:
            (n + 1,) where each vehicle's begin, and their rows.
        """
        from graphrqi.graph import cell_grid

        grid = cell_grid.cell_grid(self.xy, 0.5 * radius_m)
        return cell_grid.within_radius(self.xy, radius_m, grid)


def as_array(values: ArrayLike, what: str) -> NDArray[Any]:
    """An array of whatever is in ``values``.

    Raises:
        InputError: naming ``what``, if it is none.
    """
    try:
        return np.asarray(values)
    except ValueError as error:  # lists of different lengths
        raise InputError(f"{what}: found {values!r:.60}, expected an array ({error})") from error


def checked_ids(ids: ArrayLike, what: str = "ids") -> NDArray[np.int64]:
    """A copy as (n,) whole numbers.

    Raises:
        InputError: naming ``what``, if it is anything else.
    """
    found = as_array(ids, what)
    if found.ndim != 1:
        raise InputError(f"{what}: found shape {found.shape}, expected one id per vehicle")
    if found.size == 0:
        return np.empty(0, np.int64)
    if found.dtype.kind not in "iu":
        raise InputError(f"{what}: found {found.dtype} values, expected whole numbers")
    if found.dtype.kind == "u" and int(found.max()) > np.iinfo(np.int64).max:
        raise InputError(f"{what}: found {found.max()}, expected ids that fit 64-bit integers")
    return found.astype(np.int64)


def checked_floats(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """An array of real numbers.

    Raises:
        InputError: naming ``what``, if it is anything else.
    """
    found = as_array(values, what)
    if found.dtype.kind == "c":
        raise InputError(f"{what}: found complex numbers, expected real ones")
    try:
        return np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: found {values!r:.60}, expected numbers ({error})") from error
