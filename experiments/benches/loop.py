"""The loop closed: simulate, classify and predict at every step, timed stage by stage."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np

from experiments.console.tables import Row
from graphrqi.predict import predict
from graphrqi.stream import DEFAULT_MODEL, load_stream
from scenarios import get_scenario
from sim.engines import get_engine
from sim.frames import FloatArray, IntArray
from sim.scenario import Scenario, sample_agents

T = TypeVar("T")

SCENARIO: Final = "straight_road"

FLOW_PER_H: Final = 2700.0
"""Vehicles per hour (some 60 agents at a time on the straight road)."""

DURATION_S, QUICK_DURATION_S = 180.0, 20.0

WARM_UP_S: Final = 60.0
"""The road fills first; steps before this are not timed (a third of the time, if that is less)."""

REPEATS, QUICK_REPEATS = 3, 1
"""How often the same frames are gone through. Of each stage of each frame the least time counts:
what else the machine does only ever adds to it."""

STAGES: Final = ("simulate", "classify", "remember", "predict")
"""What a step consists of: the engine's frame, the stream's posterior, the history, the futures."""


def run_loop_bench(
    quick: bool = False,
    engine: str = "sumo",
    model: str = DEFAULT_MODEL,
    predictor: str = "graphrqi-predict",
    flow_per_h: float = FLOW_PER_H,
) -> list[Row]:
    """Time of the central processor per step of the closed loop, everything on at every step.

    Args:
        quick: a short run, to see that it works.
        engine: a key of ``ENGINES``.
        model: the classifier.
        predictor: a key of ``PREDICTORS``.
        flow_per_h: vehicles per hour.

    Returns:
        Rows ``engine stage agents metric value low high n``: ms_median, ms_p99 and real_time_factor
        of each stage and of all together.
    """
    duration_s = QUICK_DURATION_S if quick else DURATION_S
    scenario = get_scenario(SCENARIO)(flow=flow_per_h, duration_s=duration_s)
    runs = [
        run_loop(scenario, engine, model, predictor)
        for _ in range(QUICK_REPEATS if quick else REPEATS)
    ]
    agents = runs[0][0]
    least = np.min([spent for _, spent in runs], axis=0)
    whole = dict(zip(STAGES, least.T, strict=True)) | {"all": least.sum(axis=1)}
    rows: list[Row] = []
    for stage, spans in whole.items():
        key: dict[str, Any] = {
            "engine": engine, "stage": stage, "agents": round(float(np.mean(agents)))
        }  # fmt: skip
        median, p99, mean = np.median(spans), np.quantile(spans, 0.99), np.mean(spans)
        for metric, value in (
            ("ms_median", median),
            ("ms_p99", p99),
            ("real_time_factor", 1e3 * scenario.step_s / mean),
        ):
            found: dict[str, Any] = {"metric": metric, "value": float(value), "n": len(spans)}
            rows.append({**key, **found, "low": None, "high": None})
    return rows


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


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What a piece of work gives, and how many ms of the processor it took."""
    begin = time.process_time()
    result = work()
    return result, 1e3 * (time.process_time() - begin)
