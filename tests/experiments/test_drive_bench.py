"""The licence test: crowds differ by their drivers alone, scores, ranks, policies of one's own."""

from __future__ import annotations

import dataclasses
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from behaviors import InputError
from behaviors.labels import Behavior
from behaviors.populations import read_population
from experiments.benches.contract import Bench
from experiments.benches.drive.bench import BENCH, Settings, measure
from experiments.benches.drive.crowds import (
    CROWDS,
    HOMOGENEOUS,
    MIXED,
    STANDARD,
)
from experiments.benches.drive.episode import METRICS, ROADS, drive, score
from experiments.benches.drive.policies import POLICIES, get_policy
from experiments.benches.drive.ranking import mean_row, ranking_rows, ranks, swapped
from scenarios import SCENARIOS
from sim.scenario import sample_agents

PAGE = Path(__file__).parents[2] / "docs" / "what-if.md"
SHORT = {"flow": "light", "duration_s": 3.0, "warmup_s": 2.0}


def drive_one(scenario: str, crowd: str, policy: str, seed: int, config) -> dict[str, float]:
    (figures,) = drive(scenario, crowd, (policy,), seed, config).figures
    return figures


@pytest.mark.parametrize("scenario", ROADS)
def test_every_scenario_can_be_driven_in(scenario: str) -> None:
    assert drive_one(scenario, MIXED, "idm-mobil", 1, SHORT)["minutes"] > 0.0


@pytest.mark.parametrize("scenario", ["four_way_intersection", "motorway_ramps"])
def test_policies_that_begin_together_drive_as_each_does_alone(scenario: str) -> None:
    together = drive(scenario, MIXED, tuple(POLICIES), 1, SHORT).figures
    assert together == [drive_one(scenario, MIXED, policy, 1, SHORT) for policy in POLICIES]


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
    policies = ("do-nothing", "classifying_policy_of_this_test:make")
    idle, asking = drive("straight_road", MIXED, policies, 1, SHORT).figures
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
    drive_one("straight_road", "recorded", "watching", 4, SHORT)
    drive_one("straight_road", MIXED, "watching", 4, SHORT)
    (recorded, plain), scenario = [tuple(e.agents.values()) for e in seen], seen[1].scenario
    assert plain == sample_agents(scenario, 4)
    assert recorded == sample_agents(scenario, 4, read_population(CROWDS["recorded"].population))


@pytest.mark.parametrize("policy", POLICIES)
def test_our_policies_drive_and_the_same_seed_is_the_same_episode(policy: str) -> None:
    found = drive_one("four_way_intersection", MIXED, policy, 1, SHORT)
    assert found == drive_one("four_way_intersection", MIXED, policy, 1, SHORT)
    assert set(found) == set(METRICS)
    assert 0.0 <= found["score"] <= 1.0
    assert found["minutes"] == pytest.approx(0.05)


def test_doing_nothing_behind_a_queue_ends_in_a_collision() -> None:
    config = {"flow": "medium", "duration_s": 60.0, "warmup_s": 20.0}
    found = drive_one("straight_road", MIXED, "do-nothing", 1, config)
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
    mine = drive_one("straight_road", MIXED, f"{own_policy}:make", 2, SHORT)
    idle = drive_one("straight_road", MIXED, "do-nothing", 2, SHORT)
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
    settings = Settings(
        policy=("my_policy:make",), alone=True, scenarios=("straight_road", "all_way_stop"),
        crowds=("timid",), seeds=1, flow="light", duration_s=3.0, warmup_s=2.0, jobs=1,
    )  # fmt: skip
    rows = [row for part in measure(settings) for row in part]
    driven = {row["scenario"]: row for row in rows if row["metric"] == "minutes"}
    assert set(driven) == {*settings.scenarios, "all"}
    assert all(row["policy"] == "my_policy:make" for row in driven.values())
    assert all(0.0 < driven[name]["value"] <= 0.05 + 1e-9 for name in settings.scenarios)


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


def test_a_stopped_test_goes_on_from_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(
        policy=("do-nothing", "idm-mobil"), alone=True, scenarios=("straight_road",),
        crowds=(MIXED, HOMOGENEOUS), seeds=2, duration_s=2.0, warmup_s=1.0, jobs=1,
        out=str(tmp_path / "kept"),
    )  # fmt: skip
    first = [row for part in measure(settings) for row in part]
    speed = {row["metric"]: row["value"] for row in first if row["crowd"] == "all"}
    minutes = [r["value"] for r in first if r["metric"] == "minutes" and r["scenario"] == "all"]
    assert speed["driven_minutes"] == pytest.approx(sum(minutes))
    per_hour = 7200.0 / speed["core_s_per_minute"]
    assert speed["minutes_per_hour_on_two_cores"] == pytest.approx(per_hour)
    files = sorted((tmp_path / "kept").rglob("*.json"))
    assert len(files) == 2 * 2 * 2
    files[0].unlink()
    files[1].write_text("{}")
    driven = []

    def counting(*arguments):
        driven.append(arguments)
        return drive_one(*arguments)

    from experiments.benches.drive import episode

    drive_one = episode._drive
    monkeypatch.setattr(episode, "_drive", counting)
    again = [row for part in measure(settings) for row in part]
    assert _without_speed(again) == _without_speed(first)
    assert len(driven) == 2
    assert [row for part in measure(settings) for row in part] == _without_speed(first)
    other = dataclasses.replace(settings, flow="light")
    list(measure(other))
    assert len(driven) == 2 + 8  # figures of another configuration are not taken


def _without_speed(rows):
    """The rows but for what driving took, which differs every time."""
    speeds = ("driven_minutes", "core_s_per_minute", "minutes_per_hour_on_two_cores")
    return [row for row in rows if row["metric"] not in speeds]


def test_ranks_and_swaps() -> None:
    assert ranks(np.array([0.5, 0.9, 0.1])).tolist() == [2.0, 1.0, 3.0]
    assert swapped(np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, 1.0])) == 3
    clones = np.array([[0.9, 0.9, 0.9, 0.9], [0.5, 0.5, 0.5, 0.5]])
    scores = {MIXED: clones[::-1] - 0.1, HOMOGENEOUS: clones}
    rows = ranking_rows(scores, ("a", "b"), HOMOGENEOUS, MIXED)
    value = {(r["crowd"], r["policy"], r["metric"]): r["value"] for r in rows}
    assert value[MIXED, "a", "rank"] == 2.0
    assert value[HOMOGENEOUS, "a", "rank"] == 1.0
    assert value[HOMOGENEOUS, "a", "score_minus_diverse"] == pytest.approx(0.5)
    assert value[HOMOGENEOUS, "all", "swapped_pairs"] == 1.0
    assert value[HOMOGENEOUS, "all", "best_differs"] == 1.0


def test_intervals_are_over_seeds_not_over_scenarios() -> None:
    far_apart = np.array([0.1, 0.1, 0.1, 0.9, 0.9, 0.9])  # two scenarios, three seeds each
    row = mean_row({}, "score", far_apart, scenarios=2)
    assert row["low"] == pytest.approx(0.5)
    assert row["high"] == pytest.approx(0.5)
    seeds_differ = np.array([0.0, 0.1, 0.2, 0.8, 0.9, 1.0])
    row = mean_row({}, "score", seeds_differ, scenarios=2)
    assert 0.42 < row["low"] < 0.46
    assert 0.54 < row["high"] < 0.58
    assert mean_row({}, "score", np.array([0.1, 0.9]), scenarios=2)["low"] is None


def test_the_bench_refuses_unknown_words() -> None:
    assert isinstance(BENCH, Bench)
    for change, said in (
        ({"scenarios": ("stright_road",)}, "unknown scenario"),
        ({"crowds": ("timmid",)}, "unknown crowd"),
    ):
        with pytest.raises(InputError, match=said):
            list(measure(dataclasses.replace(BENCH.quick, **change)))
