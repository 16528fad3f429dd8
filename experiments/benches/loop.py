"""The loop closed: simulate, classify and predict at every step, timed stage by stage."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from experiments.benches.city import STAGES, measure_cities, timed
from experiments.benches.contract import Bench, option
from experiments.score.rows import Cell, Row, tidy_row
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
        first_use: whether the first frame of a program is measured instead.
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
    first_use: bool = option(False, "Measure a program's first frame instead, kernel by kernel.")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Time of the central processor per step of the closed loop, everything on at every step.

    Yields:
        Rows of each engine: ms_median, ms_p99 and real_time_factor of each stage and of all
        together; of cities as `experiments.benches.city` says; of a first use as
        `measure_first_use` says.
    """
    if settings.first_use:
        for engine in settings.engines:
            yield measure_first_use(engine, settings.model, settings.predictor)
        return
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


def measure_first_use(engine: str, model: str, predictor: str) -> list[Row]:
    """CPU time of a new process until its first frames are predicted, imports included, s.

    The first frame of all may be empty; the first one with two vehicles is measured, too.

    Args:
        engine: a key of ``ENGINES``.
        model: the classifier.
        predictor: a key of ``PREDICTORS``.

    Returns:
        first_use_cpu_s of the first frame and first_pair_cpu_s of the first frame with two
        vehicles, with an empty cache of kernels; next_use_cpu_s and next_pair_cpu_s with the cache
        that this left; each with the number of kernels compiled so far, numba's own included; and
        the compile_cpu_s of each kernel without those that it calls, dearest first.
    """
    unknown: dict[str, Cell] = {
        "engine": engine, "agents": None, "lanes": None, "vehicles": None,
    }  # fmt: skip
    program = "import sys; from experiments.benches.loop import first_use; first_use(*sys.argv[1:])"
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        for use in ("first", "next"):
            said = subprocess.run(
                [sys.executable, "-c", program, engine, model, predictor], env=environment,
                stdout=subprocess.PIPE, text=True, check=True,
            )  # fmt: skip
            found = json.loads(said.stdout)
            keys = {**unknown, "stage": "all"}
            for frame in ("use", "pair"):
                cpu_s, compiled = found[frame]
                rows.append(tidy_row(keys, f"{use}_{frame}_cpu_s", cpu_s, None, None, compiled))
            spent: dict[str, list[float]] = found["kernels"] if use == "first" else {}
            for kernel in sorted(spent, key=lambda name: -sum(spent[name])):
                keys = {**unknown, "stage": kernel}
                total, times = sum(spent[kernel]), len(spent[kernel])
                rows.append(tidy_row(keys, "compile_cpu_s", total, None, None, times))
    return rows


def first_use(engine: str, model: str, predictor: str) -> None:
    """Predict until two vehicles are there, and print what it cost as JSON.

    Printed are the CPU time of this process and the number of compilations at the first frame and
    at the first one with two vehicles, and the CPU time of each compilation.
    """
    from numba.core import event

    spent: dict[str, list[float]] = {}
    begun: list[float] = []
    within: list[float] = [0.0]

    class Costs(event.Listener):
        def on_start(self, _: Any) -> None:
            begun.append(time.process_time())
            within.append(0.0)

        def on_end(self, event: Any) -> None:
            whole, inner = time.process_time() - begun.pop(), within.pop()
            within[-1] += whole
            function = event.data["dispatcher"].py_func
            name = f"{function.__module__}.{function.__qualname__}"
            spent.setdefault(name, []).append(whole - inner)

    event.register("numba:compile", Costs())  # type: ignore[no-untyped-call]
    scenario = get_scenario(SCENARIO)(duration_s=20.0)
    stream = load_stream(model)
    reached: dict[str, tuple[float, int]] = {}
    for frame in get_engine(engine)(scenario, sample_agents(scenario, 0), 0):
        posterior = stream.update(frame)
        predict(stream.history, posterior, scenario.road, predictor=predictor)
        now = time.process_time(), sum(map(len, spent.values()))
        reached.setdefault("use", now)
        if len(frame) > 1:
            reached["pair"] = now
            break
    print(json.dumps({**reached, "kernels": spent}))


BENCH: Final = Bench(
    name="loop",
    summary="Time classifying and predicting while a simulation runs, stage by stage.",
    keys=("engine", "stage", "agents", "lanes", "vehicles"),
    full=Settings(),
    quick=Settings(duration_s=20.0, repeats=1, blocks=(3,), vehicles=(30, 90)),
    measure=measure,
)
