"""Makes one episode of a dataset: of a scenario, or of a random world as its sensor saw it."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig, scenario_name
from experiments.generate.worlds import DURATION_S, WARM_UP_S, World, draw_world
from scenarios import get_scenario
from sim.engines import get_engine
from sim.files import temporary_folder
from sim.frames import Frame, Tracks
from sim.road.net import read_road
from sim.scenario import AgentSpec, Scenario, sample_agents
from sim.store.encoding import rounded
from sim.store.schema import EpisodeEntry, EpisodeMeta, split_of
from sim.store.writing import EpisodeWriter, made_with

SENSOR_STREAM: Final = 9
"""Number of the random stream of a world's sensor."""


@dataclass(frozen=True, slots=True)
class Task:
    """One episode to make: of a scenario of a configuration, by its index, 0 for the first."""

    config: GenerateConfig
    scenario: str
    index: int

    @property
    def seed(self) -> int:
        """The episode's own seed, independent of every other episode's."""
        name = hashlib.sha256(scenario_name(self.scenario).encode()).digest()[:4]
        numbers = (int.from_bytes(name, "big"), self.index)
        key = numbers[1:] if self.scenario == RANDOM_WORLD else numbers
        sequence = np.random.SeedSequence(self.config.seed, spawn_key=key)
        return int(sequence.generate_state(1)[0] >> 1)  # SUMO takes 31 bits

    def meta(self, scenario: Scenario) -> EpisodeMeta:
        """Metadata of the episode, given its scenario."""
        entry = get_scenario(self.scenario)
        given = {**entry.given, **self.config.options(self.scenario, self.index)}
        options: dict[str, Any] = {
            **(self.config.scenario_options or {}),
            **{name: given[name] for name in ("flow", "limit_mps") if name in given},
            "mix": {str(behavior): share for behavior, share in scenario.mix.items()},
            "spread": scenario.spread, **scenario.population_option,
            "duration_s": scenario.duration_s, "step_s": scenario.step_s,
        }  # fmt: skip
        return EpisodeMeta(
            scenario=entry.name, engine=self.config.engine, seed=self.seed, index=self.index,
            split=split_of(self.index), options=options, made_with=made_with(self.config.engine),
        )  # fmt: skip

    def write(self, out: EpisodeWriter) -> EpisodeEntry:
        """Make the episode, and return its entry in the catalogue."""
        if self.scenario == RANDOM_WORLD:
            world = draw_world(self.seed, self.config.duration_s or DURATION_S)
            return _write_world(out, world, self.index)
        scenario = self.config.scenario(self.scenario, self.index)
        agents = sample_agents(scenario, self.seed)
        frames = get_engine(self.config.engine)(scenario, agents, self.seed)
        return out.write_episode(self.meta(scenario), frames, agents, scenario.road.source)

    def __str__(self) -> str:
        """Name of the episode, for messages."""
        return f"{scenario_name(self.scenario)} episode {self.index} (seed {self.seed})"


def _write_world(out: EpisodeWriter, world: World, index: int) -> EpisodeEntry:
    """Make the episode of a world as its sensor saw it, and return its entry in the catalogue."""
    meta = EpisodeMeta(
        scenario=RANDOM_WORLD, engine=world.engine, seed=world.seed, index=index,
        split=split_of(index), options=world.options(), made_with=made_with(world.engine),
    )  # fmt: skip
    name = f"{world.road.family}_world"
    with temporary_folder("world") as scratch:
        net = scratch / "world.net.xml"
        net.write_text(world.road.net(), encoding="utf-8")
        scenario = Scenario(
            name=name, road=read_road(net, name), flows=world.road.flows(),
            mix=world.population.mix, spread=0.0, duration_s=WARM_UP_S + world.duration_s,
            step_s=world.sensor.step_s, kinds=world.population.kinds,
        )  # fmt: skip
        agents = tuple(map(world.population.driver, sample_agents(scenario, world.seed)))
        tracks = _recorded(world, scenario, agents)
        by_name = {str(agent.id): agent for agent in agents}
        numbers = (each.tolist() for each in (tracks.ids, tracks.length, tracks.width))
        columns = zip(tracks.names, *numbers, strict=True)
        seen = [
            dataclasses.replace(by_name[name.partition("/")[0]], id=i, length_m=long, width_m=wide)
            for name, i, long, wide in columns
        ]
        road = net if world.sensor.has_map else None
        drawn = sorted(agents, key=lambda a: a.id)
        return out.write_tracks(meta, rounded(tracks), seen, road, drawn=drawn)


def _recorded(world: World, scenario: Scenario, agents: tuple[AgentSpec, ...]) -> Tracks:
    """Recording of a world's traffic by its sensor, from the end of the warm-up on."""
    frames: Iterator[Frame]
    if world.engine == "sumo":
        from sim.sumo.engine import run_with

        frames = run_with(scenario, agents, world.seed, world.settings)
    else:
        frames = get_engine(world.engine)(scenario, agents, world.seed)
    seen = itertools.dropwhile(lambda frame: frame.time_s < WARM_UP_S, frames)
    clean = Tracks.from_frames(seen, {agent.id: agent.behavior for agent in agents})
    return world.sensor.seen(clean, np.random.default_rng((world.seed, SENSOR_STREAM)))
