"""From frames or tracks to the tables of an episode and their Parquet bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from behaviors.detector_inputs import ShownTrait
from behaviors.errors import InputError
from behaviors.profiles import PROFILE_FIELDS
from sim.arrow.budget import most_unpacked_bytes
from sim.frames import SIGNALS, Event, Frame, Tracks
from sim.scenario import AgentSpec
from sim.store.schema import (
    AGENTS,
    EVENTS,
    FRAMES,
    HEADING_QUANTUM,
    MAX_OBJECTS,
    MAX_SHARD_STEPS,
    POSITION_QUANTUM,
    SIGNALS_TABLE,
    TRAITS_TABLE,
    FileName,
    steps_schema,
)

CHUNK_FRAMES: Final = 256
"""Frames collected before they are packed into arrays."""

_ROW_BYTES: Final = 8 * (1 + len(steps_schema(exact=False)))
"""What readers count for a row of ``steps.parquet``, bytes: 8 for each value, and in a shard the
episode's name."""


@dataclass(frozen=True, slots=True)
class Steps:
    """The rows of ``steps.parquet`` and the frames that they belong to."""

    agent: NDArray[np.int64]
    step: NDArray[np.int32]
    time_s: NDArray[np.float64]
    x: NDArray[Any]
    y: NDArray[Any]
    heading: NDArray[Any]
    speed: NDArray[Any]
    signals: NDArray[np.int8]
    events: tuple[Event, ...]

    @property
    def exact(self) -> bool:
        """Whether the numbers are as they came, not rounded."""
        return self.x.dtype == np.float64

    def agents(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(N,) ids of the agents, ascending, and (N,) how many rows each has."""
        first = np.ones(self.agent.size, dtype=bool)
        first[1:] = self.agent[1:] != self.agent[:-1]  # they come agent by agent
        begins = np.flatnonzero(first)
        return self.agent[begins], np.diff(begins, append=self.agent.size)


def _rounded(values: NDArray[np.float64], quantum: float) -> NDArray[np.float32]:
    return (np.rint(values * (1.0 / quantum)) * quantum).astype(np.float32)


def _rounded_heading(heading: NDArray[np.float64]) -> NDArray[np.float32]:
    rounded = _rounded(heading, HEADING_QUANTUM)
    # pi itself rounds to a multiple above pi, and -pi is outside (-pi, pi].
    over = rounded.astype(np.float64) > np.pi
    under = rounded.astype(np.float64) < -np.pi
    return cast(
        "NDArray[np.float32]",
        rounded - np.float32(HEADING_QUANTUM) * over + np.float32(HEADING_QUANTUM) * under,
    )


def collect(frames: Iterable[Frame], since_s: float | None = None) -> Steps:
    """Pack frames, a chunk at a time, and sort the rows by agent, then step.

    Args:
        frames: the episode, in time order.
        since_s: rows up to this time, s, are not written and do not count. None: all do.

    Raises:
        InputError: if times do not increase, or as soon as more rows are to be written than can be
            read back.
    """
    written = 0
    packed: list[tuple[NDArray[Any], ...]] = []
    chunk: list[Frame] = []
    times: list[float] = []
    signals: list[NDArray[np.int8]] = []
    events: list[Event] = []

    def pack() -> None:
        xy = np.concatenate([f.xy for f in chunk])
        counts = [len(f) for f in chunk]
        first = len(times) - len(chunk)
        packed.append(
            (
                np.concatenate([f.ids for f in chunk]),
                np.repeat(np.arange(first, len(times), dtype=np.int32), counts),
                _rounded(xy[:, 0], POSITION_QUANTUM),
                _rounded(xy[:, 1], POSITION_QUANTUM),
                _rounded_heading(np.concatenate([f.heading for f in chunk])),
                _rounded(np.concatenate([f.speed for f in chunk]), POSITION_QUANTUM),
            )
        )
        chunk.clear()

    for frame in frames:
        if times and frame.time_s <= times[-1]:
            raise InputError(f"frame.time_s: found {frame.time_s}, expected later than {times[-1]}")
        if since_s is None or frame.time_s >= since_s + 1e-9:
            written += len(frame)
            _check_rows(written)
        chunk.append(frame)
        times.append(frame.time_s)
        signals.append(frame.signals)
        events.extend(frame.events)
        if len(chunk) == CHUNK_FRAMES:
            pack()
    if chunk or not packed:
        chunk = chunk or [_no_agents()]
        pack()
    agent, step, x, y, heading, speed = (np.concatenate(part) for part in zip(*packed, strict=True))
    packed.clear()
    order = np.argsort(agent, kind="stable")
    return Steps(
        agent=agent[order],
        step=step[order],
        time_s=np.array(times, dtype=np.float64),
        x=x[order],
        y=y[order],
        heading=heading[order],
        speed=speed[order],
        signals=np.stack(signals, axis=1) if signals else np.empty((0, 0), dtype=np.int8),
        events=tuple(events),
    )


def _check_rows(rows: int) -> None:
    if rows > MAX_SHARD_STEPS:
        raise InputError(f"steps.parquet: found {rows} rows, expected at most {MAX_SHARD_STEPS}")


def _check_growth(rows: int, size: int) -> None:
    """Refuse rows that take too few bytes for readers to trust them."""
    most = most_unpacked_bytes(size) // _ROW_BYTES
    if rows > most:
        raise InputError(
            f"steps.parquet: found {rows} rows in {size} bytes, of which readers take at most "
            f"{most}: too many agents never move"
        )


def _no_agents() -> Frame:
    none, codes = np.empty(0), np.empty(0, dtype=np.int8)
    return Frame(0.0, codes.astype(np.int64), np.empty((0, 2)), none, none, none, none, codes)


def from_tracks(tracks: Tracks) -> Steps:
    """The rows of tracks, exactly as they are."""
    rows = tracks.as_rows()
    return Steps(
        agent=tracks.ids[rows.index.agent],
        step=rows.index.step.astype(np.int32),
        time_s=np.asarray(tracks.time_s),
        x=rows.xy[:, 0],
        y=rows.xy[:, 1],
        heading=rows.heading,
        speed=rows.speed,
        signals=np.asarray(tracks.signals),
        events=tracks.events,
    )


def _check_finite(steps: Steps) -> None:
    for name in ("x", "y", "heading", "speed"):
        bad = np.flatnonzero(~np.isfinite(getattr(steps, name)))
        if bad.size:
            at = int(bad[0])
            raise InputError(
                f"{name} of agent {steps.agent[at]} at step {steps.step[at]}: found "
                f"{getattr(steps, name)[at]}, expected a finite number"
            )


def encode_agents(agents: Sequence[AgentSpec], names: Mapping[int, str]) -> bytes:
    """The bytes of ``agents.parquet``.

    Args:
        agents: in order of id.
        names: the source's own id of each agent; by default the id in words.
    """
    return _parquet_bytes("agents.parquet", _agents_table(agents, names))


def encode(
    steps: Steps, agents: bytes, shown_traits: Sequence[ShownTrait]
) -> dict[FileName, bytes]:
    """The bytes of every table of an episode.

    Args:
        steps: the episode's rows.
        agents: what `encode_agents` gives.
        shown_traits: the traits that were shown.

    Raises:
        InputError: if a number is not finite, or a table has more rows than can be read back.
    """
    _check_rows(steps.agent.size)
    _check_finite(steps)
    tables: dict[FileName, pa.Table] = {
        "steps.parquet": _steps_table(steps),
        "frames.parquet": pa.Table.from_arrays([pa.array(steps.time_s)], schema=FRAMES),
        "signals.parquet": _signals_table(steps),
        "events.parquet": _events_table(steps.events),
        "traits.parquet": _traits_table(shown_traits),
    }
    content = {name: _parquet_bytes(name, table) for name, table in tables.items()}
    _check_growth(steps.agent.size, len(content["steps.parquet"]))
    return {**content, "agents.parquet": agents}


def _steps_table(steps: Steps) -> pa.Table:
    columns = [
        steps.agent,
        steps.step,
        steps.time_s[steps.step],
        steps.x,
        steps.y,
        steps.heading,
        steps.speed,
    ]
    return pa.Table.from_arrays([pa.array(c) for c in columns], schema=steps_schema(steps.exact))


def _agents_table(agents: Sequence[AgentSpec], names: Mapping[int, str]) -> pa.Table:
    columns: dict[str, list[Any]] = {
        "agent": [a.id for a in agents],
        "name": [names.get(a.id, str(a.id)) for a in agents],
        "kind": [a.kind.value for a in agents],
        "behavior": [None if a.behavior is None else a.behavior.value for a in agents],
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
    return pa.Table.from_pydict(columns, schema=AGENTS)


def _signals_table(steps: Steps) -> pa.Table:
    signals = steps.signals
    changed = np.ones(signals.shape, dtype=bool)
    changed[:, 1:] = signals[:, 1:] != signals[:, :-1]
    step, group = np.nonzero(changed.T)
    words = np.array([s.value for s in SIGNALS])
    state = words[signals[group, step]] if step.size else np.empty(0, dtype=str)
    columns = [step, steps.time_s[step], group, state.tolist()]
    arrays = [pa.array(c).cast(f.type) for c, f in zip(columns, SIGNALS_TABLE, strict=True)]
    return pa.Table.from_arrays(arrays, schema=SIGNALS_TABLE)


def _events_table(events: Sequence[Event]) -> pa.Table:
    rows = [
        {
            "time_s": e.time_s,
            "kind": e.kind.value,
            "agent": e.agent,
            "other": e.other,
            "rule": e.rule,
        }
        for e in events
    ]
    return pa.Table.from_pylist(rows, schema=EVENTS)


def _traits_table(shown: Sequence[ShownTrait]) -> pa.Table:
    columns = {
        "agent": [e.agent for e in shown],
        "trait": [e.trait.value for e in shown],
        "begin_s": [e.begin_s for e in shown],
        "end_s": [e.end_s for e in shown],
        "value": [float(e.value) for e in shown],
        "other": [None if e.other < 0 else e.other for e in shown],
    }
    return pa.Table.from_pydict(columns, schema=TRAITS_TABLE)


def _parquet_bytes(name: FileName, table: pa.Table) -> bytes:
    if name not in ("steps.parquet", "frames.parquet") and table.num_rows > MAX_OBJECTS:
        raise InputError(f"{name}: found {table.num_rows} rows, expected at most {MAX_OBJECTS}")
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, **parquet_options(table.schema))
    return cast(bytes, sink.getvalue().to_pybytes())


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """How tables of a schema are written: options of `pyarrow.parquet.ParquetWriter`."""
    numbers = [f.name for f in schema if pa.types.is_floating(f.type)]
    integers = [f.name for f in schema if pa.types.is_integer(f.type)]
    words = [
        f.name if pa.types.is_string(f.type) else f"{f.name}.list.element"
        for f in schema
        if not (f.name in numbers or f.name in integers)
    ]
    return {
        "compression": "zstd",
        "use_dictionary": words,
        "column_encoding": {
            **{name: "BYTE_STREAM_SPLIT" for name in numbers},
            **{name: "DELTA_BINARY_PACKED" for name in integers},
        },
        "store_schema": False,
    }
