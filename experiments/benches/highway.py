"""How quick the highway-env engine is, beside highway-env's own road, on the same traffic.

One row per road and number of cars: road frames per CPU second, the ratio to the stock road, and
how far the vehicles end up from where they end up on the road they must agree with.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from experiments.benches.contract import Bench, option
from experiments.rows import Cell, Row, tidy_row

FloatArray = NDArray[np.float64]

LANES: Final = 4
SPACING_M: Final = 24.0
"""Mean distance between cars on a lane, m (our choice: they interact)."""

STEP_S: Final = 1.0 / 15.0
"""highway-env's default step, s."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How much traffic is driven, and for how long.

    Attributes:
        cars: numbers of cars.
        seconds: simulated time over which results are compared, s.
        most_stock_frames: the stock road is timed, and compared to the bit, over at most this many
            frames, because it is slow.
        seed: of the traffic.
    """

    cars: tuple[int, ...] = option((20, 50, 100, 200), "Numbers of cars.", "N,N")
    seconds: float = option(10.0, "Simulated time over which results are compared, s.")
    most_stock_frames: int = 60
    seed: int = 0


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure the stock road, the quicker one, and the compiled step on straight roads.

    Yields:
        Rows for each number of cars: ``frames_per_cpu_s``, ``ratio_to_stock`` and ``farthest_m``
        (greatest distance to the reference: the stock road for ``fast``, the vehicle objects for
        ``compiled``).
    """
    seed = settings.seed
    for cars in settings.cars:
        frames = min(settings.most_stock_frames, max(1, 6000 // cars))
        stock, stock_places = _drive("stock", cars, frames, seed)
        fast, fast_places = _drive("fast", cars, frames, seed)
        many = round(settings.seconds / STEP_S)
        _drive("compiled", cars, 2, seed)  # compiles, if it has to
        objects, object_places = _drive("objects", cars, many, seed)
        quick, quick_places = _drive("compiled", cars, many, seed)
        profiles, _ = _drive("stock-profiles", cars, frames, seed)
        apart = {
            "fast": float(np.abs(fast_places - stock_places).max()),
            "compiled": float(np.abs(quick_places - object_places).max()),
        }
        speeds = {
            "stock": (stock, frames, stock),
            "fast": (fast, frames, stock),
            "stock-profiles": (profiles, frames, profiles),
            "objects": (objects, many, profiles),
            "compiled": (quick, many, profiles),
        }
        rows: list[Row] = []
        for road, (speed, n, reference) in speeds.items():
            figures = {"frames_per_cpu_s": speed, "ratio_to_stock": speed / reference}
            if road in apart:
                figures["farthest_m"] = apart[road]
            keys: dict[str, Cell] = {"road": road, "cars": cars}
            rows += [tidy_row(keys, name, value, None, None, n) for name, value in figures.items()]
        yield rows


BENCH: Final = Bench(
    name="highway",
    summary="Measure the highway-env engine's speed beside the stock road's.",
    keys=("road", "cars"),
    full=Settings(),
    quick=Settings(cars=(20,), seconds=2.0, most_stock_frames=10),
    measure=measure,
)


def _drive(road: str, cars: int, frames: int, seed: int) -> tuple[float, FloatArray]:
    """Frames per CPU second, and (frames, cars, 2) where everybody was, m."""
    made = _make(road, cars, seed)
    vehicles = list(made.vehicles)
    places = np.empty((frames, cars, 2))
    spent = 0.0
    for frame in range(frames):
        begin = time.process_time()
        made.act()
        made.step(STEP_S)
        spent += time.process_time() - begin
        places[frame] = [vehicle.position for vehicle in vehicles]
    return frames / max(spent, 1e-9), places


def _make(road: str, cars: int, seed: int) -> Any:
    """A straight road with cars: highway-env's drivers or ours, the same places and speeds."""
    from highway_env.road.road import Road, RoadNetwork
    from highway_env.vehicle.behavior import IDMVehicle

    from behaviors.labels import BEHAVIORS
    from behaviors.profiles import sample_profile
    from sim.highway.fast_road import FastRoad
    from sim.highway.network import HighwayNetwork, LaneInfo
    from sim.highway.traffic import TrafficRoad
    from sim.highway.vehicle import Driver, ProfileVehicle
    from sim.road import Road as SumoRoad

    net = RoadNetwork.straight_road_network(LANES, length=20_000.0, speed_limit=25.0)
    lanes = net.lanes_dict()
    if road in ("objects", "compiled"):
        from pathlib import Path

        info = {index: LaneInfo() for index in lanes}
        named = SumoRoad("bench", (), (), (), (), Path("bench"))
        network = HighwayNetwork(named, net, info, lanes, {"0-1": ("0", "1")}, {}, {}, {})
        made: Any = TrafficRoad(network, compiled=road == "compiled")
    else:
        kind = FastRoad if road == "fast" else Road
        made = kind(net, np_random=np.random.RandomState(seed))
    rng = np.random.default_rng(seed)
    for i in range(cars):
        lane = net.get_lane(("0", "1", i % LANES))
        s = 50.0 + (i // LANES) * SPACING_M + float(rng.uniform(0.0, SPACING_M / 3))
        speed, wanted = float(rng.uniform(15.0, 25.0)), float(rng.uniform(18.0, 30.0))
        profile = sample_profile(BEHAVIORS[int(rng.integers(len(BEHAVIORS)))], rng)
        if road in ("stock", "fast"):
            vehicle = IDMVehicle(made, lane.position(s, 0.0), speed=speed)
            vehicle.target_speed = wanted
        else:
            vehicle = ProfileVehicle(
                made,
                lane.position(s, 0.0),
                speed=speed,
                driver=Driver(profile, seed=(seed, i)),
                agent=i,
                lane_index=("0", "1", i % LANES),
                stretches=(("0", "1"),),
            )
        made.vehicles.append(vehicle)
    return made
