"""What generating costs: rate, overhead over bare simulation, bytes, and what more jobs bring."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.console.tables import Row
from experiments.data.generate import GenerateConfig, Task, generate, make_episode
from experiments.data.parallel import in_parallel
from scenarios import get_scenario
from sim.scenario import sample_agents
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")


def _config(episodes: int, duration_s: float) -> GenerateConfig:
    return GenerateConfig(scenarios=SCENARIOS, episodes=episodes, seed=11, duration_s=duration_s)


def _cpu_s(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


@dataclass(frozen=True, slots=True)
class _Cost:
    """What one episode costs, CPU seconds: the least of two times each.

    Attributes:
        bare: SUMO's steps alone, steered by nobody.
        steered: with controllers, which make another traffic.
        read: with every frame read, steered by nobody.
        steered_and_read: with both.
        whole: with traits, events and files, too.
        agent_steps: in the episode.
        size: of its files, bytes.
    """

    bare: float
    steered: float
    read: float
    steered_and_read: float
    whole: float
    agent_steps: int
    size: int


def _cost(scenario_name: str, index: int, duration_s: float) -> _Cost:
    """What an episode at medium flow costs, part by part, in turns."""
    from sim.sumo.engine import step_bare

    task = Task(_config(index + 1, duration_s), scenario_name, index)
    scenario = task.config.scenario(scenario_name)
    agents = sample_agents(scenario, task.seed)
    entries: list[EpisodeEntry] = []

    def part(steer: bool, read: bool) -> Callable[[], object]:
        return lambda: step_bare(scenario, agents, task.seed, steer=steer, read=read)

    def whole() -> None:
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            entries.append(make_episode(Path(scratch), task))

    calls = [part(False, False), part(True, False), part(False, True), part(True, True), whole]
    rounds = np.array([[_cpu_s(call) for call in calls] for _ in range(2)])
    bare, steered, read, both, everything = rounds.min(axis=0).tolist()
    size = sum(file.size for file in entries[0].files.values())
    return _Cost(bare, steered, read, both, everything, entries[0].agent_steps, size)


def _frames(scenario_name: str, index: int, duration_s: float) -> dict[str, float]:
    """What frames of dense traffic cost over bare stepping, without and with controllers."""
    from sim.sumo.engine import run, step_bare

    seed = 11 + index
    scenario = get_scenario(scenario_name)(flow="dense", duration_s=duration_s)
    agents = sample_agents(scenario, seed)
    bare_s, read_s, steered_s, agent_steps = np.inf, np.inf, np.inf, 0
    for _ in range(3):  # the first warms up
        bare_s = min(bare_s, _cpu_s(lambda: step_bare(scenario, agents, seed)))
        read_s = min(read_s, _cpu_s(lambda: step_bare(scenario, agents, seed, read=True)))
        begin = time.process_time()
        agent_steps = sum(len(frame) for frame in run(scenario, agents, seed))
        steered_s = min(steered_s, time.process_time() - begin)
    return {
        "frames_over_bare_stepping": read_s / bare_s - 1,
        "controllers_over_frames": steered_s / read_s - 1,
        "times_real_time": duration_s / steered_s,
        "agents_in_a_frame": agent_steps * scenario.step_s / duration_s,
    }


def _peak_mb() -> float:
    """Most memory that this process has ever held, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def _memory_growth(episodes: int, duration_s: float) -> float:
    """By how much making episodes one after another raises a process's peak memory, MB.

    Counted from a fifth of the episodes on, when everything has been loaded and compiled.
    """
    begin_mb = 0.0
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        for i in range(episodes):
            make_episode(
                Path(scratch), Task(_config(episodes, duration_s), SCENARIOS[i % 2], i // 2)
            )
            if i == episodes // 5:
                begin_mb = _peak_mb()
    return _peak_mb() - begin_mb


def _row(scenario: str, jobs: int, metric: str, values: list[float]) -> Row:
    """Mean with a 95 % interval (normal; none for a single value)."""
    mean = float(np.mean(values))
    half = 1.96 * float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else None
    low, high = (None, None) if half is None else (mean - half, mean + half)
    return {
        "scenario": scenario, "jobs": jobs, "metric": metric,
        "value": mean, "low": low, "high": high, "n": len(values),
    }  # fmt: skip


def measure(quick: bool = False) -> list[Row]:
    """Measure generation.

    Args:
        quick: short episodes and few of them.

    Returns:
        Rows keyed ``scenario, jobs`` with ``metric, value, low, high, n``:
        ``frames_over_bare_stepping`` (extra CPU time of reading every frame as a share of bare
        stepping, paired; the same dense traffic, steered by nobody), ``controllers_over_frames``
        (extra CPU time of a run with controllers, which change the traffic),
        ``times_real_time``, ``agents_in_a_frame``, ``over_bare_stepping`` (of a whole written
        episode at medium flow) and what of it there is already with less done: ``..._steered`` (by
        controllers, no frames), ``..._read`` (frames, nobody steers), ``..._steered_and_read`` (the
        engine as it is, but no traits, events and files); ``bytes_per_agent_step``,
        ``memory_growth_mb`` (of one process over many episodes), ``agent_steps_per_s`` (wall
        clock), ``speedup``.
    """
    pairs, duration_s, episodes = (1, 30.0, 2) if quick else (4, 300.0, 8)
    # The first two calls warm up.
    calls = [(name, i, duration_s) for i in range(pairs) for name in SCENARIOS]
    measured = list(in_parallel(_cost, [*calls[:2], *calls], 1))[2:]
    read = list(in_parallel(_frames, [*calls[:2], *calls], 1))[2:]
    rows: list[Row] = []
    for name in SCENARIOS:
        here = [cost for call, cost in zip(calls, read, strict=True) if call[0] == name]
        rows += [_row(name, 1, metric, [cost[metric] for cost in here]) for metric in here[0]]
        made = [cost for call, cost in zip(calls, measured, strict=True) if call[0] == name]
        for part in ("steered", "read", "steered_and_read", "whole"):
            over = [getattr(cost, part) / cost.bare - 1 for cost in made]
            metric = "over_bare_stepping" + ("" if part == "whole" else f"_{part}")
            rows.append(_row(name, 1, metric, over))
        per_step = [cost.size / cost.agent_steps for cost in made]
        rows.append(_row(name, 1, "bytes_per_agent_step", per_step))
    many, short_s = (10, 5.0) if quick else (500, 30.0)
    (growth_mb,) = in_parallel(_memory_growth, [(many, short_s)], 1)
    rows.append({**_row("all", 1, "memory_growth_mb", [growth_mb]), "n": many})
    config = _config(episodes, duration_s)
    single_s: float | None = None
    for jobs in sorted({1, os.cpu_count() or 1}):
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            begin = time.perf_counter()
            manifest = generate(config, Path(scratch) / "data", jobs, quiet=True)
            wall_s = time.perf_counter() - begin
        steps = sum(entry.agent_steps for entry in manifest.episodes)
        single_s = single_s or wall_s
        rows.append(_row("all", jobs, "agent_steps_per_s", [steps / wall_s]))
        rows.append(_row("all", jobs, "speedup", [single_s / wall_s]))
    return rows
