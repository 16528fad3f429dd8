"""Registers the gymnasium environments; loads none of them."""

from __future__ import annotations

from typing import Final

import gymnasium

ENVIRONMENTS: Final[dict[str, str]] = {
    "graphrqi/StraightRoad-v0": "scenarios.environments:StraightRoadEnv",
    "graphrqi/FourWayIntersection-v0": "scenarios.environments:FourWayIntersectionEnv",
}
"""Where each environment lives, by its id."""


def register_environments() -> None:
    """Register every environment that is not registered yet."""
    for name, source in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=source)
