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
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
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
        pa.field("domain", pa.float32()),
        pa.field("unknown", pa.float32()),
        pa.field("truth", pa.string()),
    ]
)
"""Columns of a labels file: one row per driver and frame from one second of observation on.

``recording`` is the name of the file that an episode was read from (null for simulated ones),
``agent`` the id in the dataset's tables, ``name`` the source's own id. ``behavior`` is the most
likely one, ``style`` the style with the larger sum of probabilities; each is null where it is not
likely enough to be told (`graphrqi.posterior`). ``domain`` is how foreign the traffic is to the
model, ``unknown`` the probability that no answer is earned, ``truth`` the behaviour that the driver
was drawn or labelled with (null where nobody knows)."""


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
    agents, times, answers = [], [], list[Posterior]()
    for frame in tracks.frames():
        posterior = stream.update(frame)
        agents.append(np.searchsorted(tracks.ids, posterior.ids))
        times.append(np.full(posterior.ids.size, frame.time_s))
        answers.append(posterior)
    if not agents:
        return LABELS.empty_table()
    row, probability = np.concatenate(agents), np.concatenate([a.probability for a in answers])
    style_told = np.concatenate([a.style_told for a in answers])
    told = np.concatenate([a.told for a in answers])
    truth = np.full(len(tracks.ids), -1) if tracks.behavior is None else tracks.behavior
    columns = {
        "episode": _repeated(episode, row.size),
        "recording": _repeated(recording, row.size),
        "agent": pa.array(tracks.ids[row]),
        "name": pa.array(tracks.names, pa.string()).take(pa.array(row)),
        "time_s": pa.array(np.concatenate(times)),
        "behavior": _words(BEHAVIORS, np.where(told, probability.argmax(axis=1), -1)),
        "style": _words(
            [b.style for b in BEHAVIORS], np.where(style_told, of_likelier_style(probability), -1)
        ),
        "domain": pa.array(np.repeat([a.domain for a in answers], [a.ids.size for a in answers])),
        "unknown": pa.array(np.concatenate([a.unknown for a in answers])),
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

    behavior: str | None
    style: str | None
    confidence: float
    domain: float
    truth: str | None


def _last_answers(table: pa.Table) -> list[_Driver]:
    agent = table["agent"].to_numpy()
    # Rows are in order of time, so an agent's first row from the end is its last.
    _, last = np.unique(agent[::-1], return_index=True)
    rows = table.take(pa.array(agent.size - 1 - last))
    confidence = np.stack([rows[f"p_{b.value}"].to_numpy() for b in BEHAVIORS]).max(axis=0)
    told = (rows[name].to_pylist() for name in ("behavior", "style"))
    domain, truth = (rows[name].to_pylist() for name in ("domain", "truth"))
    return list(map(_Driver, *told, confidence.tolist(), domain, truth))


def summary_of(drivers: Sequence[_Driver]) -> dict[str, Cell]:
    """What was answered about some drivers, each counted once with its last answer.

    Args:
        drivers: the last answers.

    Returns:
        ``drivers``: how many; a count for each behaviour; ``unknown``: how many have no answer;
        ``style_told``: of how many the style is told; ``foreign``: the mean of how foreign the
        traffic is; ``confidence``: the mean probability of the most likely behaviour;
        ``true_known``: of how many the truth is known, ``right_at_end`` of how many
        of those the answer is right, and ``most_frequent`` how many would be right if everybody
        were of the most frequent behaviour among them.
    """
    answered = Counter(driver.behavior for driver in drivers)
    foreign = [driver.domain for driver in drivers]
    known = Counter(driver.truth for driver in drivers if driver.truth is not None)
    sure = [driver.confidence for driver in drivers]
    summary: dict[str, Cell] = {"drivers": len(drivers)}
    summary |= {b.value: answered[b.value] for b in BEHAVIORS}
    summary["unknown"] = answered[None]
    summary["style_told"] = sum(driver.style is not None for driver in drivers)
    summary["foreign"] = sum(foreign) / len(foreign) if foreign else None
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
    shown = (
        "name", "split", "drivers", *BEHAVIORS, "unknown", "foreign", "confidence", "true_known",
        "right_at_end",
    )  # fmt: skip
    return [
        {
            str(key): per_cent(float(row[key] or 0.0))
            if key in ("foreign", "confidence")
            else row[key]
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
        line["unknown"] = per_cent(int(row["unknown"] or 0) / drivers)
        line["foreign"] = per_cent(float(row["foreign"] or 0.0))
        line["confidence"] = per_cent(float(row["confidence"] or 0.0))
        known = int(row.get("true_known") or 0)
        if known:
            line["right"] = per_cent(int(row["right_at_end"] or 0) / known)
            line["if all were the most frequent"] = per_cent(int(row["most_frequent"] or 0) / known)
        lines.append(line)
    return lines


def foreign_notice(rows: Sequence[Row]) -> str | None:
    """One line on what was found, if most of the traffic is foreign to the model.

    Args:
        rows: as from `classify_dataset`.

    Returns:
        The line; None where the traffic is like that of the model's training.
    """
    totals = [row for row in rows if row["episode"] == "all" and row["drivers"]]
    drivers = sum(int(row["drivers"] or 0) for row in totals)
    if not drivers:
        return None
    foreign = sum(float(row["foreign"] or 0.0) * int(row["drivers"] or 0) for row in totals)
    if foreign / drivers < 0.5:
        return None
    styles = sum(int(row["style_told"] or 0) for row in totals) / drivers
    unknown = sum(int(row["unknown"] or 0) for row in totals) / drivers
    return (
        f"{per_cent(1.0 - foreign / drivers)} at home: this traffic is not of the kind that the "
        f"model was trained on; the style of {per_cent(styles)} of the drivers is told, "
        f"{per_cent(unknown)} are unknown, and behaviours within a style are hardly told apart"
    )


def per_cent(share: float) -> str:
    """A share as text.

    Examples:
        >>> per_cent(0.347)
        '35 %'
    """
    return f"{100 * share:.0f} %"
