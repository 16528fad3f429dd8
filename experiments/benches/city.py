"""The closed loop in a city: what a frame costs per vehicle, on maps of any size.

Each city is measured in a process of its own, so that its memory is its own.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np

from experiments.score.rows import Cell, Row, tidy_row

T = TypeVar("T")

STAGES: Final = ("simulate", "classify", "remember", "predict")
"""What a step consists of: the engine's frame, the stream's posterior, the history, the futures."""

FILLING_S, MEASURED_S = 35.0, 10.0
"""Time until the vehicles have entered and the time measured after it, s (the costs of a hundred
frames)."""

WARM_FRAMES: Final = 5
"""Frames that are classified and predicted before any is timed."""


class City(NamedTuple):
    """One city's size, and which simulator drives there.

    Attributes:
        blocks: junctions along each side of the grid.
        vehicles: how many.
        engine: a key of ``ENGINES``.
    """

    blocks: int
    vehicles: int
    engine: str = "sumo"


class Measured(NamedTuple):
    """What one city cost.

    Attributes:
        city: its size.
        lanes: of its road.
        agents: vehicles in a frame, on average.
        spent_ms: (F, 4) time of each of `STAGES` in each frame, ms.
        open_s: time to read the road, s of the processor.
        start_s: time from then to the engine's first frame, s of the processor.
        first_s: time of the first prediction on this road, after one on another, s.
        memory_mb: most memory of the process, MB.
    """

    city: City
    lanes: int
    agents: float
    spent_ms: np.ndarray
    open_s: float
    start_s: float
    first_s: float
    memory_mb: float


def cities(blocks: Sequence[int], vehicles: Sequence[int]) -> list[City]:
    """The cities that are compared: one map with each crowd, and each map with the smallest crowd.

    The largest map has the largest crowd, too.

    Examples:
        >>> [tuple(city)[:2] for city in cities((3, 8, 20), (300, 1000))]
        [(8, 300), (8, 1000), (3, 300), (20, 300), (20, 1000)]
    """
    middle = blocks[len(blocks) // 2] if len(blocks) % 2 else blocks[len(blocks) // 2 - 1]
    found = [City(middle, n) for n in sorted(vehicles)]
    found += [City(b, min(vehicles)) for b in sorted(blocks) if b != middle]
    found.append(City(max(blocks), max(vehicles)))
    return list(dict.fromkeys(found))


def measure_cities(
    engines: Sequence[str],
    blocks: Sequence[int],
    vehicles: Sequence[int],
    model: str,
    predictor: str,
    repeats: int,
) -> Iterator[list[Row]]:
    """Rows of each engine's cities, then how its costs grow with vehicles and with lanes.

    Args:
        engines: keys of ``ENGINES``.
        blocks: sizes of the maps.
        vehicles: sizes of the crowds.
        model: the classifier.
        predictor: a key of ``PREDICTORS``.
        repeats: how often each city's frames are gone through; the least time of each counts.
    """
    from loky import ProcessPoolExecutor

    for engine in engines:
        done: list[Measured] = []  # each by a process and a thread of its own
        for size in cities(blocks, vehicles):
            city = size._replace(engine=engine)
            with ProcessPoolExecutor(max_workers=1, env={"OMP_NUM_THREADS": "1"}) as pool:
                done.append(pool.submit(measure_city, city, model, predictor, repeats).result())
            yield city_rows(done[-1])
        yield slopes(done)


def measure_city(city: City, model: str, predictor: str, repeats: int) -> Measured:
    """Go through one city; see `measure_cities`."""
    from graphrqi.predict import predict
    from graphrqi.stream import load_stream
    from scenarios.city import city_agents, city_scenario
    from scenarios.networks.grid import grid_net
    from sim.engines import get_engine
    from sim.road.net import read_road

    _load_kernels(city.engine, model, predictor)
    begin = time.process_time()
    read_road(grid_net(city.blocks), f"grid_{city.blocks}")
    open_s = time.process_time() - begin
    scenario = city_scenario(city.blocks, city.vehicles, 0, FILLING_S + MEASURED_S)
    agents = city_agents(scenario, city.vehicles, 0)
    frames, simulate_ms = [], []
    begin = time.process_time()
    running = get_engine(city.engine)(scenario, agents, 0)
    next(running)
    start_s = time.process_time() - begin
    while True:
        frame, spent = timed(lambda: next(running, None))
        if frame is None:
            break
        if frame.time_s > FILLING_S:
            frames.append(frame)
            simulate_ms.append(spent)
    runs, first_s = [], 0.0
    for repeat in range(repeats):
        stream, spent_ms = load_stream(model), []
        for i, frame in enumerate(frames):
            posterior, classify_ms = timed(lambda f=frame, s=stream: s.update(f))  # type: ignore[misc]
            history, remember_ms = timed(lambda s=stream: s.history)  # type: ignore[misc]
            _, predict_ms = timed(
                lambda h=history, p=posterior: predict(h, p, scenario.road, predictor=predictor)  # type: ignore[misc]
            )
            if i == repeat == 0:
                first_s = predict_ms / 1e3
            spent_ms.append((simulate_ms[i], classify_ms, remember_ms, predict_ms))
        runs.append(spent_ms[WARM_FRAMES:])
    least = np.min(np.array(runs), axis=0)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Measured(
        city=city,
        lanes=len(scenario.road.lanes),
        agents=float(np.mean([len(frame) for frame in frames])),
        spent_ms=least,
        open_s=open_s,
        start_s=start_s,
        first_s=first_s,
        memory_mb=most / (2**20 if sys.platform == "darwin" else 2**10),
    )


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What a piece of work gives, and how many ms of the processor it took."""
    begin = time.process_time()
    result = work()
    return result, 1e3 * (time.process_time() - begin)


def _load_kernels(engine: str, model: str, predictor: str) -> None:
    """Compile or load what the loop needs, on another road."""
    from graphrqi.predict import predict
    from graphrqi.stream import load_stream
    from scenarios import get_scenario
    from sim.engines import get_engine
    from sim.scenario import sample_agents

    scenario = get_scenario("four_way_intersection")(duration_s=15.0)
    stream = load_stream(model)
    for frame in get_engine(engine)(scenario, sample_agents(scenario, 0), 0):
        posterior = stream.update(frame)
    predict(stream.history, posterior, scenario.road, predictor=predictor)


def _keys(measured: Measured, stage: str) -> dict[str, Cell]:
    return {
        "engine": measured.city.engine, "stage": stage, "agents": round(measured.agents),
        "lanes": measured.lanes, "vehicles": measured.city.vehicles,
    }  # fmt: skip


def city_rows(measured: Measured) -> list[Row]:
    """Cost per frame and per vehicle of each stage and of all, and what opening the road takes.

    The key ``vehicles`` is how many there were to be, ``agents`` how many there were.
    """
    rows: list[Row] = []
    n = len(measured.spent_ms)
    stages = dict(zip(STAGES, measured.spent_ms.T, strict=True))
    for stage, spans in (stages | {"all": measured.spent_ms.sum(axis=1)}).items():
        for metric, value in (
            ("ms_median", np.median(spans)),
            ("ms_p99", np.quantile(spans, 0.99)),
            ("us_per_agent", 1e3 * np.median(spans) / measured.agents),
            ("real_time_factor", 1e2 / np.mean(spans)),
        ):
            rows.append(tidy_row(_keys(measured, stage), metric, float(value), None, None, n))
    for metric, value in (
        ("open_s", measured.open_s),
        ("start_s", measured.start_s),
        ("first_prediction_s", measured.first_s),
        ("memory_mb", measured.memory_mb),
    ):
        rows.append(tidy_row(_keys(measured, "open"), metric, value, None, None, 1))
    return rows


def slopes(done: Sequence[Measured]) -> list[Row]:
    """How each stage's cost grows: with vehicles on one map, and with lanes at one crowd.

    Slopes are those of logarithms: 1 is linear, 0 is no growth.
    """
    rows: list[Row] = []
    first = done[0].city
    for metric, some, size in (
        ("slope_agents", [m for m in done if m.city.blocks == first.blocks], "agents"),
        ("slope_lanes", [m for m in done if m.city.vehicles == first.vehicles], "lanes"),
    ):
        if len(some) < 2:
            continue
        across = np.log([float(getattr(m, size)) for m in some])
        for number, stage in enumerate((*STAGES, "all")):
            costs = [
                m.spent_ms.sum(axis=1) if stage == "all" else m.spent_ms[:, number] for m in some
            ]
            medians = np.maximum([np.median(cost) for cost in costs], 1e-6)
            slope = float(np.polyfit(across, np.log(medians), 1)[0])
            keys: dict[str, Cell] = {
                "engine": first.engine, "stage": stage, "agents": None, "lanes": None,
                "vehicles": None,
            }  # fmt: skip
            rows.append(tidy_row(keys, metric, slope, None, None, len(some)))
    return rows
