"""Costs of generating data: overhead over bare simulation, bytes, and the gain by more jobs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from experiments.data.parallel import in_parallel, processors
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.generate.episode import Task
from experiments.score.rows import Cell, Row, tidy_row
from sim.files import place_of
from sim.scenario import sample_agents
from sim.store.writing import EpisodeWriter

SCENARIOS: Final = ("straight_road", "four_way_intersection")
"""Those of the dataset that is made with one job and with one per core."""

TIMED: Final = (*SCENARIOS, "city")
"""Those whose episodes are timed part by part."""


def _cpu_s(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def episode_costs(scenario_name: str, index: int, duration_s: float) -> dict[str, float]:
    """Costs of one episode at medium flow, part by part, in processor time.

    Each part is timed twice, in turns, and the least time counts.

    Args:
        scenario_name: a key of ``SCENARIOS``.
        index: which of its episodes.
        duration_s: its length, s.

    Returns:
        The metrics of `measure`.
    """
    from sim.sumo.engine import step_bare

    config = GenerateConfig(
        scenarios=(scenario_name,), episodes=index + 1, seed=11, duration_s=duration_s
    )
    task = Task(config, scenario_name, index)
    scenario = config.scenario(scenario_name)
    agents = sample_agents(scenario, task.seed)
    sizes: list[int] = []
    steps: list[int] = []

    def part(steer: bool, read: bool) -> Callable[[], object]:
        return lambda: step_bare(scenario, agents, task.seed, steer=steer, read=read)

    def whole() -> None:
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            with EpisodeWriter(place_of(scratch), {}) as out:
                steps.append(task.write(out).agent_steps)
            sizes.append(sum(file.size for file in out.files.values()))

    calls = [part(False, False), part(False, True), part(True, True), whole]
    rounds = np.array([[_cpu_s(call) for call in calls] for _ in range(2)])
    bare, read, engine, everything = rounds.min(axis=0).tolist()
    return {
        "frames_over_bare_stepping": read / bare - 1,
        "engine_over_bare_stepping": engine / bare - 1,
        "over_bare_stepping": everything / bare - 1,
        "times_real_time": duration_s / everything,
        "us_per_agent_step": 1e6 * everything / steps[0],
        "annotated_us_per_agent_step": 1e6 * (everything - engine) / steps[0],
        "bytes_per_agent_step": sizes[0] / steps[0],
    }


def mean_row(scenario: str, jobs: int, metric: str, values: Sequence[float]) -> Row:
    """A mean with a 95 % interval (normal; none for a single value)."""
    keys: dict[str, Cell] = {"scenario": scenario, "jobs": jobs}
    mean, n = float(np.mean(values)), len(values)
    half = 1.96 * float(np.std(values, ddof=1)) / np.sqrt(n) if n > 1 else np.nan
    return tidy_row(keys, metric, mean, mean - half, mean + half, n)


def measure(repeats: int = 4, duration_s: float = 300.0, episodes: int = 8) -> Iterator[list[Row]]:
    """Measure generation.

    Args:
        repeats: episodes per scenario whose parts are timed.
        duration_s: of each episode, s.
        episodes: per scenario, of the datasets for the speedup.

    Yields:
        Rows of the CPU time over that of bare SUMO steps: of reading frames, of the engine with
        controllers, and of a written episode. The other rows measure the whole episode, its
        annotation, and the steps per second of the wall clock with the speedup.
    """
    for name in TIMED:
        calls = [(name, index, duration_s) for index in (0, *range(repeats))]
        found = list(in_parallel(episode_costs, calls, 1))[1:]  # the first warms up
        yield [mean_row(name, 1, metric, [one[metric] for one in found]) for metric in found[0]]
    single_s: float | None = None
    for jobs in sorted({1, processors()}):
        config = GenerateConfig(
            scenarios=SCENARIOS, episodes=episodes, seed=11, duration_s=duration_s
        )
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            begin = time.perf_counter()
            made = generate(config, Path(scratch) / "data", jobs, quiet=True)
            wall_s = time.perf_counter() - begin
        steps = sum(entry.agent_steps for entry in made.episodes)
        single_s = single_s or wall_s
        yield [
            mean_row("all", jobs, "agent_steps_per_s", [steps / wall_s]),
            mean_row("all", jobs, "speedup", [single_s / wall_s]),
        ]
