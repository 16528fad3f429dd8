"""Answers about every driver at every frame: as a table, as a file, and scored."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, get_args

import numpy as np
import pyarrow as pa

from behaviors.labels import BEHAVIORS, Behavior
from experiments.console.notices import LOGGER
from experiments.data.parallel import in_parallel
from experiments.data.scene_check import is_scene
from experiments.data.windows import measured, places_of, traffic_of
from experiments.guard import guarded_call
from experiments.score.answers import STYLES, joined_answers, score_answers
from experiments.score.rows import Cell, Row, pivoted
from experiments.score.tables import LABELS, joined_columns, table_file
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import aggressive_share
from graphrqi.stream import MIN_SECONDS, BehaviorStream
from sim.formats.common.label_file import DriverLabels, read_driver_labels
from sim.frames import BoolArray, IntArray
from sim.store.dataset import Dataset, Episode, open_dataset
from sim.store.schema import EpisodeEntry, Split

ALL: Final = "all"
"""The scenario or split of rows over several of them."""


def labels_schema(model: Model) -> pa.Schema:
    """Columns of a labels file of a model: ``LABELS``, then those of behaviours of one's own."""
    own = model.classes[len(BEHAVIORS) :]
    return pa.schema([*LABELS, *(pa.field(f"p_{b}", pa.float32()) for b in own)])


def label_episode(episode: Episode, model: Model, traffic: str | None = None) -> pa.Table:
    """Posteriors of every driver at every frame of an episode.

    Args:
        episode: as read from a dataset; what is known of its drivers only fills the columns
            ``truth`` and ``true_style``.
        model: a trained model.
        traffic: where the positions come from; None for what the episode's entry says.

    Returns:
        A table with the columns ``LABELS``. Every driver is unknown in a recording that is not a
        plausible scene.
    """
    stream = BehaviorStream(
        model, traffic=traffic_of(episode.entry, traffic), is_scene=is_scene(episode.entry)
    )
    tracks = measured(episode)
    answers = [(frame.time_s, stream.update(frame)) for frame in tracks.frames()]
    schema = labels_schema(model)
    if not answers:
        return schema.empty_table()
    row = np.concatenate([np.searchsorted(tracks.ids, a.ids) for _, a in answers])
    each = [a.ids.size for _, a in answers]
    probability = np.concatenate([a.probability for _, a in answers])
    labelled = np.concatenate([a.labelled for _, a in answers])
    aggressive = aggressive_share(probability, model.classes) >= 0.5
    known = {agent.id: agent for agent in episode.agents}
    drivers = [known[i] for i in tracks.ids.tolist()]

    def of_agents(words: Sequence[str | None]) -> pa.Array:
        return pa.array(words, pa.string()).take(pa.array(row))

    columns = {
        **joined_columns(episode.entry, row.size),
        "agent": pa.array(tracks.ids[row]),
        "name": of_agents(tracks.names),
        "time_s": pa.array(np.repeat([time_s for time_s, _ in answers], each)),
        "behavior": _words(model.classes, probability.argmax(axis=1), labelled),
        "style": _words(STYLES, np.where(aggressive, 0, 1), labelled),
        "domain": pa.array(np.repeat([a.domain for _, a in answers], each)),
        "unknown": pa.array(np.concatenate([a.unknown for _, a in answers])),
        "truth": of_agents([agent.behavior for agent in drivers]),
        "true_style": of_agents([agent.style for agent in drivers]),
    }
    for behavior, share in zip(model.classes, probability.T.astype(np.float32), strict=True):
        columns[f"p_{behavior}"] = pa.array(share)
    return pa.table(columns).select(schema.names).cast(schema)


def _words(names: Sequence[str], codes: IntArray, known: BoolArray) -> pa.Array:
    """The word of each code; null where it is not known."""
    return pa.array([*map(str, names)], pa.string()).take(pa.array(codes, pa.int64(), mask=~known))


def _with_truth(
    table: pa.Table, names: Sequence[str], entry: EpisodeEntry, labels: DriverLabels
) -> pa.Table:
    """Answers about one episode with labels that are given now instead of what was known."""
    found = zip(names, labels.of(names, entry.name, entry.file, entry.id), strict=True)
    given = {name: label for name, label in found if label is not None}
    for column, attribute in (("truth", "behavior"), ("true_style", "style")):
        rows = zip(table["name"].to_pylist(), table[column].to_pylist(), strict=True)
        words = [getattr(given[n], attribute) if n in given else word for n, word in rows]
        at = table.column_names.index(column)
        table = table.set_column(at, column, pa.array(words, pa.string()))
    return table


def _last_answers(table: pa.Table) -> pa.Table:
    """The last row of every driver of an episode, in order of agent."""
    agent = table["agent"].to_numpy()
    _, last = np.unique(agent[::-1], return_index=True)
    return table.take(pa.array(agent.size - 1 - last))


@dataclass(frozen=True, slots=True)
class Answered:
    """The last answers about the drivers of one episode.

    Attributes:
        place: scenario, where the data are of several engines with the engine.
        entry: the episode.
        table: one row per driver, with the columns ``LABELS``.
    """

    place: str
    entry: EpisodeEntry
    table: pa.Table


def answer_episodes(
    model: Model,
    datasets: Sequence[Dataset],
    *,
    split: Split | None = None,
    labels: Path | None = None,
    out: Path | None = None,
    traffic: str | None = None,
    jobs: int | None = None,
    quiet: bool = True,
) -> list[Answered]:
    """Answer for every driver of datasets.

    Args:
        model: a trained model.
        datasets: where from.
        split: only this part; None for all.
        labels: a CSV file with labels of some drivers (`sim.formats.common.label_file`); they
            replace what the datasets say.
        out: a file for the answers at every frame, .parquet or .csv; None for none.
        traffic: as `label_episode` takes it.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        The last answers of each episode, in the datasets' order.

    Raises:
        InputError: if a label belongs to no driver of the source.
    """
    given = None if labels is None else guarded_call(labels, read_driver_labels, labels)
    every = [(d.path, e) for d in datasets for e in d.episodes()]
    chosen = [
        (path, entry, place)
        for (path, entry), place in zip(every, places_of(datasets), strict=True)
        if split in (None, entry.split)
    ]
    arguments = [(model, path, entry, out is not None, traffic) for path, entry, _ in chosen]
    found: list[Answered] = []
    with nullcontext() if out is None else table_file(out, labels_schema(model)) as writer:
        answers = in_parallel(_answers, arguments, jobs, "answering episodes", quiet)
        for (_, entry, place), (names, table) in zip(chosen, answers, strict=True):
            labelled = table if given is None else _with_truth(table, names, entry, given)
            if writer is not None:
                writer.write_table(labelled)
            found.append(Answered(place, entry, _last_answers(labelled)))
        if given is not None:
            given.check()  # inside the block: nothing is written if a label belongs to no driver
    return found


def _answers(
    model: Model, folder: Path, entry: EpisodeEntry, every_frame: bool, traffic: str | None
) -> tuple[tuple[str, ...], pa.Table]:
    """Names of an episode's agents, and answers at every frame or the last ones."""
    episode = open_dataset(folder).read(entry)
    table = label_episode(episode, model, traffic)
    return episode.tracks.names, table if every_frame else _last_answers(table)


def note_unknown(
    model: str, truth: Iterable[str | None], classes: Iterable[Behavior], scored: str
) -> None:
    """Say in one line which drivers' behaviours a model does not know, and what to do."""
    if strange := {*truth} - {None, *classes}:
        LOGGER.warning(
            "model %s does not know %s: %s; graphrqi train on such data makes a model that does",
            model, ", ".join(sorted(map(str, strange))), scored,
        )  # fmt: skip


def scored_answers(
    answered: Sequence[Answered], model: str, classes: tuple[Behavior, ...] = BEHAVIORS
) -> list[Row]:
    """Rows of a model's last answers as from `score_answers`, with ``scenario`` and ``split``.

    Both are "all" over several of them.
    """
    truth = {word for one in answered for word in one.table["truth"].to_pylist()}
    note_unknown(model, truth, classes, "scored by their style alone")
    found = [one for one in answered if one.table.num_rows]
    scenarios = list(dict.fromkeys(one.place for one in found))
    splits = [split for split in get_args(Split) if any(one.entry.split == split for one in found)]
    rows: list[Row] = []
    for split in [*splits, *([ALL] if len(splits) > 1 else [])]:
        for scenario in [*scenarios, *([ALL] if len(scenarios) > 1 else [])]:
            tables = [
                one.table
                for one in found
                if scenario in (ALL, one.place) and split in (ALL, one.entry.split)
            ]
            if tables:
                keys = {"model": model, "scenario": scenario, "split": split}
                rows += score_answers(joined_answers(tables), keys, classes=classes)
    return rows


def classify_dataset(
    source: Path, model: str | Path, out: Path | None = None, labels: Path | None = None,
    *, traffic: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi classify``: answer for every driver of a dataset's folder.

    ``model`` is a shipped model's name or a folder; all other arguments are as `answer_episodes`
    takes them.

    Returns:
        Rows of each episode, by ``episode`` and ``name``, then rows by scenario and split.
    """
    known = load_model(model)
    answered = answer_episodes(
        known, [open_dataset(source)], labels=labels, out=out, traffic=traffic,
        jobs=jobs, quiet=quiet,
    )  # fmt: skip
    rows: list[Row] = []
    for one in answered:
        keys = {
            "model": str(model), "episode": one.entry.id, "name": one.entry.name,
            "scenario": one.place, "split": one.entry.split,
        }  # fmt: skip
        rows += score_answers(joined_answers([one.table]), keys, classes=known.classes)
    return [*rows, *scored_answers(answered, str(model), known.classes)]


def named_table(rows: Sequence[Row]) -> list[dict[str, Cell]]:
    """How the drivers of each episode were answered, a line each, from `classify_dataset`."""

    def column(row: Row) -> str | None:
        metric = str(row["metric"])
        if metric in ("named_share", "domain", "confidence"):
            return str(row.get("behavior", metric))
        return {"drivers": "drivers", "answered_share": "unknown"}.get(metric)

    def cell(row: Row) -> Cell:
        value = float(row["value"] or 0.0)
        if row["metric"] == "drivers":
            return int(value)
        share = 1.0 - value if row["metric"] == "answered_share" else value
        return f"{100 * share:.0f} %"

    named = [row for row in rows if row.get("name") is not None]
    lines = pivoted(named, ("episode", "name", "split"), column, cell)
    return [{**line, "episode": line.pop("name")} for line in lines]


def domain_notice(rows: Sequence[Row]) -> str | None:
    """One line if no driver was answered, or most of the traffic is unlike the training's.

    Takes the rows of `classify_dataset`; None where the traffic is like the model's training.
    """
    total = {row["metric"]: float(row["value"] or 0.0) for row in rows if row.get("name") is None}
    if not total.get("drivers"):
        return f"no driver is seen for {MIN_SECONDS:g} s or longer, so there is no answer"
    if total["domain"] < 0.5:
        return None
    return (
        "this traffic is not like the model's training traffic: "
        f"{100 * (1.0 - total['answered_share']):.0f} % of the drivers stay unknown; "
        "graphrqi train --from MODEL --labels FILE adapts the model"
    )
