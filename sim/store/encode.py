"""From tracks to the tables of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.profiles import PROFILE_FIELDS
from behaviors.traits import ShownTrait
from sim.frames import SIGNALS, EventKind, TrackRows, Tracks
from sim.safety import CONFLICT_KINDS, Conflicts
from sim.scenario import AgentSpec
from sim.store.schema import (
    AGENTS,
    CONFLICTS,
    DERIVED_QUANTUM,
    EVENTS,
    HEADING_QUANTUM,
    MAX_STEPS,
    POSITION_QUANTUM,
    TableName,
    steps_schema,
    table_schema,
)


def rounded(tracks: Tracks) -> Tracks:
    """Simulated tracks as they are stored: multiples of the schema's quanta, as float32 has them.

    Args:
        tracks: as an engine gives them.
    """
    rows = tracks.rows
    heading = _multiples(rows.heading, HEADING_QUANTUM)
    # pi itself rounds to a multiple above pi, and -pi is outside (-pi, pi].
    heading -= HEADING_QUANTUM * (heading > np.pi)
    heading += HEADING_QUANTUM * (heading < -np.pi)
    xy, speed = (_multiples(values, POSITION_QUANTUM) for values in (rows.xy, rows.speed))
    return replace(tracks, rows=TrackRows(rows.index, xy, heading, speed))


def _multiples(values: NDArray[np.float64], quantum: float) -> NDArray[np.float64]:
    whole = np.rint(values * (1.0 / quantum)) * quantum
    return whole.astype(np.float32).astype(np.float64)


def encode(
    tracks: Tracks,
    exact: bool,
    known: Mapping[str, pa.Array],
    agents: pa.Table,
    shown_traits: Sequence[ShownTrait],
    met: Conflicts,
    episode: str,
) -> dict[TableName, pa.Table]:
    """Every table of an episode.

    Args:
        tracks: what was seen.
        exact: whether numbers are stored as float64, else as float32.
        known: columns of the steps beyond those of the tracks; those left out are null.
        agents: what `agents_table` gives.
        shown_traits: the traits that were shown.
        met: the conflicts.
        episode: its id.

    Raises:
        InputError: if a number is not finite, or there are too many rows.
    """
    rows = tracks.rows
    agent, step = tracks.ids[rows.index.agent], rows.index.step
    if agent.size > MAX_STEPS:
        raise InputError(f"steps: found {agent.size} rows, expected at most {MAX_STEPS}")
    moved = {"x": rows.xy[:, 0], "y": rows.xy[:, 1], "heading": rows.heading, "speed": rows.speed}
    for name, values in moved.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"{name} of agent {agent[bad[0]]} at step {step[bad[0]]}: found "
                f"{values[bad[0]]}, expected a finite number"
            )
    events = [event for event in tracks.events if event.kind is not EventKind.CONTACT]
    columns: dict[TableName, Mapping[str, Any]] = {
        "steps": {
            "agent": agent,
            "step": step,
            "time_s": tracks.time_s[step],
            "x_m": moved["x"],
            "y_m": moved["y"],
            "heading_rad": moved["heading"],
            "speed_mps": moved["speed"],
            "acceleration_mps2": derived(_acceleration(tracks), exact),
            **known,
        },
        "frames": {"step": np.arange(tracks.time_s.size), "time_s": tracks.time_s},
        "signals": _signals(tracks),
        "events": {name: [getattr(e, name) for e in events] for name in EVENTS.names[1:]},
        "traits": {
            **{name: [getattr(e, name) for e in shown_traits] for name in _OF_TRAITS},
            "other": [None if e.other < 0 else e.other for e in shown_traits],
        },
        "conflicts": _conflicts(met),
    }
    tables = {name: _table(name, found, exact, episode) for name, found in columns.items()}
    tables["agents"] = agents.add_column(0, AGENTS.field(0), _repeated(episode, agents.num_rows))
    return tables


_OF_TRAITS: Final = ("agent", "trait", "begin_s", "end_s", "value")
_COUNTED: Final[dict[str, str]] = {"traits": "agent", "conflicts": "kind"}
"""A column of the tables that have no ``time_s``."""


def written_schema(name: TableName, exact: bool) -> pa.Schema:
    """A table's columns as they are handed to the writer, lanes as a dictionary.

    Args:
        name: of the table.
        exact: of steps, as for `steps_schema`.
    """
    schema = table_schema(name, exact)
    if name != "steps":
        return schema
    lane = pa.field("lane", pa.dictionary(pa.int32(), pa.string()))
    return schema.set(schema.get_field_index("lane"), lane)


def _table(name: TableName, columns: Mapping[str, Any], exact: bool, episode: str) -> pa.Table:
    schema = written_schema(name, exact)
    count = len(columns[_COUNTED.get(name, "time_s")])
    arrays = [_repeated(episode, count)]
    for field in list(schema)[1:]:
        values = columns.get(field.name)
        arrays.append(pa.nulls(count, field.type) if values is None else _array(values, field))
    return pa.Table.from_arrays(arrays, schema=schema)


def _array(values: Any, field: pa.Field) -> pa.Array:
    if isinstance(values, np.ndarray):
        values = values.astype(field.type.to_pandas_dtype(), copy=False)
    return values if isinstance(values, pa.Array) else pa.array(values, field.type)


def _conflicts(met: Conflicts) -> dict[str, pa.Array]:
    """The columns of conflicts: kinds as words, null for what is not known or never was."""
    found = {name: getattr(met, name) for name in CONFLICTS.names[1:]}
    columns = {
        name: pa.array(values, mask=~np.isfinite(values) if values.dtype.kind == "f" else None)
        for name, values in found.items()
    }
    columns["kind"] = pa.array([CONFLICT_KINDS[code] for code in met.kind.tolist()], pa.string())
    for name in ("passed_first", "priority"):
        columns[name] = pa.array(found[name], mask=found[name] < 0)
    return columns


def _repeated(episode: str, count: int) -> pa.Array:
    return pa.repeat(pa.scalar(episode), count)


def derived(values: NDArray[np.float64], exact: bool) -> pa.Array:
    """A column that follows from others: rounded where those are, null where it is not finite.

    Args:
        values: numbers.
        exact: as for `steps_schema`.
    """
    unknown = ~np.isfinite(values)
    kind = steps_schema(exact).field("gap_m").type
    numbers = values if exact else _multiples(np.where(unknown, 0.0, values), DERIVED_QUANTUM)
    return pa.array(numbers.astype(kind.to_pandas_dtype()), mask=unknown)


def _acceleration(tracks: Tracks) -> NDArray[np.float64]:
    """(m,) change of speed since the agent's step before, m/s²; NaN where it was not seen then."""
    rows = tracks.rows
    found = np.full(rows.speed.size, np.nan)
    at = np.flatnonzero(~rows.index.begins)
    time_s = tracks.time_s[rows.index.step]
    found[at] = (rows.speed[at] - rows.speed[at - 1]) / (time_s[at] - time_s[at - 1])
    return found


def _signals(tracks: Tracks) -> dict[str, Any]:
    """The state of every group at step 0, then every change."""
    signals = tracks.signals
    changed = np.ones(signals.shape, dtype=bool)
    changed[:, 1:] = signals[:, 1:] != signals[:, :-1]
    step, group = np.nonzero(changed.T)
    state = [SIGNALS[code] for code in signals[group, step]]
    return {"step": step, "time_s": tracks.time_s[step], "group": group, "state": state}


def agents_table(agents: Sequence[AgentSpec], names: Mapping[int, str]) -> pa.Table:
    """The rows of ``agents`` without the episode's id.

    Args:
        agents: in order of id.
        names: the source's own id of each agent; by default the id in words.
    """
    columns: dict[str, list[Any]] = {
        "agent": [a.id for a in agents],
        "name": [names.get(a.id, str(a.id)) for a in agents],
        "kind": [a.kind.value for a in agents],
        "behavior": [None if a.behavior is None else str(a.behavior) for a in agents],
        "style": [None if a.style is None else a.style.value for a in agents],
        "length_m": [a.length_m for a in agents],
        "width_m": [a.width_m for a in agents],
        "depart_s": [a.depart_s for a in agents],
        "route": [list(a.route) for a in agents],
        "walking_speed_mps": [a.speed_mps for a in agents],
        "seed": [a.seed for a in agents],
        "jaywalks": [a.jaywalks for a in agents],
    }
    for name in PROFILE_FIELDS:
        columns[name] = [None if a.profile is None else getattr(a.profile, name) for a in agents]
    return pa.Table.from_pydict(columns, schema=pa.schema(list(AGENTS)[1:]))
