"""What a dataset's folder holds beside shards.

That is its roads, episodes with files of their own, and the manifest of schema version 1.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final, TypeVar, cast

from pydantic import BaseModel, ValidationError

from behaviors.errors import InputError
from sim.invalid_fields import first_wrong_field
from sim.road import Road
from sim.road.files import ENDINGS
from sim.road.maps.stored import SUFFIX, encode_road
from sim.store.atomic import write_whole
from sim.store.decode import EpisodeFiles, Tables
from sim.store.entries import EPISODES, Versioned, check_version
from sim.store.places import Folder, Place, file_checksum, place_of
from sim.store.schema import EPISODE_FILES, EpisodeEntry, FileEntry, FileName, Manifest
from sim.store.shards import ShardTables

M = TypeVar("M", bound=BaseModel)

MANIFEST: Final = "manifest.json"
ENTRY: Final = "episode.json"

MAX_JSON_BYTES: Final = 2**28
"""Largest manifest that is read (some 300 000 episodes)."""


def checksum(data: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def canonical(value: object) -> bytes:
    """JSON with sorted keys, so that equal values have equal bytes."""
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False).encode() + b"\n"


def road_name(place: Place, sha256: str) -> str:
    """Under which name a dataset keeps a road.

    Args:
        place: the dataset.
        sha256: checksum of the road's file.

    Returns:
        The file with its map if there is one, else where its SUMO net would be.
    """
    kept = [f"roads/{sha256}{ending}" for ending in ENDINGS]
    return next((name for name in kept if place.size(name) is not None), kept[-1])


def road_path(folder: Path, sha256: str) -> Path:
    """The path of a dataset's road; see `road_name`."""
    return folder / road_name(Folder(folder), sha256)


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
    place, altered = Folder(folder), list[Path]()
    for name in cast("tuple[FileName, ...]", EPISODE_FILES):
        path, file = f"episodes/{entry.id}/{name}", entry.files.get(name)
        if file is None or not is_unaltered(place, path, file):
            altered.append(folder / path)
    if entry.road is not None and not road_is_sound(place, entry.road):
        altered.append(road_path(folder, entry.road))
    return altered


def is_unaltered(place: Place, name: str, file: FileEntry, hashed: bool = True) -> bool:
    """Whether a file of a dataset is there, as it was said to be.

    Args:
        place: the dataset.
        name: of the file.
        file: its size and checksum.
        hashed: whether to read and compare everything; otherwise the size is.
    """
    return place.size(name) == file.size and (
        not hashed or file_checksum(place, name) == file.sha256
    )


def road_is_sound(place: Place, sha256: str) -> bool:
    """Whether a dataset has a road, unaltered."""
    name = road_name(place, sha256)
    return place.size(name) is not None and file_checksum(place, name) == sha256


def validated(model: type[M], path: Path) -> M:
    """A JSON file as a model; everything that can be wrong with it is one `InputError`.

    Raises:
        FileNotFoundError: if there is no such file.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: found no file, expected one")
    return validated_in(model, Folder(path.parent), path.name)


def validated_in(model: type[M], place: Place, name: str) -> M:
    """As `validated`, for a file of a dataset wherever that is."""
    path = place.path / name
    size = place.size(name)
    if size is None:
        raise FileNotFoundError(2, "No such file", str(path))
    if size > MAX_JSON_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_JSON_BYTES}")
    try:
        return model.model_validate_json(place.read(name))
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


def read_manifest(place: Place) -> Manifest:
    """Read the manifest of a dataset of schema version 1.

    Args:
        place: the dataset.

    Returns:
        What is inside.

    Raises:
        InputError: if there is no manifest, or it is broken or of another version.
    """
    manifest = place.path / MANIFEST
    if place.size(MANIFEST) is None:
        if not place.exists():
            raise InputError(f"{place.url}: found nothing there, expected a dataset")
        if isinstance(place, Folder) and not place.path.is_dir():
            raise InputError(
                f"{place.url}: found a file, expected a dataset (import makes one of it)"
            )
        raise InputError(
            f"{place.path / EPISODES}: found no file; if the dataset is unfinished, run the same "
            "generate again"
        )
    version = validated_in(Versioned, place, MANIFEST).schema_version
    check_version(manifest, version, 1)
    return validated_in(Manifest, place, MANIFEST)


def is_dataset(path: Path) -> bool:
    """Whether a folder or URL is that of a whole dataset, of whatever version."""
    place = place_of(path)
    return any(place.size(name) is not None for name in (EPISODES, MANIFEST))


def checked_bytes(place: Place, entry: EpisodeEntry, name: FileName) -> bytes:
    """The content of an episode's own file, which must be as the entry says."""
    file = f"episodes/{entry.id}/{name}"
    path = place.path / file
    expected = entry.files.get(name)
    if expected is None:
        raise InputError(f"{path}: found no checksum of it in the manifest, expected one")
    size = place.size(file)
    if size is None:
        raise InputError(f"{path}: found no file, expected one of {expected.size} bytes")
    if size != expected.size:
        raise InputError(f"{path}: found {size} bytes, expected {expected.size}")
    data = place.read(file)
    if checksum(data) != expected.sha256:
        raise InputError(f"{path}: found another content, expected sha256 {expected.sha256}")
    return data


def tables_of(place: Place, entry: EpisodeEntry) -> Tables:
    """The tables of an episode, in its shard or in files of its own.

    Args:
        place: the dataset.
        entry: of the episode.
    """
    if entry.shard is not None:
        return ShardTables(place, entry)
    return EpisodeFiles(place.path / "episodes" / entry.id, partial(checked_bytes, place, entry))
