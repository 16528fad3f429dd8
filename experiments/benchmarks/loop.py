"""The closed loop: simulate, classify and predict at every step, timed stage by stage.

On a straight road, and in cities of growing size; and the highway-env engine's own steps beside
those of highway-env's road with the same cars. All times are of the processor.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np

from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.predict import predict
from graphrqi.stream import DEFAULT_MODEL, load_stream
from scenarios import get_scenario
from scenarios.city import city_agents, city_scenario
from scenarios.networks.build import grid_net
from sim.engines import get_engine
from sim.frames import FloatArray
from sim.road.net import read_road
from sim.scenario import AgentSpec, Scenario, sample_agents

T = TypeVar("T")

STAGES: Final = ("simulate", "classify", "remember", "predict")
"""Parts of a step: the engine's frame, the stream's posterior, the history, the futures."""

PREDICTOR: Final = "graphrqi-predict"

FLOW_PER_H: Final = 2700.0
"""Vehicles per hour of the straight road; some 60 agents are there at a time."""

ROAD_FILLS_S: Final = 60.0
"""The straight road fills first, s; a third of the time, if that is less."""

CITY_FILLS_S, CITY_MEASURED_S = 35.0, 10.0
"""Time until the vehicles of a city have entered, and the time measured after it, s."""

WARM_FRAMES: Final = 5
"""Frames of a city that are classified and predicted before any is timed."""

STOCK_STEP_S: Final = 1.0 / 15.0
"""highway-env's default step, s."""


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    """Result of a piece of work, and its processor time, ms."""
    begin = time.process_time()
    result = work()
    return result, 1e3 * (time.process_time() - begin)


def _go_through(
    scenario: Scenario, agents: Sequence[AgentSpec], engine: str, from_s: float
) -> tuple[float, FloatArray]:
    """Mean number of agents, and (F, 4) ms of each of `STAGES` in every frame after ``from_s``."""
    stream = load_stream(DEFAULT_MODEL)
    frames = get_engine(engine)(scenario, agents, 0)
    count: list[int] = []
    spent: list[tuple[float, ...]] = []
    while True:
        frame, simulate_ms = _timed(lambda: next(frames, None))
        if frame is None:
            return float(np.mean(count)), np.array(spent)
        if frame.time_s <= from_s - WARM_FRAMES * scenario.step_s:
            stream.push(frame)
            continue
        posterior, classify_ms = _timed(lambda f=frame: stream.update(f))  # type: ignore[misc]
        history, remember_ms = _timed(lambda: stream.history)
        _, predict_ms = _timed(
            lambda h=history, p=posterior: predict(h, p, scenario.road, predictor=PREDICTOR)  # type: ignore[misc]
        )
        if frame.time_s > from_s:
            count.append(len(frame))
            spent.append((simulate_ms, classify_ms, remember_ms, predict_ms))


def measure_loop(
    engines: Sequence[str], duration_s: float = 180.0, repeats: int = 3
) -> Iterator[list[Row]]:
    """Measure the loop on a straight road, and the engine's own speed.

    Args:
        engines: keys of ``ENGINES``.
        duration_s: simulated, s.
        repeats: passes over the same frames; the least time of each stage of each frame counts.

    Yields:
        Rows of each engine: ``ms_median``, ``ms_p99`` and ``real_time_factor`` of each stage and of
        all together. Last, ``agent_steps_per_cpu_s`` of the highway engine and of highway-env's own
        road and drivers, and ``ratio_to_stock``.
    """
    scenario = get_scenario("straight_road")(flow=FLOW_PER_H, duration_s=duration_s)
    agents = sample_agents(scenario, 0)
    from_s = min(ROAD_FILLS_S, duration_s / 3)
    for engine in engines:
        runs = [_go_through(scenario, agents, engine, from_s) for _ in range(repeats)]
        keys = {**_keys(engine), "agents": round(runs[0][0]), "lanes": len(scenario.road.lanes)}
        least = np.min([spent for _, spent in runs], axis=0)
        yield list(_stage_rows(keys, least, scenario.step_s))
    yield _stock_rows(min(60.0, duration_s))


def _keys(engine: str) -> dict[str, Cell]:
    return {"engine": engine, "agents": None, "lanes": None, "vehicles": None}


def _stage_rows(keys: Mapping[str, Cell], spent_ms: FloatArray, step_s: float) -> Iterator[Row]:
    """The costs of each stage and of all together."""
    every = zip((*STAGES, "all"), [*spent_ms.T, spent_ms.sum(axis=1)], strict=True)
    for stage, spans in every:
        for metric, value in (
            ("ms_median", np.median(spans)),
            ("ms_p99", np.quantile(spans, 0.99)),
            ("real_time_factor", 1e3 * step_s / max(float(np.mean(spans)), 1e-9)),
        ):
            yield tidy_row({**keys, "stage": stage}, metric, float(value), n=len(spans))


class City(NamedTuple):
    """Costs of one city.

    Attributes:
        blocks: junctions along each side of the grid.
        vehicles: how many were to be there.
        lanes: of its road.
        agents: vehicles in a frame, on average.
        spent_ms: (F, 4) time of each of `STAGES` in each frame, ms.
        open_s: time to read the road, s.
        memory_mb: most memory of the process, MB.
    """

    blocks: int
    vehicles: int
    lanes: int
    agents: float
    spent_ms: FloatArray
    open_s: float
    memory_mb: float


def _cities(blocks: Sequence[int], vehicles: Sequence[int]) -> list[tuple[int, int]]:
    """One map with each crowd, each map with the smallest crowd, the largest map with the largest.

    Examples:
        >>> _cities((3, 8, 20), (300, 1000))
        [(8, 300), (8, 1000), (3, 300), (20, 300), (20, 1000)]
    """
    middle = sorted(blocks)[(len(blocks) - 1) // 2]
    found = [(middle, n) for n in sorted(vehicles)]
    found += [(b, min(vehicles)) for b in sorted(blocks) if b != middle]
    return list(dict.fromkeys([*found, (max(blocks), max(vehicles))]))


def measure_cities(
    engines: Sequence[str], blocks: Sequence[int], vehicles: Sequence[int]
) -> Iterator[list[Row]]:
    """Measure the loop in cities, each in a process of its own, so that its memory is its own.

    Args:
        engines: keys of ``ENGINES``.
        blocks: junctions along the sides of the grids; all but 3 need netgenerate.
        vehicles: sizes of the crowds.

    Yields:
        Rows of each city: those of `measure_loop`, ``us_per_agent``, ``open_s`` and ``memory_mb``.
        ``slope_agents`` and ``slope_lanes`` say how the cost of a step grows with vehicles and
        with lanes, in logarithms.
    """
    from loky import ProcessPoolExecutor

    for engine in engines:
        done: list[City] = []
        for size in _cities(blocks, vehicles):
            with ProcessPoolExecutor(max_workers=1, env={"OMP_NUM_THREADS": "1"}) as pool:
                done.append(pool.submit(_measured_city, *size, engine).result())
            yield _city_rows(done[-1], engine)
        yield _slopes(done, engine)


def _measured_city(blocks: int, vehicles: int, engine: str) -> City:
    """Go through one city."""
    warming = get_scenario("four_way_intersection")(duration_s=15.0)  # loads every kernel
    _go_through(warming, sample_agents(warming, 0), engine, 5.0)
    _, open_ms = _timed(lambda: read_road(grid_net(blocks), f"grid_{blocks}"))
    scenario = city_scenario(blocks, vehicles, 0, CITY_FILLS_S + CITY_MEASURED_S)
    agents, spent = _go_through(scenario, city_agents(scenario, vehicles, 0), engine, CITY_FILLS_S)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    memory_mb = most / (2**20 if sys.platform == "darwin" else 2**10)
    return City(blocks, vehicles, len(scenario.road.lanes), agents, spent, open_ms / 1e3, memory_mb)


def _city_rows(city: City, engine: str) -> list[Row]:
    """The rows of one city."""
    keys: dict[str, Cell] = {
        "engine": engine, "agents": round(city.agents), "lanes": city.lanes,
        "vehicles": city.vehicles,
    }  # fmt: skip
    per_agent = 1e3 * float(np.median(city.spent_ms.sum(axis=1))) / city.agents
    return [
        *_stage_rows(keys, city.spent_ms, 0.1),
        tidy_row({**keys, "stage": "all"}, "us_per_agent", per_agent, n=1),
        tidy_row({**keys, "stage": "open"}, "open_s", city.open_s, n=1),
        tidy_row({**keys, "stage": "open"}, "memory_mb", city.memory_mb, n=1),
    ]


def _slopes(done: Sequence[City], engine: str) -> list[Row]:
    """How the cost of a step grows with vehicles and with lanes."""
    rows: list[Row] = []
    for metric, some, size in (
        ("slope_agents", [c for c in done if c.blocks == done[0].blocks], "agents"),
        ("slope_lanes", [c for c in done if c.vehicles == done[0].vehicles], "lanes"),
    ):
        if len(some) > 1:
            across = np.log([float(getattr(city, size)) for city in some])
            costs = np.log([np.median(city.spent_ms.sum(axis=1)) for city in some])
            slope = float(np.polyfit(across, costs, 1)[0])
            rows.append(tidy_row({**_keys(engine), "stage": "all"}, metric, slope, n=len(some)))
    return rows


def _stock_rows(duration_s: float) -> list[Row]:
    """Agent-steps per second of the highway engine beside highway-env's own road and drivers."""
    from sim.highway.stock import stock_traffic

    scenario = get_scenario("straight_road")(duration_s=duration_s, flow="dense")
    agents, frames = sample_agents(scenario, 0), round(duration_s)
    for _ in range(2):  # the first one compiles
        counts, spent_ms = _timed(
            lambda: [len(frame) for frame in get_engine("highway")(scenario, agents, 0)]
        )
    cars, own = max(counts), 1e3 * sum(counts) / max(spent_ms, 1e-6)
    road = stock_traffic(cars, seed=0)
    begin = time.process_time()
    for _ in range(frames):
        road.act()
        road.step(STOCK_STEP_S)
    stock = cars * frames / max(time.process_time() - begin, 1e-9)
    return [
        tidy_row(
            {**_keys(engine), "agents": cars, "vehicles": cars, "stage": "simulate"},
            metric, value, n=frames,
        )
        for engine, metric, value in (
            ("highway", "agent_steps_per_cpu_s", own),
            ("highway-env's own", "agent_steps_per_cpu_s", stock),
            ("highway", "ratio_to_stock", own / stock),
        )
    ]  # fmt: skip
