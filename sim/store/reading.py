"""Reads the Parquet files of a dataset, whose pages carry checksums, and episodes from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style, Trait, read_behaviors
from behaviors.profiles import PERCEPTION_FIELDS, PROFILE_FIELDS, Profile
from behaviors.row_index import RowIndex
from behaviors.traits import ShownTrait
from sim.files import Place, place_of
from sim.frames import KINDS, SIGNALS, AgentKind, Event, EventKind, Tracks
from sim.invalid_fields import first_wrong_field
from sim.safety import CONFLICT_KINDS, Conflicts
from sim.scenario import AgentSpec
from sim.store.schema import (
    CONFLICTS,
    METADATA_KEY,
    TABLES,
    EpisodeEntry,
    TableName,
    shard_file,
    table_schema,
)

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T")

STEPS: Final = ["agent", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
"""The columns of steps that tracks are read from."""


@contextmanager
def opened(place: Place, file: str, **options: Any) -> Iterator[pq.ParquetFile]:
    """A Parquet file of a dataset, whose footer is kept for the next time.

    A broken one is an `InputError`, a missing one a `FileNotFoundError`.
    """
    try:
        known = _footer(place.url, file, place.stamp(file))
        with place.for_arrow(file) as source:
            options["page_checksum_verification"] = True
            yield pq.ParquetFile(source, metadata=known, **options)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"{place.path / file}: found no readable Parquet ({reason:.200})"
        ) from None


@lru_cache(maxsize=64)
def _footer(url: str, file: str, stamp: str) -> pq.FileMetaData:
    """A file's footer; ``stamp`` changes when the file does."""
    with place_of(url).for_arrow(file) as source:
        return pq.read_metadata(source)


def metadata_of(path: Path, metadata: pq.FileMetaData, model: type[M]) -> M:
    """Metadata of a dataset's Parquet file as a whole."""
    found = (metadata.metadata or {}).get(METADATA_KEY.encode())
    if found is None:
        raise InputError(f"{path}: found no metadata of graphrqi, expected a file of a dataset")
    try:
        return model.model_validate_json(found)
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


def check_columns(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    """Refuse a table that lacks a column, by its name."""
    for field in expected:
        if field.name not in found.names or not found.field(field.name).equals(field):
            raise InputError(f"{path}: found no column {field.name} of {field.type}, expected it")


def read_rows(
    place: Place, table: TableName, entry: EpisodeEntry, columns: list[str] | None = None
) -> pa.Table:
    """An episode's rows of a table, read from its own row group; ``columns``, or all.

    An `InputError` names a file that is missing, broken, or does not fit the schema.
    """
    file = shard_file(table, entry.scenario, entry.split, entry.index)
    path, schema = place.path / file, table_schema(table, entry.exact)
    wanted = schema.names if columns is None else columns
    rows = schema.empty_table().select(wanted)
    try:
        with opened(place, file) as parquet:
            older = {*PERCEPTION_FIELDS} - {*parquet.schema_arrow.names}  # of an earlier version
            there = pa.schema(field for field in schema if field.name not in older)
            check_columns(path, parquet.schema_arrow, there)
            for number in range(parquet.num_row_groups):
                ids = parquet.metadata.row_group(number).column(0).statistics
                if ids is not None and ids.min == ids.max == entry.id:
                    names = [name for name in wanted if name not in older]
                    rows = parquet.read_row_group(number, names, use_threads=False)
                    break
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected the shard of {entry.id}") from None
    for name, column in zip(rows.column_names, rows.columns, strict=True):
        if pa.types.is_floating(column.type) and pc.all(pc.is_finite(column)).as_py() is False:
            raise InputError(f"{path}: found a {name} that is not finite, expected numbers")
    return rows


def read_tables(
    place: Place, entry: EpisodeEntry
) -> tuple[Tracks, tuple[AgentSpec, ...], tuple[ShownTrait, ...]]:
    """Tracks of all agents that were seen, all agents, and the shown traits of an episode.

    An `InputError` names a file that is broken or does not fit the schema.
    """
    tables = {
        table: read_rows(place, table, entry, STEPS if table == "steps" else None)
        for table in TABLES
        if table != "conflicts"
    }
    agents, steps, signals = tables["agents"], tables["steps"], tables["signals"]
    classes = (*BEHAVIORS, *read_behaviors(entry.behaviors))
    time_s, ids = _array(tables["frames"], "time_s"), _array(agents, "agent")
    agent, step, x, y, heading, speed = (_array(steps, name) for name in STEPS)
    seen, row = np.unique(agent, return_inverse=True)
    rows = np.flatnonzero(np.isin(ids, seen))
    group, changed = _array(signals, "group"), _array(signals, "step")
    state = _codes(signals, "state", SIGNALS)
    checks: tuple[tuple[TableName, Any, str], ...] = (
        ("frames", time_s.size == entry.frames, f"{entry.frames} times"),
        ("frames", (np.diff(time_s) > 0).all(), "times that increase"),
        ("agents", (np.diff(ids) > 0).all() and rows.size == seen.size, "each agent once, by id"),
        ("steps", agent.size == entry.agent_steps, f"{entry.agent_steps} rows"),
        ("steps", ((step >= 0) & (step < time_s.size)).all(), "steps of the frames"),
        ("steps", (np.diff(row * time_s.size + step) > 0).all(), "rows by agent and step"),
        ("signals", ((changed >= 0) & (changed < time_s.size)).all(), "steps of the frames"),
        ("signals", (group >= 0).all() and (state >= 0).all(), "states of groups from 0"),
    )
    for table, fits, expected in checks:
        if not fits:
            raise _other(place, table, entry, f"other rows of {entry.id}, expected {expected}")
    traits = tables["traits"]
    traits = traits.set_column(6, "other", pc.fill_null(traits["other"], -1))
    try:
        of_word = {str(behavior): behavior for behavior in classes}
        specs = tuple(_agent_spec(one, of_word) for one in agents.to_pylist())
        events = tuple(_objects(Event, tables["events"], "kind", EventKind))
        shown = tuple(_objects(ShownTrait, traits, "trait", Trait))
    except (KeyError, TypeError, ValueError) as error:
        what = f"an unknown word or number in {entry.id}: {error}"
        raise _other(place, "agents", entry, what) from None
    behavior, names = _codes(agents, "behavior", classes)[rows], agents["name"].to_pylist()
    tracks = Tracks(
        index=RowIndex.of_rows(row, step.astype(np.int64), seen.size, time_s.size),
        row_xy=np.stack([x, y], axis=1),
        row_heading=heading,
        row_speed=speed,
        ids=seen,
        names=tuple(names[i] for i in rows),
        kind=_codes(agents, "kind", KINDS)[rows],
        length=_array(agents, "length_m")[rows],
        width=_array(agents, "width_m")[rows],
        time_s=time_s,
        signals=_all_signals(group, changed, state, time_s.size),
        behavior=behavior if (behavior >= 0).any() else None,
        classes=classes,
        events=events,
    )
    return tracks, specs, shown


def _other(place: Place, table: TableName, entry: EpisodeEntry, found: str) -> InputError:
    file = shard_file(table, entry.scenario, entry.split, entry.index)
    return InputError(f"{place.path / file}: found {found}")


def read_conflicts(place: Place, entry: EpisodeEntry) -> Conflicts:
    """The conflicts of an episode; errors are as of `read_tables`."""
    rows, columns = read_rows(place, "conflicts", entry), {}
    for name in CONFLICTS.names[1:]:
        if pa.types.is_floating(rows[name].type):
            never = np.inf if name in ("ttc_s", "mttc_s") else np.nan
            columns[name] = pc.fill_null(rows[name], never).to_numpy()
        elif pa.types.is_integer(rows[name].type):
            columns[name] = pc.fill_null(rows[name], -1).to_numpy()
    near_miss = np.array(rows["near_miss"].to_pylist(), dtype=bool)
    return Conflicts(**columns, kind=_codes(rows, "kind", CONFLICT_KINDS), near_miss=near_miss)


def _objects(
    kind: Callable[..., T], rows: pa.Table, name: str, word: Callable[[str], Any]
) -> Iterator[T]:
    """An object for each row; one column has words."""
    for row in rows.drop_columns(["episode"]).to_pylist():
        yield kind(**{**row, name: word(row[name])})


def _array(rows: pa.Table, name: str) -> NDArray[Any]:
    return cast("NDArray[Any]", rows.column(name).to_numpy())


def _codes(rows: pa.Table, name: str, words: tuple[str, ...]) -> NDArray[np.int8]:
    """Each row's place in the words; -1 for null."""
    codes = pc.index_in(rows.column(name), value_set=pa.array([*map(str, words)], pa.string()))
    return cast("NDArray[np.int8]", pc.fill_null(codes, -1).to_numpy().astype(np.int8))


def _all_signals(
    group: NDArray[np.int16], step: NDArray[np.int32], state: NDArray[np.int8], steps: int
) -> NDArray[np.int8]:
    """(S, T) the state of every group at every step, from its changes."""
    groups = int(group.max(initial=-1)) + 1
    signals = np.zeros((groups, steps), dtype=np.int8)
    last = np.zeros((groups, steps), dtype=np.int64)
    signals[group, step] = state
    last[group, step] = step
    return np.take_along_axis(signals, np.maximum.accumulate(last, axis=1), axis=1)


def _agent_spec(row: dict[str, Any], behaviors: dict[str, Behavior]) -> AgentSpec:
    """The agent that a row describes; numbers that an earlier version did not write are 0."""
    profile = None
    if row[PROFILE_FIELDS[0]] is not None:
        profile = Profile(**{name: row[name] for name in PROFILE_FIELDS if name in row})
    behavior = None if row["behavior"] is None else behaviors[row["behavior"]]
    return AgentSpec(
        id=row["agent"],
        kind=AgentKind(row["kind"]),
        behavior=behavior,
        profile=profile,
        route=tuple(row["route"]),
        depart_s=row["depart_s"],
        length_m=row["length_m"],
        width_m=row["width_m"],
        speed_mps=row["walking_speed_mps"],
        seed=row["seed"],
        jaywalks=row["jaywalks"],
        style_label=None if behavior or not row["style"] else Style(row["style"]),
    )
