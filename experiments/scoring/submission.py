"""Predictions in the form in which Argoverse 2's forecasting challenge takes them.

One Parquet file: a row per scenario, track and future, with the future's probability and its 60
places, 0.1 s apart, as two lists. Futures of a track come in order of falling probability.

References:
    Wilson et al. (2021), Argoverse 2; ``av2.datasets.motion_forecasting.eval.submission``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from experiments.scoring.prediction_errors import beliefs
from graphrqi.model_files import load_model
from graphrqi.predict import predict
from graphrqi.predict.prediction import Prediction
from sim.files import whole_file
from sim.formats.argoverse.forecasting2 import OBSERVED_STEPS
from sim.store.dataset import open_dataset

RATE_HZ: Final = 10

STEPS: Final = 60
"""Places per future that the challenge wants: 6 s at 10 Hz."""

MOST_MODES: Final = 6
"""Futures per track that the challenge scores."""

SUBMISSION: Final = pa.schema(
    [
        ("scenario_id", pa.string()),
        ("track_id", pa.string()),
        ("probability", pa.float64()),
        ("predicted_trajectory_x", pa.list_(pa.float64())),
        ("predicted_trajectory_y", pa.list_(pa.float64())),
    ]
)
"""The columns of a submission."""


def write_submission(
    predictions: Mapping[str, tuple[Sequence[str], Prediction]], path: Path
) -> int:
    """Write a challenge submission.

    Args:
        predictions: by scenario: the source's own id of each agent, and its futures 6 s ahead.
        path: the Parquet file; it appears whole or not at all.

    Returns:
        How many rows were written.

    Raises:
        InputError: if names and agents do not match, the horizon is not 6 s at 10 Hz, or an agent
            has more than six futures.
    """
    rows: dict[str, list[object]] = {name: [] for name in SUBMISSION.names}
    for scenario, (names, prediction) in predictions.items():
        _check(scenario, names, prediction)
        for i, name in enumerate(names):
            for k in np.argsort(-prediction.probability[i], kind="stable"):
                rows["scenario_id"].append(scenario)
                rows["track_id"].append(name)
                rows["probability"].append(float(prediction.probability[i, k]))
                rows["predicted_trajectory_x"].append(prediction.xy[i, k, :, 0].tolist())
                rows["predicted_trajectory_y"].append(prediction.xy[i, k, :, 1].tolist())
    with whole_file(path) as partial:
        pq.write_table(pa.Table.from_pydict(rows, schema=SUBMISSION), partial)
    return len(rows["track_id"])


def submit_dataset(source: Path, predictor: str, model: str, path: Path) -> int:
    """Predict every recording of a dataset 5 s after its beginning and write a submission.

    Everybody present then is predicted; the challenge picks those that it scores.

    Args:
        source: folder of a dataset; its episodes are 10 Hz.
        predictor: a key of ``PREDICTORS``.
        model: the classifier whose beliefs are used: a shipped one's name or a folder.
        path: the Parquet file; it appears whole or not at all.

    Returns:
        How many rows were written.

    Raises:
        InputError: if an episode is not 10 Hz, or the dataset or the model cannot be read.
    """
    dataset, trained = open_dataset(source), load_model(model)
    told: dict[str, tuple[Sequence[str], Prediction]] = {}
    for entry in dataset.manifest.episodes:
        tracks = dataset.read(entry).tracks
        if tracks.time_s.size < 2:
            raise InputError(
                f"{source}: episode {entry.id}: found one frame, expected some at 10 Hz"
            )
        if abs(tracks.step_s - 1.0 / RATE_HZ) > 1e-3:
            raise InputError(
                f"{source}: episode {entry.id}: found a step of {tracks.step_s:g} s, expected "
                f"{1.0 / RATE_HZ:g} s"
            )
        stop = min(OBSERVED_STEPS, tracks.time_s.size)
        posterior = beliefs(tracks, trained, [stop])[stop]
        history = tracks.window(stop, OBSERVED_STEPS)
        prediction = predict(history, posterior, dataset.road(entry), STEPS / RATE_HZ, predictor)
        name = str(entry.options.get("recording", entry.id))
        told[name] = (history.names, prediction)
    return write_submission(told, path)


def _check(scenario: str, names: Sequence[str], prediction: Prediction) -> None:
    if len(names) != prediction.ids.size:
        raise InputError(
            f"scenario {scenario}: found {len(names)} names, expected {prediction.ids.size}"
        )
    expected = np.arange(1, STEPS + 1) * 0.1
    if prediction.time_s.size != STEPS or not np.allclose(prediction.time_s, expected):
        raise InputError(
            f"scenario {scenario}: found {prediction.time_s.size} places per future, expected "
            f"{STEPS}, 0.1 s apart"
        )
    if prediction.modes > MOST_MODES:
        raise InputError(
            f"scenario {scenario}: found {prediction.modes} futures, expected at most {MOST_MODES}"
        )
