"""Runs one scenario headless, classifying and predicting on the way if asked to."""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.data.configuration import GenerateConfig
from experiments.rows import Row
from sim.engines import get_engine
from sim.episode.window import DEFAULT_RADIUS_M, Window
from sim.frames import EventKind, Frame, Tracks
from sim.scenario import AgentSpec, sample_agents

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior
    from graphrqi.predict.prediction import Prediction
    from graphrqi.stream import BehaviorStream
    from sim.road import Road

HORIZON_S: Final = 5.0
"""How far ahead predictions are made and scored, s."""

PREDICT_EVERY_S: Final = 1.0
"""Time between predictions, s (each is scored, none is drawn)."""

COMPARED: Final = ("constant-velocity", "graphrqi-predict")
"""The predictors that a run compares."""

SHOWN_EVERY_S: Final = 0.2
"""Time between two updates of the live line, s of the clock on the wall."""


@dataclass
class RunSummary:
    """Counts and sums over the frames of a run.

    Attributes:
        frames: how many frames there were.
        entered: ids of the agents that are in a frame.
        events: how often each kind of event happened.
        distance_m: sum of speed times step over all that drive, m.
        driving_s: time driven by all that drive, s.
    """

    frames: int = 0
    entered: set[int] = field(default_factory=set)
    events: Counter[EventKind] = field(default_factory=Counter)
    distance_m: float = 0.0
    driving_s: float = 0.0

    def count(self, frames: Iterable[Frame], step_s: float) -> Iterator[Frame]:
        """Yield the frames and count what is in them."""
        for frame in frames:
            self.frames += 1
            self.entered.update(frame.ids.tolist())
            self.events.update(event.kind for event in frame.events)
            driving = frame.driving
            self.distance_m += float(frame.speed[driving].sum()) * step_s
            self.driving_s += float(driving.sum()) * step_s
            yield frame


@dataclass
class _Believed:
    """The latest belief about each driver, and how it fits the truth."""

    truth: dict[int, int]
    latest: dict[int, int] = field(default_factory=dict)
    unknown: set[int] = field(default_factory=set)
    foreign: float = 0.0

    def take(self, posterior: Posterior) -> None:
        """Keep what is believed now; drivers of whom no answer is earned are unknown."""
        answers = zip(posterior.ids, posterior.most_likely, posterior.told, strict=True)
        for agent, code, told in answers:
            self.latest[int(agent)] = int(code)
            (self.unknown.discard if told else self.unknown.add)(int(agent))
        self.foreign = posterior.domain

    @property
    def accuracy(self) -> float | None:
        """Share of the drivers classified so far whose latest belief is right."""
        if not self.latest:
            return None
        right = sum(self.truth[agent] == code for agent, code in self.latest.items())
        return right / len(self.latest)

    def rows(self) -> list[Row]:
        """How often the latest belief is right."""
        right = Counter[int]()
        total = Counter[int]()
        for agent, code in self.latest.items():
            total[self.truth[agent]] += 1
            right[self.truth[agent]] += code == self.truth[agent]
        if not total:
            return [{"what": "drivers classified", "value": 0}]
        recalls = [right[code] / total[code] for code in total]
        rows: list[Row] = [
            {"what": "drivers classified", "value": sum(total.values())},
            {"what": "accuracy", "value": sum(right.values()) / sum(total.values())},
            {
                "what": "accuracy of the most frequent behaviour",
                "value": max(total.values()) / sum(total.values()),
            },
            {"what": "balanced accuracy", "value": float(np.mean(recalls))},
            {"what": "drivers unknown to the classifier", "value": len(self.unknown)},
            {"what": "traffic foreign to the classifier", "value": self.foreign},
        ]
        for code in sorted(total):
            what = f"{BEHAVIORS[code]} recognised"
            rows.append({"what": what, "value": right[code] / total[code]})
        return rows


@dataclass
class _Predicted:
    """Predictions that wait for their time, and the errors of those whose time has come."""

    waiting: deque[tuple[float, str, Prediction]] = field(default_factory=deque)
    errors: dict[str, list[float]] = field(default_factory=lambda: {n: [] for n in COMPARED})

    @property
    def error_m(self) -> float | None:
        """Mean error so far of the last compared predictor, m."""
        errors = self.errors[COMPARED[-1]]
        return sum(errors) / len(errors) if errors else None

    def predict(self, history: Tracks, posterior: Posterior, road: Road) -> None:
        """Predict with every compared predictor; scored when the time has come."""
        from graphrqi.predict import predict

        due_s = float(history.time_s[-1]) + HORIZON_S
        for name in COMPARED:
            prediction = predict(history, posterior, road, HORIZON_S, name)
            self.waiting.append((due_s, name, prediction))

    def score(self, frame: Frame) -> None:
        """Compare what was predicted for now with what is."""
        while self.waiting and self.waiting[0][0] <= frame.time_s + 1e-6:
            _, name, prediction = self.waiting.popleft()
            common, row, now = np.intersect1d(
                prediction.ids, frame.ids, assume_unique=True, return_indices=True
            )
            if common.size:
                away = prediction.best[row, -1] - frame.xy[now]
                self.errors[name].extend(np.hypot(away[:, 0], away[:, 1]).tolist())

    def rows(self) -> list[Row]:
        """The mean error of each predictor."""
        return [
            {
                "what": f"{name}: mean error at {HORIZON_S:g} s, m",
                "value": float(np.mean(errors)) if errors else None,
            }
            for name, errors in self.errors.items()
        ]


def live_line(
    name: str, time_s: float, duration_s: float, agents: int, factor: float,
    accuracy: float | None, error_m: float | None, ms_per_frame: float,
) -> str:  # fmt: skip
    """What is shown while a scenario runs.

    Examples:
        >>> live_line("straight_road", 12.0, 300.0, 41, 9.0, 0.8125, 2.5, 6.25)
        'straight_road: 12.0 of 300 s, 41 agents, 9x real time, 81 % right, 2.50 m off at 5 s, 6.2 ms a frame'
    """  # noqa: E501  the line is as long as it is
    said = [f"{name}: {time_s:.1f} of {duration_s:g} s", f"{agents} agents"]
    said.append(f"{factor:.0f}x real time")
    if accuracy is not None:
        said.append(f"{accuracy:.0%}".replace("%", " %") + " right")
    if error_m is not None:
        said.append(f"{error_m:.2f} m off at {HORIZON_S:g} s")
    return ", ".join([*said, f"{ms_per_frame:.1f} ms a frame"])


@contextmanager
def _live(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line on the terminal that can be replaced; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    last = 0.0
    with Console(stderr=True).status("starting") as status:

        def show(text: str) -> None:
            nonlocal last
            if time.monotonic() - last >= SHOWN_EVERY_S:
                last = time.monotonic()
                status.update(text)

        yield show


def run_scenario(
    config: GenerateConfig,
    model: str | None = None,
    predict: bool = False,
    quiet: bool = False,
    window: Window | None = None,
) -> list[Row]:
    """Run the first scenario of a configuration once.

    Args:
        config: scenario, engine, options and seed; its ``episodes`` does not matter.
        model: name or folder of the model that classifies; None not to classify.
        predict: whether to predict too, and score it.
        quiet: whether to show no live line.
        window: which agents are classified and predicted; None for everybody.

    Returns:
        Rows of ``what`` and ``value`` that sum the run up.

    Raises:
        InputError: if an option is wrong or the engine cannot run.
    """
    scenario = config.scenario(config.scenarios[0])
    agents = sample_agents(scenario, config.seed)
    summary = RunSummary()
    believed, predicted = _Believed(_truth(agents)), _Predicted()
    stream = _stream(model, window)
    started = time.monotonic()
    next_prediction_s = PREDICT_EVERY_S
    simulated_s, spent_s, count = 0.0, 0.0, 0
    frames = get_engine(config.engine)(scenario, agents, config.seed)
    with _live(quiet) as show:
        for frame in summary.count(frames, scenario.step_s):
            simulated_s, begun = frame.time_s, time.monotonic()
            if stream is not None:
                posterior = stream.update(frame)
                believed.take(posterior)
                if predict:
                    predicted.score(frame)
                if predict and frame.time_s >= next_prediction_s and len(frame):
                    next_prediction_s += PREDICT_EVERY_S
                    predicted.predict(stream.history, posterior, scenario.road)
            factor = simulated_s / max(time.monotonic() - started, 1e-9)
            spent_s, count = spent_s + time.monotonic() - begun, count + 1
            show(
                live_line(
                    scenario.name, frame.time_s, scenario.duration_s, len(frame), factor,
                    believed.accuracy, predicted.error_m, 1e3 * spent_s / count,
                )
            )  # fmt: skip
    factor = simulated_s / max(time.monotonic() - started, 1e-9)
    cost: list[Row] = [{"what": "ms a frame", "value": 1e3 * spent_s / max(count, 1)}]
    mean_speed = summary.distance_m / summary.driving_s if summary.driving_s else None
    return [
        {"what": "scenario", "value": scenario.name},
        {"what": "simulated, s", "value": round(simulated_s, 3)},
        {"what": "times real time", "value": round(factor, 1)},
        {"what": "agents that entered", "value": len(summary.entered)},
        {"what": "mean speed, m/s", "value": mean_speed},
        {"what": "collisions", "value": summary.events[EventKind.COLLISION]},
        *(believed.rows() if stream is not None else []),
        *(predicted.rows() if predict else []),
        *cost,
    ]


def read_window(text: str | None) -> Window | None:
    """A window as an option says it; None where it says nothing.

    Args:
        text: an agent's id, with a distance, m, if wanted (``17:80``), or an area's smallest x and
            y and largest x and y, m (``0,0,100,50``).

    Raises:
        InputError: if it is neither, or nothing can be in the window.

    Examples:
        >>> read_window("17:80").around, read_window("0,0,100,50").region
        (17, (0.0, 0.0, 100.0, 50.0))
    """
    if text is None:
        return None
    try:
        if "," in text:
            x0, y0, x1, y1 = (float(word) for word in text.split(","))
            return Window(region=(x0, y0, x1, y1))
        agent, _, far = text.partition(":")
        return Window(around=int(agent), radius_m=float(far or DEFAULT_RADIUS_M))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        expected = "expected AGENT, AGENT:METRES or X0,Y0,X1,Y1"
        raise InputError(f"--window: found {text!r}, {expected}") from None


def _truth(agents: tuple[AgentSpec, ...]) -> dict[int, int]:
    return {a.id: a.behavior.code for a in agents if a.behavior is not None}


def _stream(model: str | None, window: Window | None) -> BehaviorStream | None:
    if model is None:
        return None
    from graphrqi.stream import load_stream

    return load_stream(model, window)
