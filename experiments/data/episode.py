"""Makes one episode of a dataset."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.data.configuration import GenerateConfig
from scenarios import get_scenario
from sim.engines import get_engine
from sim.scenario import Scenario, sample_agents
from sim.store.catalogue import finished_episode, keep_road
from sim.store.schema import EpisodeEntry, EpisodeMeta, split_of
from sim.store.writing import episode_id, made_with, write_episode


@dataclass(frozen=True, slots=True)
class Task:
    """One episode to make.

    Attributes:
        config: what the dataset is generated from.
        scenario: which of its scenarios.
        index: 0 for the scenario's first episode.
    """

    config: GenerateConfig
    scenario: str
    index: int

    @property
    def name(self) -> str:
        """What the scenario is called."""
        return get_scenario(self.scenario).name

    @property
    def seed(self) -> int:
        """The episode's own seed, independent of every other episode's."""
        name = int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:4], "big")
        sequence = np.random.SeedSequence(self.config.seed, spawn_key=(name, self.index))
        return int(sequence.generate_state(1)[0] >> 1)  # SUMO takes 31 bits

    def meta(self, scenario: Scenario) -> EpisodeMeta:
        """What the episode is made from, given its scenario."""
        entry = get_scenario(self.scenario)
        given = {**entry.given, **self.config.options(self.scenario, self.index)}
        return EpisodeMeta(
            scenario=entry.name,
            engine=self.config.engine,
            seed=self.seed,
            index=self.index,
            split=split_of(self.index),
            options={
                **(self.config.scenario_options or {}),
                **{name: given[name] for name in ("flow", "limit_mps") if name in given},
                "mix": {behavior.value: share for behavior, share in scenario.mix.items()},
                "spread": scenario.spread,
                **scenario.population_option,
                "duration_s": scenario.duration_s,
                "step_s": scenario.step_s,
            },
            made_with=made_with(self.config.engine),
        )

    def __str__(self) -> str:
        """Which episode it is, for messages."""
        return f"{self.name} episode {self.index} (seed {self.seed})"


def make_episode(folder: Path, task: Task) -> EpisodeEntry:
    """Make one episode, unless it is there already, whole and unaltered.

    Args:
        folder: the dataset.
        task: which episode.

    Returns:
        Its manifest entry.

    Raises:
        InputError: if the engine cannot run it.
        OSError: if it cannot be written.
    """
    scenario = task.config.scenario(task.scenario, task.index)
    agents = sample_agents(scenario, task.seed)
    meta = task.meta(scenario)
    road = scenario.road.source
    keep_road(folder, road)
    entry = finished_episode(folder, episode_id(meta, agents, road))
    if entry is not None:
        return entry
    frames = get_engine(task.config.engine)(scenario, agents, task.seed)
    return write_episode(folder, meta, frames, agents, road)
