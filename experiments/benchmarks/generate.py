"""Costs of generating data: time over bare simulation, bytes, and the gain by more jobs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from experiments.data.parallel import processors
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.generate.episode import Task
from experiments.score.rows import Cell, Row, tidy_row
from sim.engines import get_engine
from sim.files import place_of
from sim.frames import Tracks
from sim.safety import conflicts
from sim.scenario import sample_agents
from sim.store.writing import EpisodeWriter
from sim.sumo.engine import step_bare

SCENARIOS: Final = ("straight_road", "four_way_intersection")
"""Those of the dataset that is made with one job and with one per core; a city is timed, too."""


def episode_costs(name: str, index: int, duration_s: float) -> dict[str, float]:
    """Costs of one episode at medium flow, in processor time: the metrics of `measure`."""
    config = GenerateConfig(scenarios=(name,), episodes=index + 1, seed=11, duration_s=duration_s)
    task, scenario = Task(config, name, index), config.scenario(name)
    begin_s = time.process_time()
    step_bare(scenario, sample_agents(scenario, task.seed), task.seed)
    bare_s = time.process_time() - begin_s
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        begin_s = time.process_time()
        with EpisodeWriter(place_of(scratch), {}) as out:
            steps = task.write(out).agent_steps
        written_s = time.process_time() - begin_s
        size = sum(file.size for file in out.files.values())
    frames = get_engine(config.engine)(scenario, sample_agents(scenario, task.seed), task.seed)
    tracks = Tracks.from_frames(frames)
    begin_s = time.process_time()
    conflicts(tracks, scenario.road)
    conflicts_s = time.process_time() - begin_s
    return {
        "over_bare_stepping": written_s / bare_s - 1,
        "conflicts_over_the_rest": conflicts_s / (written_s - conflicts_s),
        "times_real_time": duration_s / written_s,
        "us_per_agent_step": 1e6 * written_s / steps,
        "bytes_per_agent_step": size / steps,
    }


def measure(repeats: int = 4, duration_s: float = 300.0, episodes: int = 8) -> Iterator[list[Row]]:
    """Rows of each scenario, of some timed episodes; then the speed-up over whole datasets.

    The CPU time of a written episode is over that of bare SUMO steps, less 1, and that of its
    conflicts over that of everything else.
    """
    for name in (*SCENARIOS, "city"):
        episode_costs(name, 0, duration_s)  # the first warms up
        found = [episode_costs(name, index, duration_s) for index in range(repeats)]
        keys: dict[str, Cell] = {"scenario": name, "jobs": 1}
        yield [
            tidy_row(keys, metric, float(np.mean([one[metric] for one in found])), n=repeats)
            for metric in found[0]
        ]
    config = GenerateConfig(scenarios=SCENARIOS, episodes=episodes, seed=11, duration_s=duration_s)
    single_s = 0.0
    for jobs in sorted({1, processors()}):
        with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
            begin_s = time.perf_counter()
            made = generate(config, Path(scratch) / "data", jobs, quiet=True)
            wall_s = time.perf_counter() - begin_s
        steps = sum(entry.agent_steps for entry in made.episodes)
        single_s = single_s or wall_s
        keys = {"scenario": "all", "jobs": jobs}
        yield [
            tidy_row(keys, "agent_steps_per_s", steps / wall_s, n=1),
            tidy_row(keys, "speedup", single_s / wall_s, n=1),
        ]
