"""Makes the episode of one world: drawn, driven, and stored as its sensor saw it."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from experiments.generate import RANDOM_WORLD
from experiments.generate.worlds.world import DURATION_S, WARM_UP_S, World, draw_world
from sim.engines import get_engine
from sim.files import temporary_folder
from sim.frames import Frame, Tracks
from sim.road.net import read_road
from sim.scenario import AgentSpec, Scenario, sample_agents
from sim.store.encode import rounded
from sim.store.schema import EpisodeEntry, EpisodeMeta, split_of
from sim.store.writing import EpisodeWriter, made_with


def write_world(
    out: EpisodeWriter, seed: int, index: int, duration_s: float | None = None
) -> EpisodeEntry:
    """Make the episode of a world.

    Args:
        out: what takes it.
        seed: of the world, as for `draw_world`.
        index: of the episode.
        duration_s: length of the episode, s; None for two minutes.

    Returns:
        Its entry in the catalogue.

    Raises:
        InputError: if the engine cannot run it.
        OSError: if it cannot be written.
    """
    world = draw_world(seed, duration_s or DURATION_S)
    meta = EpisodeMeta(
        scenario=RANDOM_WORLD,
        engine=world.engine,
        seed=world.seed,
        index=index,
        split=split_of(index),
        options=world.options(),
        made_with=made_with(world.engine),
    )
    with temporary_folder("world") as scratch:
        net = scratch / "world.net.xml"
        net.write_text(world.road.net(), encoding="utf-8")
        scenario = _scenario(world, net)
        agents = world.population.drivers(sample_agents(scenario, world.seed))
        tracks = _recorded(world, scenario, agents)
        by_name = {str(agent.id): agent for agent in agents}
        behind = [by_name[name.partition("/")[0]] for name in tracks.names]
        sizes = zip(behind, tracks.ids, tracks.length, tracks.width, strict=True)
        seen = [
            dataclasses.replace(a, id=int(i), length_m=float(long), width_m=float(wide))
            for a, i, long, wide in sizes
        ]
        road = net if world.sensor.has_map else None
        drawn = sorted(agents, key=lambda a: a.id)
        return out.write_tracks(meta, rounded(tracks), seen, road, drawn=drawn)


def _scenario(world: World, net: Path) -> Scenario:
    """The scenario of a world on the net of a file, with its warm-up."""
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
    return world.sensor.seen(clean, np.random.default_rng((world.seed, _SENSOR_STREAM)))


_SENSOR_STREAM = 9
"""Number of the random stream of a world's sensor."""
