"""Answers about every driver at every frame: as a table, as a file, and scored beside others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from experiments.console.notices import LOGGER
from experiments.data.parallel import in_parallel
from experiments.data.scene_check import is_scene
from experiments.data.windows import measured, places_of, traffic_of
from experiments.guard import guarded_call
from experiments.rival import PlainRival, whole_tracks
from experiments.score.answers import STYLES, is_scored, score_answers, score_difference
from experiments.score.rows import Cell, Row, pivoted
from experiments.score.tables import CHANCES, LABELS, as_table, joined_columns, table_file
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.places.other_traffic import Traffic
from graphrqi.posterior import Posterior, aggressive_share
from graphrqi.stream import MIN_SECONDS, BehaviorStream
from sim.formats.common.label_file import DriverLabels, read_driver_labels
from sim.formats.common.tables import read_table
from sim.frames import Tracks
from sim.store.dataset import Dataset, Episode, open_dataset
from sim.store.schema import EpisodeEntry, Split

RIVAL: Final = "plain rival"
"""Name of the random forest on nine numbers of a driver's whole track, `experiments.rival`."""

ROUNDED: Final = 0.05
"""How far sums of probabilities with two decimals may lie from 1."""

ALL: Final = "all"
"""The scenario or split of rows over several of them."""


def beliefs(
    tracks: Tracks, model: Model, stops: Iterable[int], is_scene: bool = True,
    traffic: Traffic = "simulated",
) -> dict[int, Posterior]:  # fmt: skip
    """Posteriors of a stream of the model at some instants, which are indices one past each."""
    stream, wanted = BehaviorStream(model, traffic=traffic, is_scene=is_scene), {*stops}
    found: dict[int, Posterior] = {}
    for stop, frame in enumerate(tracks.frames(), start=1):
        stream.push(frame)
        if stop in wanted:
            found[stop] = stream.posterior()
    return found


def _schema(model: Model) -> pa.Schema:
    """Columns of a labels file of a model: ``LABELS``, then those of behaviours of one's own."""
    own = model.classes[len(BEHAVIORS) :]
    return pa.schema([*LABELS, *(pa.field(f"p_{b}", pa.float32()) for b in own)])


def label_episode(episode: Episode, model: Model, traffic: str | None = None) -> pd.DataFrame:
    """Posteriors of every driver at every frame of an episode, with the columns ``LABELS``.

    The traffic's kind is what the episode's entry says unless it is named. Every driver is unknown
    in a recording that is not a plausible scene.
    """
    tracks, entry = measured(episode), episode.entry
    stops = range(1, tracks.time_s.size + 1)
    found = beliefs(tracks, model, stops, is_scene(entry), traffic_of(entry, traffic))
    answers, schema = list(found.values()), _schema(model)
    if not answers:
        return schema.empty_table().to_pandas()
    row = np.concatenate([np.searchsorted(tracks.ids, a.ids) for a in answers])
    each = [a.ids.size for a in answers]
    probability = np.concatenate([a.probability for a in answers])
    labelled = np.concatenate([a.labelled for a in answers])
    conservative = aggressive_share(probability, model.classes) < 0.5
    known = {agent.id: agent for agent in episode.agents}
    drivers = [known[i] for i in tracks.ids.tolist()]
    behavior, style = (np.array([*map(str, names)], object) for names in (model.classes, STYLES))
    columns = {
        **joined_columns(entry),
        "agent": tracks.ids[row],
        "name": np.array(tracks.names, object)[row],
        "time_s": np.repeat(tracks.time_s, each),
        "behavior": np.where(labelled, behavior[probability.argmax(axis=1)], None),
        "style": np.where(labelled, style[conservative.astype(int)], None),
        "domain": np.repeat([a.domain for a in answers], each),
        "unknown": np.concatenate([a.unknown for a in answers]),
        "truth": np.array([agent.behavior for agent in drivers], object)[row],
        "true_style": np.array([agent.style for agent in drivers], object)[row],
    }
    columns |= {f"p_{b}": p for b, p in zip(model.classes, probability.T, strict=True)}
    return as_table(pd.DataFrame(columns), schema).to_pandas()


def _with_truth(
    table: pd.DataFrame, names: Sequence[str], entry: EpisodeEntry, labels: DriverLabels
) -> pd.DataFrame:
    """Answers about one episode with labels that are given now instead of what was known."""
    found = dict(zip(names, labels.of(names, entry.name, entry.file, entry.id), strict=True))
    for column, attribute in (("truth", "behavior"), ("true_style", "style")):
        rows = zip(map(found.get, table["name"]), table[column], strict=True)
        words = [word if label is None else getattr(label, attribute) for label, word in rows]
        table[column] = pd.Series(words, table.index, dtype=object)
    return table


def answer_episodes(
    model: Model, datasets: Sequence[Dataset], *, split: Split | None = None,
    labels: Path | None = None, out: Path | None = None, traffic: str | None = None,
    jobs: int | None = None, quiet: bool = True,
) -> pd.DataFrame:  # fmt: skip
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
        The last answers about all drivers, in the datasets' order, with the columns ``LABELS`` and
        ``place``: the scenario, and where the data are of several engines, the engine.
    """
    given = None if labels is None else guarded_call(labels, read_driver_labels, labels)
    every = [(d.path, e) for d in datasets for e in d.episodes()]
    chosen = [
        (path, entry, place)
        for (path, entry), place in zip(every, places_of(datasets), strict=True)
        if split in (None, entry.split)
    ]
    arguments = [(model, path, entry, out is not None, traffic) for path, entry, _ in chosen]
    schema = _schema(model)
    found = [schema.empty_table().to_pandas().assign(place="")]
    with nullcontext() if out is None else table_file(out, schema) as write:
        answers = in_parallel(_answers, arguments, jobs, "answering episodes", quiet)
        for (_, entry, place), (names, table) in zip(chosen, answers, strict=True):
            labelled = table if given is None else _with_truth(table, names, entry, given)
            if write is not None:
                write(labelled)
            if len(labelled):
                last = labelled.drop_duplicates("agent", keep="last").sort_values("agent")
                found.append(last.assign(place=place))
        if given is not None:
            given.check()  # inside the block: nothing is written if a label belongs to no driver
    return pd.concat(found[1:] or found, ignore_index=True)


def _answers(
    model: Model, folder: Path, entry: EpisodeEntry, every_frame: bool, traffic: str | None
) -> tuple[tuple[str, ...], pd.DataFrame]:
    """Names of an episode's agents, and answers at every frame or the last ones."""
    episode = open_dataset(folder).read(entry)
    table = label_episode(episode, model, traffic)
    last = table.drop_duplicates("agent", keep="last")
    return episode.tracks.names, table if every_frame else last


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
    answers: pd.DataFrame, model: str, classes: tuple[Behavior, ...] = BEHAVIORS
) -> list[Row]:
    """Rows of a model's last answers as from `score_answers`, with ``scenario`` and ``split``.

    Both are "all" over several of them.
    """
    note_unknown(model, answers["truth"].dropna(), classes, "scored by their style alone")
    scenarios = list(answers["place"].unique())
    splits = [split for split in get_args(Split) if (answers["split"] == split).any()]
    rows: list[Row] = []
    for split in [*splits, *([ALL] if len(splits) > 1 else [])]:
        for scenario in [*scenarios, *([ALL] if len(scenarios) > 1 else [])]:
            there = (answers["place"] == scenario) | (scenario == ALL)
            some = answers[there & ((answers["split"] == split) | (split == ALL))]
            if len(some):
                keys = {"model": model, "scenario": scenario, "split": split}
                rows += score_answers(some, keys, classes=classes)
    return rows


def classify_dataset(
    source: Path, model: str | Path, out: Path | None = None, labels: Path | None = None,
    *, traffic: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi classify``: answer for every driver of a dataset's folder.

    Arguments are as `answer_episodes` takes them, but for a model's name or folder. Rows of each
    episode, by ``episode`` and ``name``, come before those by scenario and split.
    """
    known, dataset = load_model(model), open_dataset(source)
    answers = answer_episodes(
        known, [dataset], labels=labels, out=out, traffic=traffic, jobs=jobs, quiet=quiet
    )
    parts = dict(list(answers.groupby("episode")))
    rows: list[Row] = []
    for entry, place in zip(dataset.episodes(), places_of([dataset]), strict=True):
        keys = {
            "model": str(model), "episode": entry.id, "name": entry.name, "scenario": place,
            "split": entry.split,
        }  # fmt: skip
        rows += score_answers(parts.get(entry.id, answers[:0]), keys, classes=known.classes)
    return [*rows, *scored_answers(answers, str(model), known.classes)]


def evaluate(
    model: str | Path, source: Path, labels: Path | None = None, answers: Path | None = None,
    *, traffic: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi evaluate`` of a shipped model's name or a folder on a dataset's folder.

    Other arguments are as `answer_episodes` takes them. Answers of another model in a file are
    scored beside it on the test split, as is the plain rival, which learns from the training split.
    Paired differences have the key ``against``. A driver without an answer counts as unanswered,
    with the mean of the file's own probabilities.
    """
    known, dataset = load_model(model), open_dataset(source)
    classes, given = dataset.behaviors, None
    if answers is not None:
        given = guarded_call(answers, read_answers, answers, classes)
    answered = answer_episodes(
        known, [dataset], split=None if given is None else "test", labels=labels, traffic=traffic,
        jobs=jobs, quiet=quiet,
    )  # fmt: skip
    if answered.empty:
        raise InputError(f"{source}: found no driver seen for {MIN_SECONDS:g} s, expected one")
    rows = scored_answers(answered, str(model), known.classes)
    if not is_scored(rows):
        raise InputError(
            f"{source}: found no driver whose behaviour or style is known, expected at least one; "
            "--labels FILE.csv names some"
        )
    learned_from = (known.card.get("data") or {}).get("configurations") or ()
    if dict(dataset.header.configuration) in learned_from:
        LOGGER.info("the model was trained on data like these: the test split counts")
    if given is None or answers is None:
        return rows
    if not given.index.isin(_drivers(answered)).any():
        raise InputError(
            f"{answers}: found no answer about a driver of the test split of {source}, expected "
            "its episodes and agents as in the dataset's tables"
        )
    unknown = {f"p_{b}": 0.0 for b in classes if b not in known.classes}
    compared = {str(model): answered.assign(**unknown)}
    if dataset.episodes("train"):
        compared[RIVAL] = _replaced(answered, _forest_answers(dataset, jobs))
        rows += scored_answers(compared[RIVAL], RIVAL, classes)
    mine = _replaced(answered, given)
    called = answers.stem if answers.stem not in compared else answers.name
    rows += scored_answers(mine, called, classes)
    for name, other in compared.items():
        keys = {"model": called, "against": name, "scenario": ALL, "split": "test"}
        rows += score_difference(mine, other, keys, classes)
    return rows


def read_answers(path: Path, classes: Sequence[Behavior] = BEHAVIORS) -> pd.DataFrame:
    """Probabilities (n, k) by episode and agent, of the last answer about each driver in a file.

    CSV or Parquet has the columns ``episode``, ``agent`` and ``label``, one of the behaviours.
    ``time_s`` orders several answers about one driver. With a column ``p_BEHAVIOR`` of each of the
    six, the label is the likeliest, and others without a column have 0. Else the label has 1.
    """
    chances = [f"p_{b}" for b in classes]
    optional = ("time_s", *chances)
    table = read_table(path, ("agent", *optional), ("episode", "label"), optional)
    table = table.astype({"episode": str, "label": str, "agent": np.int64})
    codes = pd.Categorical(table["label"], [str(b) for b in classes]).codes
    if (codes < 0).any():
        wrong = table["label"][codes < 0].iloc[0]
        known = ", ".join(classes)
        raise InputError(f"{path}: label: found {wrong[:60]!r}, expected one of {known}")
    if set(CHANCES) <= set(table):
        table = table.assign(**{name: 0.0 for name in chances if name not in table})
        given = table[chances].to_numpy(np.float64)
        sums = (given >= 0.0).all(axis=1) & (np.abs(given.sum(axis=1) - 1.0) < ROUNDED)
        likeliest = given[np.arange(len(given)), codes] >= given.max(axis=1) - 1e-9
        for right, column, expected in (
            (sums, "p_ columns", "probabilities from 0 on that add to 1"),
            (likeliest, "label", "the behaviour with the largest p_ column"),
        ):
            if not right.all():
                row = table[["label", *chances]].iloc[right.argmin()].to_dict()
                raise InputError(f"{path}: {column}: found {row}, expected {expected}")
        table[chances] = given / given.sum(axis=1, keepdims=True)
    else:
        table[chances] = np.eye(len(classes))[codes]
    if "time_s" in table:
        table = table.sort_values("time_s", kind="stable")
    table = table.drop_duplicates(["episode", "agent"], keep="last")
    return table.set_index(["episode", "agent"])[chances]


def _forest_answers(dataset: Dataset, jobs: int | None) -> pd.DataFrame:
    """The plain rival's probabilities in the test split, by episode and agent."""
    training, asked = (whole_tracks(dataset, split, jobs) for split in ("train", "test"))
    names = np.array([entry.id for entry in dataset.manifest.episodes])
    probability = PlainRival(training).posterior(asked.features, len(dataset.behaviors))
    where = pd.MultiIndex.from_arrays([names[asked.episode], asked.agent])
    return pd.DataFrame(probability, where, [f"p_{b}" for b in dataset.behaviors])


def _drivers(answers: pd.DataFrame) -> pd.MultiIndex:
    return pd.MultiIndex.from_frame(answers[["episode", "agent"]])


def _replaced(ours: pd.DataFrame, given: pd.DataFrame) -> pd.DataFrame:
    """The same drivers with probabilities by episode and agent; their mean where there are none."""
    probability = given.reindex(_drivers(ours)).to_numpy(np.float64, copy=True)
    answered = np.isfinite(probability).all(axis=1)
    probability[~answered] = given.mean().to_numpy()
    words = given.columns.str.removeprefix("p_").to_numpy(object)[probability.argmax(axis=1)]
    found = ours.assign(behavior=np.where(answered, words, None))
    found[given.columns] = probability.astype(np.float32)
    return found


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
