"""The licence test: crowds differ by their drivers alone, scores, ranks, policies of one's own."""

from __future__ import annotations

import dataclasses
import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from behaviors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from behaviors.populations import read_population
from experiments.drive.crowds import CROWDS, HOMOGENEOUS, MIXED, STANDARD
from experiments.drive.episode import METRICS, ROADS, drive, score
from experiments.drive.figures import figure_rows, mean_row
from experiments.drive.planner import plan, risks
from experiments.drive.policies import POLICIES, get_policy, steering
from experiments.drive.run import LicenceTest, run_test
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.scene.scene import make_scene
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks
from sim.scenario import sample_agents
from tests.experiments.shared import call

PAGE = Path(__file__).parents[2] / "docs" / "what-if.md"
SHORT = {"flow": "light", "duration_s": 3.0, "warmup_s": 2.0}


@pytest.mark.parametrize("scenario", ROADS)
def test_every_scenario_can_be_driven_in(scenario: str) -> None:
    assert drive(scenario, MIXED, "idm-mobil", 1, SHORT)["minutes"] > 0.0


ASKS_A_CLASSIFIER = """
class Counting:
    def __init__(self):
        self.frames = 0

    def __call__(self, frame):
        self.frames += 1
        return self

    def of(self, ids):
        import numpy as np
        return np.full((ids.size, 6), 1 / 6)


counting = Counting()


def make(env):
    return lambda observation: 1 if observation["agents"].shape == (15, 16) else None


make.config = {"observation": "posterior", "classifier": counting}
"""


def test_a_classifier_of_ones_own_sees_the_traffic_before_too(tmp_path, monkeypatch) -> None:
    (tmp_path / "classifying_policy_of_this_test.py").write_text(ASKS_A_CLASSIFIER)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    idle = drive("straight_road", MIXED, "do-nothing", 1, SHORT)
    asking = drive("straight_road", MIXED, "classifying_policy_of_this_test:make", 1, SHORT)
    module = import_module("classifying_policy_of_this_test")
    assert asking == idle
    assert module.counting.frames >= 10 * (SHORT["duration_s"] + SHORT["warmup_s"])


def test_no_scenario_is_left_out() -> None:
    assert set(ROADS) == set(SCENARIOS)


def test_crowds_depart_alike_and_differ_by_their_drivers() -> None:
    def drawn(crowd: str):
        mix = CROWDS[crowd].mix
        scenario = SCENARIOS["straight_road"](flow="dense", duration_s=60.0, mix=mix)
        return [CROWDS[crowd].changed(agent) for agent in sample_agents(scenario, 3)]

    timid, mixed, clones = (drawn(name) for name in (Behavior.TIMID.value, MIXED, HOMOGENEOUS))
    for one, two, three in zip(timid, mixed, clones, strict=True):
        assert one.depart_s == two.depart_s == three.depart_s
        assert one.route == two.route == three.route
    assert {agent.behavior for agent in timid} == {Behavior.TIMID, None}  # None: pedestrians
    assert {agent.behavior for agent in mixed} == {*Behavior, None}
    assert {agent.profile for agent in clones} == {STANDARD, None}
    assert all(agent.behavior is None for agent in clones)


def test_the_recorded_crowd_is_drawn_from_a_population(monkeypatch) -> None:
    seen = []

    def watching(env):
        seen.append(env)
        return lambda observation: 1

    monkeypatch.setitem(POLICIES, "watching", (watching, {}))
    drive("straight_road", "recorded", "watching", 4, SHORT)
    drive("straight_road", MIXED, "watching", 4, SHORT)
    (recorded, plain), scenario = [tuple(e.agents.values()) for e in seen], seen[1].scenario
    assert plain == sample_agents(scenario, 4)
    assert recorded == sample_agents(scenario, 4, read_population(CROWDS["recorded"].population))


@pytest.mark.parametrize("policy", POLICIES)
def test_our_policies_drive_and_the_same_seed_is_the_same_episode(policy: str) -> None:
    found = drive("four_way_intersection", MIXED, policy, 1, SHORT)
    assert found == drive("four_way_intersection", MIXED, policy, 1, SHORT)
    assert set(found) == set(METRICS)
    assert 0.0 <= found["score"] <= 1.0
    assert found["minutes"] == pytest.approx(0.05)


def test_doing_nothing_behind_a_queue_ends_in_a_collision() -> None:
    config = {"flow": "medium", "duration_s": 60.0, "warmup_s": 20.0}
    found = drive("straight_road", MIXED, "do-nothing", 1, config)
    assert found["collisions_caused"] == found["collisions"] == 1.0
    assert found["score"] == 0.0
    assert found["minutes"] < 1.0


def test_the_score_is_nothing_after_a_collision_and_falls_with_each_flaw() -> None:
    good = {
        "collisions_caused": 0.0, "off_road": 0.0, "progress": 0.8, "near_misses": 0.0,
        "rules_broken": 0.0, "uncomfortable_share": 0.1,
    }  # fmt: skip
    assert score({**good, "off_road": 1.0}) == 0.0
    for flaw in ("near_misses", "rules_broken"):
        assert score({**good, flaw: 1.0}) < score(good)
    assert score(good) == pytest.approx((5 * 0.8 + 5 + 4 + 2 * 0.9) / 16)


MINE = """
def make(env):
    assert env.action_space.n == 3
    return lambda observation: 1 if observation["ego"].shape == (13,) else None

make.config = {"action": {
    "type": "DiscreteMetaAction", "lateral": False, "target_speeds": [0, 3, 6, 9, 12, 15]}}
broken = 3
"""


@pytest.fixture
def own_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "my_policy_of_this_test.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_policy_of_this_test"


def test_a_policy_of_ones_own_drives(own_policy: str) -> None:
    mine = drive("straight_road", MIXED, f"{own_policy}:make", 2, SHORT)
    idle = drive("straight_road", MIXED, "do-nothing", 2, SHORT)
    assert mine == idle  # one of three speeds: nothing is the second


def test_the_pages_trained_policy_is_trained_loaded_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3", reason="pip install 'graphrqi[train]'")
    section = PAGE.read_text().split("### A policy of your own")[1]
    training, _ = section.split("```python")[1].split("```", 1)
    policy, _ = section.split("<<'END'")[1].split("END", 1)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    exec(training, {})
    (tmp_path / "my_policy.py").write_text(policy)
    test = LicenceTest(
        policies=("my_policy:make",), scenarios=("straight_road", "all_way_stop"),
        crowds=("timid",), episodes=1, flow="light", duration_s=3.0, warmup_s=2.0,
    )  # fmt: skip
    rows = [row for part in run_test(test, 1, quiet=True) for row in part]
    driven = {row["scenario"]: row for row in rows if row["metric"] == "minutes"}
    assert set(driven) == {*test.scenarios, "all"}
    assert all(row["policy"] == "my_policy:make" for row in driven.values())
    assert all(0.0 < driven[name]["value"] <= 0.05 + 1e-9 for name in test.scenarios)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("plannr", "unknown policy 'plannr': did you mean 'planner"),
        ("nowhere_at_all:make", "expected 'module:function' that exists"),
        ("{own}:nothing", "expected 'module:function' that exists"),
        ("{own}:broken", "expected it to name a function"),
    ],
)
def test_policies_that_are_none_are_refused(own_policy: str, name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        get_policy(name.replace("{own}", own_policy))


def test_ranks_and_what_is_gained_are_paired_by_seed() -> None:
    policies, crowds = ("idm-mobil", "planner-blind", "planner-told"), (MIXED, HOMOGENEOUS)
    table = np.zeros((1, 4, 2, 3, len(METRICS)))
    score_of = METRICS.index("score")
    table[0, :, 0, :, score_of] = np.array([[0.1, 0.3, 0.5]]) + np.arange(4)[:, None] / 20
    table[0, :, 1, :, score_of] = table[0, :, 0, :, score_of] + 0.2
    found = {
        (row["crowd"], row["policy"], row["metric"]): row
        for row in figure_rows("here", crowds, policies, table)
    }
    assert found[MIXED, "planner-told", "rank"]["value"] == 1.0
    assert found[MIXED, "idm-mobil", "rank"]["value"] == 3.0
    told = found[MIXED, "planner-told", "score_minus_blind"]
    assert told["value"] == pytest.approx(0.2)
    assert told["low"] == pytest.approx(told["high"])  # the same gain at every seed
    assert found[HOMOGENEOUS, "idm-mobil", "score_minus_diverse"]["value"] == pytest.approx(0.2)


def test_intervals_are_over_seeds_not_over_scenarios() -> None:
    row = mean_row({}, "score", np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]]))
    assert row["low"] == row["high"] == pytest.approx(0.5)
    row = mean_row({}, "score", np.array([[0.0, 0.1, 0.2], [0.8, 0.9, 1.0]]))
    assert 0.42 < row["low"] < 0.46
    assert 0.54 < row["high"] < 0.58
    assert mean_row({}, "score", np.array([[0.1], [0.9]]))["low"] is None


def test_the_command_writes_rows_and_refuses_unknown_words(tmp_path: Path, capsys) -> None:
    short = ("--policy", "do-nothing", "--crowd", "timid", "--episodes", "1", "--warmup-s", "1")
    out = tmp_path / "drive.json"
    where = ("--scenario", "straight_road", "--duration-s", "1", "--jobs", "1")
    assert call("drive", *short, *where, "--json", out) == 0
    rows = json.loads(out.read_text())
    assert {row["metric"] for row in rows} == {*METRICS, "rank"}
    for word in (("--scenario", "stright_road"), ("--crowd", "timmid"), ("--policy", "plannr")):
        assert call("drive", *word) == 2
        assert word[1] in capsys.readouterr().err


def test_steering_turns_towards_the_line() -> None:
    line = np.column_stack([np.arange(60.0), np.full(60, 3.0)])
    assert steering(line, np.array([0.0, 0.0]), 0.0, 8.0, 5.0) > 0.01
    assert steering(line, np.array([0.0, 6.0]), 0.0, 8.0, 5.0) < -0.01
    assert steering(line, np.array([0.0, 3.0]), 0.0, 8.0, 5.0) == pytest.approx(0.0)


# --- the planner --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def road():
    return SCENARIOS["straight_road"]().road


def lane_y(road, lane):
    return next(x.centerline[0, 1] for x in road.lanes if x.id == lane)


def traffic(road, drivers, seconds=1.0, step_s=0.1) -> Tracks:
    """Vehicles at constant speed along x: (x now, lane, speed) each."""
    frames = []
    for t in np.arange(0.0, seconds + 1e-9, step_s):
        xy = [[x + v * (t - seconds), lane_y(road, lane)] for x, lane, v in drivers]
        n = len(drivers)
        frames.append(
            Frame(
                time_s=t, ids=np.arange(n), xy=np.array(xy), heading=np.zeros(n),
                speed=np.array([v for _, _, v in drivers]), length=np.full(n, 5.0),
                width=np.full(n, 2.0), kind=np.zeros(n),
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


def told(*behaviors: Behavior | None) -> np.ndarray:
    unknown = np.full(len(BEHAVIORS), 1.0 / len(BEHAVIORS))
    return np.array([unknown if b is None else np.eye(len(BEHAVIORS))[b.code] for b in behaviors])


def test_a_free_road_is_driven_at_the_limit(road):
    scene = make_scene(traffic(road, [(100.0, "east_in_1", 8.0)]), road)
    chosen = plan(scene, 0, told(None), default_table())
    assert chosen.accel > 1.0
    assert chosen.side == 0


def test_a_standing_vehicle_is_not_driven_into(road):
    drivers = [(100.0, "east_in_1", 12.0)]
    drivers += [(130.0, lane, 0.0) for lane in ("east_in_0", "east_in_1", "east_in_2")]
    scene = make_scene(traffic(road, drivers), road)
    scene = dataclasses.replace(scene, accel=np.zeros(4))
    chosen = plan(scene, 0, told(None, *[Behavior.TIMID] * 3), default_table())
    assert chosen.accel < -1.0


def test_neighbours_who_cut_in_are_feared_and_others_not(road):
    drivers = [(100.0, "east_in_1", 10.0), (111.0, "east_in_2", 10.0)]
    scene = make_scene(traffic(road, drivers), road)
    steps = np.arange(1, 6)[None, :, None] * np.array([2.0, 0.0])
    xy = scene.xy[:, None] + steps
    surprise = {
        b: risks(xy, scene, np.arange(2), 0, told(None, b))[2]
        for b in (Behavior.THREATENING, Behavior.CAREFUL)
    }
    assert surprise[Behavior.THREATENING] > 0.0
    assert surprise[Behavior.CAREFUL] == 0.0
