"""The environments of the other scenarios, and of roads of one's own."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from scenarios.environments.environment import TrafficEnv
from scenarios.environments.four_way_intersection import GOALS, FourWayIntersectionConfig
from scenarios.networks.grid import SHIPPED_BLOCKS, grid_net

_SQUARE: Final[dict[str, Any]] = {
    "duration_s": 90.0,
    "screen_width": 720,
    "screen_height": 720,
    "scaling": 9.0,
    "centering_position": [0.5, 0.6],
}
"""Episodes and images where ways cross."""

_FAST: Final[dict[str, Any]] = {
    "duration_s": 90.0,
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0.0, 10.0, 20.0, 25.0, 30.0, 35.0]},
    "screen_width": 1000,
    "screen_height": 180,
    "scaling": 5.0,
    "centering_position": [0.3, 0.45],
}
"""Episodes, speeds and images on a motorway."""


class TwoWayRoadEnv(TrafficEnv):
    """Drive 1200 m of a two-way road with one lane each way: ``graphrqi/TwoWayRoad-v0``.

    50 km/h, no crossing; others overtake on the oncoming lane. The ego vehicle (5 m by 2 m) begins
    at the western end; its goal is the eastern end.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = {"duration_s": 150.0}
    scenario_name = "two_way_road"

    def _route(self) -> tuple[str, ...]:
        return ("east_in", "east_out")


class _SmallIntersectionEnv(TrafficEnv):
    """Cross an intersection without signals from the south."""

    config_model = FourWayIntersectionConfig
    own_defaults: ClassVar[dict[str, Any]] = _SQUARE

    def _route(self) -> tuple[str, ...]:
        return ("south_in", GOALS[self.config["goal"]])


class PriorityIntersectionEnv(_SmallIntersectionEnv):
    """Cross a main road: ``graphrqi/PriorityIntersection-v0``.

    Four arms of 250 m with one lane in and one out, 50 km/h; the east-west road has priority. The
    ego vehicle (5 m by 2 m) comes from the south; its goal is the far end of the arm of ``goal``.

    Version history:
        v0: the first.
    """

    scenario_name = "priority_intersection"


class AllWayStopEnv(_SmallIntersectionEnv):
    """Cross where everybody stops: ``graphrqi/AllWayStop-v0``.

    Four arms of 250 m with one lane in and one out, 50 km/h, stop signs on each. The ego vehicle
    (5 m by 2 m) comes from the south; its goal is the far end of the arm of ``goal``.

    Version history:
        v0: the first.
    """

    scenario_name = "all_way_stop"


class RightBeforeLeftEnv(_SmallIntersectionEnv):
    """Cross where those from the right go first: ``graphrqi/RightBeforeLeft-v0``.

    Four arms of 250 m with one lane in and one out, 50 km/h, no signs. The ego vehicle (5 m by 2 m)
    comes from the south; its goal is the far end of the arm of ``goal``.

    Version history:
        v0: the first.
    """

    scenario_name = "right_before_left"


class MotorwayEnv(TrafficEnv):
    """Drive 2 km of a motorway: ``graphrqi/Motorway-v0``.

    Three lanes, 120 km/h. The ego vehicle (5 m by 2 m) begins at the western end on the lane with
    most room; its goal is the eastern end.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = _FAST
    scenario_name = "motorway"

    def _route(self) -> tuple[str, ...]:
        return ("before", "between", "after")


class MotorwayRampsEnv(TrafficEnv):
    """Join a motorway by its on-ramp: ``graphrqi/MotorwayRamps-v0``.

    Three lanes, 120 km/h, 2 km; a fourth lane between the ramps. The ego vehicle (5 m by 2 m)
    begins on the on-ramp; its goal is the eastern end of the motorway, which the fourth lane does
    not reach.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = _FAST
    scenario_name = "motorway_ramps"

    def _route(self) -> tuple[str, ...]:
        return ("on", "between", "after")


class RoundaboutEnv(TrafficEnv):
    """Drive round a roundabout: ``graphrqi/Roundabout-v0``.

    Four arms of 200 m, 50 km/h, and a ring with one lane and priority, 30 km/h. The ego vehicle
    (5 m by 2 m) comes from the south; its goal is the far end of the northern arm.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = _SQUARE
    scenario_name = "roundabout"

    def _route(self) -> tuple[str, ...]:
        from scenarios.roundabout import way_round

        return way_round("south", 2)


class OwnRoadEnv(TrafficEnv):
    """Drive on a road of your own: ``graphrqi/OwnRoad-v0`` with ``config={"net": FILE}``.

    Without ``net`` and ``scenario``, the road is a grid of three by three blocks with signals. The
    ego vehicle (5 m by 2 m) takes ``ego_route``, or else a route of the traffic's, drawn anew for
    each episode; its goal is the far end of the route.

    Version history:
        v0: the first.
    """

    own_defaults: ClassVar[dict[str, Any]] = {**_SQUARE, "duration_s": 120.0}
    scenario_name = str(grid_net(SHIPPED_BLOCKS))
