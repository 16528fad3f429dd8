"""What generating costs: rate, overhead over bare simulation, bytes, and what more jobs bring."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.benches.contract import Bench, option
from experiments.data.configuration import GenerateConfig
from experiments.data.episode import Task, make_episode
from experiments.data.generate import generate
from experiments.data.parallel import in_parallel, processors
from experiments.score.rows import Cell, Row, tidy_row
from sim.scenario import sample_agents
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

CITY: Final = "city"
"""The scenario whose episodes are timed beside those, not written into the datasets."""


def _config(
    episodes: int, duration_s: float, names: tuple[str, ...] = SCENARIOS, blocks: int | None = None
) -> GenerateConfig:
    options: dict[str, bool | int | float | str] | None = (
        None if blocks is None else {"blocks": blocks}
    )
    return GenerateConfig(
        scenarios=names, episodes=episodes, seed=11, duration_s=duration_s,
        scenario_options=options,
    )  # fmt: skip


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


def _cost(scenario_name: str, index: int, duration_s: float, blocks: int | None) -> _Cost:
    """What an episode at medium flow costs, part by part, in turns."""
    from sim.sumo.engine import step_bare

    task = Task(_config(index + 1, duration_s, (scenario_name,), blocks), scenario_name, index)
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


def _frames(
    scenario_name: str, index: int, duration_s: float, blocks: int | None
) -> dict[str, float]:
    """What frames of dense traffic cost over bare stepping, without and with controllers."""
    from sim.sumo.engine import run, step_bare

    seed = 11 + index
    config = _config(1, duration_s, (scenario_name,), blocks).model_copy(update={"flow": "dense"})
    scenario = config.scenario(scenario_name)
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


def _mean_row(scenario: str, jobs: int, metric: str, values: list[float]) -> Row:
    """Mean with a 95 % interval (normal; none for a single value)."""
    keys: dict[str, Cell] = {"scenario": scenario, "jobs": jobs}
    mean, n = float(np.mean(values)), len(values)
    half = 1.96 * float(np.std(values, ddof=1)) / np.sqrt(n) if n > 1 else np.nan
    return tidy_row(keys, metric, mean, mean - half, mean + half, n)


@dataclass(frozen=True, slots=True)
class Settings:
    """How much is generated.

    Attributes:
        pairs: episodes per scenario whose parts are timed.
        duration_s: of each episode, s.
        episodes: per scenario, of the dataset that is made with one job and with one per core.
        repeated: episodes that one process makes while its memory is watched.
        repeated_s: length of each of those, s.
        blocks: junctions along each side of the city whose episodes are timed, too.
    """

    pairs: int = option(4, "Episodes per scenario whose parts are timed.")
    duration_s: float = option(300.0, "Length of each episode, s.")
    episodes: int = option(8, "Episodes per scenario of the dataset that is timed whole.")
    repeated: int = option(500, "Episodes made by one process whose memory is watched.")
    repeated_s: float = option(30.0, "Length of each of those, s.")
    blocks: int = option(3, "Junctions along each side of the city; all but 3 need netgenerate.")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure generation.

    Yields:
        Rows of ``frames_over_bare_stepping`` (extra CPU time of reading every frame as a share of
        bare stepping, paired; the same dense traffic, steered by nobody),
        ``controllers_over_frames`` (extra CPU time of a run with controllers, which change the
        traffic), ``times_real_time``, ``agents_in_a_frame``, ``over_bare_stepping`` (of a whole
        written episode at medium flow) and its parts: ``..._steered`` (controllers, no frames),
        ``..._read`` (frames, nobody steers), ``..._steered_and_read`` (the engine as it is, but no
        traits, events and files); ``bytes_per_agent_step``; ``us_per_agent_step`` of the whole
        episode, and ``annotated_us_per_agent_step`` of its traits, events and files, CPU time;
        then ``memory_growth_mb`` (of one process over many episodes); then ``agent_steps_per_s``
        (wall clock) and ``speedup``.
    """
    yield _episode_rows(settings)
    repeated = settings.repeated
    (growth_mb,) = in_parallel(_memory_growth, [(repeated, settings.repeated_s)], 1)
    keys: dict[str, Cell] = {"scenario": "all", "jobs": 1}
    yield [tidy_row(keys, "memory_growth_mb", growth_mb, None, None, repeated)]
    single_s: float | None = None
    for jobs in sorted({1, processors()}):
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            begin = time.perf_counter()
            config = _config(settings.episodes, settings.duration_s)
            manifest = generate(config, Path(scratch) / "data", jobs, quiet=True)
            wall_s = time.perf_counter() - begin
        steps = sum(entry.agent_steps for entry in manifest.episodes)
        single_s = single_s or wall_s
        yield [
            _mean_row("all", jobs, "agent_steps_per_s", [steps / wall_s]),
            _mean_row("all", jobs, "speedup", [single_s / wall_s]),
        ]


def _episode_rows(settings: Settings) -> list[Row]:
    """What frames and whole episodes cost over bare stepping."""
    names = (*SCENARIOS, CITY)
    calls = [
        (name, i, settings.duration_s, settings.blocks if name == CITY else None)
        for i in range(settings.pairs)
        for name in names
    ]
    warming = calls[: len(names)]
    costs = list(in_parallel(_cost, [*warming, *calls], 1))[len(warming) :]
    frames = list(in_parallel(_frames, [*warming, *calls], 1))[len(warming) :]
    rows: list[Row] = []
    for name in names:
        here = [cost for call, cost in zip(calls, frames, strict=True) if call[0] == name]
        rows += [_mean_row(name, 1, metric, [cost[metric] for cost in here]) for metric in here[0]]
        made = [cost for call, cost in zip(calls, costs, strict=True) if call[0] == name]
        for part in ("steered", "read", "steered_and_read", "whole"):
            over = [getattr(cost, part) / cost.bare - 1 for cost in made]
            metric = "over_bare_stepping" + ("" if part == "whole" else f"_{part}")
            rows.append(_mean_row(name, 1, metric, over))
        per_step = [cost.size / cost.agent_steps for cost in made]
        rows.append(_mean_row(name, 1, "bytes_per_agent_step", per_step))
        whole = [1e6 * cost.whole / cost.agent_steps for cost in made]
        rows.append(_mean_row(name, 1, "us_per_agent_step", whole))
        after = [1e6 * (c.whole - c.steered_and_read) / c.agent_steps for c in made]
        rows.append(_mean_row(name, 1, "annotated_us_per_agent_step", after))
    return rows


BENCH: Final = Bench(
    name="generate",
    summary="Measure the cost of generating data.",
    keys=("scenario", "jobs"),
    full=Settings(),
    quick=Settings(pairs=1, duration_s=30.0, episodes=2, repeated=10, repeated_s=5.0),
    measure=measure,
)
