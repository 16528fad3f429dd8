"""Classify recordings with a trained model: who drives how, at every frame."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from graphrqi.methods import Model, load_model
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks
from sim.store.atomic import whole_file
from sim.store.dataset import open_dataset

LABELS: Final = pa.schema(
    [
        pa.field("agent", pa.string()),
        pa.field("time_s", pa.float64()),
        pa.field("behavior", pa.string()),
        *(pa.field(f"p_{b.value}", pa.float32()) for b in BEHAVIORS),
        pa.field("episode", pa.string()),
    ]
)
"""Columns of a labels file: one row per driver and frame from one second of observation on. The
agent is the source's own id, the behaviour the most likely one."""


def label_tracks(tracks: Tracks, model: Model, episode: str) -> pa.Table:
    """Posteriors of every driver at every frame of a recording.

    Args:
        tracks: the recording; its labels, if any, are not looked at.
        model: a trained model.
        episode: name to put into the ``episode`` column.

    Returns:
        A table with the columns ``LABELS``.
    """
    stream = BehaviorStream(model)
    agents, times, probabilities = [], [], []
    for frame in tracks.frames():
        posterior = stream.update(frame)
        agents.append(np.searchsorted(tracks.ids, posterior.ids))
        times.append(np.full(posterior.ids.size, frame.time_s))
        probabilities.append(posterior.probability)
    if not agents:
        return LABELS.empty_table()
    probability = np.concatenate(probabilities)
    names = pa.array(tracks.names, pa.string()).take(pa.array(np.concatenate(agents)))
    words = pa.array([b.value for b in BEHAVIORS]).take(pa.array(probability.argmax(axis=1)))
    columns = [
        names,
        pa.array(np.concatenate(times)),
        words,
        *(pa.array(p, pa.float32()) for p in probability.T.astype(np.float32)),
        pa.array([episode] * len(names), pa.string()),
    ]
    return pa.Table.from_arrays(columns, schema=LABELS)


def classify_dataset(
    source: Path, model: str | Path, out: Path, quiet: bool = False
) -> list[dict[str, Any]]:
    """What ``graphrqi classify`` does: write a labels file.

    Args:
        source: folder of a dataset.
        model: a shipped model's name or a folder.
        out: the Parquet file to write; it appears whole or not at all.
        quiet: whether to show no progress.

    Returns:
        Rows for a table: per episode its split (a model knows the drivers that it was trained
        on), how many drivers were labelled, and, where the truth is known, how many of them
        rightly at the last look, and how many are of the most frequent behaviour.
    """
    trained = load_model(model)
    dataset = open_dataset(source)
    episodes = dataset.manifest.episodes
    rows: list[dict[str, Any]] = []
    with (
        Progress("classifying episodes", len(episodes), quiet) as progress,
        whole_file(out) as partial,
        pq.ParquetWriter(partial, LABELS, compression="zstd") as writer,
    ):
        for entry in episodes:
            tracks = dataset.read(entry).tracks
            table = label_tracks(tracks, trained, entry.id)
            writer.write_table(table)
            rows.append({"episode": entry.id, "split": entry.split, **_summary(table, tracks)})
            progress.advance()
    return rows


def _summary(table: pa.Table, tracks: Tracks) -> dict[str, Any]:
    last: dict[str, str] = dict(
        zip(table["agent"].to_pylist(), table["behavior"].to_pylist(), strict=True)
    )  # rows are in order of time, so the last one of each agent stays
    summary: dict[str, Any] = {"drivers": len(last), "rows": table.num_rows}
    if tracks.behavior is not None:
        truth = dict(zip(tracks.names, tracks.behavior, strict=True))
        known = [name for name in last if truth[name] >= 0]
        right = sum(BEHAVIORS[truth[name]].value == last[name] for name in known)
        count = Counter(int(truth[name]) for name in known)
        most = max(count.values(), default=0)
        summary |= {"true_known": len(known), "right_at_end": right, "most_frequent": most}
    return summary
