"""The network made from a road, and where vehicles are on it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from highway_env.road.lane import lane_from_config
from highway_env.road.road import RoadNetwork

from behaviors import PROFILES, Behavior, InputError
from scenarios import SCENARIOS
from sim.highway.conflicts import CONFLICT_M, SAMPLE_M
from sim.highway.engine import network_of
from sim.highway.lane_places import ALIGNED, distances_along, find_on_lanes, lane_lines
from sim.highway.lanes import PolylineLane
from sim.highway.traffic import TrafficRoad
from sim.highway.vehicle import Driver, ProfileVehicle
from sim.highway.walkers import find_footway
from sim.road import Road as SumoRoad

FOUR_WAY = ("south_in>", "north_out<")


def network(name: str):
    return network_of(SCENARIOS[name]().road)


# The network ---------------------------------------------------------------------------------


def test_a_straight_road_is_one_stretch_with_lanes_counted_from_the_left():
    made = network("straight_road")
    assert set(made.lanes) == {("east_in<", "east_out>", i) for i in range(3)}
    road: SumoRoad = made.road
    leftmost = made.lanes["east_in<", "east_out>", 0]
    assert leftmost.length == pytest.approx(800.0)
    assert leftmost.start[1] == -max(
        lane.centerline[0, 1] for lane in road.lanes if lane.edge == "east_in"
    )
    strips = made.info["east_in<", "east_out>", 0].strips
    assert [(strip.near_s, strip.far_s) for strip in strips] == [(398.0, 402.0)]


def test_junction_paths_join_lanes_and_know_their_light_and_their_foes():
    made = network("four_way_intersection")
    paths = [lane for lane, info in made.info.items() if info.connector]
    assert len(paths) == len(made.road.connections) == 16
    for (lane, stretch), path in made.onward.items():
        begin, end = made.lanes[lane], made.lanes[made.exit_of[path]]
        way = made.lanes[path]
        np.testing.assert_allclose(way.position(0, 0), begin.position(begin.length, 0), atol=0.1)
        np.testing.assert_allclose(way.position(way.length, 0), end.position(0, 0), atol=0.1)
        assert made.exit_of[path][:2] == stretch
    assert all(made.info[path].signal >= 0 for path in paths)
    straight = made.info[(*FOUR_WAY, 0)]
    assert not straight.must_yield
    for conflict in straight.conflicts:
        back = [c for c in made.info[conflict.other].conflicts if c.other == (*FOUR_WAY, 0)]
        assert back, conflict
        assert back[0].begin_s == conflict.other_begin_s
    parallel = (*FOUR_WAY, 1)
    assert parallel not in [c.other for c in straight.conflicts]


@pytest.mark.parametrize("name", ["four_way_intersection", "roundabout", "city"])
def test_conflicts_are_those_that_a_comparison_of_all_paths_finds(name):
    made = network(name)
    begins = {path: lane for (lane, _), path in made.onward.items()}
    points = {
        path: np.array([lane.position(s, 0.0) for s in np.linspace(0.0, lane.length, count)])
        for path, lane in ((path, made.lanes[path]) for path in begins)
        if (count := max(int(lane.length / SAMPLE_M), 1) + 1)
    }
    for one in list(begins)[:40]:
        expected = {}
        for other in begins:
            distance = np.linalg.norm(points[one][:, None] - points[other], axis=2)
            mine = np.flatnonzero(distance.min(axis=1) < CONFLICT_M)
            theirs = np.flatnonzero(distance.min(axis=0) < CONFLICT_M)
            if mine.size and begins[other] != begins[one]:
                s = [
                    np.linspace(0.0, made.lanes[path].length, len(points[path]))[near[[0, -1]]]
                    for path, near in ((one, mine), (other, theirs))
                ]
                expected[other] = (*s[0], *s[1])
        assert expected == {
            c.other: (c.begin_s, c.end_s, c.other_begin_s, c.other_end_s)
            for c in made.info[one].conflicts
        }


@pytest.mark.parametrize("step_s", [0.02, 0.1, 7.0])
def test_lights_show_what_their_plan_says_at_every_time(step_s):
    made = network("four_way_intersection")
    (plan,) = made.road.signal_plans
    plan = dataclasses.replace(
        plan,
        duration_s=(30.0, 0.0, 0.03, 4.5),
        states=tuple((state,) * len(plan.groups) for state in range(4)),
        offset_s=-7.31,
    )
    road = dataclasses.replace(made.road, signal_plans=(plan,))
    traffic, changed_s = TrafficRoad(dataclasses.replace(made, road=road)), -np.inf
    for index in range(5000):
        shown = traffic.signals[list(plan.groups)].tolist()
        traffic.time_s = index * step_s
        traffic.update_signals()
        expected = list(plan.state_at(traffic.time_s))
        changed_s = changed_s if shown == expected else traffic.time_s
        assert traffic.signals[list(plan.groups)].tolist() == expected
        assert (traffic.signal_since[list(plan.groups)] == changed_s).all()


@pytest.mark.parametrize("name", ["four_way_intersection", "roundabout", "motorway_ramps", "city"])
def test_who_is_on_a_lane_is_what_a_search_of_all_lanes_finds(name):
    made, rng = network(name), np.random.default_rng(0)
    lanes = list(made.lanes.values())
    connector = [made.info[key].connector for key in made.lanes]
    lines, n = lane_lines(lanes, connector), 150
    near = [lanes[i] for i in rng.integers(len(lanes), size=n)]
    s = [rng.uniform(-50.0, lane.length + 15.0) for lane in near]
    aside = rng.uniform(-4.0, 4.0, n)
    xy = np.array([lane.position(*at) for lane, *at in zip(near, s, aside, strict=True)])
    heading = np.array([lane.heading_at(max(at, 0.0)) for lane, at in zip(near, s, strict=True)])
    length = rng.uniform(3.0, 20.0, n)
    found = find_on_lanes(xy, heading, np.full(n, 10.0), length, lines)
    on = {
        (int(row), k)
        for k in range(len(lanes))
        for row in found.row[found.first[k] : found.first[k + 1]]
    }
    expected = set()
    for k in range(len(lanes)):
        begin, end = lines.first[k], lines.last[k]
        along = distances_along(xy, np.full(n, k), lines)
        for row in range(n):
            piece = begin + int(
                np.searchsorted(lines.begin[begin + 1 : end + 1], along[row], side="left")
            )
            foot = lines.start[piece] + (along[row] - lines.begin[piece]) * lines.direction[piece]
            facing = lines.direction[piece] @ (np.cos(heading[row]), np.sin(heading[row]))
            if (
                np.hypot(*(xy[row] - foot)) <= lines.margin[k]
                and (facing if connector[k] else abs(facing)) > ALIGNED
                and -lines.behind[k] <= along[row] <= lanes[k].length + length[row] / 2
            ):
                expected.add((row, k))
    corner = {pair for pair in on ^ expected if not connector[pair[1]]}
    assert len(expected) > n
    assert len(on ^ expected) <= 0.02 * len(expected), corner  # a foot at a corner has two pieces
    for k in range(len(lanes)):
        assert (np.diff(found.s[found.first[k] : found.first[k + 1]]) >= 0.0).all()


def test_lanes_keep_their_order_over_the_junction():
    made = network("four_way_intersection")
    for number in range(2):
        path = made.onward[("south_in<", "south_in>", number), ("north_out<", "north_out>")]
        assert made.exit_of[path][2] == number
        assert path[2] == number  # highway-env's own vehicles rely on it


def test_only_two_way_roads_have_lanes_on_the_wrong_side():
    assert network("straight_road").wrong_side == {}
    made = network("two_way_road")
    for lane, wrong_side in made.wrong_side.items():
        own, over = made.lanes[lane], made.lanes[wrong_side]
        np.testing.assert_allclose(over.direction, own.direction, atol=1e-9)
        s, lateral = own.local_coordinates(over.position(10.0, 0.0))
        assert s == pytest.approx(10.0)
        assert lateral == pytest.approx(-own.width)  # to the left


def test_routes_that_do_not_exist_are_refused_by_name():
    made = network("four_way_intersection")
    with pytest.raises(InputError, match="'up'"):
        made.stretches(("up",))
    with pytest.raises(InputError, match="no way"):
        made.stretches(("east_out", "west_in"))


def test_polylines_project_back_and_survive_their_config():
    lane = PolylineLane(np.array([[0.0, 0.0], [10.0, 0.0], [16.0, 8.0], [16.0, 20.0]]), 3.2)
    for s in (0.0, 4.0, 12.0, 19.0, 28.0):
        for lateral in (-0.5, 0.0, 0.5):
            back = lane.local_coordinates(lane.position(s, lateral))
            np.testing.assert_allclose(back, [s, lateral], atol=0.35)
    again = lane_from_config(lane.to_config())
    np.testing.assert_array_equal(again.points, lane.points)
    assert lane.heading_at(-1.0) == 0.0
    assert lane.heading_at(lane.length) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("turn", [-1.0, 1.0])
def test_beyond_a_sharp_corner_is_outside_of_it_whatever_piece_is_nearer(turn):
    far = np.array([10.0 + 10.0 * np.cos(2.6), 10.0 * turn * np.sin(2.6)])
    lane = PolylineLane(np.array([[0.0, 0.0], [10.0, 0.0], far]), 3.2)
    for across in (-1.0, 0.0, 1.0):  # from either piece, and straight on
        _, lateral = lane.local_coordinates(np.array([12.0, across]))
        assert np.sign(lateral) == -turn


def test_footways_use_crossings_only_where_they_have_to():
    road = SCENARIOS["four_way_intersection"]().road
    assert find_footway(road, ("east_in", "north_out")).crossovers == ()
    assert len(find_footway(road, ("east_in", "west_out")).crossovers) == 1
    assert len(find_footway(road, ("east_in", "south_out")).crossovers) == 2
    with pytest.raises(InputError, match="sidewalk"):
        find_footway(road, ("nowhere",))


@pytest.mark.parametrize("name", ["four_way_intersection", "two_way_road", "roundabout"])
def test_the_closest_lane_is_the_one_that_the_stock_search_finds(name):
    net = network(name).net
    centre = np.concatenate([lane.position(0.0, 0.0)[None] for lane in net.lanes_list()])
    rng = np.random.default_rng(0)
    for place in rng.uniform(centre.min(axis=0) - 30, centre.max(axis=0) + 30, (60, 2)):
        heading = float(rng.uniform(-np.pi, np.pi))
        found = net.get_closest_lane_index(place, heading)
        assert found == RoadNetwork.get_closest_lane_index(net, place, heading)


# Profiles ------------------------------------------------------------------------------------


def test_a_new_profile_is_heeded_at_the_next_step():
    road = TrafficRoad(network("straight_road"))
    lane = road.network_info.lanes["east_in<", "east_out>", 1]
    vehicle = ProfileVehicle(
        road, lane.position(50.0, 0.0), 0.0, 9.0, driver=Driver(PROFILES[Behavior.CAREFUL]),
        lane_index=("east_in<", "east_out>", 1), stretches=(("east_in<", "east_out>"),),
    )  # fmt: skip
    road.vehicles.append(vehicle)
    for _ in range(20):
        road.act()
        road.step(0.1)
    before = vehicle.action["acceleration"]
    assert before > 0
    vehicle.profile = dataclasses.replace(PROFILES[Behavior.CAREFUL], speed_factor=0.3)
    road.act()
    road.step(0.1)
    assert vehicle.action["acceleration"] < 0
