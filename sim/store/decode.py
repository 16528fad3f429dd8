"""From an episode's tables back to `Tracks`, agents and shown traits."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style, Trait, read_behaviors
from behaviors.profiles import PERCEPTION_FIELDS, PROFILE_FIELDS, Profile
from behaviors.row_index import RowIndex
from behaviors.traits import ShownTrait
from sim.files import Place
from sim.frames import KINDS, SIGNALS, AgentKind, Event, EventKind, TrackRows, Tracks
from sim.safety import CONFLICT_KINDS, Conflicts
from sim.scenario import AgentSpec
from sim.store.schema import CONFLICTS, MAX_STEPS, TABLES, EpisodeEntry
from sim.store.shards import ShardName, read_rows

WORDS: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "agents": {"kind": KINDS, "behavior": BEHAVIORS, "style": tuple(Style)},
    "signals": {"state": SIGNALS},
    "events": {"kind": tuple(EventKind)},
    "traits": {"trait": tuple(Trait)},
    "conflicts": {"kind": CONFLICT_KINDS},
}
"""The words that the columns of a table may have."""

STEPS: Final = ["agent", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
"""The columns of steps that are read."""


def read_tables(
    place: Place, entry: EpisodeEntry
) -> tuple[Tracks, tuple[AgentSpec, ...], tuple[ShownTrait, ...]]:
    """Everything that an episode's tables hold but its conflicts.

    Args:
        place: the dataset.
        entry: what the catalogue says of the episode.

    Returns:
        Tracks of all agents that were seen, all agents, and the shown traits.

    Raises:
        InputError: if a table is broken or does not fit the schema; names the file.
    """
    paths = {table: place.path / ShardName.of(entry).file(table) for table in TABLES}
    tables = {
        table: read_rows(place, table, entry, STEPS if table == "steps" else None)
        for table in TABLES
        if table != "conflicts"
    }
    classes = (*BEHAVIORS, *read_behaviors(entry.behaviors))
    for table, rows in tables.items():
        words = WORDS.get(table, {}) | ({"behavior": classes} if table == "agents" else {})
        _check_values(paths[table], rows, words)
    agents, time_s = tables["agents"], _array(tables["frames"], "time_s")
    if time_s.size != entry.frames or (np.diff(time_s) <= 0).any():
        raise InputError(
            f"{paths['frames']}: expected {entry.frames} times, each after the one before"
        )
    if tables["steps"].num_rows != entry.agent_steps:
        found = f"{tables['steps'].num_rows} rows of {entry.id}"
        raise InputError(f"{paths['steps']}: found {found}, expected {entry.agent_steps}")
    ids = _array(agents, "agent")
    if (np.diff(ids) <= 0).any():
        raise InputError(f"{paths['agents']}: found agents out of order, expected by id")
    rows = _track_rows(paths["steps"], tables["steps"], ids, time_s.size)
    seen = np.flatnonzero(np.diff(rows.index.first))
    behavior = _codes(agents, "behavior", classes)[seen]
    names = agents.column("name").to_pylist()
    tracks = Tracks(
        rows=rows.taken(*rows.index.part(seen, slice(None))),
        ids=ids[seen],
        names=tuple(names[i] for i in seen),
        kind=_codes(agents, "kind", KINDS)[seen],
        length=_array(agents, "length_m")[seen],
        width=_array(agents, "width_m")[seen],
        time_s=time_s,
        signals=_signals(paths["signals"], tables["signals"], time_s.size),
        behavior=behavior if (behavior >= 0).any() else None,
        classes=classes,
        events=tuple(
            Event(**{**row, "kind": EventKind(row["kind"])}) for row in _dicts(tables["events"])
        ),
    )
    shown = tuple(
        ShownTrait(**{**row, "trait": Trait(row["trait"]), "other": _known(row["other"])})
        for row in _dicts(tables["traits"])
    )
    return tracks, _agent_specs(paths["agents"], agents, classes), shown


def read_conflicts(place: Place, entry: EpisodeEntry) -> Conflicts:
    """The conflicts of an episode.

    Raises:
        InputError: if the table is broken or does not fit the schema; names the file.
    """
    rows = read_rows(place, "conflicts", entry)
    path = place.path / ShardName.of(entry).file("conflicts")
    _check_values(path, rows, WORDS["conflicts"])
    columns = {}
    for field in CONFLICTS:
        if pa.types.is_floating(field.type):
            never = np.inf if field.name in ("ttc_s", "mttc_s") else np.nan
            columns[field.name] = pc.fill_null(rows[field.name], never).to_numpy()
        elif pa.types.is_integer(field.type):
            columns[field.name] = pc.fill_null(rows[field.name], -1).to_numpy()
    near_miss = np.array(rows["near_miss"].to_pylist(), dtype=bool)
    return Conflicts(**columns, kind=_codes(rows, "kind", CONFLICT_KINDS), near_miss=near_miss)


def _known(other: int | None) -> int:
    return -1 if other is None else other


def _dicts(rows: pa.Table) -> list[dict[str, Any]]:
    return cast("list[dict[str, Any]]", rows.drop_columns(["episode"]).to_pylist())


def _array(rows: pa.Table, name: str) -> NDArray[Any]:
    return cast("NDArray[Any]", rows.column(name).to_numpy())


def _check_values(path: Path, rows: pa.Table, words: dict[str, tuple[str, ...]]) -> None:
    """Refuse numbers that are not finite, and words that are not known."""
    for field in rows.schema:
        column = rows.column(field.name)
        if pa.types.is_floating(field.type) and pc.all(pc.is_finite(column)).as_py() is False:
            raise InputError(f"{path}: found a {field.name} that is not finite, expected numbers")
        if field.name in words:
            known = words[field.name]
            strange = pc.unique(column).drop_null().to_pylist()
            for word in strange:
                if word not in known:
                    expected = f"one of {', '.join(known)}"
                    raise InputError(f"{path}: found {field.name} {word!r}, expected {expected}")


def _codes(rows: pa.Table, name: str, words: tuple[str, ...]) -> NDArray[np.int8]:
    """Each row's place in the words; -1 for null."""
    codes = pc.index_in(rows.column(name), value_set=pa.array([*map(str, words)], pa.string()))
    return cast("NDArray[np.int8]", pc.fill_null(codes, -1).to_numpy().astype(np.int8))


def _track_rows(path: Path, table: pa.Table, ids: NDArray[np.int64], steps: int) -> TrackRows:
    agent, step, x, y, heading, speed = (_array(table, name) for name in STEPS)
    starts = np.flatnonzero(np.diff(agent, prepend=agent[:1] - 1)) if agent.size else agent
    runs = agent[starts]
    row = np.searchsorted(ids, runs)
    if (row >= ids.size).any() or (ids[row] != runs).any():
        raise InputError(f"{path}: found an agent that the table of agents does not have")
    _check_steps(path, step, steps)
    row = np.repeat(row, np.diff(starts, append=agent.size))
    if (np.diff(row * steps + step) <= 0).any():
        raise InputError(f"{path}: found rows out of order, expected them by agent, then step")
    index = RowIndex.of_rows(row, step.astype(np.int64), ids.size, steps)
    return TrackRows(index, np.stack([x, y], axis=1), heading, speed)


def _check_steps(path: Path, step: NDArray[np.int32], steps: int) -> None:
    if step.size and not 0 <= int(step.min()) <= int(step.max()) < steps:
        raise InputError(f"{path}: found a step outside of 0 to {steps - 1}")


def _signals(path: Path, table: pa.Table, steps: int) -> NDArray[np.int8]:
    """The state of every group at every step, from its changes."""
    step, group = _array(table, "step"), _array(table, "group")
    groups = int(group.max()) + 1 if group.size else 0
    _check_steps(path, step, steps)
    if (group.size and int(group.min()) < 0) or groups * steps > MAX_STEPS:
        raise InputError(f"{path}: found a signal group outside of 0 to {MAX_STEPS // steps}")
    if np.unique(group[step == 0]).size != groups:
        raise InputError(f"{path}: expected a state of every signal group at step 0")
    signals = np.zeros((groups, steps), dtype=np.int8)
    last = np.zeros((groups, steps), dtype=np.int64)
    signals[group, step] = _codes(table, "state", SIGNALS)
    last[group, step] = step
    return np.take_along_axis(signals, np.maximum.accumulate(last, axis=1), axis=1)


def _agent_specs(
    path: Path, table: pa.Table, classes: tuple[Behavior, ...]
) -> tuple[AgentSpec, ...]:
    specs: list[AgentSpec] = []
    for row in table.to_pylist():
        numbers = {name: row[name] for name in PROFILE_FIELDS}
        known = any(value is not None for value in numbers.values())
        if row[PERCEPTION_FIELDS[0]] is None:  # older datasets do not have these columns
            numbers |= dict.fromkeys(PERCEPTION_FIELDS, 0.0)
        try:
            profile = Profile(**numbers) if known else None
        except (InputError, TypeError) as error:
            raise InputError(f"{path}: agent {row['agent']}: {error}") from None
        behavior = None if row["behavior"] is None else classes[classes.index(row["behavior"])]
        specs.append(
            AgentSpec(
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
        )
    return tuple(specs)
