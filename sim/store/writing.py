"""Writes episodes: each is one folder, named by the hash of what it was made from.

The folder appears whole or not at all; the manifest (`sim.store.catalogue`) is written last.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from behaviors.detector_inputs import ShownTrait
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Style
from behaviors.row_index import RowIndex
from sim.episode.annotate import annotate
from sim.episode.rows import TrajectoryRows
from sim.frames import KINDS, Event, Frame, Tracks
from sim.road import Road
from sim.road.files import read_road_file
from sim.scenario import AgentSpec
from sim.store.atomic import whole_folder
from sim.store.catalogue import ENTRY, canonical, checksum, keep_road
from sim.store.encode import Steps, collect, encode, encode_agents, from_tracks
from sim.store.schema import (
    EPISODE_FIELDS,
    EPISODE_VERSION,
    EpisodeEntry,
    EpisodeMeta,
    FileEntry,
)

_DETERMINING: Final[dict[str, tuple[str, ...]]] = {
    "sumo": ("libsumo",),
    "sumo-idm": ("libsumo",),
    "highway": ("highway-env",),
    "highway-krauss": ("highway-env",),
    "worlds": ("libsumo", "highway-env"),
}
"""Which packages, beside ours, numpy and pyarrow, determine an engine's bytes."""


def made_with(engine: str) -> dict[str, str]:
    """Versions of the packages that determine the bytes of an episode of this engine.

    Args:
        engine: registered name of the engine, or a recording's format key.

    Returns:
        Version by package name.
    """
    names = ("graphrqi", "numpy", "pyarrow", *_DETERMINING.get(engine, ()))
    return {name: metadata.version(name) for name in names}


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
        encode_agents(sorted(agents, key=lambda a: a.id), {}),
        None if road is None else checksum(road.read_bytes()),
    )


def _identity(
    meta: EpisodeMeta, agents: bytes, road: str | None, recorded: bytes | None = None
) -> str:
    made_from = {
        **meta.model_dump(),
        "schema_version": EPISODE_VERSION,
        "agents": checksum(agents),
        "road": road,
        "recorded": None if recorded is None else checksum(recorded),
    }
    return checksum(canonical(made_from))[:16]


def write_episode(
    folder: Path,
    meta: EpisodeMeta,
    frames: Iterable[Frame],
    agents: Sequence[AgentSpec],
    road: Path | None = None,
    since_s: float | None = None,
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
        since_s: write only what is later than this, s. Events and traits are found with all frames
            in sight. None writes everything.

    Returns:
        The manifest's entry of the episode.

    Raises:
        InputError: if a frame holds an agent that is not among ``agents``, a number that is not
            finite, or a time that does not increase; or as soon as there are more rows than can be
            read back.
        OSError: if something cannot be written; nothing of the episode is left behind.
    """
    try:
        steps = collect(frames, since_s)
    finally:
        close = getattr(frames, "close", None)
        if close is not None:
            close()
    ordered = sorted(agents, key=lambda a: a.id)
    present, _ = steps.agents()
    strangers = present[~np.isin(present, np.array([a.id for a in ordered], dtype=np.int64))]
    if strangers.size:
        raise InputError(f"frames: found agent {strangers[0]}, expected one of {len(agents)} given")
    shown: tuple[ShownTrait, ...] = ()
    if road is not None and steps.time_s.size > 2:
        events, shown = _annotated(steps, ordered, road)
        steps = dataclasses.replace(steps, events=events)
    if since_s is not None:
        steps = _later(steps, since_s)
        present, _ = steps.agents()
        shown = tuple(trait for trait in shown if trait.begin_s > since_s)
    return _write(folder, meta, steps, encode_agents(ordered, {}), int(present.size), road, shown)


def write_sensed(
    folder: Path,
    meta: EpisodeMeta,
    tracks: Tracks,
    agents: Sequence[AgentSpec],
    drawn: Sequence[AgentSpec],
    road: Path | None = None,
) -> EpisodeEntry:
    """Write what a sensor saw of a simulated episode, without events and traits.

    Args:
        folder: the dataset; created if need be. `write_manifest` completes it.
        meta: what the episode is made from.
        tracks: what the sensor recorded, sizes included; its labels are those of ``agents``.
        agents: the agent behind each track, in the tracks' order; a track has its own id.
        drawn: everyone who was drawn; with ``meta`` and the road they determine the episode.
        road: the map that the recording comes with, if any.

    Returns:
        The manifest's entry of the episode, whose id is that of `episode_id` for ``drawn``.

    Raises:
        InputError: if a number is not finite.
        OSError: if something cannot be written; nothing of the episode is left behind.
    """
    steps = collect(tracks.frames())
    named = {int(i): name for i, name in zip(tracks.ids, tracks.names, strict=True)}
    seen = zip(agents, named, tracks.length.tolist(), tracks.width.tolist(), strict=True)
    specs = [dataclasses.replace(a, id=i, length_m=long, width_m=wide) for a, i, long, wide in seen]
    made_from = encode_agents(sorted(drawn, key=lambda a: a.id), {})
    content = encode_agents(specs, named)
    return _write(folder, meta, steps, content, len(specs), road, (), made_from)


def _later(steps: Steps, since_s: float) -> Steps:
    """The part of an episode that is later than a time, s."""
    first = int(np.searchsorted(steps.time_s, since_s + 1e-9))
    kept = steps.step >= first
    columns = ("agent", "x", "y", "heading", "speed")
    return dataclasses.replace(
        steps,
        **{name: getattr(steps, name)[kept] for name in columns},
        step=(steps.step[kept] - first).astype(np.int32),
        time_s=steps.time_s[first:],
        signals=steps.signals[:, first:],
        events=tuple(event for event in steps.events if event.time_s > since_s + 1e-9),
    )


def _annotated(
    steps: Steps, agents: Sequence[AgentSpec], road: Path
) -> tuple[tuple[Event, ...], tuple[ShownTrait, ...]]:
    """Events and shown traits of the rounded steps, which are what a reader gets."""
    every = np.array([a.id for a in agents], dtype=np.int64)
    ids, counts = steps.agents()
    row = np.repeat(np.arange(ids.size), counts)
    specs = [agents[i] for i in np.searchsorted(every, ids)]
    rows = TrajectoryRows(
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
    found = annotate(rows, read_road_file(road))
    return found.events, found.shown_traits


def write_recording(
    folder: Path,
    meta: EpisodeMeta,
    tracks: Tracks,
    road: Path | Road | None = None,
    styles: Mapping[str, Style] = MappingProxyType({}),
) -> EpisodeEntry:
    """Write tracks that come from elsewhere as one episode, exactly as they are.

    Args:
        folder: the dataset; created if need be. `write_manifest` completes it.
        meta: where the recording comes from.
        tracks: the recording.
        road: the road that it happened on, or the file of its SUMO net or Argoverse 2 map.
        styles: by name, of the drivers of whom the style is known but not the behaviour.

    Returns:
        The manifest's entry of the episode.

    Raises:
        InputError: if a number is not finite where it is valid.
        OSError: if something cannot be written; nothing of the episode is left behind.
    """
    steps = from_tracks(tracks)
    n = tracks.ids.size
    codes = np.full(n, -1) if tracks.behavior is None else tracks.behavior
    rows = tracks.as_rows()
    first_s = tracks.time_s[rows.first_steps()] if tracks.time_s.size else np.zeros(n)
    agents = [
        AgentSpec(
            id=int(tracks.ids[i]),
            kind=KINDS[tracks.kind[i]],
            behavior=None if codes[i] < 0 else BEHAVIORS[codes[i]],
            profile=None,
            route=(),
            depart_s=float(first_s[i]),
            length_m=float(tracks.length[i]),
            width_m=float(tracks.width[i]),
            style_label=styles.get(tracks.names[i]) if codes[i] < 0 else None,
        )
        for i in range(n)
    ]
    names = {int(i): name for i, name in zip(tracks.ids, tracks.names, strict=True)}
    seen = int((np.diff(rows.index.first) > 0).sum())
    return _write(folder, meta, steps, encode_agents(agents, names), seen, road, ())


def _write(
    folder: Path,
    meta: EpisodeMeta,
    steps: Steps,
    agents: bytes,
    seen: int,
    road: Path | Road | None,
    shown: Sequence[ShownTrait],
    made_from: bytes | None = None,
) -> EpisodeEntry:
    """Write an episode; ``made_from``: agents that determine its id, by default its own."""
    content = encode(steps, agents, shown)
    road_sha256 = None if road is None else keep_road(folder, road)
    recorded = content["steps.parquet"] if steps.exact else None
    identity = _identity(meta, made_from or agents, road_sha256, recorded)
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
            files={n: FileEntry(sha256=checksum(d), size=len(d)) for n, d in content.items()},
        )
        (partial / ENTRY).write_bytes(canonical(entry.model_dump(include=set(EPISODE_FIELDS))))
    return entry
