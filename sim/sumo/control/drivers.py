"""The drivers that a controller steers, and which of them are on the road."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from sim.scenario import AgentSpec

D = TypeVar("D")


@dataclass(slots=True)
class OnRoute:
    """A driver whose conduct is decided anew on every edge of its route.

    Attributes:
        agent: who drives.
        rng: its own, for what is decided.
        following: by edge, the one that follows.
        edge: the last one on which something was decided.
        look_s: when to look at it again, s.
    """

    agent: AgentSpec
    rng: np.random.Generator
    following: Mapping[str, str] = field(init=False)
    edge: str = ""
    look_s: float = 0.0

    def __post_init__(self) -> None:
        """Read the route."""
        self.following = dict(itertools.pairwise(self.agent.route))


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
