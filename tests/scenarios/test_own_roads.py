"""Roads of one's own: demand made from a net, routes from a file, scenarios from a file."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.generate.world_roads import ramp_net
from scenarios import SCENARIOS, get_scenario
from scenarios.networks.build import grid_net
from scenarios.own.flows import EdgeGraph, flows_of
from scenarios.own.scenario_file import ScenarioFile, own_road
from sim.engines import get_engine
from sim.road.net import read_road
from sim.scenario import sample_agents


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def ramp(tmp_path):
    net = tmp_path / "ramp.net.xml"
    net.write_text(ramp_net(2, 25.0, 600.0))
    return net


def refusal(make) -> str:
    """The one line with which something is refused."""
    with pytest.raises(InputError) as caught:
        make()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def ride(scenario, engine: str, demand_s: float, most_s: float):
    """Who entered, and who is still on the road at the end."""
    agents = sample_agents(dataclasses.replace(scenario, duration_s=demand_s), 0)
    longer = dataclasses.replace(scenario, duration_s=most_s)
    entered: set[int] = set()
    present: set[int] = set()
    for frame in get_engine(engine)(longer, agents, 0):
        present = set(frame.ids.tolist())
        entered |= present
        if frame.time_s > demand_s and len(entered) == len(agents) and not present:
            break
    return entered, present


def test_demand_leads_from_fringe_to_fringe_over_joined_edges():
    road = read_road(grid_net(3), "grid")
    graph = EdgeGraph(road)
    assert len(graph.sources) == len(graph.sinks) == 12
    flows = flows_of(road, 1200.0, None)
    assert len(flows) == 12 * 12
    assert sum(flow.per_hour for flow in flows) == pytest.approx(1200.0)
    for flow in flows:
        assert flow.route[0] in graph.sources
        assert flow.route[-1] in graph.sinks
        assert all(pair in graph.links for pair in itertools.pairwise(flow.route))


@pytest.mark.parametrize("engine", ["sumo", "highway"])
def test_everybody_leaves_a_grid_where_turns_need_the_right_lane(engine):
    entered, present = ride(own_road(net=grid_net(3), flow=1500.0), engine, 12.0, 300.0)
    assert len(entered) >= 5
    assert not present


def test_a_route_file_says_how_often_each_route_is_driven(ramp, tmp_path):
    routes = tmp_path / "ramp.rou.xml"
    routes.write_text(
        '<routes><route id="through" edges="before between after"/>'
        '<flow id="a" route="through" begin="0" end="600" number="100"/>'
        '<flow id="b" from="on" to="after" period="exp(0.05)"/>'
        '<trip id="c" depart="0:00:10" from="before" to="off"/></routes>'
    )
    flows = own_road(net=ramp, routes=routes).flows
    assert {flow.route: flow.per_hour for flow in flows} == {
        ("before", "between", "after"): pytest.approx(600.0),
        ("on", "between", "after"): pytest.approx(180.0),
        ("before", "between", "off"): pytest.approx(60.0),
    }
    scaled = own_road(net=ramp, routes=routes, flow=420.0)
    assert scaled.per_hour(walking=False) == pytest.approx(420.0)


def test_a_file_describes_a_scenario(ramp, tmp_path):
    file = tmp_path / "rush.toml"
    file.write_text(
        'net = "ramp.net.xml"\nduration_s = 30\nstep_s = 0.5\nlimits_mps = [10, 20]\n'
        "[demand]\non = 300\n[mix]\ntimid = 1.0\n"
    )
    entry = get_scenario(str(file))
    scenario = entry()
    assert (scenario.name, scenario.steps, entry.limits_mps) == ("rush", 60, (10.0, 20.0))
    assert {flow.route[0] for flow in scenario.flows} == {"on"}
    assert scenario.per_hour(walking=False) == pytest.approx(300.0)
    assert max(lane.speed_limit_mps for lane in scenario.road.lanes) == pytest.approx(10.0)
    assert entry(limit_mps=20.0).road.lanes[0].speed_limit_mps == pytest.approx(20.0)


def documented(heading: str) -> dict[str, str]:
    """The rows of a table of the page about roads: the first cell, without its marks, and the rest.

    Args:
        heading: what stands in the head of its first column.
    """
    page = (Path(__file__).parents[2] / "docs" / "roads.md").read_text()
    rows = page.partition(f"| {heading} |")[2].splitlines()[2:]
    cells = (row.split("|", 2) for row in itertools.takewhile(lambda row: row[:1] == "|", rows))
    return {name.strip(" `"): rest for _, name, rest in cells}


def test_the_page_on_roads_has_every_key_of_a_scenario_file():
    assert list(documented("key")) == list(ScenarioFile.model_fields)


def test_the_page_on_roads_has_every_further_option_of_every_scenario():
    further = documented("further option")
    known = {
        (option, name)
        for name, entry in SCENARIOS.items()
        for option in entry.options
        if option not in ScenarioFile.model_fields
    }
    told = {
        (option, name)
        for option, rest in further.items()
        for name in SCENARIOS
        if f"`{name}`" in rest.split("|")[0]
    }
    assert told == known


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('scenario = "straight_road"\npopulation = "people"', "unknown population"),
        ("", "expected either it or net"),
        ('scenario = "straight_road"\nflo = 3', "did you mean 'flow'"),
        ('scenario = "straight_rod"', "straight_road"),
        ('scenario = "straight_road"\nsignals = false', "signals"),
        ('scenario = "straight_road"\nduration_s = "long"', "duration_s"),
        ('net = "missing.net.xml"', "found no file"),
        ('net = "ramp.net.xml"\ndemand = { on = -1 }', "demand.on"),
        ('net = "ramp.net.xml"\ndemand = { nowhere = 1 }', "edge 'nowhere'"),
        ('net = "ramp.net.xml"\nflow = 1\ndemand = { on = 1 }', "found flow beside it"),
        ("net = [", "Invalid value"),
    ],
)
def test_broken_scenario_files_are_refused_in_one_line(ramp, tmp_path, content, said):
    file = tmp_path / "bad.toml"
    file.write_text(content)
    assert said in refusal(lambda: get_scenario(str(file))())


def test_signals_can_be_taken_out_of_a_net():
    lit, dark = own_road(net=grid_net(3)), own_road(net=grid_net(3), signals=False)
    assert lit.road.signal_groups
    assert not dark.road.signal_groups
    assert all(link.signal < 0 for link in dark.road.connections)
    assert any(link.must_yield for link in dark.road.connections)
