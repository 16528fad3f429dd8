"""The closed loop: simulate, classify and predict at every step, timed stage by stage.

On a straight road, and in cities of growing size; and the highway-env engine's own steps beside
those of highway-env's road with the same cars. All times are of the processor.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeVar

import gymnasium
import numpy as np

from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.predict import predict
from graphrqi.stream import DEFAULT_MODEL, load_stream
from scenarios import get_scenario
from scenarios.city import city as make_city
from scenarios.city import city_agents
from sim.engines import get_engine
from sim.frames import FloatArray
from sim.scenario import AgentSpec, Scenario, sample_agents

T = TypeVar("T")

STAGES: Final = ("simulate", "classify", "remember", "predict")
"""Parts of a step: the engine's frame, the stream's posterior, the history, the futures."""

PREDICTOR: Final = "graphrqi-predict"

FLOW_PER_H, ROAD_FILLS_S = 2700.0, 60.0
"""Vehicles per hour of the straight road, where some 60 agents are at a time. It fills first, s, or
a third of the time, if that is less."""

CITY_FLOW_PER_H, CITY_FILLS_S, CITY_MEASURED_S = 80_000.0, 35.0, 10.0
"""Vehicles per hour of which those of a city are drawn; the time until they have entered, and the
time measured after it, s."""

WARM_FRAMES: Final = 5
"""Frames that are classified and predicted before any is timed."""

STOCK_ROADS_S: Final = {"straight_road": 60.0, "four_way_intersection": 240.0}
"""Roads on which the engine drives beside highway-env's own, and for how long at most, s: the
intersection takes some minutes to fill."""

STOCK_STEP_S, STOCK_REPEATS = 1.0 / 15.0, 5
"""highway-env's default step, s, and how often both are timed."""


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


def measure(
    engines: Sequence[str] = ("sumo", "highway"), city: bool = False, duration_s: float = 180.0,
    repeats: int = 3, blocks: Sequence[int] = (3, 8, 20, 60),
    vehicles: Sequence[int] = (300, 1000, 3000),
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of each engine on a straight road or in cities, and of the highway engine's own speed.

    On the road, the least time of several passes over the same frames counts, stage by stage. Grids
    of cities have ``blocks`` junctions along their sides; all but 3 need netgenerate. Each number
    of ``vehicles`` drives on the largest grid, and the least on the smaller ones.
    """
    if city:
        for engine in engines:
            yield from _city_rows(engine, sorted(blocks), sorted(vehicles))
        return
    scenario = get_scenario("straight_road")(flow=FLOW_PER_H, duration_s=duration_s)
    agents = sample_agents(scenario, 0)
    from_s = min(ROAD_FILLS_S, duration_s / 3)
    for engine in engines:
        runs = [_go_through(scenario, agents, engine, from_s) for _ in range(repeats)]
        least = np.min([spent for _, spent in runs], axis=0)
        yield list(_stage_rows(_keys(engine, runs[0][0], scenario), least, scenario.step_s))
    for name, most_s in STOCK_ROADS_S.items():
        yield _stock_rows(name, min(most_s, duration_s))


def _city_rows(
    engine: str, blocks: Sequence[int], vehicles: Sequence[int]
) -> Iterator[list[Row]]:  # fmt: skip
    warming = get_scenario("four_way_intersection")(duration_s=15.0)  # loads every kernel
    _go_through(warming, sample_agents(warming, 0), engine, 5.0)
    for side, many in [(b, vehicles[0]) for b in blocks[:-1]] + [(blocks[-1], n) for n in vehicles]:
        duration_s = CITY_FILLS_S + CITY_MEASURED_S
        scenario = make_city(flow=CITY_FLOW_PER_H, blocks=side, duration_s=duration_s)
        agents = city_agents(scenario, many, 0)
        seen, spent_ms = _go_through(scenario, agents, engine, CITY_FILLS_S)
        yield list(_stage_rows(_keys(engine, seen, scenario), spent_ms, scenario.step_s))


def _keys(engine: str, agents: float, scenario: Scenario) -> dict[str, Cell]:
    return {"engine": engine, "agents": round(agents), "lanes": len(scenario.road.lanes)}


def _stage_rows(keys: Mapping[str, Cell], spent_ms: FloatArray, step_s: float) -> Iterator[Row]:
    """The costs of each stage and of all together."""
    for stage, spans in zip((*STAGES, "all"), [*spent_ms.T, spent_ms.sum(axis=1)], strict=True):
        for metric, value in (
            ("ms_median", np.median(spans)),
            ("ms_p99", np.quantile(spans, 0.99)),
            ("real_time_factor", 1e3 * step_s / max(np.mean(spans), 1e-9)),
        ):
            yield tidy_row({**keys, "stage": stage}, metric, float(value), n=len(spans))


def _stock_rows(name: str, duration_s: float) -> list[Row]:
    """Agent-steps per second of the highway engine beside highway-env's own road and drivers.

    highway-env's road has three straight lanes and the same mean number of cars. Both are timed in
    turn.
    """
    scenario = get_scenario(name)(duration_s=duration_s, flow="dense")
    agents, frames, found = sample_agents(scenario, 0), round(duration_s), []
    for repeat in range(STOCK_REPEATS + 1):
        counts, spent_ms = _timed(
            lambda: [len(frame) for frame in get_engine("highway")(scenario, agents, 0)]
        )
        cars = round(float(np.mean(counts)))
        config = {"lanes_count": 3, "vehicles_count": cars - 1}
        stock: Any = gymnasium.make("highway_env:highway-v0", config=config).unwrapped
        stock.reset(seed=repeat)
        begin, moved = time.process_time(), 0
        for _ in range(frames):
            stock.road.act()
            stock.road.step(STOCK_STEP_S)
            moved += len(stock.road.vehicles)
        stock_s = max(time.process_time() - begin, 1e-9)
        found.append((1e3 * sum(counts) / max(spent_ms, 1e-6), moved / stock_s))
    own, others = np.array(found[1:]).T  # the first one compiles
    figures = {
        ("highway", "agent_steps_per_cpu_s"): (np.median(own), own),
        ("highway-env's own", "agent_steps_per_cpu_s"): (np.median(others), others),
        ("highway", "ratio_to_stock"): (np.median(own) / np.median(others), own / others),
    }
    return [
        tidy_row({**_keys(engine, cars, scenario), "stage": "simulate", "scenario": name}, metric,
                 float(value), each.min(), each.max(), STOCK_REPEATS)
        for (engine, metric), (value, each) in figures.items()
    ]  # fmt: skip
