"""Random worlds: everything in which other traffic may differ from the training traffic.

A world has its own road, car-following law, lane discipline, population and sensor. The label
keeps its meaning: the behaviour that a driver was drawn with, relative to its world. All ranges
are our choice, wide enough to hold the recordings that we know.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from behaviors.elementwise import log_uniform
from behaviors.labels import BEHAVIORS, PROFILES, Behavior
from behaviors.populations import LOWEST_HEADWAY_S
from behaviors.profiles import FARTHEST_SPREADS
from experiments.data import disturbances
from experiments.generate.world_roads import WorldRoad, draw_road
from graphrqi.posterior import AGGRESSIVE
from sim.formats.common.recording import CAR_LENGTH_M, CAR_WIDTH_M, with_motion
from sim.frames import AgentKind, FloatArray, Tracks
from sim.scenario import KIND_LIMITS, AgentSpec
from sim.sumo.vehicle_types import LAWS, SumoSettings

DURATION_S, WARM_UP_S = 120.0, 40.0
"""Length of a world's episode, s; before, traffic drives so long that the road is not empty, s."""

# --- the law and the lane discipline -------------------------------------------------------------

FINEST_STEP_S: Final = dict.fromkeys(("ACC", "highway-env IDM", "highway-env Krauss"), 0.1)
"""Shortest time between frames of some laws, s: with shorter ones drivers with ACC collide, and
highway-env takes long."""

KEEP_RIGHT: Final = (0.0, 0.0, 0.2, 0.5, 1.0, 2.0, 5.0)
"""SUMO's lcKeepRight, drawn with equal chances: from never to strongly (1 is SUMO's default)."""

LANE_CHANGES_S, SIMULATION_STEPS_S = (0.0, 1.0, 2.5, 4.0), (0.1, 0.1, 0.2, 0.25)
"""How long a lane change takes, s, and the longest steps of the simulation, s: equal chances."""

HIGHWAY_LAWS: Final = {"highway": "IDM", "highway-krauss": "Krauss"}
HIGHWAY_FAMILIES, HIGHWAY_SHARE = ("straight", "junction", "two-way"), 0.12
"""highway-env's engines with their laws, the families of roads that they drive on, and their chance
there (they take ten times as long)."""

# --- the drivers ---------------------------------------------------------------------------------

TRAF_MIX: Final = (53, 13, 52, 266, 2, 6)
"""Agents of each behaviour in the annotated TRAF videos, in the order of ``BEHAVIORS``."""

VARIED: Final[dict[str, tuple[float, float]]] = {
    "speed_factor": (0.08, 1.0),
    "time_headway_s": (0.22, -1.0),
    "min_gap_m": (0.25, -1.0),
    "max_accel_mps2": (0.2, 1.0),
    "comfort_decel_mps2": (0.15, 1.0),
    "lane_change_gain": (0.5, 1.0),
    "lane_change_patience_s": (0.4, -1.0),
    "lane_change_assertiveness": (0.25, 1.0),
    "gap_acceptance_s": (0.25, -1.0),
    "startup_delay_s": (0.3, -1.0),
}
"""Numbers of the profiles by which whole populations differ: the log-normal spread between
populations, and whether a number grows or falls with how briskly a driver drives."""

MIXES: Final = {
    "equal": 0.25, "any": 0.3, "one-sided": 0.2, "traf": 0.1, "one style": 0.08, "pure": 0.07,
}  # fmt: skip
"""Chance of each way of drawing the mix."""

ACTS: Final = ("cut_in_rate_per_min", "stop_rate_per_min", "wrong_way_rate_per_min")
"""Rates of deliberate acts, which differ between worlds."""

_STREAM: Final = 8
"""Number of a driver's random stream for its numbers in a world."""

# --- the sensor ----------------------------------------------------------------------------------

STEPS_S: Final = (0.04, 0.05, 0.1, 0.1, 0.1, 0.2, 0.25, 0.3, 0.4)
"""Time between frames, drawn with equal chances, s: 25 to 2.5 Hz, mostly 10."""

NOISE_M, NOISE_CORRELATION_S = (0.01, 0.5), (0.0, 0.2, 0.5, 1.0)
"""Smallest and largest standard deviation of positions, m, where there is noise, and the time in
which an error falls to 1/e, s; 0: white."""

LOSSES, LOST_PER_MIN = (0.0, 0.0, 0.05, 0.15, 0.3), (0.0, 0.0, 0.5, 2.0)
"""Shares of frames, and of single detections, that are missing, and how often an agent is lost and
found again, per minute: equal chances."""

MAP_SHARE, PIXEL_SHARE = 0.6, 0.35
"""Chance that the recording comes with the map, and of one without that it is in pixels."""

PIXELS_PER_M, PIXEL_STEP = (2.0, 30.0), 0.5
"""Smallest and largest scale (TRAF's videos have some 6 to 30). Positions in an image are multiples
of the second, pixels: centres of boxes with whole corners."""


@dataclass(frozen=True, slots=True)
class Population:
    """Drivers of a world.

    Attributes:
        mix: share of each behaviour.
        mix_kind: how it was drawn, a key of `MIXES`.
        kinds: share of each kind of vehicle.
        spread: log-normal spread between drivers of one behaviour.
        correlation: share of that spread's variance that all numbers of a driver have in common.
        shifts: factor on a number of every driver, by the number's name.
        acts: factor on how often drivers cut in, stop for no reason or overtake on the wrong side.
    """

    mix: dict[Behavior, float]
    mix_kind: str
    kinds: dict[AgentKind, float]
    spread: float
    correlation: float
    shifts: dict[str, float]
    acts: float

    def driver(self, agent: AgentSpec) -> AgentSpec:
        """The same agent with numbers of this world, on which its own seed decides."""
        if agent.profile is None or agent.behavior is None:
            return agent
        rng = np.random.default_rng((agent.seed, _STREAM))
        median, limits = PROFILES[agent.behavior], KIND_LIMITS[agent.kind]
        drawn = rng.standard_normal(len(VARIED) + 1).clip(-FARTHEST_SPREADS, FARTHEST_SPREADS)
        common, own = float(drawn[0]), drawn[1:]
        numbers: dict[str, float] = {}
        for z, (name, (_, tendency)) in zip(own, VARIED.items(), strict=True):
            mixed = (1 - self.correlation) ** 0.5 * z
            mixed += self.correlation**0.5 * common * tendency
            factor = math.exp(self.spread * mixed) * self.shifts.get(name, 1.0)
            numbers[name] = getattr(median, name) * factor
        numbers["time_headway_s"] = max(numbers["time_headway_s"], LOWEST_HEADWAY_S)
        numbers["max_accel_mps2"] = min(numbers["max_accel_mps2"], limits.max_accel_mps2)
        numbers["comfort_decel_mps2"] = min(numbers["comfort_decel_mps2"], limits.max_decel_mps2)
        numbers |= {name: getattr(agent.profile, name) * self.acts for name in ACTS}
        return dataclasses.replace(agent, profile=dataclasses.replace(agent.profile, **numbers))


@dataclass(frozen=True, slots=True)
class Sensor:
    """Sensor that records the traffic, with the numbers named above.

    ``lost_frames`` and ``lost_detections`` are shares; ``found_as`` is "same" or "new", the id of
    an agent that is found again after some 1.5 s. Without ``has_sizes`` all are cars of 4.5 m. The
    scale is 0 for metres. Recordings without a map may be mirrored and turned.
    """

    step_s: float
    noise_m: float = 0.0
    noise_correlation_s: float = 0.0
    lost_frames: float = 0.0
    lost_detections: float = 0.0
    lost_per_min: float = 0.0
    found_as: str = "same"
    has_map: bool = True
    has_sizes: bool = True
    pixels_per_m: float = 0.0
    left_hand: bool = False
    turned_rad: float = 0.0

    def seen(self, tracks: Tracks, rng: np.random.Generator) -> Tracks:
        """Recording of traffic by the sensor at its frame rate, with the same labels.

        Headings and speeds follow from the positions, as in most recordings. Names begin with the
        agent's id; behind a slash follows the number of the track where an agent has several.
        """
        seen, noise_m = tracks, self.noise_m
        if noise_m and self.noise_correlation_s:
            seen = disturbances.correlated_noise(seen, noise_m, rng, self.noise_correlation_s)
        elif noise_m:
            seen = disturbances.position_noise(seen, noise_m, rng)
        if self.lost_per_min and self.found_as == "new":
            seen = disturbances.renamed_tracks(seen, self.lost_per_min, rng)
        elif self.lost_per_min:
            seen = disturbances.lost_tracks(seen, self.lost_per_min, rng)
        if self.lost_detections:
            seen = disturbances.lost_detections(seen, self.lost_detections, rng)
        if self.lost_frames:
            seen = disturbances.dropped_frames(seen, self.lost_frames, rng)
        if not self.has_map:
            seen = self._in_its_axes(seen)
        seen = seen.part(np.flatnonzero(seen.valid.any(axis=1)), slice(None))
        signals = seen.signals if self.has_map else seen.signals[:0]
        return dataclasses.replace(with_motion(seen), signals=signals, events=())

    def _in_its_axes(self, tracks: Tracks) -> Tracks:
        """Positions and sizes in the sensor's axes and unit."""
        cos, sin = math.cos(self.turned_rad), math.sin(self.turned_rad)
        axes = np.array([[cos, sin], [-sin, cos]])
        if self.left_hand:
            axes = np.diag([1.0, -1.0]) @ axes
        scale = self.pixels_per_m or 1.0
        xy = scale * (tracks.xy @ axes)
        if self.pixels_per_m:
            xy = np.round(xy / PIXEL_STEP) * PIXEL_STEP
        length, width = tracks.length, tracks.width
        if not self.has_sizes:
            length, width = np.full_like(length, CAR_LENGTH_M), np.full_like(width, CAR_WIDTH_M)
        return tracks.with_dense(xy=xy, length=scale * length, width=scale * width)


@dataclass(frozen=True, slots=True)
class World:
    """Everything that an episode of a world is made from; the seed is that of all its parts."""

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
        return self.settings.law if self.engine == "sumo" else f"highway-env {self.settings.law}"

    def options(self) -> dict[str, Any]:
        """All numbers, flat, as they are kept with the episode."""
        settings = dataclasses.asdict(self.settings)
        del settings["options"]  # worlds have none
        step_s, drivers = settings.pop("longest_step_s"), self.population
        return {
            **settings, "law": self.law, "simulation_step_s": step_s,
            **dataclasses.asdict(self.road), **dataclasses.asdict(drivers),
            "mix": {str(b): share for b, share in drivers.mix.items()},
            "kinds": {str(k): share for k, share in drivers.kinds.items()},
            **dataclasses.asdict(self.sensor),
            "duration_s": self.duration_s, "warm_up_s": WARM_UP_S,
        }  # fmt: skip


def draw_world(seed: int, duration_s: float = DURATION_S) -> World:
    """Draw a world; the same seed draws the same world.

    Each part draws from a generator of its own, so that a change to one leaves the others alone.

    Examples:
        >>> draw_world(1) == draw_world(1)
        True
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    sensor, settings = _draw_sensor(streams[0]), _draw_settings(streams[1])
    road, population = draw_road(streams[2]), _draw_population(streams[3])
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


def _draw_population(rng: np.random.Generator) -> Population:
    kind = str(rng.choice(list(MIXES), p=list(MIXES.values())))
    shares = _draw_mix(kind, rng)
    shifted = rng.random() < 0.8
    shifts = {
        name: round(math.exp(deviation * rng.standard_normal()), 3) if shifted else 1.0
        for name, (deviation, _) in VARIED.items()
    }
    trucks = float(rng.choice((0.0, 0.0, 0.05, 0.15)))
    kinds = {AgentKind.CAR: 1.0 - trucks, AgentKind.TRUCK: trucks}
    return Population(
        mix={b: float(s) for b, s in zip(BEHAVIORS, shares, strict=True)},
        mix_kind=kind,
        kinds={k: share for k, share in kinds.items() if share},
        spread=round(float(rng.uniform(0.05, 0.2)), 3),
        correlation=round(float(rng.choice((0.0, 0.0, 0.5, 0.8))), 3),
        shifts=shifts,
        acts=round(float(rng.choice((0.0, rng.uniform(0.2, 1.0), 1.0))), 3),
    )


def _draw_mix(kind: str, rng: np.random.Generator) -> FloatArray:
    """(6,) shares in the order of ``BEHAVIORS``; they sum to 1."""
    n = len(BEHAVIORS)
    if kind == "equal":
        shares = np.full(n, 1.0)
    elif kind == "traf":
        shares = np.array(TRAF_MIX, dtype=np.float64)
    elif kind == "pure":
        shares = np.zeros(n)
        shares[rng.integers(n)] = 1.0
    elif kind == "one style":
        shares = np.where((rng.random() < 0.5) == AGGRESSIVE, rng.dirichlet(np.full(n, 2.0)), 0.0)
    elif kind == "one-sided":
        shares = np.full(n, 0.4 / (n - 1))
        shares[rng.integers(n)] = 0.6
    else:
        shares = rng.dirichlet(np.full(n, 1.0))
    rounded: FloatArray = np.round(shares / shares.sum(), 6)
    rounded[int(rounded.argmax())] += 1.0 - rounded.sum()
    return rounded


def _draw_sensor(rng: np.random.Generator) -> Sensor:
    """One in five measures positions exactly."""
    noise = 0.0 if rng.random() < 0.2 else log_uniform(rng, *NOISE_M)
    correlation = float(rng.choice(NOISE_CORRELATION_S))
    step_s = float(rng.choice(STEPS_S))
    lost_frames, lost_detections = float(rng.choice(LOSSES)), float(rng.choice(LOSSES))
    lost_per_min, found_as = float(rng.choice(LOST_PER_MIN)), str(rng.choice(["same", "new"]))
    has_map, pixels = bool(rng.random() < MAP_SHARE), bool(rng.random() < PIXEL_SHARE)
    scale = log_uniform(rng, *PIXELS_PER_M)
    left, turned = bool(rng.random() < 0.3), float(rng.uniform(-np.pi, np.pi))
    sizes = bool(rng.random() < 0.6)
    return Sensor(
        step_s, round(noise, 3), correlation if noise else 0.0, lost_frames, lost_detections,
        lost_per_min, found_as, has_map, has_sizes=has_map or sizes,
        pixels_per_m=round(scale, 2) if pixels and not has_map else 0.0,
        left_hand=left and not has_map, turned_rad=0.0 if has_map else round(turned, 4),
    )  # fmt: skip


def seen_badly(tracks: Tracks, rng: np.random.Generator) -> Tracks:
    """Tracks as a sensor that is drawn at random sees them, in metres, at a steady frame rate."""
    sensor = dataclasses.replace(_draw_sensor(rng), pixels_per_m=0.0)
    every = round(sensor.step_s / tracks.step_s)
    step_s = every * tracks.step_s if every else sensor.step_s
    return sensor.seen(disturbances.frame_rate(tracks, 1.0 / step_s, rng), rng)
