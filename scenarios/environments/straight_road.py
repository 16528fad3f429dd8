"""The environment of the straight road."""

from __future__ import annotations

from typing import Any, ClassVar

from scenarios.environments.environment import TrafficEnv


class StraightRoadEnv(TrafficEnv):
    """Drive 800 m of one-way road among the six behaviours: ``graphrqi/StraightRoad-v0``.

    Three lanes, 50 km/h, a zebra crossing half-way where pedestrians have priority. The ego vehicle
    (5 m by 2 m) begins at the western end on the lane with most room; its goal is the eastern end.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = {
        "screen_width": 1000,
        "screen_height": 180,
        "scaling": 7.0,
        "centering_position": [0.3, 0.45],
    }
    scenario_name = "straight_road"

    def _route(self) -> tuple[str, ...]:
        return ("east_in", "east_out")
