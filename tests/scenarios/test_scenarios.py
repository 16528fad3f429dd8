"""The registered scenarios: their options, their roads, and what they refuse."""

import subprocess
import sys

import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from scenarios import SCENARIOS, get_scenario
from scenarios.demand import PopulationOptions, parse_flow, parse_kinds, parse_mix
from scenarios.networks import build
from scenarios.networks.geometries import four_way_sources
from sim.engines import get_engine
from sim.frames import AgentKind
from sim.scenario import sample_agents


def test_each_scenario_is_a_command_of_its_name(tmp_path):
    command = [sys.executable, "-m", "scenarios.all_way_stop", "--duration-s", "5", "--quiet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "simulated_s" in done.stdout
    for name in SCENARIOS:
        assert f'run_as_command("{name}")' in (build.FOLDER.parent / f"{name}.py").read_text()


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_carry_the_name_they_are_registered_under(name):
    scenario = SCENARIOS[name]()
    assert scenario.name == name
    assert sum(scenario.mix.values()) == pytest.approx(1.0)
    edges = {lane.edge for lane in scenario.road.lanes}
    assert {e for flow in scenario.flows for e in flow.route} <= edges
    same = SCENARIOS[name](**SCENARIOS[name].options)
    assert sample_agents(same, 0) == sample_agents(scenario, 0)


def test_a_scenario_takes_the_options_of_the_population():
    population = {"mix", "kinds", "spread", "duration_s", "step_s", "jaywalk_share", "population",
                  "behaviors"}  # fmt: skip
    assert population == PopulationOptions.__annotations__.keys()
    assert population < SCENARIOS["two_way_road"].options.keys()
    assert SCENARIOS["two_way_road"].options.keys().isdisjoint({"two_way", "lanes", "crossing"})
    made = SCENARIOS["two_way_road"](jaywalk_share=0.5, mix="timid=1")
    assert (made.jaywalk_share, dict(made.mix)) == (0.5, {Behavior.TIMID: 1.0})


@pytest.mark.parametrize("engine", ["sumo", "highway"])
@pytest.mark.parametrize(("step_s", "duration_s", "frames"), [(0.6, 1.0, 1), (0.1, 0.99, 9)])
def test_no_frame_is_later_than_the_end(engine, step_s, duration_s, frames):
    scenario = get_scenario("straight_road")(step_s=step_s, duration_s=duration_s)
    found = list(get_engine(engine)(scenario, sample_agents(scenario, 0), 0))
    assert len(found) == scenario.steps == frames
    assert found[-1].time_s <= duration_s


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flow": None}, "flow: found None"),
        ({"flow": True}, "flow: found True"),
        ({"flow": "-3"}, "flow: found '-3', expected light or medium or dense or a number"),
        ({"flow": "nan"}, "flow: found 'nan'"),
        ({"mix": 5}, "mix: found 5, expected shares by name"),
        ({"mix": {"timid": None}}, "mix: found timid=None"),
        ({"mix": "timid=.5"}, "mix: found shares adding to 0.5, expected 1"),
        ({"mix": "shy=1"}, "mix: found 'shy', expected one of impatient"),
        ({"mix": "timid"}, "mix: found 'timid', expected name=share"),
        ({"mix": "reckless=.2,aggressive=.8"}, "mix: found 'reckless' twice"),
        ({"kinds": "pedestrian=1"}, "kinds: found 'pedestrian', expected one of car"),
        ({"spread": 1e3}, "spread: found 1000.0, expected 0 to 1"),
        ({"duration_s": 0.05}, "duration_s: found 0.05, expected 0.1 to 86400"),
        ({"step_s": 5.0}, "step_s: found 5.0, expected 0.01 to 1"),
        ({"lanez": 2}, "unknown option of scenario 'straight_road', 'lanez'"),
        ({"lanes": 9}, "lanes: found 9, expected 1 to 5"),
        ({"lanes": "two"}, "lanes: found 'two', expected a value like 3"),
        ({"crossing": 3}, "crossing: found 3, expected a value like True"),
        ({"length_m": -5.0}, "length_m: found -5.0, expected a number > 0"),
        ({"jaywalk_share": 2.0}, "jaywalk_share: found 2.0, expected 0 to 1"),
        ({"pedestrians_per_h": -2.0}, "pedestrians_per_h: found -2"),
    ],
)
def test_bad_values_are_refused_by_name_in_one_line(options, message):
    with pytest.raises(InputError, match=message) as refused:
        get_scenario("straight_road")(**options)
    assert "\n" not in str(refused.value)


def test_flow_mix_and_kinds():
    assert parse_flow("1e3", {}) == 1000.0
    assert parse_mix(None) == pytest.approx(dict.fromkeys(BEHAVIORS, 1 / 6))
    assert parse_mix({"timid": 1}) == {Behavior.TIMID: 1.0}
    styles = parse_mix("aggressive=.2,conservative=.8")
    assert styles[Behavior.RECKLESS] == pytest.approx(0.2 / 3)
    assert styles[Behavior.TIMID] == pytest.approx(0.8 / 3)
    assert parse_kinds({AgentKind.BUS: 1.0}) == {AgentKind.BUS: 1.0}


def test_the_shipped_nets_are_those_of_the_scenarios():
    for name in SCENARIOS:
        assert SCENARIOS[name]().road.source.is_relative_to(build.FOLDER)
    for net in build.FOLDER.glob(f"*/{build.NET}"):
        assert "<!--" not in net.read_text(encoding="utf-8")  # where and when it was built


def test_another_geometry_is_built_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sources = four_way_sources(lanes=3, arm_m=120.0)
    net = build.net_of(sources)
    assert net.is_relative_to(tmp_path)
    assert build.net_of(sources) == net
