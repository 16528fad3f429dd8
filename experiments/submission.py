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
from graphrqi.predict.prediction import Prediction
from sim.atomic import whole_file

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
