"""From an episode's tracks to its tables."""

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
from sim.episode.annotate import Annotations
from sim.frames import SIGNALS, EventKind, Tracks
from sim.road import Road
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
    TRAITS_TABLE,
    TableName,
    table_schema,
)

ATTRIBUTES: Final = {"agent": "id", "walking_speed_mps": "speed_mps"}
"""The attribute of `AgentSpec` in a column of ``agents``, where it has another name."""


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
    """Every table of an episode; numbers are float64 if ``exact``, else float32.

    ``known`` is what `road_columns` gives; agents are in order of id; ``met`` are the conflicts.
    """
    agent, step = tracks.ids[tracks.index.agent], tracks.index.step
    if agent.size > MAX_STEPS:
        raise InputError(f"steps: found {agent.size} rows, expected at most {MAX_STEPS}")
    (x, y), heading, speed = tracks.row_xy.T, tracks.row_heading, tracks.row_speed
    for name, values in (("x", x), ("y", y), ("heading", heading), ("speed", speed)):
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
            "x_m": x,
            "y_m": y,
            "heading_rad": heading,
            "speed_mps": speed,
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
