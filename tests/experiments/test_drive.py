"""The licence test: crowds differ by their drivers alone; scores, ranks, and trained policies."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS, Behavior
from experiments.drive.episode import (
    CROWDS,
    HOMOGENEOUS,
    METRICS,
    MIXED,
    ROADS,
    STANDARD,
    drive,
    score,
    standard,
)
from experiments.drive.policies import POLICIES
from experiments.drive.run import EVERYWHERE, STRAYS, figure_rows, mean_row, run_test
from scenarios import SCENARIOS
from sim.scenario import sample_agents
from tests.experiments.shared import call

PAGE = Path(__file__).parents[2] / "docs" / "what-if.md"
SHORT = {"flow": "light", "duration_s": 3.0, "warmup_s": 2.0}


def test_planners_drive_everywhere_but_where_they_do_not_know_their_exit() -> None:
    assert {*ROADS} - {*EVERYWHERE} == {*STRAYS}
    assert {*EVERYWHERE} < {*SCENARIOS}


def test_crowds_depart_alike_and_differ_by_their_drivers() -> None:
    def drawn(crowd: str):
        scenario = SCENARIOS["straight_road"](flow="dense", duration_s=60.0, **CROWDS[crowd])
        agents = sample_agents(scenario, 3)
        return [standard(agent) for agent in agents] if crowd == HOMOGENEOUS else agents

    timid, mixed, clones = (drawn(name) for name in (Behavior.TIMID.value, MIXED, HOMOGENEOUS))
    for one, two, three in zip(timid, mixed, clones, strict=True):
        assert one.depart_s == two.depart_s == three.depart_s
        assert one.route == two.route == three.route
    assert {agent.behavior for agent in timid} == {Behavior.TIMID, None}  # None: pedestrians
    assert {agent.behavior for agent in mixed} == {*BEHAVIORS, None}
    assert {agent.profile for agent in clones} == {STANDARD, None}
    assert all(agent.behavior is None for agent in clones)


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
    scenarios = ("straight_road", "all_way_stop")
    parts = run_test(
        policies=("my_policy:make",), scenarios=scenarios, crowds=("timid",), episodes=1,
        flow="light", duration_s=3.0, warmup_s=2.0, jobs=1,
    )  # fmt: skip
    rows = [row for part in parts for row in part]
    driven = {row["scenario"]: row for row in rows if row["metric"] == "minutes"}
    assert set(driven) == {*scenarios, "all"}
    assert all(row["policy"] == "my_policy:make" for row in driven.values())
    assert all(0.0 < driven[name]["value"] <= 0.05 + 1e-9 for name in scenarios)


def test_ranks_and_what_is_gained_are_paired_by_seed() -> None:
    policies, crowds = ("idm-mobil", "planner-blind", "planner-classified"), (MIXED, HOMOGENEOUS)
    table = np.zeros((1, 4, 2, 3, len(METRICS)))
    score_of = METRICS.index("score")
    table[0, :, 0, :, score_of] = np.array([[0.1, 0.3, 0.5]]) + np.arange(4)[:, None] / 20
    table[0, :, 1, :, score_of] = table[0, :, 0, :, score_of] + 0.2
    found = {
        (row["crowd"], row["policy"], row["metric"]): row
        for row in figure_rows("here", crowds, policies, table)
    }
    assert found[MIXED, "planner-classified", "rank"]["value"] == 1.0
    assert found[MIXED, "idm-mobil", "rank"]["value"] == 3.0
    told = found[MIXED, "planner-classified", "score_minus_blind"]
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
