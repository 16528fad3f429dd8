"""Branches of a running SUMO episode are exact, independent of the trunk, and cleaned up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.frames import Frame
from sim.scenario import sample_agents
from sim.sumo.branches import Trunk
from sim.sumo.control import Action

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="branches need Linux")
FORK_S, UNTIL_S, SEED = 20.0, 30.0, 2


def scenario_and_agents(name: str):
    scenario = SCENARIOS[name](duration_s=60.0, flow="dense")
    return scenario, sample_agents(scenario, SEED)


def same(one: Frame, other: Frame) -> bool:
    arrays = ("ids", "xy", "heading", "speed", "length", "width", "kind", "signals")
    return (
        one.time_s == other.time_s
        and one.events == other.events
        and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
    )


def children(process: int) -> list[str]:
    """States of a process's children, one letter each ("Z" for one that nobody waited for)."""
    told = subprocess.run(
        ["ps", "-o", "stat=", "--ppid", str(process)], capture_output=True, text=True, check=False
    )
    return told.stdout.split()


@pytest.mark.parametrize("name", ["straight_road", "four_way_intersection"])
def test_unchanged_branches_repeat_the_trunk_to_the_bit(name: str) -> None:
    scenario, agents = scenario_and_agents(name)
    plain = [f for f in get_engine("sumo")(scenario, agents, SEED) if f.time_s <= UNTIL_S + 1e-9]
    with Trunk(scenario, agents, SEED) as trunk:
        before = trunk.advance(FORK_S)
        branches = [tuple(trunk.branch(UNTIL_S)) for _ in range(5)]
        after = trunk.advance(UNTIL_S)
    assert len(before) + len(after) == len(plain)
    assert all(map(same, [*before, *after], plain))
    for branch in branches:
        assert len(branch) == len(after)
        assert all(map(same, branch, after))


def test_a_killed_or_closed_branch_leaves_the_trunk_alive_and_no_zombie(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    scenario, agents = scenario_and_agents("straight_road")
    with Trunk(scenario, agents, SEED) as trunk:
        trunk.advance(5.0)
        closed = trunk.branch(scenario.duration_s)
        closed.close()
        killed = trunk.branch(scenario.duration_s)
        next(iter(killed))
        found = subprocess.run(
            ["pgrep", "--parent", str(trunk.process_id)], capture_output=True, text=True
        )
        for process in found.stdout.split():
            with suppress(ProcessLookupError):  # the closed one has ended by then
                os.kill(int(process), signal.SIGKILL)
        with pytest.raises(InputError, match="ended before its last frame"):
            list(killed)
        assert len(trunk.advance(6.0)) == 10
        late = time.monotonic() + 10.0
        while children(trunk.process_id) and time.monotonic() < late:
            time.sleep(0.05)
        assert children(trunk.process_id) == []
        assert list(tmp_path.glob("graphrqi-*"))
    assert not list(tmp_path.glob("graphrqi-*"))  # what it has written for SUMO


def speeds(frames: tuple[Frame, ...], agent: int) -> float:
    here = [frame.speed[frame.ids == agent] for frame in frames]
    return float(np.concatenate(here).mean())


def test_one_driver_changes_and_the_others_are_not_drawn_anew() -> None:
    scenario, agents = scenario_and_agents("straight_road")
    drivers = {agent.id: agent for agent in agents if agent.profile is not None}
    with Trunk(scenario, agents, SEED) as trunk:
        now = trunk.advance(FORK_S)[-1]
        agent = next(int(i) for i in now.ids if int(i) in drivers)
        branches = {
            behavior: tuple(trunk.branch(UNTIL_S, agent, behavior)) for behavior in BEHAVIORS
        }
        again = tuple(trunk.branch(UNTIL_S, agent, Behavior.TIMID))
        plain = tuple(trunk.branch(UNTIL_S))
    assert speeds(branches[Behavior.TIMID], agent) < speeds(branches[Behavior.CAUTIOUS], agent)
    assert speeds(branches[Behavior.CAUTIOUS], agent) < speeds(branches[Behavior.IMPATIENT], agent)
    assert all(map(same, again, branches[Behavior.TIMID]))
    first, unchanged = branches[Behavior.TIMID][0], plain[0]
    away_m = np.linalg.norm(unchanged.xy - unchanged.xy[unchanged.ids == agent], axis=1)
    far = away_m > 60.0  # who is nearer may react at once
    assert far.sum() > 5
    assert np.array_equal(first.xy[far], unchanged.xy[far])


def test_an_action_lasts_and_then_the_driver_goes_on() -> None:
    scenario, agents = scenario_and_agents("straight_road")
    drivers = {agent.id: agent for agent in agents if agent.profile is not None}
    with Trunk(scenario, agents, SEED) as trunk:
        now = trunk.advance(FORK_S)[-1]
        lane = scenario.road.lanes[scenario.road.lane_index["east_in_3"]].centerline[0, 1]
        moving = (now.xy[:, 0] > 60.0) & (now.xy[:, 0] < 280.0) & (now.speed > 5.0)
        moving &= np.abs(now.xy[:, 1] - lane) < 1.0
        agent = next(int(i) for i in now.ids[moving] if int(i) in drivers)
        does = {
            action: tuple(trunk.branch(UNTIL_S, agent, action))
            for action in (Action.BRAKE, Action.KEEP, Action.ACCELERATE, Action.CHANGE_RIGHT)
        }
        with pytest.raises(InputError, match=f"agent {agent}: found no lane for change-left"):
            tuple(trunk.branch(UNTIL_S, agent, Action.CHANGE_LEFT))
    early = round(2.0 / scenario.step_s)
    slowed, kept, hurried = (
        speeds(does[action][:early], agent)
        for action in (Action.BRAKE, Action.KEEP, Action.ACCELERATE)
    )
    assert slowed < kept <= hurried
    braked = does[Action.BRAKE]
    ended = round(4.0 / scenario.step_s)
    assert speeds(braked[-early:], agent) > speeds(braked[ended - 1 : ended], agent)
    last = does[Action.CHANGE_RIGHT][round(3.5 / scenario.step_s)]
    assert abs(float(last.xy[last.ids == agent][0, 1]) - lane) > 2.0
