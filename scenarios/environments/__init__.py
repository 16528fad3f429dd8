"""The scenarios as gymnasium environments: one vehicle is yours, the traffic is ours.

``import scenarios`` registers them by name and loads none of them, and
``gymnasium.make("scenarios:graphrqi/StraightRoad-v0")`` works anywhere. They run on highway-env's
road and take highway-env's actions; the other drivers have the six behaviours' profiles.
`scenarios.environments.environment.TrafficEnv` specifies observations, rewards and episodes.
Configure an environment with ``gymnasium.make(id, config={...})`` or
``reset(options={"config": {...}})``; unknown keys and unusable values are refused by name. The keys
``net``, ``routes`` and ``scenario`` set any of them on another road.
`scenarios.environments.parallel` makes an environment for several agents of any of them
(PettingZoo, extra ``multi``).
"""

from __future__ import annotations

from typing import Final

import gymnasium

ENVIRONMENTS: Final[dict[str, str]] = {
    "graphrqi/StraightRoad-v0": "scenarios.environments.straight_road:StraightRoadEnv",
    "graphrqi/FourWayIntersection-v0": (
        "scenarios.environments.four_way_intersection:FourWayIntersectionEnv"
    ),
    "graphrqi/TwoWayRoad-v0": "scenarios.environments.roads:TwoWayRoadEnv",
    "graphrqi/PriorityIntersection-v0": "scenarios.environments.roads:PriorityIntersectionEnv",
    "graphrqi/AllWayStop-v0": "scenarios.environments.roads:AllWayStopEnv",
    "graphrqi/RightBeforeLeft-v0": "scenarios.environments.roads:RightBeforeLeftEnv",
    "graphrqi/Motorway-v0": "scenarios.environments.roads:MotorwayEnv",
    "graphrqi/MotorwayRamps-v0": "scenarios.environments.roads:MotorwayRampsEnv",
    "graphrqi/Roundabout-v0": "scenarios.environments.roads:RoundaboutEnv",
    "graphrqi/OwnRoad-v0": "scenarios.environments.roads:OwnRoadEnv",
}
"""Where each environment lives, by its id."""


def register_environments() -> None:
    """Register every environment that is not registered yet."""
    for name, source in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=source)
