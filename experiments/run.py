"""Runs one scenario headless, classifying and predicting on the way if asked to."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.generate.configuration import GenerateConfig
from experiments.generate.episode import Task
from experiments.score.answers import known_answers, score_answers
from experiments.score.labels import note_unknown
from experiments.score.predictions import EVERY_S, WARM_UP_S, score_episode, score_predictions
from experiments.score.rows import Cell, Row, tidy_row
from sim.engines import get_engine
from sim.frames import EventKind, Frame, Tracks
from sim.scenario import sample_agents

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior

COMPARED: Final = ("constant-velocity", "graphrqi-predict")
"""The predictors that a run compares."""

SHOWN: Final = (
    "agents", "mean_speed_mps", "collisions", "drivers", "weighted_accuracy",
    "majority_weighted_accuracy", "balanced_accuracy", "style_balanced_accuracy", "answered_share",
    "domain", "recall", "simulated_s", "real_time_factor", "ms_per_frame",
)  # fmt: skip
ERRORS: Final = ("ade_m", "fde_m")
"""Figures of the table for people: of traffic and drivers, and of predictions."""


def run_scenario(
    config: GenerateConfig,
    model: str | None = None,
    predict: bool = False,
    quiet: bool = False,
) -> list[Row]:
    """Run the first episode that a configuration generates.

    Without a model, the name or folder of one, nothing is classified; ``predict`` scores
    predictions, too.

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

        stream = load_stream(model)
    latest: dict[int, tuple[Posterior, int]] = {}
    beliefs: dict[int, Posterior] = {}
    entered, kept, driven = set[int](), list[Frame](), np.zeros(2)  # m and s, without the step
    frames = collisions = 0
    started, spent_s, due_s, time_s = time.monotonic(), 0.0, WARM_UP_S, 0.0
    steps = round(scenario.duration_s / scenario.step_s)
    with Progress(f"{scenario.name}: frames", steps, quiet) as progress:
        for frame in get_engine(config.engine)(scenario, agents, task.seed):
            frames, time_s = frames + 1, frame.time_s
            entered.update(frame.ids.tolist())
            collisions += sum(event.kind is EventKind.COLLISION for event in frame.events)
            driven += frame.speed[frame.driving].sum(), frame.driving.sum()
            begun = time.monotonic()
            if stream is not None:
                posterior = stream.update(frame)
                latest |= {agent: (posterior, i) for i, agent in enumerate(posterior.ids.tolist())}
                if predict:
                    kept.append(frame)
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
    }
    rows = [tidy_row(keys, name, value) for name, value in figures.items()]
    truth = {agent.id: agent.behavior for agent in agents}
    if stream is not None:
        rows.append(tidy_row(keys, "ms_per_frame", round(1e3 * spent_s / max(frames, 1), 3)))
        last = list(latest.values())
        classes = last[0][0].classes if last else BEHAVIORS
        note_unknown(str(model), truth.values(), classes, "not scored")
        code = [classes.index(b) if (b := truth[agent]) in classes else -1 for agent in latest]
        probability = np.array([p.probability[row] for p, row in last]).reshape(-1, len(classes))
        nothing = np.zeros(len(last), dtype=np.int64)
        answers = known_answers(probability, np.array(code, dtype=np.int64), nothing, classes)
        labelled = np.array([p.labelled[row] for p, row in last], dtype=bool)
        answers["behavior"] = answers["behavior"].where(labelled)
        answers["domain"] = np.array([p.domain for p, _ in last], dtype=np.float64)
        rows += score_answers(answers, {**keys, "model": model}, classes=classes)
    if predict and kept:
        errors = score_episode(Tracks.from_frames(kept, truth), beliefs, scenario.road, COMPARED)
        rows += score_predictions([errors], keys)
    return rows


def shown(rows: Sequence[Row]) -> list[Row]:
    """The main figures from `run_scenario` for people: a line with what, and how much, for each."""
    lines: list[Row] = []
    for row in rows:
        what = [row.get("behavior"), row["metric"]]
        if "predictor" in row:
            what = [row["predictor"], row["metric"], f"{row['horizon_s']:g} s"]
        wanted = SHOWN if "predictor" not in row else ERRORS if row["behavior"] == "all" else ()
        if row["metric"] in wanted:
            words = " ".join(str(word) for word in what if word not in (None, "all"))
            lines.append({"what": words, "value": row["value"]})
    return lines
