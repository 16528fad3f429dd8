"""The environment of the four-way intersection with signals."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

from scenarios.environments.config import TrafficConfig, member_of
from scenarios.environments.environment import TrafficEnv

GOALS: Final[dict[str, str]] = {
    "straight": "north_out",
    "left": "west_out",
    "right": "east_out",
}
"""The edges by which the ego vehicle may leave; it comes from the south."""


class FourWayIntersectionConfig(TrafficConfig):
    """The configuration of `FourWayIntersectionEnv`."""

    goal: Annotated[str, member_of(GOALS, "goal")] = "straight"
    """Where the ego vehicle is to go: "straight", "left" or "right"."""


class FourWayIntersectionEnv(TrafficEnv):
    """Cross an intersection with signals and pedestrians: ``graphrqi/FourWayIntersection-v0``.

    Four arms of 250 m with two lanes in and two out, 50 km/h, fixed-time signals, crossings on
    every arm. The ego vehicle (5 m by 2 m) begins at the far end of the southern arm, on a lane
    that leads to its goal; the goal is the far end of the arm that ``goal`` names.

    Version history:
        v0: the first.
    """

    config_model = FourWayIntersectionConfig
    own_defaults: ClassVar[dict[str, Any]] = {
        "duration_s": 90.0,
        "screen_width": 720,
        "screen_height": 720,
        "scaling": 9.0,
        "centering_position": [0.5, 0.6],
    }
    scenario_name = "four_way_intersection"

    def _route(self) -> tuple[str, ...]:
        return ("south_in", GOALS[self.config["goal"]])
