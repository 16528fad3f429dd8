"""SUMO with IDM: the same drivers follow by the other law, all of them and by its own equation."""

import dataclasses

import numpy as np
import pytest

from behaviors.labels import PROFILES, Behavior
from scenarios import get_scenario
from sim.engines import get_engine
from sim.frames import AgentKind
from sim.scenario import AgentSpec, sample_agents
from sim.sumo.vehicle_types import SumoSettings, vehicle_type


def pair(scenario) -> list[AgentSpec]:
    """A slow driver and one behind who stays in its lane."""
    follower = dataclasses.replace(
        PROFILES[Behavior.CAREFUL], lane_change_gain=0.0, lane_change_assertiveness=0.1
    )
    leader = dataclasses.replace(follower, speed_factor=0.75)
    first = AgentSpec(
        id=0, kind=AgentKind.CAR, behavior=Behavior.CAREFUL, profile=leader,
        route=scenario.flows[0].route, depart_s=0.0, length_m=5.0, width_m=1.8,
    )  # fmt: skip
    return [first, dataclasses.replace(first, id=1, profile=follower, depart_s=4.0)]


@pytest.mark.parametrize("engine", ["sumo", "sumo-idm"])
def test_gap_behind_a_slow_leader_is_the_law_s(engine):
    scenario = get_scenario("two_way_road")(duration_s=45.0, flow=0.0)
    agents = pair(scenario)
    frames = [f for f in get_engine(engine)(scenario, agents, 0) if len(f) == 2]
    assert np.abs(frames[-1].xy[0, 1] - frames[-1].xy[1, 1]) < 0.1  # in one lane
    gap_m = np.median([f.xy[0, 0] - f.xy[1, 0] - 5.0 for f in frames[-50:]])
    driver = agents[1].profile
    speed = float(np.median([f.speed[1] for f in frames[-50:]]))
    expected_m = driver.min_gap_m + driver.time_headway_s * speed
    if engine == "sumo-idm":  # Treiber, Hennecke, Helbing (2000), eq. 5
        wanted = driver.speed_factor * scenario.road.lanes[0].speed_limit_mps
        expected_m /= np.sqrt(1.0 - (speed / wanted) ** 4)
        assert expected_m > 1.15 * (driver.min_gap_m + driver.time_headway_s * speed)
    assert gap_m == pytest.approx(expected_m, rel=0.05)


def test_everybody_follows_by_the_same_law():
    agents = sample_agents(get_scenario("straight_road")(duration_s=60.0, flow="dense"), 0)
    drivers = [a for a in agents if a.profile is not None]
    assert {vehicle_type(a, SumoSettings(law="IDM"))["carFollowModel"] for a in drivers} == {"IDM"}
    assert {vehicle_type(a)["carFollowModel"] for a in drivers} == {"Krauss"}
