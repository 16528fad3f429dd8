"""Draws random worlds: everything in which other traffic may differ from the training traffic.

A world has its own road, car-following law, lane discipline, population and sensor. The label
keeps its meaning: the behaviour that a driver was drawn with, relative to its world. All ranges
are our choice, wide enough to hold the recordings that we know.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from experiments.generate.worlds.population import Population, draw_population
from experiments.generate.worlds.roads import WorldRoad, draw_road
from experiments.generate.worlds.sensor import Sensor, draw_sensor
from sim.frames import AgentKind
from sim.sumo.vehicle_types import LAWS, SumoSettings

DURATION_S: Final = 120.0
"""Length of a world's episode, s."""

WARM_UP_S: Final = 40.0
"""Traffic drives this long before the sensor looks, s, so that the road is not empty."""

FINEST_STEP_S: Final = dict.fromkeys(("ACC", "highway-env IDM", "highway-env Krauss"), 0.1)
"""Shortest time between frames of some laws, s: with shorter ones drivers with ACC collide, and
highway-env takes long."""

KEEP_RIGHT: Final = (0.0, 0.0, 0.2, 0.5, 1.0, 2.0, 5.0)
"""SUMO's lcKeepRight, drawn with equal chances: from never to strongly (1 is SUMO's default)."""

LANE_CHANGES_S: Final = (0.0, 1.0, 2.5, 4.0)
"""How long a lane change takes, drawn with equal chances, s."""

SIMULATION_STEPS_S: Final = (0.1, 0.1, 0.2, 0.25)
"""Longest steps of the simulation, drawn with equal chances, s."""

HIGHWAY_ENV: Final = "highway-env"
"""Prefix of the names of the other engine's laws."""

HIGHWAY_LAWS: Final = {"highway": "IDM", "highway-krauss": "Krauss"}
"""The other engine's names, by what its drivers follow."""

HIGHWAY_FAMILIES: Final = ("straight", "junction", "two-way")
"""Families of roads that the other engine drives on."""

HIGHWAY_SHARE: Final = 0.12
"""Chance of the other engine where it can drive (it takes ten times as long)."""


@dataclass(frozen=True, slots=True)
class World:
    """Everything that an episode of a world is made from.

    Attributes:
        seed: of the population, the engine and the sensor.
        engine: registered name of the engine.
        settings: the law, the lane discipline, and how long a lane change takes.
        road: the road and the demand on it.
        population: the drivers.
        sensor: how they are seen.
        duration_s: for how long, s.
    """

    seed: int
    engine: str
    settings: SumoSettings
    road: WorldRoad
    population: Population
    sensor: Sensor
    duration_s: float = DURATION_S

    @property
    def law(self) -> str:
        """The car-following law, which for drivers of highway-env has a name of its own."""
        return self.settings.law if self.engine == "sumo" else f"{HIGHWAY_ENV} {self.settings.law}"

    def options(self) -> dict[str, Any]:
        """All numbers, flat, as they are kept with the episode."""
        settings, road = dataclasses.asdict(self.settings), dataclasses.asdict(self.road)
        del settings["options"]  # worlds have none
        return {
            **{name: settings[name] for name in settings if name != "longest_step_s"},
            "law": self.law,
            "simulation_step_s": self.settings.longest_step_s,
            **road,
            **self.population.options(),
            **dataclasses.asdict(self.sensor),
            "duration_s": self.duration_s,
            "warm_up_s": WARM_UP_S,
        }


def draw_world(seed: int, duration_s: float = DURATION_S) -> World:
    """Draw a world with an episode of ``duration_s``; the same seed draws the same world.

    Each part draws from a generator of its own, so that a change to one leaves the others as they
    were.

    Examples:
        >>> draw_world(1) == draw_world(1)
        True
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    sensor, settings = draw_sensor(streams[0]), _draw_settings(streams[1])
    road, population = draw_road(streams[2]), draw_population(streams[3])
    engine = "sumo"
    if road.family in HIGHWAY_FAMILIES and streams[4].random() < HIGHWAY_SHARE:
        engine = str(streams[4].choice(list(HIGHWAY_LAWS)))
        settings = SumoSettings(law=HIGHWAY_LAWS[engine])
        population = dataclasses.replace(population, kinds={AgentKind.CAR: 1.0})
    world = World(seed, engine, settings, road, population, sensor, duration_s)
    finest = max(sensor.step_s, FINEST_STEP_S.get(world.law, 0.0))
    return dataclasses.replace(world, sensor=dataclasses.replace(sensor, step_s=finest))


def _draw_settings(rng: np.random.Generator) -> SumoSettings:
    return SumoSettings(
        law=str(rng.choice(list(LAWS))),
        imperfection=float(np.round(rng.uniform(0.0, 0.6), 3)),
        keep_right=float(rng.choice(KEEP_RIGHT)),
        lane_change_s=float(rng.choice(LANE_CHANGES_S)),
        longest_step_s=float(rng.choice(SIMULATION_STEPS_S)),
    )
