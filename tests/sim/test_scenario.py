import dataclasses

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import Behavior
from behaviors.populations import read_population
from scenarios import SCENARIOS
from scenarios.straight_road import straight_road
from sim.frames import AgentKind
from sim.scenario import (
    KIND_LIMITS,
    RouteFlow,
    Scenario,
    sample_agents,
    with_behavior,
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return straight_road(duration_s=200.0, pedestrians_per_h=600.0)


def test_same_seed_same_agents(scenario):
    assert sample_agents(scenario, 4) == sample_agents(scenario, 4)
    assert sample_agents(scenario, 4) != sample_agents(scenario, 5)


def test_one_stream_does_not_change_another(scenario):
    fewer = dataclasses.replace(
        scenario,
        flows=tuple(
            dataclasses.replace(s, per_hour=0.0) if s.walking else s for s in scenario.flows
        ),
    )
    drivers = [a for a in sample_agents(scenario, 3) if a.profile is not None]
    alone = sample_agents(fewer, 3)
    assert [dataclasses.replace(a, id=0) for a in drivers] == [
        dataclasses.replace(a, id=0) for a in alone
    ]


def test_the_flow_and_the_mix_are_what_was_asked_for():
    made = straight_road(flow=3600.0, mix="timid=.75,reckless=.25", duration_s=3600.0)
    drivers = [a for a in sample_agents(made, 0) if a.behavior is not None]
    assert len(drivers) == pytest.approx(3600, rel=0.06)
    timid = np.mean([a.behavior is Behavior.TIMID for a in drivers])
    assert timid == pytest.approx(0.75, abs=0.03)


def test_vehicle_lengths_vary_and_kinds_keep_their_limits():
    made = straight_road(kinds="car=.5,truck=.3,bicycle=.2", duration_s=1800.0)
    agents = [a for a in sample_agents(made, 0) if a.profile is not None]
    for kind in (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BICYCLE):
        mine = [a for a in agents if a.kind is kind]
        assert np.std([a.length_m for a in mine]) > 0
        assert max(a.profile.max_accel_mps2 for a in mine) <= KIND_LIMITS[kind].max_accel_mps2


def test_jaywalkers_are_as_many_as_asked_for():
    made = straight_road(flow=0, pedestrians_per_h=3000.0, jaywalk_share=0.3, duration_s=3600.0)
    assert np.mean([a.jaywalks for a in sample_agents(made, 0)]) == pytest.approx(0.3, abs=0.04)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mix", {Behavior.TIMID: 0.5}),
        ("mix", {Behavior.TIMID: 1.5, Behavior.RECKLESS: -0.5}),
        ("kinds", {AgentKind.CAR: 0.9}),
        ("kinds", {AgentKind.PEDESTRIAN: 1.0}),
        ("flows", (RouteFlow((), 900.0),)),
        ("flows", (RouteFlow((), 900.0, walking=True),)),
        ("spread", -1.0),
        ("spread", 1.1),
        ("duration_s", 0.0),
        ("duration_s", 0.09),
        ("step_s", 2.0),
        ("jaywalk_share", 1.2),
    ],
)
def test_what_cannot_be_is_refused_by_name(scenario, field, value):
    with pytest.raises(InputError, match=f"^{field}: found"):
        dataclasses.replace(scenario, **{field: value})


def test_a_population_changes_drivers_numbers_and_nothing_else():
    scenario = SCENARIOS["straight_road"](duration_s=60.0)
    plain = sample_agents(scenario, 3)
    recorded = sample_agents(scenario, 3, read_population("profiles"))
    assert [dataclasses.replace(a, profile=None) for a in plain] == [
        dataclasses.replace(a, profile=None) for a in recorded
    ]
    driving = [(a, b) for a, b in zip(plain, recorded, strict=True) if a.profile is not None]
    assert all(a.profile != b.profile for a, b in driving)
    named = SCENARIOS["straight_road"](duration_s=60.0, population="profiles")
    assert sample_agents(named, 3) == recorded
    agent = driving[0][1]
    other = with_behavior(agent, Behavior.TIMID, population=named.population)
    assert other == with_behavior(agent, Behavior.TIMID, population=read_population("profiles"))
    assert other != with_behavior(agent, Behavior.TIMID)
