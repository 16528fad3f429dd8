"""From an episode's tracks to its tables, and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style, Trait, read_behaviors
from behaviors.profiles import PERCEPTION_FIELDS, PROFILE_FIELDS, Profile
from behaviors.row_index import RowIndex
from behaviors.traits import ShownTrait
from sim.episode.annotate import Annotations
from sim.files import Place
from sim.frames import KINDS, SIGNALS, AgentKind, Event, EventKind, Tracks
from sim.road import Road
from sim.safety import CONFLICT_KINDS, Conflicts
from sim.scenario import AgentSpec
from sim.store.parquet import read_rows
from sim.store.schema import (
    AGENTS,
    CONFLICTS,
    DERIVED_QUANTUM,
    EVENTS,
    HEADING_QUANTUM,
    MAX_STEPS,
    POSITION_QUANTUM,
    TABLES,
    TRAITS_TABLE,
    EpisodeEntry,
    TableName,
    shard_file,
    table_schema,
)

T = TypeVar("T")

ATTRIBUTES: Final = {"agent": "id", "walking_speed_mps": "speed_mps"}
"""The attribute of `AgentSpec` in a column of ``agents``, where it has another name."""

STEPS: Final = ["agent", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
"""The columns of steps that tracks are read from."""


# --- to tables ----------------------------------------------------------------------------------


def rounded(tracks: Tracks) -> Tracks:
    """Simulated tracks as they are stored: multiples of the quanta, as float32 has them."""
    heading = _multiples(tracks.row_heading, HEADING_QUANTUM)
    # pi itself rounds to a multiple above pi, and -pi is outside (-pi, pi].
    heading -= HEADING_QUANTUM * (heading > np.pi)
    heading += HEADING_QUANTUM * (heading < -np.pi)
    xy, speed = (
        _multiples(values, POSITION_QUANTUM) for values in (tracks.row_xy, tracks.row_speed)
    )
    return replace(tracks, row_xy=xy, row_heading=heading, row_speed=speed)


def _multiples(values: NDArray[np.float64], quantum: float) -> NDArray[np.float64]:
    whole = np.rint(values * (1.0 / quantum)) * quantum
    return whole.astype(np.float32).astype(np.float64)


def encode(
    tracks: Tracks,
    exact: bool,
    known: Mapping[str, pa.Array],
    agents: Sequence[AgentSpec],
    shown_traits: Sequence[ShownTrait],
    met: Conflicts,
    episode: str,
) -> dict[TableName, pa.Table]:
    """Every table of an episode.

    Numbers are float64 if ``exact``, else float32. ``known`` is what `road_columns` gives; agents
    are in order of id; ``met`` are the conflicts.

    Raises:
        InputError: if a number is not finite, or there are too many rows.
    """
    agent, step = tracks.ids[tracks.index.agent], tracks.index.step
    if agent.size > MAX_STEPS:
        raise InputError(f"steps: found {agent.size} rows, expected at most {MAX_STEPS}")
    (x, y), heading, speed = tracks.row_xy.T, tracks.row_heading, tracks.row_speed
    moved = {"x": x, "y": y, "heading": heading, "speed": speed}
    for name, values in moved.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"{name} of agent {agent[bad[0]]} at step {step[bad[0]]}: found "
                f"{values[bad[0]]}, expected a finite number"
            )
    events = [event for event in tracks.events if event.kind is not EventKind.CONTACT]
    names = {int(i): name for i, name in zip(tracks.ids, tracks.names, strict=True)}
    columns: dict[TableName, Mapping[str, Any]] = {
        "steps": {
            "agent": agent,
            "step": step,
            "time_s": tracks.time_s[step],
            "x_m": moved["x"],
            "y_m": moved["y"],
            "heading_rad": moved["heading"],
            "speed_mps": moved["speed"],
            "acceleration_mps2": _derived(_acceleration(tracks), exact),
            **known,
        },
        "agents": {
            **{
                name: [getattr(a, ATTRIBUTES.get(name, name), None) for a in agents]
                for name in AGENTS.names[1:]
            },
            **{name: [getattr(a.profile, name, None) for a in agents] for name in PROFILE_FIELDS},
            "name": [names.get(a.id, str(a.id)) for a in agents],
        },
        "frames": {"step": np.arange(tracks.time_s.size), "time_s": tracks.time_s},
        "signals": _signal_changes(tracks),
        "events": {name: [getattr(e, name) for e in events] for name in EVENTS.names[1:]},
        "traits": {
            **{name: [getattr(e, name) for e in shown_traits] for name in TRAITS_TABLE.names[1:]},
            "other": [None if e.other < 0 else e.other for e in shown_traits],
        },
        "conflicts": _conflict_columns(met),
    }
    return {name: _table(name, found, exact, episode) for name, found in columns.items()}


def written_schema(name: TableName, exact: bool) -> pa.Schema:
    """A table's columns as they are handed to the writer: lanes as a dictionary."""
    schema = table_schema(name, exact)
    if name != "steps":
        return schema
    lane = pa.field("lane", pa.dictionary(pa.int32(), pa.string()))
    return schema.set(schema.get_field_index("lane"), lane)


def _table(name: TableName, columns: Mapping[str, Any], exact: bool, episode: str) -> pa.Table:
    schema = written_schema(name, exact)
    count = len(next(iter(columns.values())))
    arrays = [pa.repeat(pa.scalar(episode), count)]
    for field in list(schema)[1:]:
        values = columns.get(field.name)
        if values is None:
            values = pa.nulls(count, field.type)
        elif isinstance(values, np.ndarray):
            values = values.astype(field.type.to_pandas_dtype(), copy=False)
        arrays.append(values if isinstance(values, pa.Array) else pa.array(values, field.type))
    return pa.Table.from_arrays(arrays, schema=schema)


def _conflict_columns(met: Conflicts) -> dict[str, pa.Array]:
    """The columns of conflicts: kinds as words, null for what is not known or never was."""
    columns = {}
    for name in CONFLICTS.names[1:]:
        values = getattr(met, name)
        unknown = ~np.isfinite(values) if values.dtype.kind == "f" else None
        if name in ("passed_first", "priority"):
            unknown = values < 0
        columns[name] = pa.array(values, mask=unknown)
    columns["kind"] = pa.array([CONFLICT_KINDS[code] for code in met.kind.tolist()], pa.string())
    return columns


def road_columns(tracks: Tracks, found: Annotations, road: Road) -> dict[str, pa.Array]:
    """The columns of simulated steps that come from the road."""
    agent = tracks.ids[tracks.index.agent]
    seen = found.inputs
    lane = pa.array(seen.lane, pa.int32(), mask=seen.lane < 0)
    lane_ids = pa.array([lane.id for lane in road.lanes], pa.string())
    return {
        "lane": pa.DictionaryArray.from_arrays(lane, lane_ids),
        "lane_s_m": _derived(found.lane_s, exact=False),
        "leader": pa.array(agent[seen.leader], mask=seen.leader < 0),
        "gap_m": _derived(seen.gap, exact=False),
    }


def _derived(values: NDArray[np.float64], exact: bool) -> pa.Array:
    """A column that follows from others: rounded where those are, null where it is not finite."""
    unknown = ~np.isfinite(values)
    if exact:
        return pa.array(values, mask=unknown)
    numbers = _multiples(np.where(unknown, 0.0, values), DERIVED_QUANTUM)
    return pa.array(numbers.astype(np.float32), mask=unknown)


def _acceleration(tracks: Tracks) -> NDArray[np.float64]:
    """(m,) change of speed since the agent's step before, m/s²; NaN where it was not seen then."""
    found = np.full(tracks.row_speed.size, np.nan)
    at = np.flatnonzero(~tracks.index.begins)
    time_s = tracks.time_s[tracks.index.step]
    found[at] = (tracks.row_speed[at] - tracks.row_speed[at - 1]) / (time_s[at] - time_s[at - 1])
    return found


def _signal_changes(tracks: Tracks) -> dict[str, Any]:
    """The state of every group at step 0, then every change."""
    signals = tracks.signals
    changed = np.ones(signals.shape, dtype=bool)
    changed[:, 1:] = signals[:, 1:] != signals[:, :-1]
    step, group = np.nonzero(changed.T)
    state = [SIGNALS[code] for code in signals[group, step]]
    return {"step": step, "time_s": tracks.time_s[step], "group": group, "state": state}


# --- and back -----------------------------------------------------------------------------------


def read_tables(
    place: Place, entry: EpisodeEntry
) -> tuple[Tracks, tuple[AgentSpec, ...], tuple[ShownTrait, ...]]:
    """Tracks of all agents that were seen, all agents, and the shown traits of an episode.

    Raises:
        InputError: if a table is broken or does not fit the schema; names the file.
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
    count = np.searchsorted(agent, ids, side="right") - np.searchsorted(agent, ids)
    seen = np.flatnonzero(count > 0)
    row = np.repeat(np.arange(seen.size), count[seen])[: agent.size]
    group, changed = _array(signals, "group"), _array(signals, "step")
    state = _codes(signals, "state", SIGNALS)
    checks: tuple[tuple[TableName, Any, str], ...] = (
        ("frames", time_s.size == entry.frames, f"{entry.frames} times"),
        ("frames", (np.diff(time_s) > 0).all(), "times that increase"),
        ("agents", (np.diff(ids) > 0).all(), "agents by id"),
        ("steps", agent.size == entry.agent_steps, f"{entry.agent_steps} rows"),
        ("steps", np.array_equal(ids[seen][row], agent), "rows by agent, each of a known one"),
        ("steps", ((step >= 0) & (step < time_s.size)).all(), "steps of the frames"),
        ("steps", (np.diff(row * time_s.size + step[: row.size]) > 0).all(), "rows by step"),
        ("signals", ((changed >= 0) & (changed < time_s.size)).all(), "steps of the frames"),
        ("signals", (group >= 0).all() and (state >= 0).all(), "states of groups from 0"),
    )
    for table, fits, expected in checks:
        if not fits:
            file = shard_file(table, entry.scenario, entry.split, entry.index)
            raise InputError(
                f"{place.path / file}: found other rows of {entry.id}, expected {expected}"
            )
    traits = tables["traits"]
    traits = traits.set_column(6, "other", pc.fill_null(traits["other"], -1))
    try:
        of_word = {str(behavior): behavior for behavior in classes}
        specs = tuple(_agent_spec(one, of_word) for one in agents.to_pylist())
        events = tuple(_objects(Event, tables["events"], "kind", EventKind))
        shown = tuple(_objects(ShownTrait, traits, "trait", Trait))
    except (KeyError, TypeError, ValueError) as error:
        file = shard_file("agents", entry.scenario, entry.split, entry.index)
        raise InputError(
            f"{place.path / file}: found an unknown word or number in {entry.id}: {error}"
        ) from None
    behavior = _codes(agents, "behavior", classes)[seen]
    names = agents.column("name").to_pylist()
    index = RowIndex.of_rows(row, step.astype(np.int64), seen.size, time_s.size)
    tracks = Tracks(
        index=index,
        row_xy=np.stack([x, y], axis=1),
        row_heading=heading,
        row_speed=speed,
        ids=ids[seen],
        names=tuple(names[i] for i in seen),
        kind=_codes(agents, "kind", KINDS)[seen],
        length=_array(agents, "length_m")[seen],
        width=_array(agents, "width_m")[seen],
        time_s=time_s,
        signals=_all_signals(group, changed, state, time_s.size),
        behavior=behavior if (behavior >= 0).any() else None,
        classes=classes,
        events=events,
    )
    return tracks, specs, shown


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
    """The agent that a row describes."""
    numbers = {name: row[name] for name in PROFILE_FIELDS}
    profile = None
    if any(value is not None for value in numbers.values()):
        if row[PERCEPTION_FIELDS[0]] is None:  # older datasets do not have these columns
            numbers |= dict.fromkeys(PERCEPTION_FIELDS, 0.0)
        profile = Profile(**numbers)
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
