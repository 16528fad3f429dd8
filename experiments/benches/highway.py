"""How quick the highway-env engine is, beside highway-env's own road, on the same traffic.

One row per road and number of cars: road frames and agent-steps per CPU second, the ratio to the
stock road, and how far the vehicles end up from where they end up on the road they must agree with.
The straight road is filled with cars; the four-way intersection has the traffic of its scenario.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from experiments.benches.contract import Bench, option
from experiments.score.rows import Cell, Row, tidy_row

FloatArray = NDArray[np.float64]

STEP_S: Final = 1.0 / 15.0
"""highway-env's default step, s."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How much traffic is driven, and for how long.

    Attributes:
        cars: numbers of cars.
        seconds: simulated time over which results are compared, s.
        warmup_s: how long the four-way intersection fills before that, s.
        most_stock_frames: the stock road is timed, and compared to the bit, over at most this many
            frames, because it is slow.
        seed: of the traffic.
    """

    cars: tuple[int, ...] = option((20, 50, 100, 200), "Numbers of cars.", "N,N")
    seconds: float = option(10.0, "Simulated time over which results are compared, s.")
    warmup_s: float = option(60.0, "How long the four-way intersection fills before that, s.")
    most_stock_frames: int = 60
    seed: int = 0


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure the stock road, the quicker one, and the compiled step.

    Yields:
        Rows for each number of cars on a straight road, then for the four-way intersection:
        ``frames_per_cpu_s``, ``agent_steps_per_cpu_s``, ``ratio_to_stock`` and ``farthest_m``
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
            figures = {
                "frames_per_cpu_s": speed,
                "agent_steps_per_cpu_s": speed * cars,
                "ratio_to_stock": speed / reference,
            }
            if road in apart:
                figures["farthest_m"] = apart[road]
            keys: dict[str, Cell] = {"road": road, "cars": cars}
            rows += [tidy_row(keys, name, value, None, None, n) for name, value in figures.items()]
        yield rows
    yield _four_way(settings)


BENCH: Final = Bench(
    name="highway",
    summary="Measure the highway-env engine's speed beside the stock road's.",
    keys=("road", "cars"),
    full=Settings(),
    quick=Settings(cars=(20,), seconds=2.0, most_stock_frames=10, warmup_s=20.0),
    measure=measure,
)


def _drive(road: str, cars: int, frames: int, seed: int) -> tuple[float, FloatArray]:
    """Frames per CPU second, and (frames, cars, 2) where everybody was, m."""
    from sim.highway.comparison import straight_traffic

    made = straight_traffic(road, cars, seed)
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


def _four_way(settings: Settings) -> list[Row]:
    """The four-way intersection: stock drivers who only yield, and ours with all rules.

    Roads are compared by agent-steps, since pedestrians travel on ours alone.
    """
    from scenarios import get_scenario
    from sim.highway.comparison import stock_copy
    from sim.highway.demand import Demand
    from sim.highway.engine import network_of
    from sim.highway.traffic import TrafficRoad
    from sim.scenario import sample_agents

    warmup, many = round(settings.warmup_s / STEP_S), round(settings.seconds / STEP_S)
    duration_s = settings.warmup_s + settings.seconds
    scenario = get_scenario("four_way_intersection")(flow="dense", duration_s=duration_s)
    agents = sample_agents(scenario, settings.seed)
    speeds: dict[str, tuple[float, float]] = {}
    places: dict[str, list[FloatArray]] = {}
    for name in ("objects", "compiled"):
        road = TrafficRoad(network_of(scenario.road), compiled=name == "compiled")
        demand = Demand(road, agents, settings.seed)
        spent, steps, places[name] = 0.0, 0, []
        for frame in range(warmup + many):
            demand.enter()
            begin = time.process_time()
            road.act()
            road.step(STEP_S)
            if frame >= warmup:
                spent += time.process_time() - begin
                steps += len(road.vehicles) + len(road.walkers)
                places[name].append(np.array([v.position for v in road.vehicles]).reshape(-1, 2))
        speeds[name] = many / max(spent, 1e-9), steps / max(spent, 1e-9)
    stock, frames = stock_copy(road), min(many, settings.most_stock_frames)
    spent = 0.0
    for _ in range(frames):
        begin = time.process_time()
        stock.act()
        stock.step(STEP_S)
        spent += time.process_time() - begin
    cars = len(stock.vehicles)
    speeds["stock"] = frames / max(spent, 1e-9), cars * frames / max(spent, 1e-9)
    apart = max(
        float(np.abs(one - other).max(initial=0.0)) if one.shape == other.shape else np.inf
        for one, other in zip(places["objects"], places["compiled"], strict=True)
    )
    rows: list[Row] = []
    for name, (frames_per_s, steps_per_s) in speeds.items():
        figures = {
            "frames_per_cpu_s": frames_per_s,
            "agent_steps_per_cpu_s": steps_per_s,
            "ratio_to_stock": steps_per_s / max(speeds["stock"][1], 1e-9),
        }
        if name == "compiled":
            figures["farthest_m"] = apart
        keys: dict[str, Cell] = {"road": f"four-way {name}", "cars": cars}
        rows += [tidy_row(keys, what, value, None, None, many) for what, value in figures.items()]
    return rows
