"""The network made from a road, and where vehicles are on it."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

from behaviors import InputError
from scenarios import SCENARIOS
from sim.highway.network import CONFLICT_M, SAMPLE_M, WIDEST_M
from sim.highway.run import network_of
from sim.highway.traffic import TrafficRoad
from sim.road import Road as SumoRoad

FOUR_WAY = ("south_in>", "north_out<")


def network(name: str):
    return network_of(SCENARIOS[name]().road)


def conflicts_of(made, lane: int):
    row = made.arrays.lanes[lane]
    return made.arrays.conflicts[row.conflict : row.conflict_end]


# The network ---------------------------------------------------------------------------------


def test_a_straight_road_is_one_stretch_with_lanes_counted_from_the_left():
    made = network("straight_road")
    assert set(made.lanes) == {("east_in<", "east_out>", i) for i in range(3)}
    road: SumoRoad = made.road
    leftmost = made.lanes["east_in<", "east_out>", 0]
    assert leftmost.length == pytest.approx(800.0)
    assert leftmost.points[0, 1] == -max(
        lane.centerline[0, 1] for lane in road.lanes if lane.edge == "east_in"
    )
    strips = made.strips_of(("east_in<", "east_out>", 0))
    assert strips[["near", "far"]].tolist() == [(398.0, 402.0)]


def test_junction_paths_join_lanes_and_know_their_light_and_their_foes():
    made = network("four_way_intersection")
    paths = list(made.exit_of)
    assert len(paths) == len(made.road.connections) == 16
    for (lane, stretch), path in made.onward.items():
        begin, end = made.lanes[lane], made.lanes[made.exit_of[path]]
        way = made.lanes[path]
        np.testing.assert_allclose(way.position(0, 0), begin.position(begin.length, 0), atol=0.1)
        np.testing.assert_allclose(way.position(way.length, 0), end.position(0, 0), atol=0.1)
        assert made.exit_of[path][:2] == stretch
    assert all(made.arrays.lanes[made.number[path]].signal >= 0 for path in paths)
    straight, parallel = (made.number[(*FOUR_WAY, i)] for i in range(2))
    assert not made.arrays.lanes[straight].must_yield
    for conflict in conflicts_of(made, straight):
        back = [c for c in conflicts_of(made, conflict.other) if c.other == straight]
        assert back[0].begin == conflict.other_begin
        assert conflict.other != parallel


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
        spans = {
            made.keys[c.other]: ((c.begin, c.end), (c.other_begin, c.other_end))
            for c in conflicts_of(made, made.number[one])
        }
        for other in begins:
            distance = np.linalg.norm(points[one][:, None] - points[other], axis=2)
            if begins[other] == begins[one] or distance.min() >= WIDEST_M:
                assert other not in spans
            elif distance.min() < CONFLICT_M:
                for k, path in enumerate((one, other)):
                    near = np.flatnonzero(distance.min(axis=1 - k) < CONFLICT_M)
                    s = np.linspace(0.0, made.lanes[path].length, len(points[path]))
                    begin, end = spans[other][k]
                    assert begin <= s[near[0]]
                    assert end >= s[near[-1]]


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
    other = copy.copy(made)
    other.road = road
    traffic, changed_s = TrafficRoad(other), -np.inf
    for index in range(5000):
        shown = traffic.signals[list(plan.groups)].tolist()
        traffic.time_s = index * step_s
        traffic.update_signals()
        expected = list(plan.state_at(traffic.time_s))
        changed_s = changed_s if shown == expected else traffic.time_s
        assert traffic.signals[list(plan.groups)].tolist() == expected
        assert (traffic.signal_since[list(plan.groups)] == changed_s).all()


def test_routes_that_do_not_exist_are_refused_by_name():
    made = network("four_way_intersection")
    with pytest.raises(InputError, match="'up'"):
        made.stretches(("up",))
    with pytest.raises(InputError, match="no way"):
        made.stretches(("east_out", "west_in"))
