"""What a classifier believes about each driver over the time of one episode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.scoring.classification import LABELS
from graphrqi.methods import Model
from graphrqi.posterior import Posterior
from graphrqi.stream import BehaviorStream
from sim.arrow.budget import MAX_TEXT_BYTES, Layout, check_number, check_spelled_out
from sim.arrow.parquet import opened
from sim.frames import FloatArray, IntArray, Tracks

EVERY_S: Final = 0.5
"""Time between two beliefs that are kept, s (evidence gathers over seconds)."""

MAX_LOOKS: Final = 3_000_000
"""Most beliefs that are kept: agents times instants. Longer recordings have fewer instants (a page
of some megabytes)."""

MAX_ROWS: Final = 10**8
"""Most rows of a labels file that are read."""

MAX_KEPT: Final = 10**7
"""Most of these rows that one episode may have (an hour of 250 drivers at 10 Hz; in memory some 1
GB)."""

BATCH_ROWS: Final = 2**16
"""Rows that are read at a time."""

MAX_BATCH_BYTES: Final = 2**26
"""Most bytes that the texts of one column may take in a batch (64 MiB, 1 kB for each row)."""


BELIEFS: Final = pa.schema(
    [LABELS.field(name) for name in ("episode", "agent", "time_s")]
    + [LABELS.field(f"p_{b.value}") for b in BEHAVIORS]
)
"""The columns of a labels file that are read."""


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """Posteriors of every agent of an episode at some times.

    Attributes:
        ids: (N,) agent ids, ascending.
        time_s: (S,) when, s, increasing.
        probability: (N, S, 6) in the order of ``BEHAVIORS``; NaN where nothing is believed.
    """

    ids: IntArray
    time_s: FloatArray
    probability: NDArray[np.float32]

    def at(self, time_s: float) -> Posterior:
        """The latest beliefs at a time, of the agents that have any."""
        column = int(np.searchsorted(self.time_s, time_s + 1e-6)) - 1
        if column < 0:
            return Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
        now = self.probability[:, column]
        known = np.isfinite(now).all(axis=1)
        return Posterior(self.ids[known], now[known].astype(np.float64))


def kept_steps(tracks: Tracks) -> IntArray:
    """Indices of the frames at which beliefs and the graph are kept: every half a second.

    Args:
        tracks: an episode; of one with very many agents for very long, looks are farther apart.

    Returns:
        (S,) ascending; the first is 0.
    """
    if not tracks.time_s.size:
        return np.empty(0, dtype=np.int64)
    span_s = float(tracks.time_s[-1] - tracks.time_s[0])
    steps_s = np.diff(tracks.time_s)
    if (steps_s > EVERY_S).any():  # nobody is looked at in a break
        span_s = float(np.minimum(steps_s, EVERY_S).sum())
    wanted = tracks.ids.size * span_s / EVERY_S
    return sampled(tracks, EVERY_S * max(1, math.ceil(wanted / MAX_LOOKS)))


def sampled(tracks: Tracks, every_s: float) -> IntArray:
    """Indices of the first frame in every interval of so many seconds.

    Args:
        tracks: an episode with a frame at least.
        every_s: length of the intervals, s.

    Returns:
        (S,) ascending; the first is 0.
    """
    slot = np.floor((tracks.time_s - tracks.time_s[0]) / every_s + 1e-6)
    return np.flatnonzero(np.diff(slot, prepend=-1.0) > 0)


def believe(tracks: Tracks, model: Model, is_scene: bool = True) -> Beliefs:
    """Classify the drivers of an episode from their positions.

    Args:
        tracks: an episode; its labels, if any, are not looked at.
        model: a trained model.
        is_scene: as for `graphrqi.stream.BehaviorStream`.

    Returns:
        Its beliefs every half a second.
    """
    steps = kept_steps(tracks)
    probability = _nothing(tracks, steps)
    column = {int(step): i for i, step in enumerate(steps)}
    stream = BehaviorStream(model, is_scene=is_scene)
    for step, frame in enumerate(tracks.frames()):
        stream.push(frame)
        if step in column:
            posterior = stream.posterior()
            rows = np.searchsorted(tracks.ids, posterior.ids)
            # Where the frames show no scene that can be believed, every behaviour is as likely.
            earned = (posterior.unknown < 1.0)[:, None]
            chance = np.where(earned, posterior.probability, 1.0 / len(BEHAVIORS))
            probability[rows, column[step]] = chance
    return Beliefs(tracks.ids, tracks.time_s[steps], probability)


def read_beliefs(path: Path, episode: str, tracks: Tracks) -> Beliefs:
    """Beliefs from a labels file, as ``graphrqi classify`` writes them.

    Args:
        path: the Parquet file.
        episode: whose rows.
        tracks: that episode.

    Returns:
        The beliefs at every half a second of which the file says something.

    Raises:
        InputError: if the file is not a labels file or does not speak of this episode.
    """
    table = episode_rows(path, BELIEFS, episode, "labels")
    agent = agent_rows(path, table, episode, tracks)
    steps = kept_steps(tracks)
    times = tracks.time_s[steps]
    time_s = table["time_s"].to_numpy()
    column = np.clip(np.searchsorted(times, time_s - 1e-4), 0, times.size - 1)
    here = np.abs(times[column] - time_s) < 1e-3
    told = np.stack([table[f"p_{b.value}"].to_numpy() for b in BEHAVIORS], axis=1)
    del table  # of millions of rows there is memory for one copy
    if not np.isfinite(time_s).all():
        raise InputError(f"{path}: found a time_s that is not finite, expected seconds")
    if not np.isfinite(told).all() or (np.abs(told.sum(axis=1) - 1.0) > 1e-3).any():
        raise InputError(f"{path}: found p_ columns that do not add to 1, expected probabilities")
    probability = _nothing(tracks, steps)
    probability[agent[here], column[here]] = told[here]
    return Beliefs(tracks.ids, times, probability)


def episode_rows(path: Path, schema: pa.Schema, episode: str, what: str) -> pa.Table:
    """What a Parquet file that this project writes says of one episode.

    Args:
        path: the file, read a piece at a time: the rows of other episodes take no memory.
        schema: the columns it must have, ``episode`` among them, none of them empty anywhere;
            others are left out.
        episode: whose rows.
        what: what the rows are, for messages.

    Returns:
        The rows, without the column ``episode``.

    Raises:
        InputError: if the file is broken, too large, a column is missing or of another type, or no
            row is of that episode.
    """
    with opened(path) as (layout, source):
        texts = _check_columns(path, schema, layout, pq.read_schema(source))
        file = pq.ParquetFile(source, read_dictionary=texts)
        ours_only = schema.remove(schema.get_field_index("episode"))
        parts, kept = [ours_only.empty_table()], 0
        for batch in file.iter_batches(BATCH_ROWS, columns=schema.names, use_threads=False):
            part = pa.Table.from_batches([batch])
            part.validate(full=True)
            for name in schema.names:
                if part[name].null_count:
                    raise InputError(f"{path}: found an empty {name}, expected one in every row")
            ours = pc.equal(part["episode"].cast(pa.string()), episode)
            part = part.select(ours_only.names).filter(ours)
            kept += part.num_rows
            if kept > MAX_KEPT:
                raise InputError(
                    f"{path}: found more than {MAX_KEPT} rows of episode {episode}, expected fewer"
                )
            for field in ours_only:
                check_spelled_out(path, part[field.name], MAX_BATCH_BYTES)
            if part.num_rows:
                parts.append(part.cast(ours_only))
        table = pa.concat_tables(parts)
    if not table.num_rows:
        raise InputError(f"{path}: found no row of episode {episode}, expected its {what}")
    return table


def _check_columns(path: Path, schema: pa.Schema, layout: Layout, found: pa.Schema) -> list[str]:
    """Refuse a file without these columns or with too many rows; its columns of texts."""
    for name in schema.names:
        if found.names.count(name) != 1:
            raise InputError(
                f"{path}: found column {name} {found.names.count(name)} times, expected it once"
            )
        wanted = schema.field(name).type
        if pa.types.is_integer(wanted) or pa.types.is_floating(wanted):
            check_number(path, found.field(name))
    if layout.rows > MAX_ROWS:
        raise InputError(f"{path}: found {layout.rows} rows, expected at most {MAX_ROWS}")
    columns = [column for column in layout.columns if column.name in schema.names]
    for column in columns:
        if column.repeated or column.largest_page > MAX_TEXT_BYTES:
            raise InputError(
                f"{path}: column {column.name}: found lists, or pages of up to "
                f"{column.largest_page} bytes, expected at most {MAX_TEXT_BYTES}"
            )
    return [column.name for column in columns if column.physical == "BYTE_ARRAY"]


def agent_rows(path: Path, table: pa.Table, episode: str, tracks: Tracks) -> IntArray:
    """(m,) agent of an episode that each row of a table is about, by the column ``agent``.

    Raises:
        InputError: if it names somebody whom the episode does not have.
    """
    agent: IntArray = table["agent"].to_numpy()
    row: IntArray = np.minimum(np.searchsorted(tracks.ids, agent), tracks.ids.size - 1)
    strangers = agent[tracks.ids[row] != agent]
    if strangers.size:
        raise InputError(
            f"{path}: found agent {strangers[0]}, expected one of {episode}'s {tracks.ids.size}"
        )
    return row


def _nothing(tracks: Tracks, steps: IntArray) -> NDArray[np.float32]:
    return np.full((tracks.ids.size, steps.size, len(BEHAVIORS)), np.nan, dtype=np.float32)
