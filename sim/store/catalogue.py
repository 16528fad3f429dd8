"""What a dataset's folder holds: its manifest, the entries of its episodes, and its roads."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar, cast

from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from behaviors.errors import InputError
from sim.invalid_fields import first_wrong_field
from sim.road import Road
from sim.road.files import ENDINGS
from sim.road.maps.stored import SUFFIX, encode_road
from sim.store.atomic import write_whole
from sim.store.schema import EPISODE_FILES, SCHEMA_VERSION, EpisodeEntry, FileName, Manifest

M = TypeVar("M", bound=BaseModel)

MANIFEST: Final = "manifest.json"
ENTRY: Final = "episode.json"

MAX_JSON_BYTES: Final = 2**28
"""Largest manifest that is read (our choice: some 300 000 episodes)."""


def checksum(data: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def canonical(value: object) -> bytes:
    """JSON with sorted keys, so that equal values have equal bytes."""
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False).encode() + b"\n"


def road_path(folder: Path, sha256: str) -> Path:
    """Where a dataset keeps a road.

    Args:
        folder: the dataset.
        sha256: checksum of the road's file.

    Returns:
        The file with its map if there is one, else where its SUMO net would be.
    """
    kept = [folder / "roads" / f"{sha256}{ending}" for ending in ENDINGS]
    return next((path for path in kept if path.is_file()), kept[-1])


def road_bytes(road: Path | Road) -> bytes:
    """What a dataset keeps of a road: a file as it is, anything else as a file of ours.

    Args:
        road: a SUMO net or an Argoverse 2 map, or a road that has no such file.

    Returns:
        The file's content.

    Raises:
        OSError: if the file cannot be read.
    """
    return encode_road(road) if isinstance(road, Road) else road.read_bytes()


def keep_road(folder: Path, road: Path | Road) -> str:
    """Put a road into a dataset, unless it is there already, unaltered.

    Args:
        folder: the dataset.
        road: as for `road_bytes`.

    Returns:
        Its checksum.

    Raises:
        OSError: if it cannot be read or written.
    """
    data = road_bytes(road)
    sha256 = checksum(data)
    name = SUFFIX if isinstance(road, Road) else road.name
    ending = next((e for e in ENDINGS if name.endswith(e)), ENDINGS[-1])
    path = folder / "roads" / f"{sha256}{ending}"
    if not path.exists() or checksum(path.read_bytes()) != sha256:
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
        entry = validated(EpisodeEntry, home / ENTRY)
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
            yield validated(EpisodeEntry, path)


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
        or checksum(path.read_bytes()) != file.sha256
    ]
    if entry.road is not None:
        road = road_path(folder, entry.road)
        if not road.is_file() or checksum(road.read_bytes()) != entry.road:
            altered.append(road)
    return altered


def write_manifest(
    folder: Path, configuration: Mapping[str, JsonValue], entries: Iterable[EpisodeEntry]
) -> Manifest:
    """Complete a dataset: list its episodes.

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
    write_whole(folder / MANIFEST, canonical(manifest.model_dump()))
    return manifest


class _Versioned(BaseModel):
    """The one field that every version of the manifest has."""

    model_config = ConfigDict(extra="ignore")
    schema_version: int


def validated(model: type[M], path: Path) -> M:
    """A JSON file as a model; everything that can be wrong with it is one `InputError`."""
    size = path.stat().st_size
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected one")
    if size > MAX_JSON_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_JSON_BYTES}")
    try:
        return model.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a dataset.

    Args:
        folder: the dataset.

    Returns:
        What is inside.

    Raises:
        InputError: if there is no manifest, or it is broken or of another version.
    """
    manifest = folder / MANIFEST
    if not folder.exists():
        raise InputError(f"{folder}: found nothing there, expected a dataset")
    if not folder.is_dir():
        raise InputError(f"{folder}: found a file, expected a dataset (import makes one of it)")
    if not manifest.is_file():
        raise InputError(
            f"{manifest}: found no file; if the dataset is unfinished, run the same generate again"
        )
    version = validated(_Versioned, manifest).schema_version
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{manifest}: found schema_version {version}, expected {SCHEMA_VERSION}"
            + ("; a newer graphrqi reads it" if version > SCHEMA_VERSION else "")
        )
    return validated(Manifest, manifest)


def checked_bytes(path: Path, entry: EpisodeEntry) -> bytes:
    """The content of an episode's file, which must be as the manifest says."""
    expected = entry.files.get(cast(FileName, path.name))
    if expected is None:
        raise InputError(f"{path}: found no checksum of it in the manifest, expected one")
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected one of {expected.size} bytes")
    size = path.stat().st_size
    if size != expected.size:
        raise InputError(f"{path}: found {size} bytes, expected {expected.size}")
    data = path.read_bytes()
    if checksum(data) != expected.sha256:
        raise InputError(f"{path}: found another content, expected sha256 {expected.sha256}")
    return data
