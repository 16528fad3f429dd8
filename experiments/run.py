"""Runs one scenario headless, classifying and predicting on the way if asked to."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.generate.configuration import GenerateConfig
from experiments.generate.episode import Task
from experiments.score.answers import Answers, score_answers
from experiments.score.predictions import EVERY_S, WARM_UP_S, score_episode, score_predictions
from experiments.score.rows import Cell, Row, tidy_row
from sim.engines import get_engine
from sim.episode.window import DEFAULT_RADIUS_M, Window
from sim.frames import EventKind, Frame, Tracks
from sim.scenario import AgentSpec, Scenario, sample_agents

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior

COMPARED: Final = ("constant-velocity", "graphrqi-predict")
"""The predictors that a run compares."""


@dataclass
class RunSummary:
    """Counts and sums over the frames of a run.

    Attributes:
        frames: how many frames there were.
        entered: ids of the agents that are in a frame.
        events: how often each kind of event happened.
        distance_m: sum of speed times step over all that drive, m.
        driving_s: time driven by all that drive, s.
        time_s: time of the last frame, s.
    """

    frames: int = 0
    entered: set[int] = field(default_factory=set)
    events: Counter[EventKind] = field(default_factory=Counter)
    distance_m: float = 0.0
    driving_s: float = 0.0
    time_s: float = 0.0

    def count(self, frames: Iterable[Frame], step_s: float) -> Iterator[Frame]:
        """Yield the frames and count what is in them."""
        for frame in frames:
            self.frames += 1
            self.entered.update(frame.ids.tolist())
            self.events.update(event.kind for event in frame.events)
            driving = frame.driving
            self.distance_m += float(frame.speed[driving].sum()) * step_s
            self.driving_s += float(driving.sum()) * step_s
            self.time_s = frame.time_s
            yield frame


@dataclass
class _Beliefs:
    """The latest posterior about each driver, and those at the instants of prediction."""

    latest: dict[int, tuple[Posterior, int]] = field(default_factory=dict)
    instants: dict[int, Posterior] = field(default_factory=dict)

    def take(self, posterior: Posterior) -> None:
        """Keep the present posteriors."""
        for row, agent in enumerate(posterior.ids.tolist()):
            self.latest[agent] = posterior, row

    def answers(self, agents: tuple[AgentSpec, ...]) -> Answers:
        """The last answer about every driver that got one."""
        classes = next((p.classes for p, _ in self.latest.values()), BEHAVIORS)
        code = {a.id: classes.index(a.behavior) if a.behavior in classes else -1 for a in agents}
        found = [(code[agent], *one) for agent, one in self.latest.items()]
        known = Answers.known(
            np.array([p.probability[row] for _, p, row in found]).reshape(-1, len(classes)),
            np.array([code for code, _, _ in found], dtype=np.int64),
            np.zeros(len(found), dtype=np.int64),
            classes,
        )
        return dataclasses.replace(
            known,
            answered=np.array([p.labelled[row] for _, p, row in found], dtype=bool),
            domain=np.array([p.domain for _, p, _ in found], dtype=np.float64),
        )


def run_scenario(
    config: GenerateConfig,
    model: str | None = None,
    predict: bool = False,
    quiet: bool = False,
    window: Window | None = None,
    out: Path | None = None,
) -> list[Row]:
    """Run the first episode that a configuration generates.

    Args:
        config: scenario, engine, options and seed.
        model: name or folder of the model that classifies; None not to classify.
        predict: whether to predict too, and score it.
        quiet: whether to show no progress.
        window: which agents are classified and predicted; None for everybody.
        out: folder for the episode as a dataset; None not to keep it.

    Returns:
        Tidy rows of the traffic and of the time per frame, then the scores of the last answers and
        of the predictions.

    Raises:
        InputError: if an option is wrong or the engine cannot run.
    """
    task = Task(config, config.scenarios[0], 0)
    scenario = config.scenario(task.scenario)
    agents = sample_agents(scenario, task.seed)
    summary, beliefs, kept = RunSummary(), _Beliefs(), list[Frame]()
    stream = None
    if model is not None:
        from graphrqi.stream import load_stream

        stream = load_stream(model, window)
    started, spent_s, due_s = time.monotonic(), 0.0, WARM_UP_S
    steps = round(scenario.duration_s / scenario.step_s)
    with Progress(f"{scenario.name}: frames", steps, quiet) as progress:
        for frame in summary.count(_frames(config, task, scenario, agents, out), scenario.step_s):
            begun = time.monotonic()
            if stream is not None:
                posterior = stream.update(frame)
                beliefs.take(posterior)
                if predict:
                    kept.append(frame if window is None else window.of(frame))
                if predict and frame.time_s >= due_s - 1e-6:
                    beliefs.instants[len(kept)] = posterior
                    due_s += EVERY_S
            spent_s += time.monotonic() - begun
            progress.advance()
    factor = summary.time_s / max(time.monotonic() - started, 1e-9)
    keys: dict[str, Cell] = {"scenario": scenario.name, "engine": config.engine}
    mean_speed = summary.distance_m / summary.driving_s if summary.driving_s else None
    figures = {
        "agents": len(summary.entered),
        "mean_speed_mps": mean_speed,
        "collisions": summary.events[EventKind.COLLISION],
        "simulated_s": round(summary.time_s, 3),
        "real_time_factor": round(factor, 1),
        "ms_per_frame": round(1e3 * spent_s / max(summary.frames, 1), 3),
    }
    rows = [tidy_row(keys, name, value) for name, value in figures.items()]
    if stream is not None:
        rows += score_answers(beliefs.answers(agents), {**keys, "model": model})
    if predict and kept:
        truth = {a.id: a.behavior for a in agents}
        tracks = Tracks.from_frames(kept, truth)
        errors = score_episode(tracks, beliefs.instants, scenario.road, COMPARED)
        rows += score_predictions([errors], keys)
    return rows


def _frames(
    config: GenerateConfig, task: Task, scenario: Scenario, agents: tuple[AgentSpec, ...],
    out: Path | None,
) -> Iterator[Frame]:  # fmt: skip
    """The frames of the episode, from the engine or from the dataset that is made of it."""
    if out is None:
        yield from get_engine(config.engine)(scenario, agents, task.seed)
        return
    from experiments.generate.dataset import generate
    from sim.store.dataset import open_dataset

    generate(config, out, 1, True)
    dataset = open_dataset(out)
    yield from dataset.read(dataset.episodes()[0]).tracks.frames()


SHOWN: Final = (
    "agents", "mean_speed_mps", "collisions", "drivers", "weighted_accuracy",
    "majority_weighted_accuracy", "balanced_accuracy", "style_balanced_accuracy", "answered_share",
    "domain", "recall", "ade_m", "fde_m", "simulated_s", "real_time_factor", "ms_per_frame",
)  # fmt: skip
"""Figures of the table for people."""


def shown(rows: Sequence[Row]) -> list[Row]:
    """The main figures of a run for people: what, and how much.

    Args:
        rows: from `run_scenario`.

    Returns:
        A line for each figure.
    """
    lines: list[Row] = []
    for row in rows:
        words = [row.get(key) for key in ("predictor", "behavior") if row.get(key) != "all"]
        ahead = f"{row['horizon_s']:g} s" if "horizon_s" in row else None
        predicted = "predictor" in row
        if row["metric"] not in SHOWN or (predicted and row["behavior"] != "all"):
            continue
        if predicted != (row["metric"] in ("ade_m", "fde_m")):
            continue
        name = " ".join(str(word) for word in (*words, row["metric"], ahead) if word is not None)
        lines.append({"what": name, "value": row["value"]})
    return lines


def read_window(text: str | None) -> Window | None:
    """A window as an option says it; None where it says nothing.

    Args:
        text: an agent's id, with an optional distance, m (``17:80``), or an area's bounds, m
            (``0,0,100,50``).

    Returns:
        The window.

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
