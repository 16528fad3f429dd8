"""Runs one scenario headless, classifying and predicting on the way if asked to."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from experiments.console.progress import Progress
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.generate.episode import Task
from experiments.score.answers import known_answers, score_answers
from experiments.score.labels import note_unknown
from experiments.score.predictions import EVERY_S, WARM_UP_S, score_episode, score_predictions
from experiments.score.rows import Cell, Row, tidy_row
from sim.engines import get_engine
from sim.episode.live import DEFAULT_RADIUS_M, Window
from sim.frames import EventKind, Frame, Tracks
from sim.scenario import sample_agents
from sim.store.dataset import open_dataset

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior

COMPARED: Final = ("constant-velocity", "graphrqi-predict")
"""The predictors that a run compares."""

SHOWN: Final = (
    "agents", "mean_speed_mps", "collisions", "drivers", "weighted_accuracy",
    "majority_weighted_accuracy", "balanced_accuracy", "style_balanced_accuracy", "answered_share",
    "domain", "recall", "ade_m", "fde_m", "simulated_s", "real_time_factor", "ms_per_frame",
)  # fmt: skip
"""Figures of the table for people."""


def run_scenario(
    config: GenerateConfig,
    model: str | None = None,
    predict: bool = False,
    quiet: bool = False,
    window: Window | None = None,
    out: Path | None = None,
) -> list[Row]:
    """Run the first episode that a configuration generates.

    Without a model, the name or folder of one, nothing is classified; ``predict`` scores
    predictions, too. Only agents in the window, if there is one, are classified and predicted. The
    episode is kept as a dataset in the folder ``out``, if it is given.

    Returns:
        Tidy rows of the traffic and of the time per frame, then the scores of the last answers and
        of the predictions.
    """
    task = Task(config, config.scenarios[0], 0)
    scenario = config.scenario(task.scenario)
    agents = sample_agents(scenario, task.seed)
    stream = None
    if model is not None:
        from graphrqi.stream import load_stream

        stream = load_stream(model, window)
    latest: dict[int, tuple[Posterior, int]] = {}
    beliefs: dict[int, Posterior] = {}
    entered, kept, driven = set[int](), list[Frame](), np.zeros(2)  # m and s, without the step
    frames = collisions = 0
    started, spent_s, due_s, time_s = time.monotonic(), 0.0, WARM_UP_S, 0.0
    steps = round(scenario.duration_s / scenario.step_s)
    if out is None:
        made = get_engine(config.engine)(scenario, agents, task.seed)
    else:
        generate(config, out, 1, True)
        dataset = open_dataset(out)
        made = dataset.read(dataset.episodes()[0]).tracks.frames()
    with Progress(f"{scenario.name}: frames", steps, quiet) as progress:
        for frame in made:
            frames, time_s = frames + 1, frame.time_s
            entered.update(frame.ids.tolist())
            collisions += sum(event.kind is EventKind.COLLISION for event in frame.events)
            driven += frame.speed[frame.driving].sum(), frame.driving.sum()
            begun = time.monotonic()
            if stream is not None:
                posterior = stream.update(frame)
                latest |= {agent: (posterior, i) for i, agent in enumerate(posterior.ids.tolist())}
                if predict:
                    kept.append(frame if window is None else window.of(frame))
                if predict and time_s >= due_s - 1e-6:
                    beliefs[len(kept)] = posterior
                    due_s += EVERY_S
            spent_s += time.monotonic() - begun
            progress.advance()
    keys: dict[str, Cell] = {"scenario": scenario.name, "engine": config.engine}
    figures = {
        "agents": len(entered),
        "mean_speed_mps": driven[0] / driven[1] if driven[1] else None,
        "collisions": collisions,
        "simulated_s": round(time_s, 3),
        "real_time_factor": round(time_s / max(time.monotonic() - started, 1e-9), 1),
        "ms_per_frame": round(1e3 * spent_s / max(frames, 1), 3),
    }
    rows = [tidy_row(keys, name, value) for name, value in figures.items()]
    truth = {agent.id: agent.behavior for agent in agents}
    if stream is not None:
        classes = next((p.classes for p, _ in latest.values()), BEHAVIORS)
        note_unknown(str(model), truth.values(), classes, "not scored")
        answers = _last_answers(latest, truth, classes)
        rows += score_answers(answers, {**keys, "model": model}, classes=classes)
    if predict and kept:
        errors = score_episode(Tracks.from_frames(kept, truth), beliefs, scenario.road, COMPARED)
        rows += score_predictions([errors], keys)
    return rows


def _last_answers(
    latest: Mapping[int, tuple[Posterior, int]], truth: Mapping[int, Behavior | None],
    classes: Sequence[Behavior],
) -> pd.DataFrame:  # fmt: skip
    """The last answer about every driver: its row of a posterior."""
    found = list(latest.values())
    code = [classes.index(b) if (b := truth[agent]) in classes else -1 for agent in latest]
    probability = np.array([p.probability[row] for p, row in found]).reshape(-1, len(classes))
    none = np.zeros(len(found), dtype=np.int64)
    answers = known_answers(probability, np.array(code, dtype=np.int64), none, classes)
    labelled = np.array([p.labelled[row] for p, row in found], dtype=bool)
    domain = np.array([p.domain for p, _ in found], dtype=np.float64)
    return answers.assign(behavior=answers["behavior"].where(labelled), domain=domain)


def shown(rows: Sequence[Row]) -> list[Row]:
    """The main figures from `run_scenario` for people: a line with what, and how much, for each."""
    lines: list[Row] = []
    for row in rows:
        predicted = "predictor" in row
        wanted = row["metric"] in SHOWN and predicted == (row["metric"] in ("ade_m", "fde_m"))
        if wanted and not (predicted and row["behavior"] != "all"):
            named = [row.get(key) for key in ("predictor", "behavior") if row.get(key) != "all"]
            ahead = f"{row['horizon_s']:g} s" if predicted else None
            words = [word for word in (*named, row["metric"], ahead) if word is not None]
            lines.append({"what": " ".join(map(str, words)), "value": row["value"]})
    return lines


def read_window(text: str | None) -> Window | None:
    """A window as an option says it; None where it says nothing.

    The text is an agent's id, with an optional distance, m, or an area's bounds, m.

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
