"""The engines' contract, and the physics and manners of the highway-env engine."""

from __future__ import annotations

import dataclasses
import math
import subprocess

import numpy as np
import pytest

from behaviors import BEHAVIORS, PROFILES, Behavior
from scenarios import SCENARIOS
from scenarios.networks.build import find_program
from sim.engines import get_engine
from sim.episode.observables import observe
from sim.frames import PEDESTRIAN, SIGNALS, AgentKind, EventKind, Tracks
from sim.highway import run as engine
from sim.highway.driving import driver_rows
from sim.highway.move import CLEAR_AFTER_S
from sim.highway.run import network_of, run
from sim.highway.traffic import TrafficRoad
from sim.road.net import read_road
from sim.scenario import WALK_START_M, AgentSpec, Scenario, sample_agents

STRAIGHT = ("east_in", "east_out")
OPPOSITE = (("east", "west"), ("west", "east"), ("north", "south"), ("south", "north"))


def driver(
    behavior: Behavior,
    number: int = 0,
    *,
    route=STRAIGHT,
    depart_s: float = 0.0,
    kind: AgentKind = AgentKind.CAR,
    length: float = 4.6,
    **changes,
) -> AgentSpec:
    profile = dataclasses.replace(PROFILES[behavior], **changes)
    return AgentSpec(
        number, kind, behavior, profile, route, depart_s, length, 1.8, 0.0, seed=number
    )


def walker(number: int, route, depart_s: float = 0.0, speed: float = 1.4) -> AgentSpec:
    return AgentSpec(
        number, AgentKind.PEDESTRIAN, None, None, route, depart_s, 0.25, 0.5, speed, seed=number
    )


def tracks(name: str, agents, duration_s: float, seed: int = 0, **options) -> Tracks:
    scenario = SCENARIOS[name](duration_s=duration_s, **options)
    return Tracks.from_frames(run(scenario, agents, seed), {a.id: a.behavior for a in agents})


def put(road, lane, s: float, speed: float, behavior: Behavior, number=0, law="IDM", **changes):
    (row,) = driver_rows([driver(behavior, number, **changes)], 0, law)
    row["route"], network = road.route_number((lane[:2],)), road.network
    engine.put(row, network.number[lane], s, speed, network.arrays)
    road.add(row)
    return road.vehicles[-1]


def change(vehicle, **values) -> None:
    for name, value in values.items():
        rows, row = vehicle.road.row_of(vehicle.agent)
        rows[name][row] = value


def straight_network():
    return network_of(SCENARIOS["straight_road"]().road)


# Draws ---------------------------------------------------------------------------------------


def test_a_driver_runs_the_same_lights_whoever_else_is_there():
    agents = [
        driver(Behavior.CAREFUL, i, route=route, depart_s=8.0 * (i // 4), red_run_probability=0.5)
        for i, route in enumerate(4 * [(f"{a}_in", f"{b}_out") for a, b in OPPOSITE])
    ]
    runs = []
    for some in (agents, agents[::-1]):
        scenario = SCENARIOS["four_way_intersection"](duration_s=45.0)
        events = [e for f in run(scenario, some, 3) for e in f.events]
        runs.append({e.agent for e in events if e.kind is EventKind.RED_RUN})
    assert runs[0] == runs[1] != set()


# Car following -------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["IDM", "Krauss"])
def test_follows_at_the_law_s_equilibrium_gap_from_bumper_to_bumper(law):
    road = TrafficRoad(straight_network())
    lane, slow = ("east_in<", "east_out>", 0), 8.0 / 13.89
    changes = {"lane_change_gain": 0.0}
    leader = put(road, lane, 100.0, 8.0, Behavior.CAREFUL, 1, speed_factor=slow, **changes)
    follower = put(road, lane, 70.0, 8.0, Behavior.CAREFUL, 2, law, **changes)
    for _ in range(700):
        road.advance(0.1)
    profile = PROFILES[Behavior.CAREFUL]
    speed, wanted = follower.speed, profile.speed_factor * 13.89
    gap = leader.position[0] - follower.position[0] - (leader.LENGTH + follower.LENGTH) / 2
    expected = profile.min_gap_m + speed * profile.time_headway_s
    if law == "IDM":  # Treiber, Hennecke, Helbing (2000), eq. 5
        expected /= math.sqrt(1.0 - (speed / wanted) ** 4)
    assert speed == pytest.approx(8.0, abs=0.05)
    assert gap == pytest.approx(expected, rel=0.02)


def test_a_free_driver_is_not_held_to_the_limit():
    seen = tracks("straight_road", [driver(Behavior.IMPATIENT)], 30.0)
    assert seen.speed[0, -1] == pytest.approx(1.35 * 13.89, rel=0.02)


@pytest.mark.parametrize("behavior", BEHAVIORS)
def test_stops_behind_what_stands_in_the_way(behavior):
    road = TrafficRoad(straight_network())
    for lane in range(3):
        block = put(road, ("east_in<", "east_out>", lane), 200.0, 0.0, behavior, 10 + lane)
        change(block, due=math.inf, stop_until=math.inf)
    own = put(road, ("east_in<", "east_out>", 1), 20.0, 14.0, behavior, 1)
    for _ in range(400):
        road.advance(0.1)
    assert not own.crashed
    gap = 200.0 - own.position[0] - own.LENGTH
    assert own.speed < 0.3
    assert 0.0 < gap < 3.0 * PROFILES[behavior].min_gap_m + 1.0


def test_a_driver_who_stops_for_no_reason_does_and_goes_on():
    seen = tracks("straight_road", [driver(Behavior.TIMID, stop_rate_per_min=4.0)], 60.0)
    speed = seen.speed[0][seen.valid[0]]
    assert speed.min() < 1.0
    assert speed[np.argmin(speed) :].max() > 6.0


def test_nobody_drives_backwards_and_the_road_clears():
    scenario = SCENARIOS["straight_road"](duration_s=200.0, flow=600)
    agents = [a for a in sample_agents(scenario, 2) if a.depart_s < 20.0]
    seen = Tracks.from_frames(run(scenario, agents, 0))
    assert np.nanmin(seen.speed) >= 0.0
    drivers = seen.kind != PEDESTRIAN
    assert not seen.valid[drivers, -1].any()


# Lane changes --------------------------------------------------------------------------------


def test_an_impatient_driver_overtakes_and_a_timid_one_stays_behind():
    for behavior, overtakes in ((Behavior.IMPATIENT, True), (Behavior.TIMID, False)):
        road = TrafficRoad(straight_network())
        lane, changes = ("east_in<", "east_out>", 1), {"stop_rate_per_min": 0.0}
        slow = put(road, lane, 60.0, 5.0, Behavior.TIMID, 1, speed_factor=0.36, **changes)
        own = put(road, lane, 20.0, 9.0, behavior, 2)
        for _ in range(300):
            road.advance(0.1)
        assert bool(own.position[0] > slow.position[0]) is overtakes


def test_a_lane_change_takes_about_three_seconds():
    road = TrafficRoad(straight_network())
    vehicle = put(road, ("east_in<", "east_out>", 1), 50.0, 12.0, Behavior.TIMID)
    begin = vehicle.position[1]
    change(vehicle, target=0, wanted=0)
    taken = 0.0
    while abs(vehicle.position[1] - begin) < 3.0 and taken < 10.0:
        road.advance(0.1)
        taken += 0.1
    assert 2.0 < taken < 4.5


def test_a_threatening_driver_cuts_in_just_ahead_of_somebody():
    road = TrafficRoad(straight_network())
    put(road, ("east_in<", "east_out>", 0), 90.0, 10.0, Behavior.CAREFUL, 1)
    changes = {"lane_change_gain": 0.0, "cut_in_rate_per_min": 600.0}
    own = put(road, ("east_in<", "east_out>", 1), 102.0, 10.5, Behavior.THREATENING, 2, **changes)
    for _ in range(60):
        road.advance(0.1)
        if own.lane_index[2] != 1:
            break
    assert own.lane_index[2] == 0
    assert not own.crashed


# Lights, junctions, crossings ----------------------------------------------------------------


def red_runs(behavior: Behavior, number: int) -> tuple[int, int]:
    """How many of lone drivers that come to a red light run it."""
    runs = 0
    for seed in range(number):
        agent = driver(behavior, route=("east_in", "west_out"))
        agent = dataclasses.replace(agent, seed=seed)
        scenario = SCENARIOS["four_way_intersection"](duration_s=29.0)
        events = [e for f in run(scenario, [agent], seed) for e in f.events]
        runs += sum(e.kind is EventKind.RED_RUN for e in events)
    return runs, number


def test_reckless_drivers_run_red_lights_and_careful_ones_wait():
    runs, number = red_runs(Behavior.RECKLESS, 5)
    assert runs == number
    assert red_runs(Behavior.CAREFUL, 5)[0] == 0
    assert red_runs(Behavior.IMPATIENT, 5)[0] == 0


def test_a_driver_who_waits_at_red_stands_before_the_line_and_goes_at_green():
    seen = tracks(
        "four_way_intersection", [driver(Behavior.CAREFUL, route=("east_in", "west_out"))], 60.0
    )
    front = seen.xy[0, :, 0] - seen.length[0] / 2
    red = seen.time_s < 29.0
    assert np.nanmin(front[red]) > 10.4  # the line
    assert seen.speed[0, 280] < 0.2
    assert seen.xy[0, seen.valid[0]][-1, 0] < -200.0


@pytest.mark.parametrize("turn", ["north_out", "west_out", "south_out"])
def test_keeps_to_its_path_through_the_junction(turn):
    agent = driver(Behavior.CAREFUL, route=("east_in", turn))
    scenario = SCENARIOS["four_way_intersection"](duration_s=75.0)
    seen = Tracks.from_frames(run(scenario, [agent], 0))
    facts = observe(seen, scenario.road)
    assert np.nanmax(np.abs(facts.offset)) < 0.9
    assert np.isin(turn, [scenario.road.lanes[i].edge for i in facts.lane if i >= 0])


def test_a_left_turner_lets_oncoming_traffic_pass_first():
    agents = [
        driver(Behavior.CAREFUL, 0, route=("north_in", "east_out")),
        driver(Behavior.CAREFUL, 1, route=("south_in", "north_out"), depart_s=0.0),
    ]
    seen = tracks("four_way_intersection", agents, 60.0)
    assert not [e for e in seen.events if e.kind is EventKind.COLLISION]
    through = seen.time_s[np.flatnonzero(seen.xy[1, :, 1] > 10.0)[0]]
    turned = seen.time_s[np.flatnonzero(seen.xy[0, :, 0] > 10.0)[0]]
    assert turned > through


def meet_pedestrian(behavior: Behavior, seed: int = 0) -> Tracks:
    """A driver and a pedestrian who come to the zebra together."""
    arrives_s = 10.0 + 395.0 / (PROFILES[behavior].speed_factor * 13.89)
    leaves_s = arrives_s - 1.5 - WALK_START_M / 1.4
    agents = [
        dataclasses.replace(driver(behavior, 0, depart_s=10.0, stop_rate_per_min=0.0), seed=seed),
        walker(1, ("west_in", "east_in"), leaves_s, speed=1.4),
    ]
    return tracks("straight_road", agents, 90.0)


@pytest.mark.parametrize(
    ("behavior", "yields"),
    [(Behavior.CAREFUL, True), (Behavior.TIMID, True), (Behavior.RECKLESS, False)],
)
def test_conservative_drivers_let_pedestrians_cross_and_reckless_ones_do_not(behavior, yields):
    seen = meet_pedestrian(behavior)
    assert EventKind.COLLISION not in [event.kind for event in seen.events]
    slowest = np.nanmin(seen.speed[0])
    assert bool(slowest < 3.0) is yields


def test_pedestrians_cross_at_the_crossing_and_reach_the_other_side():
    seen = tracks("straight_road", [walker(0, ("east_in", "west_out"))], 330.0, step_s=0.5)
    on_road = (seen.xy[0, :, 1] < -0.8) & (seen.xy[0, :, 1] > -8.8)
    assert on_road.any()
    assert (np.abs(seen.xy[0, on_road, 0] - 400.0) < 2.0).all()
    assert seen.xy[0, seen.valid[0]][-1, 1] > 0.0


def test_pedestrians_wait_for_their_light():
    seen = tracks("four_way_intersection", [walker(0, ("east_in", "west_out"))], 330.0, step_s=0.2)
    on = (np.abs(seen.xy[0, :, 0]) < 6.0) & (np.abs(seen.xy[0, :, 1]) < 10.4)
    begin = int(np.flatnonzero(on)[0])
    crossing = SCENARIOS["four_way_intersection"]().road.crossings[0]
    stepped_out = seen.signals[crossing.signal, begin - 12 : begin]
    assert (stepped_out == SIGNALS.index("green")).any()


def test_an_all_way_stop_is_stopped_at_or_rolled():
    for behavior, rolls in ((Behavior.CAREFUL, False), (Behavior.RECKLESS, True)):
        seen = tracks("all_way_stop", [driver(behavior, route=("east_in", "west_out"))], 60.0)
        rolled = any(event.kind is EventKind.STOP_ROLLED for event in seen.events)
        assert rolled is rolls
        assert bool(np.nanmin(seen.speed[0]) < 0.3) is (not rolls)


@pytest.mark.parametrize("number", [0, 1])
def test_at_right_before_left_the_driver_from_the_right_goes_first(number):
    agents = [
        driver(Behavior.CAREFUL, number, route=("east_in", "west_out")),
        driver(Behavior.CAREFUL, 1 - number, route=("north_in", "south_out"), depart_s=1.0),
    ]
    seen = tracks("right_before_left", agents, 40.0)
    assert not [e for e in seen.events if e.kind is EventKind.COLLISION]
    from_east = seen.time_s[np.flatnonzero(seen.xy[number, :, 0] < 0.0)[0]]
    from_north = seen.time_s[np.flatnonzero(seen.xy[1 - number, :, 1] < 0.0)[0]]
    assert from_north < from_east


@pytest.mark.parametrize("later", [0, 1])
def test_at_an_all_way_stop_who_stops_first_goes_first(later):
    routes = (("east_in", "west_out"), ("north_in", "south_out"))
    agents = [
        driver(Behavior.CAREFUL, i, route=route, depart_s=1.5 * (i == later))
        for i, route in enumerate(routes)
    ]
    seen = tracks("all_way_stop", agents, 45.0)
    assert not [e for e in seen.events if e.kind is EventKind.COLLISION]
    crossed = [
        seen.time_s[np.flatnonzero(seen.xy[i, :, axis] < 0.0)[0]] for i, axis in ((0, 0), (1, 1))
    ]
    assert crossed[later] > crossed[1 - later]


def test_careful_drivers_keep_their_whole_car_on_its_side_in_tight_corners(tmp_path):
    pytest.importorskip("sumo", reason="netgenerate is not installed")
    net = tmp_path / "grid.net.xml"
    options = "--grid --grid.number 2 --grid.length 60 --no-turnarounds"
    command = [find_program("netgenerate"), *options.split(), "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    round_both_ways = (("A0A1", "A1B1", "B1B0"), ("B0B1", "B1A1", "A1A0"))
    agents = [
        driver(Behavior.CAREFUL, i, route=round_both_ways[i % 2], depart_s=3.0 * (i // 2))
        for i in range(8)
    ]
    scenario = Scenario("corner", read_road(net), (), duration_s=40.0)
    events = [event for frame in run(scenario, agents, 0) for event in frame.events]
    assert not [event for event in events if event.kind is EventKind.COLLISION]


def test_reckless_drivers_overtake_on_the_wrong_side_and_come_back():
    agents = [
        driver(Behavior.TIMID, 0, stop_rate_per_min=0.0, speed_factor=0.4),
        driver(Behavior.RECKLESS, 1, depart_s=6.0, wrong_way_rate_per_min=60.0),
    ]
    seen = tracks("two_way_road", agents, 90.0)
    assert EventKind.WRONG_WAY in [event.kind for event in seen.events]
    both = seen.valid.all(axis=0)
    assert (seen.xy[1, both, 0] > seen.xy[0, both, 0]).any()  # got past
    own_side = seen.xy[0, seen.valid[0]][0, 1]
    assert seen.xy[1, seen.valid[1]][-1, 1] == pytest.approx(own_side, abs=0.5)
    assert not [e for e in seen.events if e.kind is EventKind.COLLISION]


# Collisions ----------------------------------------------------------------------------------


def test_a_collision_is_noted_and_cleared():
    road = TrafficRoad(straight_network())
    standing = put(road, ("east_in<", "east_out>", 1), 100.0, 0.0, Behavior.CAREFUL, 1)
    change(standing, due=math.inf, stop_until=math.inf)
    moving = put(road, ("east_in<", "east_out>", 1), 90.0, 14.0, Behavior.THREATENING, 2)
    for _ in range(10):
        road.advance(0.1)
    (event,) = [e for e in road.take_events() if e.kind is EventKind.COLLISION]
    assert (event.agent, event.other) == (2, 1)
    assert moving.crashed
    assert standing.crashed
    for _ in range(round(10 * CLEAR_AFTER_S) + 5):
        road.advance(0.1)
    assert road.vehicles == []
    assert [e.kind for e in road.take_events()] == [EventKind.REMOVAL] * 2


def test_traffic_behind_a_collision_goes_on_once_it_is_cleared():
    road = TrafficRoad(straight_network())
    for lane in range(3):
        wreck = put(road, ("east_in<", "east_out>", lane), 200.0, 0.0, Behavior.CAREFUL, lane)
        change(wreck, crashed=True, crashed_at=0.0)
    own = put(road, ("east_in<", "east_out>", 0), 120.0, 10.0, Behavior.CAREFUL, 9)
    for _ in range(300):
        road.advance(0.1)
    assert not own.crashed
    assert own.position[0] > 210.0


@pytest.mark.parametrize("engine", ["highway", "highway-krauss"])
def test_conservative_drivers_cause_no_collisions_on_the_straight_road(engine):
    scenario = SCENARIOS["straight_road"](duration_s=100.0, flow="dense")
    agents = sample_agents(scenario, 7)
    events = [e for f in get_engine(engine)(scenario, agents, 7) for e in f.events]
    caused = [e for e in events if e.kind is EventKind.COLLISION]
    assert all(agents[e.agent].behavior.style == "aggressive" for e in caused)


def test_all_kinds_of_vehicles_drive():
    agents = [
        driver(Behavior.CAREFUL, i, depart_s=4.0 * i, kind=kind, length=length)
        for i, (kind, length) in enumerate(
            [(AgentKind.BUS, 12.0), (AgentKind.BICYCLE, 1.8), (AgentKind.TRUCK, 8.5)]
        )
    ]
    seen = tracks("straight_road", agents, 40.0)
    np.testing.assert_allclose(seen.length, [12.0, 1.8, 8.5])
    assert seen.kind.tolist() == [a.kind.code for a in agents]
    assert np.nanmax(seen.speed[1]) < 5.6  # as fast as bicycles go
    assert not seen.events
