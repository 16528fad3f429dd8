"""Labelled episodes on disk: written whole, listed with checksums, read back as arrays.

What the files hold is said in `sim.store.schema`. An episode is one folder, named by the hash of
what it was made from, and appears whole or not at all; the manifest is written last.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Trait
from behaviors.profiles import PROFILE_FIELDS, Profile
from behaviors.row_index import RowIndex
from behaviors.traits import Exhibit
from sim.episode.annotate import Watched, watch
from sim.episode.rows import TrajectoryRows
from sim.frames import KINDS, SIGNALS, AgentKind, Event, EventKind, Frame, Tracks
from sim.road import Road
from sim.road.files import MAP_SUFFIX, read_road_file
from sim.scenario import AgentSpec
from sim.store.atomic import whole_folder, write_whole
from sim.store.schema import (
    AGENTS,
    EPISODE_FILES,
    EVENTS,
    FRAMES,
    HEADING_QUANTUM,
    POSITION_QUANTUM,
    SCHEMA_VERSION,
    SIGNALS_TABLE,
    TRAITS_TABLE,
    EpisodeEntry,
    EpisodeMeta,
    FileEntry,
    FileName,
    Manifest,
    Split,
    steps_schema,
)

M = TypeVar("M", bound=BaseModel)

MANIFEST: Final = "manifest.json"
ENTRY: Final = "episode.json"

MAX_JSON_BYTES: Final = 2**28
"""Largest manifest that is read (our choice: some 300 000 episodes)."""

MAX_CELLS: Final = 10**8
"""Most agents times steps that one episode may have as dense arrays (our choice: 3 GB)."""

MAX_OBJECTS: Final = 10**6
"""Most agents, events, traits, changes of lights and edges of routes that one episode may have (our
choice: as many agents as a recording may have; as Python objects they take up to 3 GB)."""

MAX_TEXT_BYTES: Final = 2**28
"""Most bytes that the texts of one column may take (our choice: 256 MiB, 268 for each object)."""

_DETERMINING: Final[dict[str, tuple[str, ...]]] = {
    "sumo": ("libsumo",),
    "sumo-idm": ("libsumo",),
    "highway": ("highway-env",),
    "highway-krauss": ("highway-env",),
}
"""Which packages, beside ours, numpy and pyarrow, determine an engine's bytes."""

_CHUNK_FRAMES: Final = 256
"""Frames collected before they are packed (our choice)."""


def made_with(engine: str) -> dict[str, str]:
    """Versions of the packages that determine the bytes of an episode of this engine.

    Args:
        engine: registered name of the engine, or a recording's format key.

    Returns:
        Version by package name.
    """
    names = ("graphrqi", "numpy", "pyarrow", *_DETERMINING.get(engine, ()))
    return {name: metadata.version(name) for name in names}


# --- steps --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Steps:
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


def _collect(frames: Iterable[Frame]) -> _Steps:
    """Pack frames, a chunk at a time, and sort the rows by agent, then step."""
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
        chunk.append(frame)
        times.append(frame.time_s)
        signals.append(frame.signals)
        events.extend(frame.events)
        if len(chunk) == _CHUNK_FRAMES:
            pack()
    if chunk or not packed:
        chunk = chunk or [_no_agents()]
        pack()
    agent, step, x, y, heading, speed = (np.concatenate(part) for part in zip(*packed, strict=True))
    packed.clear()
    order = np.argsort(agent, kind="stable")
    return _Steps(
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


def _no_agents() -> Frame:
    none, codes = np.empty(0), np.empty(0, dtype=np.int8)
    return Frame(0.0, codes.astype(np.int64), np.empty((0, 2)), none, none, none, none, codes)


def _from_tracks(tracks: Tracks) -> _Steps:
    row, step = np.nonzero(tracks.valid)
    return _Steps(
        agent=tracks.ids[row],
        step=step.astype(np.int32),
        time_s=np.asarray(tracks.time_s),
        x=tracks.xy[row, step, 0],
        y=tracks.xy[row, step, 1],
        heading=tracks.heading[row, step],
        speed=tracks.speed[row, step],
        signals=np.asarray(tracks.signals),
        events=tracks.events,
    )


def _check_finite(steps: _Steps) -> None:
    for name in ("x", "y", "heading", "speed"):
        bad = np.flatnonzero(~np.isfinite(getattr(steps, name)))
        if bad.size:
            at = int(bad[0])
            raise InputError(
                f"{name} of agent {steps.agent[at]} at step {steps.step[at]}: found "
                f"{getattr(steps, name)[at]}, expected a finite number"
            )


# --- tables -------------------------------------------------------------------------------------


def _steps_table(steps: _Steps) -> pa.Table:
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
        "style": [None if a.behavior is None else a.behavior.style.value for a in agents],
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


def _signals_table(steps: _Steps) -> pa.Table:
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


def _traits_table(exhibits: Sequence[Exhibit]) -> pa.Table:
    columns = {
        "agent": [e.agent for e in exhibits],
        "trait": [e.trait.value for e in exhibits],
        "begin_s": [e.begin_s for e in exhibits],
        "end_s": [e.end_s for e in exhibits],
        "value": [float(e.value) for e in exhibits],
        "other": [None if e.other < 0 else e.other for e in exhibits],
    }
    return pa.Table.from_pydict(columns, schema=TRAITS_TABLE)


def _parquet_bytes(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    numbers = [f.name for f in table.schema if pa.types.is_floating(f.type)]
    integers = [f.name for f in table.schema if pa.types.is_integer(f.type)]
    words = [
        f.name if pa.types.is_string(f.type) else f"{f.name}.list.element"
        for f in table.schema
        if not (f.name in numbers or f.name in integers)
    ]
    pq.write_table(
        table,
        sink,
        compression="zstd",
        use_dictionary=words,
        column_encoding={
            **{name: "BYTE_STREAM_SPLIT" for name in numbers},
            **{name: "DELTA_BINARY_PACKED" for name in integers},
        },
        store_schema=False,
    )
    return cast(bytes, sink.getvalue().to_pybytes())


# --- writing ------------------------------------------------------------------------------------


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _canonical(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False).encode() + b"\n"


def episode_id(meta: EpisodeMeta, agents: Sequence[AgentSpec], road: Path | None = None) -> str:
    """The name of an episode: the hash of everything that determines its content.

    Args:
        meta: what it is made from.
        agents: everyone who may appear in it.
        road: its SUMO net, if any.

    Returns:
        16 hexadecimal digits.
    """
    return _identity(
        meta,
        _parquet_bytes(_agents_table(sorted(agents, key=lambda a: a.id), {})),
        None if road is None else _sha256(road.read_bytes()),
    )


def _identity(
    meta: EpisodeMeta, agents: bytes, road: str | None, recorded: bytes | None = None
) -> str:
    made_from = {
        **meta.model_dump(),
        "schema_version": SCHEMA_VERSION,
        "agents": _sha256(agents),
        "road": road,
        "recorded": None if recorded is None else _sha256(recorded),
    }
    return _sha256(_canonical(made_from))[:16]


def write_episode(
    folder: Path,
    meta: EpisodeMeta,
    frames: Iterable[Frame],
    agents: Sequence[AgentSpec],
    road: Path | None = None,
) -> EpisodeEntry:
    """Run frames to their end and write them as one episode.

    Args:
        folder: the dataset; created if need be. `write_manifest` completes it.
        meta: what the episode is made from.
        frames: the episode, in time order; closed here, also on an error.
        agents: everyone who may appear in a frame.
        road: the SUMO net that the episode happened on (``scenario.road.source``); with it the
            events are completed (rules kept and broken, near misses, causes) and the traits that
            were shown are found.

    Returns:
        The manifest's entry of the episode.

    Raises:
        InputError: if a frame holds an agent that is not among ``agents``, a number that is not
            finite, or a time that does not increase.
        OSError: if something cannot be written; nothing of the episode is left behind.
    """
    try:
        steps = _collect(frames)
    finally:
        close = getattr(frames, "close", None)
        if close is not None:
            close()
    ordered = sorted(agents, key=lambda a: a.id)
    seen, _ = steps.agents()
    strangers = seen[~np.isin(seen, np.array([a.id for a in ordered], dtype=np.int64))]
    if strangers.size:
        raise InputError(f"frames: found agent {strangers[0]}, expected one of {len(agents)} given")
    exhibits: tuple[Exhibit, ...] = ()
    if road is not None and steps.time_s.size > 2:
        watched = _watched(steps, ordered, road)
        steps, exhibits = dataclasses.replace(steps, events=watched.events), watched.exhibits
    agents_table = _agents_table(ordered, {})
    return _write(folder, meta, steps, agents_table, int(seen.size), road, exhibits)


def _watched(steps: _Steps, agents: Sequence[AgentSpec], road: Path) -> Watched:
    """What is told of the steps as they are read back."""
    every = np.array([a.id for a in agents], dtype=np.int64)
    ids, counts = steps.agents()
    row = np.repeat(np.arange(ids.size), counts)
    specs = [agents[i] for i in np.searchsorted(every, ids)]
    told = TrajectoryRows(
        row_index=RowIndex.of_rows(row, steps.step.astype(np.int64), ids.size, steps.time_s.size),
        ids=ids,
        kind=np.array([a.kind.code for a in specs], dtype=np.int8),
        length=np.array([a.length_m for a in specs]),
        width=np.array([a.width_m for a in specs]),
        time_s=steps.time_s,
        step_s=float(np.median(np.diff(steps.time_s))),
        xy=np.stack([steps.x, steps.y], axis=1).astype(np.float64),
        heading=steps.heading.astype(np.float64),
        speed=steps.speed.astype(np.float64),
        signals=steps.signals,
        events=steps.events,
    )
    return watch(told, read_road_file(road))


def write_recording(
    folder: Path, meta: EpisodeMeta, tracks: Tracks, road: Path | None = None
) -> EpisodeEntry:
    """Write tracks that come from elsewhere as one episode, exactly as they are.

    Args:
        folder: the dataset; created if need be. `write_manifest` completes it.
        meta: where the recording comes from.
        tracks: the recording.
        road: the SUMO net or Argoverse 2 map that it happened on, if there is one.

    Returns:
        The manifest's entry of the episode.

    Raises:
        InputError: if a number is not finite where it is valid.
        OSError: if something cannot be written; nothing of the episode is left behind.
    """
    steps = _from_tracks(tracks)
    codes = np.full(tracks.ids.size, -1) if tracks.behavior is None else tracks.behavior
    first = np.argmax(tracks.valid, axis=1) if tracks.time_s.size else np.zeros(tracks.ids.size)
    agents = [
        AgentSpec(
            id=int(tracks.ids[i]),
            kind=KINDS[tracks.kind[i]],
            behavior=None if codes[i] < 0 else BEHAVIORS[codes[i]],
            profile=None,
            route=(),
            depart_s=float(tracks.time_s[int(first[i])]) if tracks.time_s.size else 0.0,
            length_m=float(tracks.length[i]),
            width_m=float(tracks.width[i]),
        )
        for i in range(tracks.ids.size)
    ]
    names = {int(i): name for i, name in zip(tracks.ids, tracks.names, strict=True)}
    seen = int(tracks.valid.any(axis=1).sum())
    return _write(folder, meta, steps, _agents_table(agents, names), seen, road, ())


def _write(
    folder: Path,
    meta: EpisodeMeta,
    steps: _Steps,
    agents: pa.Table,
    seen: int,
    road: Path | None,
    exhibits: Sequence[Exhibit],
) -> EpisodeEntry:
    _check_finite(steps)
    road_sha256 = None if road is None else keep_road(folder, road)
    tables: dict[FileName, pa.Table] = {
        "steps.parquet": _steps_table(steps),
        "agents.parquet": agents,
        "frames.parquet": pa.Table.from_arrays([pa.array(steps.time_s)], schema=FRAMES),
        "signals.parquet": _signals_table(steps),
        "events.parquet": _events_table(steps.events),
        "traits.parquet": _traits_table(exhibits),
    }
    for name in ("agents.parquet", "signals.parquet", "events.parquet", "traits.parquet"):
        if tables[name].num_rows > MAX_OBJECTS:
            raise InputError(
                f"{name}: found {tables[name].num_rows} rows, expected at most {MAX_OBJECTS}"
            )
    content = {name: _parquet_bytes(table) for name, table in tables.items()}
    recorded = content["steps.parquet"] if steps.exact else None
    identity = _identity(meta, content["agents.parquet"], road_sha256, recorded)
    with whole_folder(folder / "episodes" / identity) as partial:
        for name, data in content.items():
            (partial / name).write_bytes(data)
        entry = EpisodeEntry(
            **meta.model_dump(),
            id=identity,
            road=road_sha256,
            frames=int(steps.time_s.size),
            agents=seen,
            agent_steps=int(steps.agent.size),
            files={n: FileEntry(sha256=_sha256(d), size=len(d)) for n, d in content.items()},
        )
        (partial / ENTRY).write_bytes(_canonical(entry.model_dump()))
    return entry


def road_path(folder: Path, sha256: str) -> Path:
    """Where a dataset keeps a road.

    Args:
        folder: the dataset.
        sha256: checksum of the road's file.

    Returns:
        The file with its map if there is one, else that of its SUMO net.
    """
    kept = folder / "roads" / f"{sha256}{MAP_SUFFIX}"
    return kept if kept.is_file() else kept.with_name(f"{sha256}.net.xml")


def keep_road(folder: Path, road: Path) -> str:
    """Copy a road into a dataset, unless it is there already, unaltered.

    Args:
        folder: the dataset.
        road: a SUMO net or an Argoverse 2 map.

    Returns:
        Its checksum.

    Raises:
        OSError: if it cannot be read or written.
    """
    data = road.read_bytes()
    sha256 = _sha256(data)
    ending = MAP_SUFFIX if road.suffix == MAP_SUFFIX else ".net.xml"
    path = folder / "roads" / f"{sha256}{ending}"
    if not path.exists() or _sha256(path.read_bytes()) != sha256:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data)
    return sha256


def finished_episode(folder: Path, identity: str) -> EpisodeEntry | None:
    """The entry of an episode that is there, whole and unaltered.

    Args:
        folder: the dataset.
        identity: the episode's id.

    Returns:
        Its entry; None if it has to be made (again).
    """
    home = folder / "episodes" / identity
    try:
        entry = _validated(EpisodeEntry, home / ENTRY)
        if entry.id != identity or altered_files(folder, entry):
            return None
    except (InputError, FileNotFoundError):
        return None
    return entry


def unlisted_episodes(folder: Path) -> Iterator[EpisodeEntry]:
    """The entries of the episodes that are in a folder, whether a manifest lists them or not.

    Args:
        folder: the dataset.

    Yields:
        Each readable ``episode.json``, in order of id.
    """
    for path in sorted((folder / "episodes").glob(f"[0-9a-f]*/{ENTRY}")):
        with suppress(InputError):
            yield _validated(EpisodeEntry, path)


def altered_files(folder: Path, entry: EpisodeEntry) -> list[Path]:
    """The files of an episode that are missing or not as the entry says, its road included.

    Args:
        folder: the dataset.
        entry: the episode.

    Returns:
        Paths; empty if all is well.
    """
    home = folder / "episodes" / entry.id
    expected = [(home / n, entry.files.get(n)) for n in cast("tuple[FileName, ...]", EPISODE_FILES)]
    altered = [
        path
        for path, file in expected
        if file is None
        or not path.is_file()
        or path.stat().st_size != file.size
        or _sha256(path.read_bytes()) != file.sha256
    ]
    if entry.road is not None:
        road = road_path(folder, entry.road)
        if not road.is_file() or _sha256(road.read_bytes()) != entry.road:
            altered.append(road)
    return altered


def write_manifest(
    folder: Path, configuration: Mapping[str, JsonValue], entries: Iterable[EpisodeEntry]
) -> Manifest:
    """Complete a dataset: list its episodes, and describe them for people.

    Args:
        folder: the dataset.
        configuration: what it was generated or imported with.
        entries: its episodes.

    Returns:
        The manifest that was written.

    Raises:
        OSError: if it cannot be written; an older one is then still there, whole.
    """
    ordered = tuple(sorted(entries, key=lambda e: (e.scenario, e.engine, e.index, e.id)))
    roads = sorted({e.road for e in ordered if e.road is not None})
    manifest = Manifest(
        schema_version=SCHEMA_VERSION,
        configuration=dict(configuration),
        roads={sha256: road_path(folder, sha256).stat().st_size for sha256 in roads},
        episodes=ordered,
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / MANIFEST, _canonical(manifest.model_dump()))
    return manifest


# --- reading ------------------------------------------------------------------------------------


class _Versioned(BaseModel):
    """The one field that every version of the manifest has."""

    model_config = ConfigDict(extra="ignore")
    schema_version: int


def _first_error(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"{where}: {first['msg']}" if where else first["msg"]


def _validated(model: type[M], path: Path) -> M:
    size = path.stat().st_size
    if size > MAX_JSON_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_JSON_BYTES}")
    try:
        return model.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise InputError(f"{path}: {_first_error(error)}") from None


@dataclass(frozen=True)
class Episode:
    """One episode in memory.

    Attributes:
        entry: what it is and how it was made.
        tracks: everyone that was seen, with labels in ``tracks.behavior``.
        agents: everyone that was drawn, seen or not, in order of id.
        exhibits: the traits that were shown; ``agent`` and ``other`` are agent ids (-1: nobody).
    """

    entry: EpisodeEntry
    tracks: Tracks
    agents: tuple[AgentSpec, ...]
    exhibits: tuple[Exhibit, ...] = ()


@dataclass(frozen=True)
class Dataset:
    """A dataset whose manifest has been read and found valid.

    Attributes:
        path: its folder.
        manifest: what is inside.
    """

    path: Path
    manifest: Manifest

    def episodes(
        self, split: Split | None = None, scenario: str | None = None
    ) -> tuple[EpisodeEntry, ...]:
        """The episodes of a split and a scenario, in the manifest's order.

        Args:
            split: only this part of the data; None for all.
            scenario: only this scenario; None for all.

        Returns:
            Their entries.
        """
        return tuple(
            e
            for e in self.manifest.episodes
            if split in (None, e.split) and scenario in (None, e.scenario)
        )

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that have episodes, sorted."""
        return tuple(sorted({e.scenario for e in self.manifest.episodes}))

    def read(self, entry: EpisodeEntry) -> Episode:
        """Read an episode, checking every file against its checksum.

        Args:
            entry: one of `episodes`.

        Returns:
            Its tracks and agents.

        Raises:
            InputError: if a file is missing, altered, or does not fit the schema; names the file.
        """
        home = self.path / "episodes" / entry.id
        tables = {name: _checked_bytes(home / name, entry) for name in EPISODE_FILES}
        return _read_episode(home, entry, tables)

    def road(self, entry: EpisodeEntry) -> Road | None:
        """The road an episode happened on.

        Args:
            entry: one of `episodes`.

        Returns:
            The road; None where it is not known.

        Raises:
            InputError: if the net is missing or altered.
        """
        if entry.road is None:
            return None

        path = road_path(self.path, entry.road)
        if not path.is_file():
            raise InputError(f"{path}: found no file, expected the road of episode {entry.id}")
        if _sha256(path.read_bytes()) != entry.road:
            raise InputError(f"{path}: found another checksum than its name, expected it unaltered")
        return read_road_file(path, entry.scenario)


def open_dataset(path: str | Path) -> Dataset:
    """Open a dataset folder.

    Args:
        path: the folder that holds ``manifest.json``.

    Returns:
        The dataset; episodes are read when asked for.

    Raises:
        InputError: if there is no manifest, or it is broken or of a newer version.
    """
    folder = Path(path)
    manifest = folder / MANIFEST
    if not folder.exists():
        raise InputError(f"{folder}: found nothing there, expected a dataset")
    if not folder.is_dir():
        raise InputError(f"{folder}: found a file, expected a dataset (import makes one of it)")
    if not manifest.is_file():
        raise InputError(
            f"{manifest}: found no file; if the dataset is unfinished, run the same generate again"
        )
    version = _validated(_Versioned, manifest).schema_version
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{manifest}: found schema_version {version}, expected {SCHEMA_VERSION}"
            + ("; a newer graphrqi reads it" if version > SCHEMA_VERSION else "")
        )
    return Dataset(folder, _validated(Manifest, manifest))


def _checked_bytes(path: Path, entry: EpisodeEntry) -> bytes:
    expected = entry.files.get(cast(FileName, path.name))
    if expected is None:
        raise InputError(f"{path}: found no checksum of it in the manifest, expected one")
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected one of {expected.size} bytes")
    size = path.stat().st_size
    if size != expected.size:
        raise InputError(f"{path}: found {size} bytes, expected {expected.size}")
    data = path.read_bytes()
    if _sha256(data) != expected.sha256:
        raise InputError(f"{path}: found another content, expected sha256 {expected.sha256}")
    return data


def _read_table(
    path: Path, data: bytes, schemas: Sequence[pa.Schema], max_rows: int, columns: list[str] | None
) -> pa.Table:
    """A table that has one of the schemas; every way it can be broken is one InputError."""
    try:
        file = pq.ParquetFile(pa.BufferReader(data))
        found = file.schema_arrow.remove_metadata()
        if not any(_same_columns(found, schema) for schema in schemas):
            raise InputError(f"{path}: {_first_difference(found, schemas[0])}")
        texts = _check_amount(path, file, max_rows)
        # A small file can repeat a long text for every row: read with each text in memory once.
        packed = pq.ParquetFile(
            pa.BufferReader(data), metadata=file.metadata, read_dictionary=texts
        ).read(columns=columns, use_threads=False)
        packed.validate(full=True)  # words are valid UTF-8, offsets are inside
        table = _spelled_out(path, packed, found)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: found no readable Parquet table ({reason})") from None
    return table


def _check_amount(path: Path, file: Any, max_rows: int) -> list[str]:
    """Refuse more rows than there may be; the names of the columns of texts."""
    groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
    texts: list[str] = []
    for place in range(file.metadata.num_columns):
        chunks = [group.column(place) for group in groups]
        rows = sum(chunk.num_values for chunk in chunks)  # the edges of all routes, for routes
        if rows > max_rows:
            raise InputError(f"{path}: found {rows} rows, expected at most {max_rows}")
        if file.schema.column(place).physical_type == "BYTE_ARRAY":
            _check_text_bytes(path, sum(chunk.total_uncompressed_size for chunk in chunks))
            texts.append(file.schema.column(place).path)
    return texts


def _spelled_out(path: Path, packed: pa.Table, schema: pa.Schema) -> pa.Table:
    """The texts of every row, unless they would not fit into memory."""
    for column in packed.columns:
        flat = pc.list_flatten(column) if pa.types.is_list(column.type) else column
        if pa.types.is_dictionary(flat.type):
            longest = [pc.max(pc.binary_length(part.dictionary)).as_py() for part in flat.chunks]
            _check_text_bytes(path, len(flat) * max((n or 0 for n in longest), default=0))
    return packed.cast(pa.schema([schema.field(name) for name in packed.column_names]))


def _check_text_bytes(path: Path, size: int) -> None:
    if size > MAX_TEXT_BYTES:
        raise InputError(
            f"{path}: found texts of up to {size} bytes in a column, expected at most "
            f"{MAX_TEXT_BYTES}"
        )


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


def _read_episode(home: Path, entry: EpisodeEntry, data: Mapping[str, bytes]) -> Episode:
    agents_path, frames_path = home / "agents.parquet", home / "frames.parquet"
    agents = _read_table(agents_path, data["agents.parquet"], [AGENTS], MAX_OBJECTS, None)
    frames = _read_table(
        frames_path, data["frames.parquet"], [FRAMES], min(entry.frames, MAX_CELLS), None
    )
    time_s = _numbers(frames_path, frames, "time_s")
    if time_s.size != entry.frames or (np.diff(time_s) <= 0).any():
        raise InputError(f"{frames_path}: expected {entry.frames} times, each after the one before")
    if agents.num_rows * time_s.size > MAX_CELLS:
        raise InputError(
            f"{agents_path}: found {agents.num_rows} agents in {time_s.size} steps, expected "
            f"agents times steps at most {MAX_CELLS}"
        )
    ids = _numbers(agents_path, agents, "agent")
    if (np.diff(ids) <= 0).any():
        raise InputError(f"{agents_path}: found agents out of order, expected ascending ids")
    dense = _read_steps(home / "steps.parquet", entry, data["steps.parquet"], ids, time_s.size)
    seen = np.flatnonzero(dense.valid.any(axis=1))
    behavior = _codes(agents_path, agents, "behavior", BEHAVIORS, optional=True)[seen]
    specs = _agent_specs(agents_path, agents)
    names = agents.column("name").to_pylist()
    sizes = {c: _numbers(agents_path, agents, c)[seen] for c in ("length_m", "width_m")}
    take = slice(None) if seen.size == ids.size else seen
    tracks = Tracks(
        ids=ids[seen],
        names=tuple(names[i] for i in seen),
        kind=_codes(agents_path, agents, "kind", KINDS)[seen],
        length=sizes["length_m"],
        width=sizes["width_m"],
        time_s=time_s,
        xy=dense.xy[take],
        heading=dense.heading[take],
        speed=dense.speed[take],
        valid=dense.valid[take],
        signals=_read_signals(home / "signals.parquet", data["signals.parquet"], time_s.size),
        behavior=behavior if (behavior >= 0).any() else None,
        events=_read_events(home / "events.parquet", data["events.parquet"]),
    )
    exhibits = _read_exhibits(home / "traits.parquet", data["traits.parquet"])
    return Episode(entry, tracks, specs, exhibits)


@dataclass(frozen=True, slots=True)
class _Dense:
    xy: NDArray[np.float64]
    heading: NDArray[np.float64]
    speed: NDArray[np.float64]
    valid: NDArray[np.bool_]


def _read_steps(
    path: Path, entry: EpisodeEntry, data: bytes, ids: NDArray[np.int64], steps: int
) -> _Dense:
    columns = ["agent", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
    schemas = [steps_schema(exact=False), steps_schema(exact=True)]
    max_rows = min(entry.agent_steps, ids.size * steps)
    table = _read_table(path, data, schemas, max_rows, columns)
    agent, step, x, y, heading, speed = (_numbers(path, table, c) for c in columns)
    starts = np.flatnonzero(np.diff(agent, prepend=agent[:1] - 1)) if agent.size else agent
    runs = agent[starts]
    row = np.searchsorted(ids, runs)
    if (row >= ids.size).any() or (ids[row] != runs).any():
        raise InputError(f"{path}: found an agent that agents.parquet does not have")
    if agent.size and not 0 <= int(step.min()) <= int(step.max()) < steps:
        raise InputError(f"{path}: found a step outside of 0 to {steps - 1}")
    counts = np.diff(starts, append=agent.size)
    cell = np.repeat(row * steps, counts) + step
    if (np.diff(cell) <= 0).any():
        raise InputError(f"{path}: found rows out of order, expected them by agent, then step")
    xy = np.full((ids.size, steps, 2), np.nan)
    flat = xy.reshape(-1, 2)
    flat[cell, 0] = x
    flat[cell, 1] = y
    dense = [np.full((ids.size, steps), np.nan) for _ in range(2)]
    dense[0].reshape(-1)[cell] = heading
    dense[1].reshape(-1)[cell] = speed
    valid = np.zeros((ids.size, steps), dtype=bool)
    valid.reshape(-1)[cell] = True
    return _Dense(xy, dense[0], dense[1], valid)


def _read_signals(path: Path, data: bytes, steps: int) -> NDArray[np.int8]:
    table = _read_table(path, data, [SIGNALS_TABLE], MAX_OBJECTS, None)
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


def _read_events(path: Path, data: bytes) -> tuple[Event, ...]:
    table = _read_table(path, data, [EVENTS], MAX_OBJECTS, None)
    kinds = [k.value for k in EventKind]
    _codes(path, table, "kind", kinds)
    _numbers(path, table, "time_s")
    _numbers(path, table, "agent")
    return tuple(
        Event(EventKind(r["kind"]), r["time_s"], r["agent"], r["other"], r["rule"] or "")
        for r in table.to_pylist()
    )


def _read_exhibits(path: Path, data: bytes) -> tuple[Exhibit, ...]:
    table = _read_table(path, data, [TRAITS_TABLE], MAX_OBJECTS, None)
    _codes(path, table, "trait", tuple(Trait))
    for name in ("agent", "begin_s", "end_s", "value"):
        _numbers(path, table, name)
    return tuple(
        Exhibit(
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
            )
        )
    return tuple(specs)
