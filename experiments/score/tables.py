"""Tables of answers and predictions on disk: Parquet or CSV, as the file's ending says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.predict.prediction import Prediction
from sim.files import whole_file
from sim.frames import Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import CONFLICTS, EpisodeEntry

ENDINGS: Final = (".parquet", ".csv")
"""Endings of the files that are written; a path without an ending is Parquet."""

JOINED: Final = tuple(
    pa.field(name, pa.string()) for name in ("episode", "recording", "file", "scenario", "split")
)
"""First columns of every table; the recording and file are null for simulated episodes."""

_AGENT: Final = [("agent", pa.int64()), ("name", pa.string()), ("time_s", pa.float64())]

CHANCES: Final = [f"p_{b.value}" for b in BEHAVIORS]
"""Columns of a labels file with the probability of each behaviour."""

LABELS: Final = pa.schema(
    [
        *JOINED,
        *_AGENT,
        *((name, pa.string()) for name in ("behavior", "style")),
        *((name, pa.float32()) for name in (*CHANCES, "domain", "unknown")),
        *((name, pa.string()) for name in ("truth", "true_style")),
    ]
)
"""Columns of a labels file: one row per driver and frame from one second of observation on.

``agent`` is the id in the dataset's tables, ``name`` the source's own id. ``behavior`` is the most
likely one, ``style`` the style with the larger sum; each is null below the label threshold
(`graphrqi.posterior`). ``domain`` is 0 in simulated traffic and 1 in other traffic; ``unknown`` is
the probability that the style is only guessed. ``truth`` and ``true_style`` are the true labels,
null where unknown."""

PREDICTIONS: Final = pa.schema(
    [
        *JOINED,
        ("predictor", pa.string()),
        *_AGENT,
        ("mode", pa.int8()),
        *((name, pa.float32()) for name in ("probability", "ahead_s")),
        *((name, pa.float64()) for name in ("x_m", "y_m")),
    ]
)
"""Columns of a predictions file: one row per future and place, every half second.

``mode`` distinguishes the futures of one predictor, agent and instant ``time_s``; a future's
probability is repeated in each of its rows."""


def read_labels(path: Path, episode: str) -> pd.DataFrame:
    """The columns ``agent``, ``time_s`` and `CHANCES` of an episode's rows in a labels file."""
    columns, own = ["agent", "time_s", *CHANCES], [("episode", "==", episode)]
    try:
        table = pd.read_parquet(path, columns=columns, filters=own)
    except (ValueError, OSError, KeyError) as error:
        said = " ".join(str(error).split())
        raise InputError(f"{path}: {said:.120}, expected a file of labels") from None
    if table.empty:
        raise InputError(f"{path}: found no row of episode {episode}, expected its labels")
    empty = [name for name in table if table[name].isna().any()]
    if empty:
        raise InputError(f"{path}: found an empty {empty[0]}, expected one in every row")
    if not (np.abs(table[CHANCES].sum(axis=1) - 1.0) < 1e-3).all():
        raise InputError(f"{path}: found p_ columns that do not add to 1, expected probabilities")
    return table


def joined_columns(entry: EpisodeEntry) -> dict[str, str | None]:
    """The columns `JOINED`, by name, of rows that are all of one episode."""
    words = (entry.id, entry.recording, entry.file, entry.scenario, entry.split)
    return {field.name: word for field, word in zip(JOINED, words, strict=True)}


def as_table(frame: pd.DataFrame, schema: pa.Schema) -> pa.Table:
    """The columns of a schema."""
    return pa.Table.from_pandas(frame[schema.names], schema, preserve_index=False)


def predictions_table(
    prediction: Prediction, history: Tracks, predictor: str, entry: EpisodeEntry, horizon_s: float
) -> pd.DataFrame:
    """One instant's futures of a history's last frame up to a horizon, s: rows `PREDICTIONS`."""
    ahead = np.arange(1, round(horizon_s / SAMPLE_S) + 1) * SAMPLE_S
    ahead = ahead[ahead <= prediction.time_s[-1] + 1e-6]
    xy = prediction.xy[:, :, np.searchsorted(prediction.time_s, ahead - 1e-6)]
    n, modes, times, _ = xy.shape
    agent = np.repeat(np.searchsorted(history.ids, prediction.ids), modes * times)
    columns = {
        **joined_columns(entry),
        "predictor": predictor,
        "agent": history.ids[agent],
        "name": np.array(history.names, object)[agent],
        "time_s": history.time_s[-1],
        "mode": np.tile(np.repeat(np.arange(modes), times), n),
        "probability": np.repeat(prediction.probability.ravel(), times),
        "ahead_s": np.tile(ahead, n * modes),
        "x_m": xy[..., 0].ravel(),
        "y_m": xy[..., 1].ravel(),
    }
    return pd.DataFrame(columns)


def check_ending(path: Path) -> Path:
    """The path of a file to write, refused if nothing is written with such an ending."""
    if path.suffix.lower() not in ("", *ENDINGS):
        raise InputError(f"{path}: found the ending {path.suffix}, expected {' or '.join(ENDINGS)}")
    return path


@contextmanager
def table_file(path: Path, schema: pa.Schema) -> Iterator[Callable[[pd.DataFrame], None]]:
    """What adds rows to a new file, Parquet or CSV, which appears complete when the block ends."""
    with whole_file(check_ending(path)) as partial:
        writer: Any
        if path.suffix.lower() == ".csv":
            writer = pyarrow.csv.CSVWriter(partial, schema)
        else:
            writer = pq.ParquetWriter(partial, schema, compression="zstd")
        with writer:
            yield lambda frame: writer.write_table(as_table(frame, schema))


def write_conflicts(source: Path, out: Path) -> None:
    """Write the conflicts of all episodes of a dataset's folder into one file, with `JOINED`."""
    dataset = open_dataset(source)
    names = [(name, pa.string()) for name in ("first_name", "second_name")]
    own = [
        pa.field(f.name, pa.string() if pa.types.is_dictionary(f.type) else f.type)
        for f in CONFLICTS
        if f.name != "episode"
    ]
    with table_file(out, pa.schema([*JOINED, *names, *own])) as write:
        for entry in dataset.episodes():
            rows, tracks = dataset.rows(entry, "conflicts").to_pandas(), dataset.read(entry).tracks
            called = np.array(tracks.names, object)
            found = {
                f"{side}_name": called[np.searchsorted(tracks.ids, rows[side])]
                for side in ("first", "second")
            }
            write(rows.assign(**joined_columns(entry), **found))
