"""Classify recordings with a trained model: who drives how, at every frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.rows import Cell, Row
from experiments.scoring.metrics import of_likelier_style
from graphrqi.methods import Model, load_model
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks
from sim.store.atomic import whole_file
from sim.store.dataset import open_dataset

LABELS: Final = pa.schema(
    [
        pa.field("episode", pa.string()),
        pa.field("recording", pa.string()),
        pa.field("agent", pa.int64()),
        pa.field("name", pa.string()),
        pa.field("time_s", pa.float64()),
        pa.field("behavior", pa.string()),
        pa.field("style", pa.string()),
        *(pa.field(f"p_{b.value}", pa.float32()) for b in BEHAVIORS),
        pa.field("truth", pa.string()),
    ]
)
"""Columns of a labels file: one row per driver and frame from one second of observation on.

``recording`` is the name of the file that an episode was read from (null for simulated ones),
``agent`` the id in the dataset's tables, ``name`` the source's own id. ``behavior`` is the most
likely one, ``style`` the style with the larger sum of probabilities, ``truth`` the behaviour that
the driver was drawn or labelled with (null where nobody knows)."""


def label_tracks(
    tracks: Tracks, model: Model, episode: str, recording: str | None = None
) -> pa.Table:
    """Posteriors of every driver at every frame of a recording.

    Args:
        tracks: the recording; its labels, if any, only fill the column ``truth``.
        model: a trained model.
        episode: the episode's id.
        recording: name of the recording; None for a simulated episode.

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
    row, probability = np.concatenate(agents), np.concatenate(probabilities)
    truth = np.full(len(tracks.ids), -1) if tracks.behavior is None else tracks.behavior
    columns = {
        "episode": _repeated(episode, row.size),
        "recording": _repeated(recording, row.size),
        "agent": pa.array(tracks.ids[row]),
        "name": pa.array(tracks.names, pa.string()).take(pa.array(row)),
        "time_s": pa.array(np.concatenate(times)),
        "behavior": _words(BEHAVIORS, probability.argmax(axis=1)),
        "style": _words([b.style for b in BEHAVIORS], of_likelier_style(probability)),
        "truth": _words(BEHAVIORS, truth[row]),
    }
    for behavior, share in zip(BEHAVIORS, probability.T.astype(np.float32), strict=True):
        columns[f"p_{behavior.value}"] = pa.array(share)
    return pa.table(columns).select(LABELS.names).cast(LABELS)


def _repeated(text: str | None, count: int) -> pa.Array:
    return pa.array([text], pa.string()).take(pa.array(np.zeros(count, dtype=np.int64)))


def _words(names: Sequence[StrEnum], codes: NDArray[np.integer[Any]]) -> pa.Array:
    """The word of each code; null for -1."""
    return pa.array([name.value for name in names], pa.string()).take(
        pa.array(codes, pa.int64(), mask=codes < 0)
    )


def classify_dataset(source: Path, model: str | Path, out: Path, quiet: bool = False) -> list[Row]:
    """What ``graphrqi classify`` does: write a labels file.

    Args:
        source: folder of a dataset.
        model: a shipped model's name or a folder.
        out: the Parquet file to write; it appears whole or not at all.
        quiet: whether to show no progress.

    Returns:
        A row per episode, then one per split whose ``episode`` is "all"; see `summary_of`. The
        split matters, since a model knows the drivers that it was trained on.
    """
    trained = load_model(model)
    dataset = open_dataset(source)
    episodes = dataset.manifest.episodes
    rows: list[Row] = []
    drivers: dict[str, list[_Driver]] = {}
    with (
        Progress("classifying episodes", len(episodes), quiet) as progress,
        whole_file(out) as partial,
        pq.ParquetWriter(partial, LABELS, compression="zstd") as writer,
    ):
        for entry in episodes:
            tracks = dataset.read(entry).tracks
            table = label_tracks(tracks, trained, entry.id, entry.recording)
            writer.write_table(table)
            found = _last_answers(table)
            head = {"episode": entry.id, "name": entry.name, "split": entry.split}
            rows.append({**head, **summary_of(found), "rows": table.num_rows})
            drivers.setdefault(entry.split, []).extend(found)
            progress.advance()
    for split, found in drivers.items():
        rows.append({"episode": "all", "name": None, "split": split, **summary_of(found)})
    return rows


@dataclass(frozen=True, slots=True)
class _Driver:
    """The last answer about one driver."""

    behavior: str
    confidence: float
    truth: str | None


def _last_answers(table: pa.Table) -> list[_Driver]:
    agent = table["agent"].to_numpy()
    # Rows are in order of time, so an agent's first row from the end is its last.
    _, last = np.unique(agent[::-1], return_index=True)
    rows = table.take(pa.array(agent.size - 1 - last))
    confidence = np.stack([rows[f"p_{b.value}"].to_numpy() for b in BEHAVIORS]).max(axis=0)
    return [
        _Driver(behavior, float(sure), truth)
        for behavior, sure, truth in zip(
            rows["behavior"].to_pylist(), confidence, rows["truth"].to_pylist(), strict=True
        )
    ]


def summary_of(drivers: Sequence[_Driver]) -> dict[str, Cell]:
    """What was answered about some drivers, each counted once with its last answer.

    Args:
        drivers: the last answers.

    Returns:
        ``drivers``: how many; a count for each behaviour; ``confidence``: the mean probability of
        the answers; ``true_known``: of how many the truth is known, ``right_at_end`` of how many
        of those the answer is right, and ``most_frequent`` how many would be right if everybody
        were of the most frequent behaviour among them.
    """
    answered = Counter(driver.behavior for driver in drivers)
    known = Counter(driver.truth for driver in drivers if driver.truth is not None)
    sure = [driver.confidence for driver in drivers]
    summary: dict[str, Cell] = {"drivers": len(drivers)}
    summary |= {b.value: answered[b.value] for b in BEHAVIORS}
    summary["confidence"] = sum(sure) / len(sure) if sure else None
    if known:
        summary |= {
            "true_known": known.total(),
            "right_at_end": sum(driver.behavior == driver.truth for driver in drivers),
            "most_frequent": max(known.values()),
        }
    return summary


def episodes_table(rows: Sequence[Row]) -> list[Row]:
    """The episodes among the rows of `classify_dataset`, as a table for people."""
    shown = ("name", "split", "drivers", *BEHAVIORS, "confidence", "true_known", "right_at_end")
    return [
        {
            str(key): per_cent(float(row[key] or 0.0)) if key == "confidence" else row[key]
            for key in shown
            if key in row
        }
        for row in rows
        if row["episode"] != "all"
    ]


def totals_table(rows: Sequence[Row]) -> list[Row]:
    """The totals among the rows of `classify_dataset`, as a table for people."""
    lines: list[Row] = []
    for row in rows:
        drivers = int(row["drivers"] or 0)
        if row["episode"] != "all" or not drivers:
            continue
        episodes = sum(r["split"] == row["split"] for r in rows) - 1
        line: dict[str, Cell] = {"split": row["split"], "episodes": episodes, "drivers": drivers}
        line |= {b.value: per_cent(int(row[b.value] or 0) / drivers) for b in BEHAVIORS}
        line["confidence"] = per_cent(float(row["confidence"] or 0.0))
        known = int(row.get("true_known") or 0)
        if known:
            line["right"] = per_cent(int(row["right_at_end"] or 0) / known)
            line["if all were the most frequent"] = per_cent(int(row["most_frequent"] or 0) / known)
        lines.append(line)
    return lines


def per_cent(share: float) -> str:
    """A share as text.

    Examples:
        >>> per_cent(0.347)
        '35 %'
    """
    return f"{100 * share:.0f} %"
