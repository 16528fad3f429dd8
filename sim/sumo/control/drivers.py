"""The drivers that a controller steers, and which of them are on the road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

D = TypeVar("D")


class Steered(Generic[D]):
    """What controllers of drivers have in common.

    Attributes:
        _drivers: by name, everyone whom the controller steers.
        _here: those of them who are on the road, in SUMO's order.
    """

    def __init__(self) -> None:
        self._drivers: dict[str, D] = {}
        self._here: list[tuple[str, D]] = []

    def look_round(self, vehicles: Sequence[str]) -> None:
        """Note who is on the road, whenever that changes."""
        self._here = [(name, self._drivers[name]) for name in vehicles if name in self._drivers]
