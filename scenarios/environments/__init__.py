"""The scenarios as gymnasium environments: one vehicle is yours, the traffic is ours.

``import scenarios`` registers them by name and loads none of them, and
``gymnasium.make("scenarios:graphrqi/StraightRoad-v0")`` works anywhere. They run on highway-env's
road and take highway-env's actions; the other drivers have the six behaviours' profiles.
`scenarios.environments.environment.TrafficEnv` specifies observations, rewards and episodes.
`scenarios.environments.config.TrafficConfig` lists the keys of the configuration for
``gymnasium.make`` and ``reset``. Unknown keys and unusable values are refused by name. The keys
``net``, ``routes`` and ``scenario`` set any of them on another road.
`scenarios.environments.parallel` makes environments for several agents (PettingZoo, extra
``multi``). ``gymnasium.make_vec(id, num_envs=16)`` makes many worlds that one call steps.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import gymnasium

_GRID: Final = Path(__file__).parents[1] / "networks" / "grid_3" / "road.net.xml"

_WIDE: Final[dict[str, Any]] = {
    "screen_width": 1000, "screen_height": 180, "centering_position": [0.3, 0.45]
}  # fmt: skip
_ROAD: Final = {**_WIDE, "scaling": 7.0}
_MOTORWAY: Final = {
    **_WIDE,
    "scaling": 5.0,
    "duration_s": 90.0,
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0.0, 10.0, 20.0, 25.0, 30.0, 35.0]},
}
_SQUARE: Final[dict[str, Any]] = {
    "duration_s": 90.0,
    "screen_width": 720,
    "screen_height": 720,
    "scaling": 9.0,
    "centering_position": [0.5, 0.6],
}
_FROM_THE_SOUTH: Final = {
    "straight": ("south_in", "north_out"),
    "left": ("south_in", "west_out"),
    "right": ("south_in", "east_out"),
}
_ROUND: Final = ("south_in", "south_east", "east_north", "north_out")


ENVIRONMENTS: Final[dict[str, dict[str, Any]]] = {
    f"graphrqi/{name}-v0": {"scenario_name": scenario, "routes": routes, "defaults": defaults}
    for name, scenario, routes, defaults in (
        # 800 m of one-way road with three lanes and a zebra crossing half-way, from west to east
        ("StraightRoad", "straight_road", ("east_in", "east_out"), _ROAD),
        # 1200 m of a road with one lane each way, where others overtake on the oncoming lane
        ("TwoWayRoad", "two_way_road", ("east_in", "east_out"), {"duration_s": 150.0}),
        # intersections of four arms of 250 m; the ego vehicle comes from the south
        ("FourWayIntersection", "four_way_intersection", _FROM_THE_SOUTH, _SQUARE),
        ("PriorityIntersection", "priority_intersection", _FROM_THE_SOUTH, _SQUARE),
        ("AllWayStop", "all_way_stop", _FROM_THE_SOUTH, _SQUARE),
        ("RightBeforeLeft", "right_before_left", _FROM_THE_SOUTH, _SQUARE),
        # 2 km of motorway with three lanes; with ramps, the ego vehicle joins it
        ("Motorway", "motorway", ("before", "between", "after"), _MOTORWAY),
        ("MotorwayRamps", "motorway_ramps", ("on", "between", "after"), _MOTORWAY),
        # from the southern arm round a ring with one lane to the northern arm
        ("Roundabout", "roundabout", _ROUND, _SQUARE),
        # a grid of streets, or any road by config={"net": FILE}, along a route of the traffic's
        ("OwnRoad", str(_GRID), None, {**_SQUARE, "duration_s": 120.0}),
    )
}
"""Arguments of `TrafficEnv` for each environment, by its id."""

for _name, _arguments in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name, "scenarios.environments.environment:TrafficEnv", kwargs=_arguments
        )
