"""Makes the episode of one world: drawn, driven, and stored as its sensor saw it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from experiments.data.worlds.world import DURATION_S, WARM_UP_S, World, draw_world
from sim.engines import get_engine
from sim.frames import Frame, Tracks
from sim.invalid_fields import first_wrong_field
from sim.road.net import read_road
from sim.scenario import AgentSpec, Scenario, sample_agents
from sim.store.atomic import temporary_folder
from sim.store.catalogue import finished_episode, keep_road
from sim.store.schema import EpisodeEntry, EpisodeMeta, split_of
from sim.store.writing import episode_id, made_with, write_sensed


class WorldsConfig(BaseModel):
    """What a dataset of random worlds is generated from.

    Attributes:
        worlds: how many.
        seed: any non-negative integer.
        duration_s: length of every episode, s.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    engine: ClassVar[str] = "worlds"

    worlds: Annotated[int, Field(ge=1, le=10**6)]
    seed: Annotated[int, Field(ge=0)] = 0
    duration_s: Annotated[float, Field(ge=1.0, le=3600.0)] = DURATION_S

    def check(self) -> None:
        """Every configuration with numbers in range can be made."""


def read_worlds_config(path: Path | None, worlds: int, **given: object) -> WorldsConfig:
    """A configuration of worlds from the options of the command line.

    Args:
        path: file of the command's ``--config``; worlds take none.
        worlds: how many.
        **given: the command's other options; None where not given.

    Returns:
        The configuration.

    Raises:
        InputError: if an option is given that worlds draw themselves, or a number is out of range.
    """
    if path is not None:
        raise InputError(f"--worlds: found --config {path} beside it, expected none")
    fields = {name: value for name, value in given.items() if value is not None}
    for name in fields:
        if name not in WorldsConfig.model_fields:
            option = {"scenarios": "scenario", "scenario_options": "set"}.get(name, name)
            raise InputError(f"--worlds: found --{option} beside it, expected none: it is drawn")
    try:
        return WorldsConfig.model_validate({**fields, "worlds": worlds})
    except ValidationError as error:
        raise InputError(f"--{first_wrong_field(error)}") from None


@dataclass(frozen=True, slots=True)
class WorldTask:
    """One world to make.

    Attributes:
        config: what the dataset is generated from.
        index: which of its worlds.
    """

    config: WorldsConfig
    index: int

    @property
    def world(self) -> World:
        """The world; it depends on the configuration's seed and the index alone."""
        sequence = np.random.SeedSequence(self.config.seed, spawn_key=(self.index,))
        seed = int(sequence.generate_state(1)[0] >> 1)  # SUMO takes 31 bits
        return draw_world(seed, self.config.duration_s)

    def meta(self) -> EpisodeMeta:
        """What the episode is made from."""
        world = self.world
        return EpisodeMeta(
            scenario=f"{world.road.family}_world",
            engine=world.engine,
            seed=world.seed,
            index=self.index,
            split=split_of(self.index),
            options=world.options(),
            made_with=made_with(world.engine),
        )

    def __str__(self) -> str:
        """Which episode it is, for messages."""
        return f"world {self.index} (seed {self.world.seed})"


def make_world(folder: Path, task: WorldTask) -> EpisodeEntry:
    """Make the episode of a world, unless it is there already, whole and unaltered.

    Args:
        folder: the dataset.
        task: which world.

    Returns:
        Its manifest entry.

    Raises:
        InputError: if the engine cannot run it.
        OSError: if it cannot be written.
    """
    world, meta = task.world, task.meta()
    with temporary_folder("world") as scratch:
        net = scratch / "world.net.xml"
        net.write_text(world.road.net(), encoding="utf-8")
        scenario = world_scenario(world, net)
        agents = world.population.drivers(sample_agents(scenario, world.seed))
        road = net if world.sensor.has_map else None
        if road is not None:
            keep_road(folder, road)
        entry = finished_episode(folder, episode_id(meta, agents, road))
        if entry is not None:
            return entry
        tracks, seen = record(world, scenario, agents)
        return write_sensed(folder, meta, tracks, seen, agents, road)


def world_scenario(world: World, net: Path) -> Scenario:
    """The scenario of a world, with its warm-up.

    Args:
        world: which.
        net: file that holds `WorldRoad.net`.
    """
    return Scenario(
        name=f"{world.road.family}_world",
        road=read_road(net, f"{world.road.family}_world"),
        flows=world.road.flows(),
        mix=world.population.mix,
        spread=0.0,
        duration_s=WARM_UP_S + world.duration_s,
        step_s=world.sensor.step_s,
        kinds=world.population.kinds,
    )


def record(
    world: World, scenario: Scenario, agents: tuple[AgentSpec, ...]
) -> tuple[Tracks, tuple[AgentSpec, ...]]:
    """Drive a world and see it with its sensor.

    Args:
        world: which.
        scenario: what `world_scenario` gives.
        agents: its drivers and pedestrians.

    Returns:
        What the sensor recorded, from time 0 on, and the agent behind each track.
    """
    frames = run_world(world, scenario, agents)
    seen = itertools.dropwhile(lambda frame: frame.time_s < WARM_UP_S, frames)
    behaviors = {agent.id: agent.behavior for agent in agents}
    clean = Tracks.from_frames(seen, behaviors)
    rng = np.random.default_rng((world.seed, _SENSOR_STREAM))
    tracks = world.sensor.seen(clean, rng)
    by_name = {str(agent.id): agent for agent in agents}
    return tracks, tuple(by_name[name.partition("/")[0]] for name in tracks.names)


_SENSOR_STREAM = 9
"""Number of the random stream of a world's sensor."""


def run_world(world: World, scenario: Scenario, agents: tuple[AgentSpec, ...]) -> Iterator[Frame]:
    """Frames of a world as they are, its warm-up included."""
    if world.engine != "sumo":
        return get_engine(world.engine)(scenario, agents, world.seed)
    from sim.sumo.engine import run_with

    return run_with(scenario, agents, world.seed, world.settings)
