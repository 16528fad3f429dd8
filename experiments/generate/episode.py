"""Makes one episode of a dataset."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig, scenario_name
from experiments.generate.worlds.episode import write_world
from scenarios import get_scenario
from sim.engines import get_engine
from sim.scenario import Scenario, sample_agents
from sim.store.schema import EpisodeEntry, EpisodeMeta, split_of
from sim.store.writing import EpisodeWriter, made_with


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
        """Name of the scenario."""
        return scenario_name(self.scenario)

    @property
    def seed(self) -> int:
        """The episode's own seed, independent of every other episode's."""
        name = int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:4], "big")
        key = (self.index,) if self.scenario == RANDOM_WORLD else (name, self.index)
        sequence = np.random.SeedSequence(self.config.seed, spawn_key=key)
        return int(sequence.generate_state(1)[0] >> 1)  # SUMO takes 31 bits

    def meta(self, scenario: Scenario) -> EpisodeMeta:
        """Metadata of the episode, given its scenario."""
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
                "mix": {str(behavior): share for behavior, share in scenario.mix.items()},
                "spread": scenario.spread,
                **scenario.population_option,
                "duration_s": scenario.duration_s,
                "step_s": scenario.step_s,
            },
            made_with=made_with(self.config.engine),
        )

    def write(self, out: EpisodeWriter) -> EpisodeEntry:
        """Make the episode, and return its entry in the catalogue.

        Raises:
            InputError: if the engine cannot run it.
            OSError: if it cannot be written.
        """
        if self.scenario == RANDOM_WORLD:
            return write_world(out, self.seed, self.index, self.config.duration_s)
        scenario = self.config.scenario(self.scenario, self.index)
        agents = sample_agents(scenario, self.seed)
        frames = get_engine(self.config.engine)(scenario, agents, self.seed)
        return out.write_episode(self.meta(scenario), frames, agents, scenario.road.source)

    def __str__(self) -> str:
        """Name of the episode, for messages."""
        return f"{self.name} episode {self.index} (seed {self.seed})"
