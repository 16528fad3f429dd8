"""Classify recordings with a trained model: who drives how, at every frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.data.admission import is_scene
from experiments.data.windows import measured, places_of
from experiments.rows import Cell, Row
from experiments.scoring.metrics import of_likelier_style
from experiments.scoring.table_file import JOINED, joined_columns, table_file
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.stream import MIN_SECONDS, BehaviorStream
from sim.formats.common.label_file import DriverLabels, read_driver_labels
from sim.store.dataset import Episode, open_dataset
from sim.store.schema import EpisodeEntry

LABELS: Final = pa.schema(
    [
        *JOINED,
        pa.field("agent", pa.int64()),
        pa.field("name", pa.string()),
        pa.field("time_s", pa.float64()),
        pa.field("behavior", pa.string()),
        pa.field("style", pa.string()),
        *(pa.field(f"p_{b.value}", pa.float32()) for b in BEHAVIORS),
        pa.field("domain", pa.float32()),
        pa.field("unknown", pa.float32()),
        pa.field("truth", pa.string()),
        pa.field("true_style", pa.string()),
    ]
)
"""Columns of a labels file: one row per driver and frame from one second of observation on.

The first are those of `JOINED`; ``agent`` is the id in the dataset's tables, ``name`` the source's
own id. ``behavior`` is the most likely one, ``style`` the style with the larger sum of
probabilities; each is null where it is not likely enough to be told (`graphrqi.posterior`).
``domain`` is how foreign the traffic is to the model, ``unknown`` the probability that no answer is
earned, ``truth`` the behaviour that the driver was drawn or labelled with and ``true_style`` its
style (null where nobody knows; of some drivers only the style is known)."""


def label_episode(episode: Episode, model: Model) -> pa.Table:
    """Posteriors of every driver at every frame of an episode.

    Args:
        episode: as read from a dataset; what is known of its drivers only fills the columns
            ``truth`` and ``true_style``.
        model: a trained model.

    Returns:
        A table with the columns ``LABELS``. Everybody is unknown in a recording that is no scene
        that can be believed.
    """
    stream = BehaviorStream(model, is_scene=is_scene(episode.entry))
    tracks = measured(episode)
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
    known = {agent.id: agent for agent in episode.agents}
    truth = pa.array([known[i].behavior for i in tracks.ids.tolist()], pa.string())
    true_style = pa.array([known[i].style for i in tracks.ids.tolist()], pa.string())
    joined = joined_columns(episode.entry, row.size)
    columns = {
        **dict(zip((field.name for field in JOINED), joined, strict=True)),
        "agent": pa.array(tracks.ids[row]),
        "name": pa.array(tracks.names, pa.string()).take(pa.array(row)),
        "time_s": pa.array(np.concatenate(times)),
        "behavior": _words(BEHAVIORS, np.where(told, probability.argmax(axis=1), -1)),
        "style": _words(
            [b.style for b in BEHAVIORS], np.where(style_told, of_likelier_style(probability), -1)
        ),
        "domain": pa.array(np.repeat([a.domain for a in answers], [a.ids.size for a in answers])),
        "unknown": pa.array(np.concatenate([a.unknown for a in answers])),
        "truth": truth.take(pa.array(row)),
        "true_style": true_style.take(pa.array(row)),
    }
    for behavior, share in zip(BEHAVIORS, probability.T.astype(np.float32), strict=True):
        columns[f"p_{behavior.value}"] = pa.array(share)
    return pa.table(columns).select(LABELS.names).cast(LABELS)


def with_truth(
    table: pa.Table, names: Sequence[str], entry: EpisodeEntry, labels: DriverLabels | None
) -> pa.Table:
    """Answers with labels that are given now instead of what was known.

    Args:
        table: with the columns ``LABELS``, of one episode.
        names: of the episode's agents.
        entry: the episode.
        labels: of drivers; what was known is left of others. None if no labels are given.

    Returns:
        The table.
    """
    if labels is None:
        return table
    found = labels.of(names, entry.name, entry.file, entry.id)
    given = {name: one for name, one in zip(names, found, strict=True) if one is not None}
    if not given:
        return table
    new: dict[str, list[str | None]] = {"truth": [], "true_style": []}
    before = (table[column].to_pylist() for column in ("name", *new))
    for name, truth, style in zip(*before, strict=True):
        label = given.get(name)
        new["truth"].append(truth if label is None else label.behavior)
        new["true_style"].append(style if label is None else label.style)
    for column, words in new.items():
        at = table.column_names.index(column)
        table = table.set_column(at, column, pa.array(words, pa.string()))
    return table


def last_answers(table: pa.Table) -> pa.Table:
    """The last row of every driver of an episode.

    Args:
        table: with the columns ``LABELS``, of one episode, in order of time.

    Returns:
        Its rows in order of agent.
    """
    agent = table["agent"].to_numpy()
    _, last = np.unique(agent[::-1], return_index=True)
    return table.take(pa.array(agent.size - 1 - last))


def _words(names: Sequence[StrEnum], codes: NDArray[np.integer[Any]]) -> pa.Array:
    """The word of each code; null for -1."""
    return pa.array([name.value for name in names], pa.string()).take(
        pa.array(codes, pa.int64(), mask=codes < 0)
    )


@dataclass(frozen=True, slots=True)
class Answered:
    """The last answers about the drivers of one episode.

    Attributes:
        place: scenario, where the data are of several engines with the engine.
        names: of all agents, those about whom there is no answer too.
        table: one row per driver, with the columns ``LABELS``.
    """

    place: str
    names: tuple[str, ...]
    table: pa.Table


def classify_dataset(
    source: Path,
    model: str | Path,
    out: Path | None,
    quiet: bool = False,
    labels: Path | None = None,
) -> tuple[list[Row], list[Answered]]:
    """What ``graphrqi classify`` does: answer for every driver, and write a labels file.

    Args:
        source: folder of a dataset.
        model: a shipped model's name or a folder.
        out: the file to write, .parquet or .csv; it appears whole or not at all. None for none.
        quiet: whether to show no progress.
        labels: a CSV file with labels of some drivers (`sim.formats.common.label_file`), which
            fill the columns ``truth`` and ``true_style``.

    Returns:
        A row per episode, then one per split whose ``episode`` is "all", see `summary_of`; the
        split matters, since a model knows the drivers that it was trained on. And the last
        answers, which `experiments.scoring.evaluation` scores.
    """
    trained = load_model(model)
    given = None if labels is None else read_driver_labels(labels)
    dataset = open_dataset(source)
    episodes = dataset.manifest.episodes
    rows: list[Row] = []
    found: list[Answered] = []
    with (
        Progress("classifying episodes", len(episodes), quiet) as progress,
        nullcontext() if out is None else table_file(out, LABELS) as writer,
    ):
        for entry, place in zip(episodes, places_of([dataset]), strict=True):
            episode = dataset.read(entry)
            names = episode.tracks.names
            table = with_truth(label_episode(episode, trained), names, entry, given)
            if writer is not None:
                writer.write_table(table)
            last = last_answers(table)
            found.append(Answered(place, names, last))
            head = {"episode": entry.id, "name": entry.name, "split": entry.split}
            rows.append({**head, **summary_of(last), "rows": table.num_rows})
            progress.advance()
        if given is not None:
            given.check()
    for split in dict.fromkeys(entry.split for entry in episodes):
        own = [a.table for a, e in zip(found, episodes, strict=True) if e.split == split]
        rows.append(
            {"episode": "all", "name": None, "split": split, **summary_of(pa.concat_tables(own))}
        )
    return rows, found


def summary_of(last: pa.Table) -> dict[str, Cell]:
    """What was answered about some drivers, each counted once with its last answer.

    Args:
        last: the last answers, with the columns ``LABELS``.

    Returns:
        ``drivers``: how many; a count for each behaviour; ``unknown``: how many have no answer;
        ``style_told``: of how many the style is told; ``foreign``: the mean of how foreign the
        traffic is; ``confidence``: the mean probability of the most likely behaviour;
        ``true_known``: of how many the truth is known, ``right_at_end`` of how many
        of those the answer is right, and ``most_frequent`` how many would be right if everybody
        were of the most frequent behaviour among them.
    """
    behavior, truth = last["behavior"].to_pylist(), last["truth"].to_pylist()
    answered = Counter(behavior)
    known = Counter(word for word in truth if word is not None)
    summary: dict[str, Cell] = {"drivers": last.num_rows}
    summary |= {b.value: answered[b.value] for b in BEHAVIORS}
    summary["unknown"] = answered[None]
    summary["style_told"] = last.num_rows - last["style"].null_count
    summary["foreign"] = float(last["domain"].to_numpy().mean()) if last.num_rows else None
    summary["confidence"] = float(probabilities(last).max(axis=1).mean()) if last.num_rows else None
    if known:
        summary |= {
            "true_known": known.total(),
            "right_at_end": sum(
                word is not None and word == true
                for word, true in zip(behavior, truth, strict=True)
            ),
            "most_frequent": max(known.values()),
        }
    return summary


def probabilities(table: pa.Table) -> NDArray[np.float64]:
    """(n, 6) the probabilities in a table with the columns ``LABELS``."""
    columns = [table[f"p_{b.value}"].to_numpy() for b in BEHAVIORS]
    return np.stack(columns, axis=1).astype(np.float64)


_HEADINGS: Final = {"true_known": "truth known", "right_at_end": "told and right"}
"""What columns are called for people, where it differs from the key."""


def episodes_table(rows: Sequence[Row]) -> list[Row]:
    """The episodes among the rows of `classify_dataset`, as a table for people."""
    shown = (
        "name", "split", "drivers", *BEHAVIORS, "unknown", "foreign", "confidence", "true_known",
        "right_at_end",
    )  # fmt: skip
    return [
        {
            _HEADINGS.get(key, str(key)): per_cent(float(row[key] or 0.0))
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
            line["told and right"] = per_cent(int(row["right_at_end"] or 0) / known)
            line["if all were the most frequent"] = per_cent(int(row["most_frequent"] or 0) / known)
        lines.append(line)
    return lines


def foreign_notice(rows: Sequence[Row]) -> str | None:
    """One line on what was found, if nobody was, or most of the traffic is foreign to the model.

    Args:
        rows: as from `classify_dataset`.

    Returns:
        The line; None where the traffic is like that of the model's training.
    """
    totals = [row for row in rows if row["episode"] == "all" and row["drivers"]]
    drivers = sum(int(row["drivers"] or 0) for row in totals)
    if not drivers:
        return f"nobody is seen for {MIN_SECONDS:g} s or more, so that there is no answer"
    foreign = sum(float(row["foreign"] or 0.0) * int(row["drivers"] or 0) for row in totals)
    if foreign / drivers < 0.5:
        return None
    styles = sum(int(row["style_told"] or 0) for row in totals) / drivers
    unknown = sum(int(row["unknown"] or 0) for row in totals) / drivers
    return (
        f"this traffic is {per_cent(foreign / drivers)} foreign to what the model was trained on: "
        f"it tells the style of {per_cent(styles)} of the drivers, {per_cent(unknown)} are unknown "
        "and behaviours of one style can hardly be told apart; graphrqi adapt helps"
    )


def per_cent(share: float) -> str:
    """A share as text.

    Examples:
        >>> per_cent(0.347)
        '35 %'
    """
    return f"{100 * share:.0f} %"
