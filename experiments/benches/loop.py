"""The loop closed: simulate, classify and predict at every step, timed stage by stage."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.benches.city import STAGES, measure_cities, timed
from experiments.benches.contract import Bench, option
from experiments.rows import Cell, Row, tidy_row
from graphrqi.predict import predict
from graphrqi.stream import DEFAULT_MODEL, load_stream
from scenarios import get_scenario
from sim.engines import get_engine
from sim.frames import FloatArray, IntArray
from sim.scenario import Scenario, sample_agents

SCENARIO: Final = "straight_road"

WARM_UP_S: Final = 60.0
"""The road fills first; steps before this are not timed (a third of the time, if that is less)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What is run, and how often.

    Attributes:
        engines: keys of ``ENGINES``.
        model: the classifier.
        predictor: a key of ``PREDICTORS``.
        flow_per_h: vehicles per hour; 2700 are some 60 agents at a time.
        duration_s: simulated, s.
        repeats: how often the same frames are gone through. Of each stage of each frame the least
            time counts: whatever else the machine does only adds to it.
        city: whether cities are measured (`experiments.benches.city`) rather than a straight road.
        blocks: sizes of the cities; all but that of 3 need netgenerate.
        vehicles: sizes of the crowds in them.
    """

    engines: tuple[str, ...] = option(("sumo", "highway"), "Simulators.")
    model: str = option(DEFAULT_MODEL, "The classifier.")
    predictor: str = option("graphrqi-predict", "The predictor.")
    flow_per_h: float = option(2700.0, "Vehicles per hour.")
    duration_s: float = option(180.0, "Simulated time, s.")
    repeats: int = option(3, "How often the same frames are gone through.")
    city: bool = option(False, "Measure in cities instead: grids of blocks of several sizes.")
    blocks: tuple[int, ...] = option((3, 8, 20, 60), "With --city: junctions along a grid's side.")
    vehicles: tuple[int, ...] = option((300, 1000, 3000), "With --city: vehicles at a time.")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Time of the central processor per step of the closed loop, everything on at every step.

    Yields:
        Rows of each engine: ms_median, ms_p99 and real_time_factor of each stage and of all
        together; of cities as `experiments.benches.city` says.
    """
    if settings.city:
        yield from measure_cities(
            settings.engines, settings.blocks, settings.vehicles, settings.model,
            settings.predictor, settings.repeats,
        )  # fmt: skip
        return
    flow, duration_s = settings.flow_per_h, settings.duration_s
    scenario = get_scenario(SCENARIO)(flow=flow, duration_s=duration_s)
    for engine in settings.engines:
        runs = [
            run_loop(scenario, engine, settings.model, settings.predictor)
            for _ in range(settings.repeats)
        ]
        agents = round(float(np.mean(runs[0][0])))
        least = np.min([spent for _, spent in runs], axis=0)
        rows: list[Row] = []
        for stage, spans in (
            dict(zip(STAGES, least.T, strict=True)) | {"all": least.sum(axis=1)}
        ).items():
            keys: dict[str, Cell] = {
                "engine": engine, "stage": stage, "agents": agents,
                "lanes": len(scenario.road.lanes), "vehicles": None,
            }  # fmt: skip
            for metric, value in (
                ("ms_median", np.median(spans)),
                ("ms_p99", np.quantile(spans, 0.99)),
                ("real_time_factor", 1e3 * scenario.step_s / np.mean(spans)),
            ):
                rows.append(tidy_row(keys, metric, float(value), None, None, len(spans)))
        yield rows


def run_loop(
    scenario: Scenario, engine: str, model: str, predictor: str
) -> tuple[IntArray, FloatArray]:
    """Go through a scenario once.

    Args:
        scenario: what is simulated.
        engine: a key of ``ENGINES``.
        model: the classifier.
        predictor: a key of ``PREDICTORS``.

    Returns:
        (F,) agents in each frame after the warm-up, and (F, 4) time of each of ``STAGES``, ms.
    """
    stream = load_stream(model)
    frames = get_engine(engine)(scenario, sample_agents(scenario, 0), 0)
    agents: list[int] = []
    taken: list[tuple[float, ...]] = []
    warm_s = min(WARM_UP_S, scenario.duration_s / 3)
    while True:
        frame, simulate_ms = timed(lambda: next(frames, None))
        if frame is None:
            return np.array(agents), np.array(taken)
        posterior, classify_ms = timed(functools.partial(stream.update, frame))
        history, remember_ms = timed(lambda: stream.history)
        _, predict_ms = timed(
            functools.partial(predict, history, posterior, scenario.road, predictor=predictor)
        )
        if frame.time_s > warm_s:
            agents.append(len(frame))
            taken.append((simulate_ms, classify_ms, remember_ms, predict_ms))


BENCH: Final = Bench(
    name="loop",
    summary="Time classifying and predicting while a simulation runs, stage by stage.",
    keys=("engine", "stage", "agents", "lanes", "vehicles"),
    full=Settings(),
    quick=Settings(duration_s=20.0, repeats=1, blocks=(3,), vehicles=(30, 90)),
    measure=measure,
)
