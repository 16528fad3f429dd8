"""The scenarios as gymnasium environments: one vehicle is yours, the traffic is ours.

``import scenarios`` registers them by name and loads none of them, and
``gymnasium.make("scenarios:graphrqi/StraightRoad-v0")`` works anywhere. They run on highway-env's
road and take highway-env's actions; the other drivers have the six behaviours' profiles.
`scenarios.environments.environment.TrafficEnv` specifies observations, rewards and episodes.
Configure an environment with ``gymnasium.make(id, config={...})`` or
``reset(options={"config": {...}})``; unknown keys and unusable values are refused by name.
"""

from __future__ import annotations

from typing import Final

import gymnasium

ENVIRONMENTS: Final[dict[str, str]] = {
    "graphrqi/StraightRoad-v0": "scenarios.environments.straight_road:StraightRoadEnv",
    "graphrqi/FourWayIntersection-v0": (
        "scenarios.environments.four_way_intersection:FourWayIntersectionEnv"
    ),
}
"""Where each environment lives, by its id."""


def register_environments() -> None:
    """Register every environment that is not registered yet."""
    for name, source in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=source)
