"""From an episode's tables back to `Tracks`, agents and shown traits.

Whatever can be wrong with a table is one `InputError` that names the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from behaviors.detector_inputs import ShownTrait
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style, Trait
from behaviors.profiles import PROFILE_FIELDS, Profile
from behaviors.row_index import RowIndex
from sim.arrow.budget import MAX_TEXT_BYTES, check_budget, check_spelled_out
from sim.arrow.parquet import opened, read_packed
from sim.frames import KINDS, SIGNALS, AgentKind, Event, EventKind, Tracks
from sim.scenario import AgentSpec
from sim.store.schema import (
    AGENTS,
    EVENTS,
    FRAMES,
    MAX_CELLS,
    MAX_OBJECTS,
    SIGNALS_TABLE,
    TRAITS_TABLE,
    EpisodeEntry,
    FileName,
    steps_schema,
)
from sim.track_rows import TrackRows

STEPS: Final = (steps_schema(exact=False), steps_schema(exact=True))
"""What a table of steps may look like."""


class Tables(Protocol):
    """The tables of one episode, wherever they are."""

    def path(self, name: FileName) -> Path:
        """The file that a table is in, for messages."""

    def table(
        self,
        name: FileName,
        schemas: Sequence[pa.Schema],
        max_rows: int,
        columns: list[str] | None = None,
    ) -> pa.Table:
        """A table that has one of the schemas.

        Args:
            name: which table.
            schemas: what it may look like.
            max_rows: most values of a column.
            columns: those to read; None for all.

        Raises:
            InputError: if it is broken in any way.
        """


@dataclass(frozen=True, slots=True)
class EpisodeFiles:
    """Tables of an episode that has a file for each.

    Attributes:
        home: the episode's folder, for messages.
        read: gives the bytes of each of ``EPISODE_FILES``.
    """

    home: Path
    read: Callable[[FileName], bytes]

    def path(self, name: FileName) -> Path:
        """The table's file."""
        return self.home / name

    def table(
        self,
        name: FileName,
        schemas: Sequence[pa.Schema],
        max_rows: int,
        columns: list[str] | None = None,
    ) -> pa.Table:
        """A table that has one of the schemas."""
        path = self.path(name)
        with opened(path, self.read(name)) as (layout, source):
            found = pq.read_schema(source).remove_metadata()
            check_columns(path, found, schemas)
            # the edges of all routes count as the rows of routes
            texts = check_budget(path, layout, columns, max_rows)
            packed = read_packed(source, texts, columns)
            for column in packed.columns:
                check_spelled_out(path, column, MAX_TEXT_BYTES)
            return packed.cast(pa.schema([found.field(name) for name in packed.column_names]))


def read_tables(
    entry: EpisodeEntry, tables: Tables
) -> tuple[Tracks, tuple[AgentSpec, ...], tuple[ShownTrait, ...]]:
    """Everything that an episode's tables hold.

    Args:
        entry: what the catalogue says of it.
        tables: where they are.

    Returns:
        Tracks of all agents that were seen, all agents, and the shown traits.

    Raises:
        InputError: if a table is broken or does not fit the schema; names the file.
    """
    agents_path, frames_path = tables.path("agents.parquet"), tables.path("frames.parquet")
    agents = tables.table("agents.parquet", [AGENTS], MAX_OBJECTS)
    frames = tables.table("frames.parquet", [FRAMES], min(entry.frames, MAX_CELLS))
    time_s = _numbers(frames_path, frames, "time_s")
    if time_s.size != entry.frames or (np.diff(time_s) <= 0).any():
        raise InputError(f"{frames_path}: expected {entry.frames} times, each after the one before")
    ids = _numbers(agents_path, agents, "agent")
    if (np.diff(ids) <= 0).any():
        raise InputError(f"{agents_path}: found agents out of order, expected ascending ids")
    rows = _read_steps(tables, entry, ids, time_s.size)
    seen = np.flatnonzero(np.diff(rows.index.first))
    behavior = _codes(agents_path, agents, "behavior", BEHAVIORS, optional=True)[seen]
    specs = _agent_specs(agents_path, agents)
    names = agents.column("name").to_pylist()
    sizes = {c: _numbers(agents_path, agents, c)[seen] for c in ("length_m", "width_m")}
    tracks = Tracks.of_rows(
        rows if seen.size == ids.size else rows.part(seen, slice(None)),
        ids=ids[seen],
        names=tuple(names[i] for i in seen),
        kind=_codes(agents_path, agents, "kind", KINDS)[seen],
        length=sizes["length_m"],
        width=sizes["width_m"],
        time_s=time_s,
        signals=_read_signals(tables, time_s.size),
        behavior=behavior if (behavior >= 0).any() else None,
        events=_read_events(tables),
    )
    return tracks, specs, _read_shown_traits(tables)


def check_columns(path: Path, found: pa.Schema, schemas: Sequence[pa.Schema]) -> None:
    """Refuse a table that has none of the schemas.

    Raises:
        InputError: naming the first column that differs.
    """
    if not any(_same_columns(found, schema) for schema in schemas):
        raise InputError(f"{path}: {_first_difference(found, schemas[0])}")


def check_number(path: Path, field: pa.Field) -> None:
    """Refuse a column of a file that Arrow reads as something else than numbers, such as times.

    Args:
        path: of the file, for the message.
        field: name and type of the column.

    Raises:
        InputError: naming both.
    """
    if not (pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
        raise InputError(f"{path}: column {field.name}: found {field.type}, expected numbers")


def _first_difference(found: pa.Schema, expected: pa.Schema) -> str:
    """Which column is the first that is not as the schema has it."""
    for field in expected:
        if field.name not in found.names:
            return f"found no column {field.name}, expected it"
        if found.names.count(field.name) > 1:
            return f"found column {field.name} more than once"
        if found.field(field.name).type != field.type:
            return f"found {field.name} as {found.field(field.name).type}, expected {field.type}"
    strange = [name for name in found.names if name not in expected.names]
    return f"found column {strange[0]}" if strange else "found other columns in another order"


def _same_columns(found: pa.Schema, expected: pa.Schema) -> bool:
    """Whether names and types agree; how lists name their items does not matter."""

    def plain(kind: pa.DataType) -> pa.DataType:
        return pa.list_(kind.value_type) if pa.types.is_list(kind) else kind

    return found.names == expected.names and all(
        plain(a.type) == plain(b.type) for a, b in zip(found, expected, strict=True)
    )


def _numbers(path: Path, table: pa.Table, name: str) -> NDArray[Any]:
    column = table.column(name)
    if column.null_count:
        raise InputError(f"{path}: found an empty {name}, expected a number in every row")
    values: NDArray[Any] = column.to_numpy()
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(f"{path}: found a {name} that is not finite, expected numbers")
    return values


def _codes(
    path: Path, table: pa.Table, name: str, words: Sequence[str], optional: bool = False
) -> NDArray[np.int8]:
    """Each row's place in ``words``; -1 for null, which only optional columns may have."""
    column = table.column(name)
    if column.null_count and not optional:
        raise InputError(f"{path}: found an empty {name}, expected one of {', '.join(words)}")
    codes = pc.index_in(column, value_set=pa.array(words))
    if codes.null_count != column.null_count:
        strange = column.filter(pc.and_(pc.is_null(codes), pc.is_valid(column)))[0].as_py()
        raise InputError(f"{path}: found {name} {strange!r}, expected one of {', '.join(words)}")
    return cast("NDArray[np.int8]", pc.fill_null(codes, -1).to_numpy().astype(np.int8))


def _read_steps(
    tables: Tables, entry: EpisodeEntry, ids: NDArray[np.int64], steps: int
) -> TrackRows:
    path = tables.path("steps.parquet")
    columns = ["agent", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
    max_rows = min(entry.agent_steps, ids.size * steps)
    table = tables.table("steps.parquet", STEPS, max_rows, columns)
    agent, step, x, y, heading, speed = (_numbers(path, table, c) for c in columns)
    starts = np.flatnonzero(np.diff(agent, prepend=agent[:1] - 1)) if agent.size else agent
    runs = agent[starts]
    row = np.searchsorted(ids, runs)
    if (row >= ids.size).any() or (ids[row] != runs).any():
        raise InputError(f"{path}: found an agent that agents.parquet does not have")
    if agent.size and not 0 <= int(step.min()) <= int(step.max()) < steps:
        raise InputError(f"{path}: found a step outside of 0 to {steps - 1}")
    counts = np.diff(starts, append=agent.size)
    row = np.repeat(row, counts)
    if (np.diff(row * steps + step) <= 0).any():
        raise InputError(f"{path}: found rows out of order, expected them by agent, then step")
    index = RowIndex.of_rows(row, step.astype(np.int64), ids.size, steps)
    return TrackRows(index, np.stack([x, y], axis=1), heading, speed)


def _read_signals(tables: Tables, steps: int) -> NDArray[np.int8]:
    path = tables.path("signals.parquet")
    table = tables.table("signals.parquet", [SIGNALS_TABLE], MAX_OBJECTS)
    step, group = _numbers(path, table, "step"), _numbers(path, table, "group")
    state = _codes(path, table, "state", SIGNALS)
    groups = int(group.max()) + 1 if group.size else 0
    if step.size and not 0 <= int(step.min()) <= int(step.max()) < steps:
        raise InputError(f"{path}: found a step outside of 0 to {steps - 1}")
    if (group.size and int(group.min()) < 0) or groups * steps > MAX_CELLS:
        raise InputError(f"{path}: found a signal group outside of 0 to {MAX_CELLS // steps}")
    first = np.zeros(groups, dtype=bool)
    first[group[step == 0]] = True
    if not first.all():
        raise InputError(f"{path}: expected a state of every signal group at step 0")
    signals = np.zeros((groups, steps), dtype=np.int8)
    last = np.zeros((groups, steps), dtype=np.int64)
    signals[group, step] = state
    last[group, step] = step
    last = np.maximum.accumulate(last, axis=1)
    return np.take_along_axis(signals, last, axis=1)


def _read_events(tables: Tables) -> tuple[Event, ...]:
    path = tables.path("events.parquet")
    table = tables.table("events.parquet", [EVENTS], MAX_OBJECTS)
    kinds = [k.value for k in EventKind]
    _codes(path, table, "kind", kinds)
    _numbers(path, table, "time_s")
    _numbers(path, table, "agent")
    return tuple(
        Event(EventKind(r["kind"]), r["time_s"], r["agent"], r["other"], r["rule"] or "")
        for r in table.to_pylist()
    )


def _read_shown_traits(tables: Tables) -> tuple[ShownTrait, ...]:
    path = tables.path("traits.parquet")
    table = tables.table("traits.parquet", [TRAITS_TABLE], MAX_OBJECTS)
    _codes(path, table, "trait", tuple(Trait))
    for name in ("agent", "begin_s", "end_s", "value"):
        _numbers(path, table, name)
    return tuple(
        ShownTrait(
            trait=Trait(row["trait"]),
            agent=row["agent"],
            begin_s=row["begin_s"],
            end_s=row["end_s"],
            value=row["value"],
            other=-1 if row["other"] is None else row["other"],
        )
        for row in table.to_pylist()
    )


def _agent_specs(path: Path, table: pa.Table) -> tuple[AgentSpec, ...]:
    behavior = _codes(path, table, "behavior", BEHAVIORS, optional=True)
    _codes(path, table, "kind", KINDS)
    _codes(path, table, "style", tuple(Style), optional=True)
    for name in ("length_m", "width_m", "depart_s", "walking_speed_mps", "seed"):
        _numbers(path, table, name)
    for name in ("name", "route", "jaywalks"):
        if table.column(name).null_count:
            raise InputError(f"{path}: found an empty {name}, expected one in every row")
    specs: list[AgentSpec] = []
    for code, row in zip(behavior, table.to_pylist(), strict=True):
        numbers = {name: row[name] for name in PROFILE_FIELDS}
        missing = [name for name, value in numbers.items() if value is None]
        if missing and len(missing) < len(numbers):
            raise InputError(f"{path}: agent {row['agent']}: found no {missing[0]}, expected one")
        try:
            profile = None if missing else Profile(**numbers)
        except InputError as error:
            raise InputError(f"{path}: agent {row['agent']}: {error}") from None
        specs.append(
            AgentSpec(
                id=row["agent"],
                kind=AgentKind(row["kind"]),
                behavior=None if code < 0 else Behavior(row["behavior"]),
                profile=profile,
                route=tuple(row["route"]),
                depart_s=row["depart_s"],
                length_m=row["length_m"],
                width_m=row["width_m"],
                speed_mps=row["walking_speed_mps"],
                seed=row["seed"],
                jaywalks=row["jaywalks"],
                style_label=None if code >= 0 or not row["style"] else Style(row["style"]),
            )
        )
    return tuple(specs)
