import re

import numpy as np
import pytest

from behaviors.errors import InputError
from scenarios.networks.build import FOLDER, NET
from sim.frames import Signal
from sim.road import SignalPlan
from sim.road.lane_graph import LaneGraph
from sim.road.net import read_road


@pytest.fixture(scope="module")
def four_way():
    return read_road(FOLDER / "four_way_intersection" / NET, "four_way")


@pytest.mark.parametrize("name", sorted(one.parent.name for one in FOLDER.glob("*/road.netccfg")))
def test_every_shipped_net_is_a_road(name):
    road = read_road(FOLDER / name / NET, name)
    assert road.name == name
    assert road.connections
    assert {link.from_lane for link in road.connections} <= set(road.lane_index)
    for link in road.connections:
        for via in link.via:
            assert road.lanes[road.lane_index[via]].internal
        assert all(0 <= i < len(road.connections) for i in link.yields_to)
        assert link.must_yield == bool(link.yields_to)
    without = name.endswith("_plain") or name in ("motorway", "motorway_ramps", "roundabout")
    assert bool(road.crossings) is not without


def test_signals_are_grouped_and_their_plan_covers_every_group(four_way):
    (plan,) = four_way.signal_plans
    assert len(four_way.signal_groups) == 4
    assert sorted(plan.groups) == [0, 1, 2, 3]
    assert {c.signal for c in four_way.crossings} <= set(plan.groups)
    green = Signal.GREEN.code
    ways = {link.from_lane.split("_")[0]: link.signal for link in four_way.connections}
    assert ways["north"] == ways["south"] != ways["east"] == ways["west"]
    both = [ways["north"], ways["east"]]
    for states in plan.states:
        assert [states[plan.groups.index(g)] for g in both] != [green, green]


def test_a_left_turn_yields_to_the_oncoming_traffic_only(four_way):
    for link in four_way.connections:
        arms = {four_way.connections[i].from_lane.split("_")[0] for i in link.yields_to}
        opposite = {"north": "south", "south": "north", "east": "west", "west": "east"}
        expected = {opposite[link.from_lane.split("_")[0]]} if link.direction == "left" else set()
        assert arms == expected


def test_control_decides_who_stops_and_who_yields():
    def arms(name, field):
        road = read_road(FOLDER / name / NET)
        links = [c for c in road.connections if c.direction == "straight"]
        return {c.from_lane.split("_")[0] for c in links if getattr(c, field)}

    every = {"north", "south", "east", "west"}
    assert arms("four_way_priority", "must_yield") == {"north", "south"}
    assert arms("four_way_allway_stop", "must_stop") == every
    assert arms("four_way_right_before_left", "must_yield") == every
    assert arms("four_way_right_before_left", "must_stop") == set()


def test_two_way_roads_know_the_lane_of_the_other_direction():
    road = read_road(FOLDER / "two_way_1" / NET)
    lane = road.lanes[road.lane_index["east_in_1"]]
    assert lane.opposite == "west_out_1"
    heading = {
        i: float(np.arctan2(*np.diff(road.lanes[road.lane_index[i]].centerline, axis=0)[0][::-1]))
        for i in ("east_in_1", "west_out_1")
    }
    assert abs(heading["east_in_1"] - heading["west_out_1"]) == pytest.approx(np.pi)


def test_project_finds_lane_distance_and_offset():
    road = read_road(FOLDER / "straight_road" / NET)
    lane = road.lanes[road.lane_index["east_in_2"]]
    x, y = lane.centerline[0] + [100.0, 0.7]
    found = LaneGraph.of(road).project(np.array([[x, y]]), np.array([0.0]))
    assert road.lanes[int(found.lane[0])].id == "east_in_2"
    assert found.s[0] == pytest.approx(100.0)
    assert found.offset[0] == pytest.approx(0.7)


def test_signal_plan_repeats():
    plan = SignalPlan("a", (0,), (0,), (10.0, 5.0), ((2,), (0,)), offset_s=3.0)
    assert [plan.state_at(t) for t in (3.0, 12.9, 13.0, 18.0, 2.9)] == [
        (2,),
        (2,),
        (0,),
        (2,),
        (0,),
    ]


def test_the_programme_that_is_loaded_last_runs(tmp_path, four_way):
    text = four_way.source.read_text()
    whole = re.search(r"<tlLogic.*?</tlLogic>", text, re.DOTALL)
    assert whole is not None
    other = re.sub(r'programID="[^"]*"', 'programID="other"', whole[0])
    other = re.sub(r'duration="[^"]*"', 'duration="7"', other)
    path = tmp_path / "road.net.xml"
    path.write_text(text.replace(whole[0], whole[0] + other))
    (plan,) = read_road(path).signal_plans
    assert set(plan.duration_s) == {7.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "found no file"),
        ("", "broken file"),
        ("<net><edge", "broken file"),
        ("<other/>", "no drivable lane"),
    ],
)
def test_what_is_no_net_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "road.net.xml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_road(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
