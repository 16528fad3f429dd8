"""Predicts every episode of a dataset and scores the predictors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from behaviors.errors import InputError, lookup
from experiments.console.notices import LOGGER
from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.data.scene_check import is_scene
from experiments.data.windows import measured, traffic_of
from experiments.score.predictions import (
    HORIZONS_S,
    LEAST_SEEN_S,
    Errors,
    beliefs,
    instants,
    score_episode,
    score_predictions,
    shortest_s,
)
from experiments.score.rows import Row
from experiments.score.tables import PREDICTIONS, predictions_table, table_file
from graphrqi.model_files import load_model
from graphrqi.predict import chosen_predictor
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.recorded.network import trained_network
from graphrqi.predict.scene.scene import LONGEST_S
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry, Split

SPLITS: Final[dict[str, Split | None]] = {
    "test": "test", "validation": "validation", "train": "train", "all": None
}  # fmt: skip
"""Episodes that may be scored, by name."""


def _evaluate_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], horizons_s: Sequence[float],
    model: str, keep: bool, weights: Path | None, traffic: str | None,
) -> tuple[dict[str, Errors], pa.Table, float]:  # fmt: skip
    """Errors by predictor, futures as rows if they are kept, and the length of one episode, s.

    There are no errors where the episode is too short to predict anything.
    """
    dataset = open_dataset(folder)
    tracks, road = measured(dataset.read(entry)), dataset.road(entry)
    stops = list(instants(tracks, max(horizons_s)))
    tables = [PREDICTIONS.empty_table()]
    length_s = float(tracks.time_s[-1] - tracks.time_s[0]) if tracks.time_s.size else 0.0
    if not stops:
        return {}, tables[0], length_s

    def keep_futures(name: str, history: Tracks, prediction: Prediction) -> None:
        tables.append(predictions_table(prediction, history, name, entry, max(horizons_s)))

    posteriors = beliefs(
        tracks, load_model(model), stops, is_scene(entry), traffic_of(entry, traffic)
    )
    errors = score_episode(
        tracks, posteriors, road, predictors, horizons_s, keep_futures if keep else None, weights
    )
    return errors, pa.concat_tables(tables), length_s


def _check_request(predictors: Sequence[str], horizon_s: float) -> None:
    samples = horizon_s / SAMPLE_S
    if not SAMPLE_S <= horizon_s <= LONGEST_S or abs(samples - round(samples)) > 1e-6:
        raise InputError(
            f"horizon_s: found {horizon_s}, expected {SAMPLE_S} s or a multiple of it up to "
            f"{LONGEST_S:g} s"
        )
    if not predictors:
        raise InputError("predictors: found none, expected at least one name")
    for name in predictors:
        chosen_predictor(name)


def predict_dataset(
    source: Path,
    predictors: Sequence[str],
    horizon_s: float = 5.0,
    model: str = DEFAULT_MODEL,
    *,
    out: Path | None = None,
    weights: Path | None = None,
    traffic: str | None = None,
    split: str = "test",
    jobs: int | None = None,
    quiet: bool = False,
) -> list[Row]:
    """Predict every episode of one of a dataset's splits and return the errors.

    Episodes that are too short are left out, each in a line on stderr.

    Args:
        source: a dataset.
        predictors: keys of ``PREDICTORS``, or "module:function".
        horizon_s: how far ahead, s.
        model: the classifier whose beliefs are used: a shipped one's name or a folder.
        out: where to write the futures (`experiments.score.tables`); None: nowhere.
        weights: as `experiments.score.predictions.score_episode` takes them.
        traffic: as `experiments.score.labels.label_episode` takes it.
        split: a key of `SPLITS`; of ``test``, all of a scenario is predicted that has none.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        Rows as `score_predictions` gives them, over all scenarios.

    Raises:
        InputError: if the dataset, the model or a predictor's name is wrong, or no agent is seen
            for long enough.
    """
    _check_request(predictors, horizon_s)
    wanted = lookup(SPLITS, split, "split")
    if weights is not None:
        trained_network(weights)
    load_model(model)
    horizons_s = sorted({h for h in HORIZONS_S if h < horizon_s} | {horizon_s})
    dataset = open_dataset(source)
    entries, told = [], {}
    for scenario in dataset.scenarios:
        some = dataset.episodes(wanted, scenario)
        told[scenario] = split if some else "all"
        if not some and split == "test":
            some = dataset.episodes(None, scenario)
        entries += [(scenario, entry) for entry in some]
    if not entries:
        raise InputError(f"{source}: found no {split} episode, expected at least 1")
    found: dict[str, list[Mapping[str, Errors]]] = {}
    short: list[tuple[EpisodeEntry, float]] = []
    least_s = shortest_s(horizon_s)
    same = (predictors, horizons_s, model, out is not None, weights, traffic)
    arguments = [(source, entry, *same) for _, entry in entries]
    with (
        Progress("predicting episodes", len(entries), quiet) as progress,
        nullcontext() if out is None else table_file(out, PREDICTIONS) as file,
    ):
        answers = in_parallel(_evaluate_episode, arguments, jobs)
        for (scenario, entry), (errors, futures, length_s) in zip(entries, answers, strict=True):
            if errors:
                found.setdefault(scenario, []).append(errors)
            else:
                short.append((entry, length_s))
            if file is not None:
                file.write_table(futures)
            progress.advance(entry.agents, entry.agent_steps)
        if not found:
            raise InputError(
                f"{source}: found {len(short)} episodes of at most "
                f"{max(length_s for _, length_s in short):g} s, expected one of {least_s:g} s or "
                f"longer to predict {horizon_s:g} s ahead: ask for a shorter horizon"
            )
        if not any(errors[predictors[0]].count.any() for one in found.values() for errors in one):
            raise InputError(
                f"{source}: found no agent seen for {LEAST_SEEN_S:g} s and then for another "
                f"{horizon_s:g} s, expected at least one agent"
            )
    for entry, length_s in short:
        LOGGER.warning(
            "skipped episode %s (%s): found %g s, expected at least %g s to predict %g s ahead",
            entry.id, entry.name, length_s, least_s, horizon_s,
        )  # fmt: skip
    return [
        row
        for scenario, episodes in found.items()
        for row in score_predictions(
            episodes, {"scenario": scenario, "split": told[scenario]}, horizons_s
        )
    ]


def default_split(source: Path) -> str:
    """The split that is scored unless another is asked for: of recordings, all."""
    entries = open_dataset(source).episodes()
    return "all" if all(entry.recording is not None for entry in entries) else "test"


def errors_table(rows: Sequence[Row]) -> list[Row]:
    """One line per scenario and predictor: ADE and FDE of all drivers at each horizon."""
    lines: dict[tuple[Any, Any], dict[str, Any]] = {}
    for row in rows:
        if row["behavior"] == "all" and row["metric"] in ("ade_m", "fde_m"):
            place = {"scenario": row["scenario"], "episodes": row["split"]}
            line = lines.setdefault(
                (row["scenario"], row["predictor"]), {**place, "predictor": row["predictor"]}
            )
            line[f"{row['metric']} {row['horizon_s']:g}s"] = round(float(row["value"] or 0.0), 3)
    return list(lines.values())
