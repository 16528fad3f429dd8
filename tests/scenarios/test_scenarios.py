import os
import subprocess
import sys

import pytest

from behaviors.errors import InputError
from behaviors.labels import Behavior
from scenarios import SCENARIOS, ScenarioEntry, get_scenario
from scenarios.command import main
from scenarios.demand import PopulationOptions, parse_flow, parse_kinds, parse_mix
from scenarios.networks import build
from scenarios.networks.geometry import FourWayGeometry, StraightGeometry
from sim.engines import ENGINES, get_engine
from sim.frames import AgentKind
from sim.scenario import sample_agents
from sim.store.dataset import open_dataset


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("engine", ENGINES)
def test_the_command_prints_a_summary(name, engine, capsys):
    assert main(name, ["--engine", engine, "--duration-s", "4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"scenario: {name}"
    assert "frames: 40" in lines
    assert any(line.startswith("collisions: ") for line in lines)


def test_the_command_runs_from_any_folder(tmp_path):
    command = [sys.executable, "-m", "scenarios.all_way_stop", "--duration-s", "5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "frames: 50" in done.stdout.splitlines()
    assert done.stderr == ""


def test_each_command_of_the_package_runs_the_scenario_of_its_file():
    texts = {path.stem: path.read_text() for path in build.FOLDER.parent.glob("*.py")}
    commands = {name: text for name, text in texts.items() if "SystemExit(main(" in text}
    assert len(commands) == 10
    for name, text in commands.items():
        assert name in SCENARIOS
        assert f'SystemExit(main("{name}"))' in text


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_carry_the_name_they_are_registered_under(name):
    scenario = SCENARIOS[name]()
    assert scenario.name == name
    assert sum(scenario.mix.values()) == pytest.approx(1.0)
    edges = {lane.edge for lane in scenario.road.lanes}
    assert {e for flow in scenario.flows for e in flow.route} <= edges


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_option_has_the_default_that_the_scenario_is_made_with(name):
    entry = SCENARIOS[name]
    assert all(option.default is not option.empty for option in entry.options.values())
    own = {option: parameter.default for option, parameter in entry.options.items()}
    assert sample_agents(entry(**own), 0) == sample_agents(entry(), 0)


def test_a_scenario_takes_the_options_of_the_population():
    population = {"mix", "kinds", "spread", "duration_s", "step_s", "jaywalk_share", "population"}
    assert population == PopulationOptions.__annotations__.keys()
    assert population < SCENARIOS["two_way_road"].options.keys()
    assert SCENARIOS["two_way_road"].options.keys().isdisjoint({"two_way", "lanes", "crossing"})
    made = SCENARIOS["two_way_road"](jaywalk_share=0.5, mix="timid=1")
    assert (made.jaywalk_share, dict(made.mix)) == (0.5, {Behavior.TIMID: 1.0})


@pytest.fixture
def quiet_road():
    """A registered scenario without the options of the population."""

    def make(*, flow: str = "light", duration_s: float = 5.0):
        return SCENARIOS["straight_road"](flow=flow, duration_s=duration_s)

    SCENARIOS["quiet_road"] = ScenarioEntry("quiet_road", make)
    yield
    del SCENARIOS["quiet_road"]


@pytest.mark.usefixtures("quiet_road")
def test_a_scenario_without_the_common_options_has_a_command_too(capsys):
    assert SCENARIOS["quiet_road"].options.keys() == {"flow", "duration_s"}
    assert main("quiet_road", ["--engine", "highway"]) == 0
    assert "frames: 50" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main("quiet_road", ["--mix", "timid=1"])


def test_an_episode_is_written(tmp_path, capsys):
    out = tmp_path / "data"
    arguments = ["--duration-s", "5", "--flow", "2000", "--seed", "3", "--out", str(out)]
    assert main("straight_road", [*arguments, "--set", "lanes=2"]) == 0
    (episode,) = open_dataset(out).episodes()
    assert episode.scenario == "straight_road"
    assert episode.frames == 50
    assert episode.options["lanes"] == 2
    assert "frames: 50" in capsys.readouterr().out


def test_a_dataset_that_is_there_is_not_written_over(tmp_path, capsys):
    out = tmp_path / "data"
    arguments = ["--duration-s", "1", "--out", str(out)]
    assert main("straight_road", arguments) == 0
    manifest = (out / "episodes.parquet").read_bytes()
    capsys.readouterr()
    assert main("straight_road", [*arguments, "--seed", "5"]) == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    assert (out / "episodes.parquet").read_bytes() == manifest


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
        ({"flow": [1]}, "flow: found"),
        ({"mix": 5}, "mix: found 5, expected shares by name"),
        ({"mix": {"timid": None}}, "mix: found timid=None"),
    ],
)
def test_values_of_no_kind_are_refused_by_name(options, message):
    with pytest.raises(InputError, match=message):
        get_scenario("straight_road")(**options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--mix", "timid=.5"], "mix: found shares adding to 0.5, expected 1"),
        (["--mix", "shy=1"], "mix: found 'shy', expected one of impatient"),
        (["--mix", "timid=x"], "mix: found timid='x', expected a share >= 0"),
        (["--mix", "timid"], "mix: found 'timid', expected name=share"),
        (["--mix", "timid=.5,timid=.5"], "mix: found 'timid' twice"),
        (["--kinds", "pedestrian=1"], "kinds: found 'pedestrian', expected one of car"),
        (["--flow", "-3"], "flow: found '-3', expected light or medium or dense or a number"),
        (["--flow", "heavy"], "flow: found 'heavy'"),
        (["--flow", "nan"], "flow: found 'nan'"),
        (["--spread", "-1"], "spread: found -1.0, expected 0 to 1"),
        (["--spread", "1e3"], "spread: found 1000.0, expected 0 to 1"),
        (["--duration-s", "0.05"], "duration_s: found 0.05, expected at least a step of 0.1 s"),
        (["--set", "flow=3"], "--set: found flow, expected --flow for it"),
        (["--set", "step_s=1"], "--set: found step_s, expected --step-s for it"),
        (["--duration-s", "0"], "duration_s: found 0.0, expected seconds > 0"),
        (["--step-s", "5"], "step_s: found 5.0, expected seconds from 0.01 to 1"),
        (["--seed", "-1"], "seed: found -1, expected an integer >= 0"),
        (["--engine", "suma"], "unknown engine 'suma': did you mean 'sumo'?"),
        (["--set", "lanez=2"], "unknown option of scenario 'straight_road', 'lanez'"),
        (["--set", "lanes=9"], "lanes: found 9, expected 1 to 5"),
        (["--set", "lanes=two"], "lanes: found 'two', expected a value like 3"),
        (["--set", "crossing=3"], "crossing: found 3, expected a value like True"),
        (["--set", "lanes"], "--set: found 'lanes', expected NAME=VALUE"),
        (["--set", "length_m=-5"], "length_m: found -5, expected a number > 0"),
        (["--set", "jaywalk_share=2"], "jaywalk_share: found 2, expected 0 to 1"),
        (["--set", "pedestrians_per_h=-2"], "pedestrians_per_h: found -2"),
    ],
)
def test_bad_values_are_refused_by_name_in_one_line(arguments, message, capsys):
    assert main("straight_road", arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("scenarios.straight_road: error: ")
    assert message in said
    assert said.count("\n") == 1


def test_an_unwritable_folder_is_one_line(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main("straight_road", ["--duration-s", "2", "--out", str(blocked / "x")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_unknown_names_are_suggested():
    with pytest.raises(InputError, match="did you mean 'straight_road'"):
        get_scenario("straight_raod")


def test_flow_mix_and_kinds():
    assert parse_flow("1e3", {}) == 1000.0
    assert parse_mix(None) == pytest.approx(dict.fromkeys(Behavior, 1 / 6))
    assert parse_mix({"timid": 1}) == {Behavior.TIMID: 1.0}
    styles = parse_mix("aggressive=.2,conservative=.8")
    assert styles[Behavior.RECKLESS] == pytest.approx(0.2 / 3)
    assert styles[Behavior.TIMID] == pytest.approx(0.8 / 3)
    with pytest.raises(InputError, match="found 'reckless' twice"):
        parse_mix("reckless=.2,aggressive=.8")
    assert parse_kinds({AgentKind.BUS: 1.0}) == {AgentKind.BUS: 1.0}


def test_the_shipped_sources_are_those_of_the_geometries():
    for name, geometry in build.SHIPPED.items():
        for file, text in geometry.sources().items():
            assert (build.FOLDER / name / file).read_text(encoding="utf-8") == text


def test_shipped_nets_do_not_say_where_or_when_they_were_built():
    for name in build.SHIPPED:
        text = (build.FOLDER / name / build.NET).read_text(encoding="utf-8")
        assert "<!--" not in text
        assert "generated" not in text


def test_another_geometry_says_what_to_install_or_is_built_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    geometry = FourWayGeometry(lanes=3, arm_m=120.0)
    try:
        build.find_program("netconvert")
    except InputError:
        with pytest.raises(InputError, match=r"pip install graphrqi\[networks\]"):
            build.net_of(geometry)
        assert not list(tmp_path.rglob("*"))
        return
    net = build.net_of(geometry)
    assert net.is_relative_to(tmp_path)
    assert build.net_of(geometry) == net


def test_a_netconvert_that_fails_is_one_line(tmp_path, monkeypatch):
    failing = tmp_path / "netconvert"
    failing.write_text("#!/bin/sh\necho 'Error: no good' >&2\nexit 1\n")
    failing.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "find_program", lambda name: str(failing))
    with pytest.raises(InputError, match="netconvert refused the sources: Error: no good"):
        build.net_of(StraightGeometry(length_m=333.0))
    assert os.listdir(tmp_path / "cache" / "graphrqi" / "networks")
    assert not list((tmp_path / "cache").rglob("road.net.xml"))
