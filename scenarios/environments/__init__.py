"""The scenarios as gymnasium environments: one vehicle is yours, the traffic is ours.

``import scenarios`` registers them, and ``gymnasium.make("scenarios:graphrqi/StraightRoad-v0")``
works anywhere. They run on highway-env's road and take highway-env's actions; the other drivers
have the six behaviours' profiles. Configure one with ``gymnasium.make(id, config={...})`` or
``reset(options={"config": {...}})``; a key or a value that means nothing is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from behaviors.errors import lookup
from scenarios import get_scenario
from scenarios.environments.environment import TrafficEnv
from sim.scenario import Scenario

_SPECIFICATION: Final = """
    Configuration (``config``), with its default:

    ====================== ============= ==========================================================
    observation            "kinematics"  or "behavior", "posterior", "graph": see below
    observed               15            how many others are observed at most
    action                 meta actions  highway-env's ``DiscreteMetaAction``, ``DiscreteAction`` or
                                         ``ContinuousAction`` with its options
    flow                   "medium"      traffic: light, medium, dense or vehicles per hour
    mix                    None          share of each behaviour: a mapping or "impatient=.2,..."
    spread                 0.15          how much drivers of one behaviour differ
    seed                   None          of every episode's traffic; None: drawn by ``reset(seed)``
    duration_s             40.0          time until an episode is cut off, s
    warmup_s               20.0          traffic that drives before the episode begins, s
    simulation_frequency   10            Hz, at least 10
    policy_frequency       5             Hz; divides the simulation frequency
    classifier             the stream    "module:function" that makes what classifies, or a callable
                                         that takes a `Frame` and returns a belief with ``of(ids)``
    ====================== ============= ==========================================================

    Beside these highway-env's keys for windows: ``screen_width``, ``screen_height``, ``scaling``,
    ``centering_position``, ``render_agent``, ``offscreen_rendering``, ``manual_control``,
    ``real_time_rendering``.

    Observation: a ``Dict``. All boxes are float32 in [-1, 1]: values are divided by the unit given
    and clipped. N is ``observed``.

    ============ ============= ====================================================================
    key          shape         columns (unit)
    ============ ============= ====================================================================
    ego          (13,)         speed (20 m/s); offset to the left of the lane (lane widths); heading
                               to the left of the lane's (pi rad); limit (20 m/s); lanes to the
                               left, to the right (4); distance to the stop line (100 m, 1: none);
                               red, yellow, green (0 or 1); distance to the next crossing (100 m,
                               1: none); whether somebody is on it or at its kerb (0 or 1); distance
                               left to the goal (1000 m)
    agents       (N, 10)       others within 100 m, nearest first, rows of zeros after them: present
                               (1); x ahead, y to the left (100 m); velocity relative to the ego
                               vehicle ahead, to the left (20 m/s); cosine, sine of the heading
                               relative to it; length (12 m); width (3 m); a pedestrian (0 or 1)
    agents       (N, 16)       with "behavior": six more, 1 for the driver's true behaviour
    agents       (N, 16)       with "posterior": six more, the classifier's probabilities; uniform
                               until a driver is known
    mask         (N + 1,)      with "graph", int8: which nodes exist; node 0 is the ego vehicle,
                               node i + 1 is row i of ``agents``
    adjacency    (N + 1, N+1)  with "graph", int8, symmetric: 1 if either is among the other's 4
                               nearest
    ============ ============= ====================================================================

    The behaviours' order is that of ``behaviors.BEHAVIORS``; pedestrians have zeros there.

    Actions: highway-env's. By default 5 meta actions: 0 lane to the left, 1 nothing, 2 lane to the
    right, 3 faster, 4 slower, between the target speeds 0, 3, 6, 9, 12 and 15 m/s. Signals,
    crossings and everybody else are yours to mind; the others react to you as to anybody.

    Reward per step: progress along the way as a share of what the limit allows, in [0, 1]; -10 for
    a collision; -1 for each near miss (time to collision to the leader below 1 s, or passing within
    0.4 m); -3 for running a red light; -5 for leaving the road. ``info["rewards"]`` has the parts.

    Episode: begins when there is room for the ego vehicle at the beginning of its way, at 0.7 of
    the limit. Terminated by a collision, by leaving the road, or at the goal; truncated after
    ``duration_s``.

    ``info``: time_s, speed (m/s), crashed, arrived, collisions, near_misses, red_runs, rewards, and
    events: tuples (what, agent, other or -1, rule) of everybody's events in the step. Ids are those
    of the drawn agents; the ego vehicle's is one more than the greatest.

    Images: lanes, crossings, stop lines in the colour of their signal, pedestrians, vehicles in the
    colour of their behaviour (warm: aggressive, cool: conservative), the ego vehicle white. For a
    video at the simulation's rate wrap in ``RecordVideo`` and call
    ``env.unwrapped.set_record_video_wrapper(env)``.
"""


class StraightRoadEnv(TrafficEnv):
    """Drive 800 m of one-way road among the six behaviours: ``graphrqi/StraightRoad-v0``.

    Three lanes, 50 km/h, a zebra crossing half-way where pedestrians have priority. The ego vehicle
    (5 m by 2 m) begins at the western end on the lane with most room; its goal is the eastern end.
    One more key of the configuration: ``compiled`` (True) drives the others in compiled code, with
    the same result within rounding.

    Version history:
        v0: the first.
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """The configuration where nothing else is asked for; see the class docstring."""
        return {
            **super().default_config(),
            "compiled": True,
            "screen_width": 1000,
            "screen_height": 180,
            "scaling": 7.0,
            "centering_position": [0.3, 0.45],
        }

    def _make_scenario(self, config: Mapping[str, Any], duration_s: float) -> Scenario:
        return _scenario("straight_road", config, duration_s)

    def _route(self) -> tuple[str, ...]:
        return ("east_in", "east_out")


class FourWayIntersectionEnv(TrafficEnv):
    """Cross an intersection with signals and pedestrians: ``graphrqi/FourWayIntersection-v0``.

    Four arms of 250 m with two lanes in and two out, 50 km/h, fixed-time signals, crossings on
    every arm. The ego vehicle (5 m by 2 m) begins at the far end of the southern arm, on a lane
    that leads to its goal. One more key of the configuration: ``goal`` ("straight", or "left",
    "right"), the arm to leave by; its far end is the goal. ``duration_s`` is 90 here.

    Version history:
        v0: the first.
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """The configuration where nothing else is asked for; see the class docstring."""
        return {
            **super().default_config(),
            "goal": "straight",
            "duration_s": 90.0,
            "screen_width": 720,
            "screen_height": 720,
            "scaling": 9.0,
            "centering_position": [0.5, 0.6],
        }

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take changes to the configuration; see `TrafficEnv.configure`."""
        goal = (config or {}).get("goal", self.config["goal"])
        lookup(GOALS, str(goal), "goal")
        super().configure(config)

    def _make_scenario(self, config: Mapping[str, Any], duration_s: float) -> Scenario:
        return _scenario("four_way_intersection", config, duration_s)

    def _route(self) -> tuple[str, ...]:
        return ("south_in", GOALS[str(self.config["goal"])])


def _scenario(name: str, config: Mapping[str, Any], duration_s: float) -> Scenario:
    options = {key: config[key] for key in ("flow", "mix", "spread")}
    return get_scenario(name)(duration_s=duration_s, **options)


GOALS: Final[dict[str, str]] = {
    "straight": "north_out",
    "left": "west_out",
    "right": "east_out",
}
"""Where the ego vehicle, which comes from the south, may want to go."""

for _environment in (StraightRoadEnv, FourWayIntersectionEnv):
    _environment.__doc__ = f"{_environment.__doc__}{_SPECIFICATION}"
