"""Predictions on disk: one tidy table, a row per future and place.

The futures of each predictor, agent and instant are distinguished by ``mode``; a future's
probability is repeated in each of its rows. Places are given every half second.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from experiments.score.tables import JOINED, joined_columns
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.predict.prediction import Prediction
from sim.frames import Tracks
from sim.store.schema import EpisodeEntry

PREDICTIONS: Final = pa.schema(
    [
        *JOINED,
        pa.field("predictor", pa.string()),
        pa.field("agent", pa.int64()),
        pa.field("name", pa.string()),
        pa.field("time_s", pa.float64()),
        pa.field("mode", pa.int8()),
        pa.field("probability", pa.float32()),
        pa.field("ahead_s", pa.float32()),
        pa.field("x_m", pa.float64()),
        pa.field("y_m", pa.float64()),
    ]
)
"""Columns of a predictions file: those of `JOINED`, ``name`` (the source's own id), ``time_s`` (of
the prediction) and ``ahead_s``."""


def predictions_table(
    prediction: Prediction, history: Tracks, predictor: str, entry: EpisodeEntry, horizon_s: float
) -> pa.Table:
    """One instant's futures as rows.

    Args:
        prediction: the futures of the agents of the history.
        history: what was predicted from; its last column is the present.
        predictor: whose futures they are.
        entry: the episode.
        horizon_s: no place farther ahead is kept, s.

    Returns:
        A table with the columns `PREDICTIONS`; agents, futures and times ascend.
    """
    ahead = np.arange(1, round(horizon_s / SAMPLE_S) + 1) * SAMPLE_S
    ahead = ahead[ahead <= prediction.time_s[-1] + 1e-6]
    xy = prediction.xy[:, :, np.searchsorted(prediction.time_s, ahead - 1e-6)]
    n, modes, times, _ = xy.shape
    rows = n * modes * times
    agent = np.repeat(np.searchsorted(history.ids, prediction.ids), modes * times)
    columns = [
        *joined_columns(entry, rows).values(),
        pa.array([predictor]).take(pa.array(np.zeros(rows, int))),
        pa.array(history.ids[agent]),
        pa.array(history.names, pa.string()).take(pa.array(agent)),
        pa.array(np.full(rows, history.time_s[-1])),
        pa.array(np.tile(np.repeat(np.arange(modes), times), n).astype(np.int8)),
        pa.array(np.repeat(prediction.probability.ravel(), times).astype(np.float32)),
        pa.array(np.tile(ahead, n * modes).astype(np.float32)),
        pa.array(xy[..., 0].ravel()),
        pa.array(xy[..., 1].ravel()),
    ]
    return pa.Table.from_arrays(columns, schema=PREDICTIONS)
