"""Draws worlds: everything in which traffic elsewhere may differ from the traffic trained on.

A world has its own road, car-following law, lane discipline, population and sensor. What stays is
the meaning of the label: the behaviour that a driver was drawn with, relative to its world. All
ranges are our choice, wide enough to hold the recordings that we know.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from experiments.data.worlds.population import Population, draw_population
from experiments.data.worlds.roads import WorldRoad, draw_road
from experiments.data.worlds.sensor import Sensor, draw_sensor
from sim.sumo.settings import LAWS, SumoSettings

DURATION_S: Final = 120.0
"""Length of a world's episode, s."""

WARM_UP_S: Final = 40.0
"""Traffic drives this long before the sensor looks, s, so that the road is not empty."""

FINEST_STEP_S: Final[dict[str, float]] = {"ACC": 0.1}
"""Laws that collide at shorter steps than this, s (measured: 99 collisions among 108 drivers at
0.04 s, none at 0.1 s)."""

KEEP_RIGHT: Final = (0.0, 0.0, 0.2, 0.5, 1.0, 2.0, 5.0)
"""SUMO's lcKeepRight, drawn with equal chances: from never to strongly (1 is SUMO's default)."""

LANE_CHANGES_S: Final = (0.0, 1.0, 2.5, 4.0)
"""How long a lane change takes, drawn with equal chances, s."""

SIMULATION_STEPS_S: Final = (0.1, 0.1, 0.2, 0.25)
"""Longest steps of the simulation, drawn with equal chances, s."""


@dataclass(frozen=True, slots=True)
class World:
    """Everything that an episode of a world is made from.

    Attributes:
        seed: of the population, the engine and the sensor.
        engine: the family of the engine: sumo.
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

    def options(self) -> dict[str, Any]:
        """All numbers, flat, as they are kept with the episode."""
        settings, road = dataclasses.asdict(self.settings), dataclasses.asdict(self.road)
        return {
            "engine": self.engine,
            **{name: settings[name] for name in settings if name != "longest_step_s"},
            "simulation_step_s": self.settings.longest_step_s,
            **road,
            **self.population.options(),
            **dataclasses.asdict(self.sensor),
            "duration_s": self.duration_s,
            "warm_up_s": WARM_UP_S,
        }


def draw_world(seed: int, duration_s: float = DURATION_S) -> World:
    """Draw a world.

    Each part draws from a generator of its own, so that a change to one leaves the others as they
    were.

    Args:
        seed: any integer from 0 to 2**31 - 1; the same seed draws the same world.
        duration_s: length of its episode, s.

    Returns:
        The world.

    Examples:
        >>> draw_world(1) == draw_world(1)
        True
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    sensor = draw_sensor(streams[0])
    settings = _draw_settings(streams[1])
    finest = FINEST_STEP_S.get(settings.law, 0.0)
    sensor = dataclasses.replace(sensor, step_s=max(sensor.step_s, finest))
    road = draw_road(streams[2])
    population = draw_population(streams[3])
    return World(seed, "sumo", settings, road, population, sensor, duration_s)


def _draw_settings(rng: np.random.Generator) -> SumoSettings:
    return SumoSettings(
        law=str(rng.choice(list(LAWS))),
        imperfection=float(np.round(rng.uniform(0.0, 0.6), 3)),
        keep_right=float(rng.choice(KEEP_RIGHT)),
        lane_change_s=float(rng.choice(LANE_CHANGES_S)),
        longest_step_s=float(rng.choice(SIMULATION_STEPS_S)),
    )
