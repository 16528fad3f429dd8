"""Compares a dataset with its catalogue, and makes again the episodes of files that differ."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import ValidationError

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from experiments.data.cards.croissant import CROISSANT
from experiments.data.data_card import DATA_CARD
from experiments.data.generate import generate
from experiments.data.shards.plan import AnyConfig, check_versions, config_in
from experiments.data.what_if import WhatIf, make_what_if
from sim.store.atomic import write_whole
from sim.store.catalogue import ENTRY, MANIFEST, altered_files, road_name, road_path
from sim.store.dataset import Dataset, open_dataset
from sim.store.entries import EPISODES
from sim.store.lock import LOCK, sole_writer
from sim.store.places import Folder, Place, file_checksum, is_remote, place_of
from sim.store.schema import EPISODE_FILES, TABLES, EpisodeEntry, Header, Manifest

State = Literal["missing", "altered", "foreign"]

_OURS: Final = frozenset({EPISODES, MANIFEST, LOCK, DATA_CARD, CROISSANT})
"""Files of a dataset that no episode owns."""

_FOLDERS: Final = ("episodes", "roads", *TABLES)
"""Folders of a dataset. They may be links to other disks; nothing inside them may be one to a
folder."""

ASIDE_PREFIX: Final = ".aside-"
"""Prefix of the folder into which a repair moves what is in its way. Unlike partial files, it stays
if the repair is killed, so that nothing is lost."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """One file that is not as it should be.

    Attributes:
        path: the file, relative to the dataset; of a link to a folder, the link.
        state: missing, altered (another size or content, or no file), or foreign (not of this
            dataset).
        episode: the episode that it belongs to; None for shards, roads and foreign files.
    """

    path: Path
    state: State
    episode: str | None


def find_flaws(dataset: Dataset) -> list[Flaw]:
    """Compare every file of a dataset with its catalogue.

    Args:
        dataset: which.

    Returns:
        What is wrong, in order of path; empty if nothing is.
    """
    if dataset.header.schema_version == 1:
        flaws = [flaw for entry in dataset.manifest.episodes for flaw in _flaws_of(dataset, entry)]
    else:
        flaws = list(_flaws_of_files(place_of(dataset.path), dataset.header))
    flaws += [Flaw(path, "foreign", None) for path in _foreign(dataset)]
    return sorted(set(flaws), key=lambda f: f.path)


def _flaws_of_files(place: Place, header: Header) -> Iterator[Flaw]:
    """What is wrong with shards and roads."""
    expected = {path: (file.size, file.sha256) for path, file in header.files.items()}
    for sha256, bytes_ in header.roads.items():
        expected[road_name(place, sha256)] = (bytes_, sha256)
    for name, (size, sha256) in expected.items():
        found = place.size(name)
        if found is None:
            there = isinstance(place, Folder) and os.path.lexists(place.path / name)
            yield Flaw(Path(name), "altered" if there else "missing", None)
        elif found != size or file_checksum(place, name) != sha256:
            yield Flaw(Path(name), "altered", None)


def _flaws_of(dataset: Dataset, entry: EpisodeEntry) -> Iterator[Flaw]:
    wrong = altered_files(dataset.path, entry)
    if _own_entry(dataset, entry) != entry:
        wrong.append(_own(dataset, entry))
    for path in wrong:
        state: State = "altered" if path.exists() else "missing"
        road = path.parent.name == "roads"
        yield Flaw(path.relative_to(dataset.path), state, None if road else entry.id)


def _own(dataset: Dataset, entry: EpisodeEntry) -> Path:
    return dataset.path / "episodes" / entry.id / ENTRY


def _own_entry(dataset: Dataset, entry: EpisodeEntry) -> EpisodeEntry | None:
    """The entry in the episode's own file; None if it cannot be read."""
    own = _own(dataset, entry)
    try:
        return EpisodeEntry.model_validate_json(own.read_bytes()) if own.is_file() else None
    except ValidationError:
        return None


def _foreign(dataset: Dataset) -> Iterator[Path]:
    place = place_of(dataset.path)
    known = {*_OURS, *_FOLDERS, *dataset.header.files}
    if dataset.header.schema_version == 1:
        for entry in dataset.manifest.episodes:
            known |= {f"episodes/{entry.id}/{name}" for name in (*EPISODE_FILES, ENTRY)}
    known |= {road_name(place, sha256) for sha256 in dataset.header.roads}
    if not isinstance(place, Folder):
        yield from (Path(name) for name in place.files() if name not in known)
        return
    for path in sorted(dataset.path.rglob("*")):
        relative = path.relative_to(dataset.path)
        if (path.is_symlink() or not path.is_dir()) and relative.as_posix() not in known:
            yield relative


def repair(dataset: Dataset, jobs: int | None = None, quiet: bool = False) -> list[Flaw]:
    """Make again what is missing or altered, and move foreign files among the episodes away.

    Foreign files are moved to a folder beside the dataset, and a line on stderr names it; those
    elsewhere in the dataset are left alone. A bad episode stays until its successor is whole; if
    something cannot be made, the rest of the dataset is as it was.

    Args:
        dataset: which; it must have been generated, with the packages that are installed now.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.

    Returns:
        What is still wrong afterwards.

    Raises:
        InputError: if the dataset cannot be made again here, or comes out differently.
        OSError: if something cannot be written.
    """
    make = _maker(dataset, jobs, quiet)
    if is_remote(dataset.path):
        make()
        return find_flaws(dataset)
    flaws = find_flaws(dataset)
    for sha256 in dataset.header.roads:
        road = road_path(dataset.path, sha256)
        if road.is_dir():
            raise InputError(f"{road}: found a folder, expected a file; move it away")
    foreign = [
        dataset.path / flaw.path
        for flaw in flaws
        if flaw.state == "foreign" and flaw.path.parts[0] in _FOLDERS
    ]
    ours = [path for path in _obstacles(dataset) if path not in foreign]
    before = dataset.manifest
    with _as_it_was(dataset.path), _aside(dataset.path, foreign, ours):
        again = make()
        if not _same(again, before):
            raise InputError(
                f"{dataset.path}: came out differently than its catalogue said, expected the same; "
                "it was made on another platform"
            )
    with sole_writer(dataset.path):
        for table in ("episodes", *TABLES):
            for folder in sorted((dataset.path / table).rglob("*/"), reverse=True):
                if not any(folder.iterdir()):
                    folder.rmdir()
        with suppress(OSError):  # not empty, or not there
            (dataset.path / "episodes").rmdir()
    return find_flaws(open_dataset(dataset.path))


def _same(again: Manifest, before: Manifest) -> bool:
    """Whether a dataset has come out as it was; one of schema version 1 gets shards."""
    if before.schema_version == 1:
        ids = {entry.id for entry in before.episodes}
        return ids == {e.id for e in again.episodes} and again.roads == before.roads
    return again == before


def _obstacles(dataset: Dataset) -> Iterator[Path]:
    """Paths that would stop generation, or be mistaken for an episode of this dataset."""
    if dataset.header.schema_version != 1:
        for name in dataset.header.files:
            path = dataset.path / name
            if path.is_dir() or path.is_symlink():
                yield path
        return
    for entry in dataset.manifest.episodes:
        own = _own(dataset, entry)
        home = own.parent
        if home.is_symlink() or home.is_file():
            yield home
        elif own.exists() and _own_entry(dataset, entry) != entry:
            yield own


@contextmanager
def _aside(folder: Path, foreign: Sequence[Path], ours: Sequence[Path]) -> Iterator[None]:
    """Keep some paths of a folder out of the way while the block lasts.

    When it ends, foreign ones are moved to a folder beside the dataset and ours are removed. If it
    fails, all are put back where their place is still empty. A link is moved as a link: what it
    points to is not touched.
    """
    if not foreign and not ours:
        yield
        return
    kept = Path(tempfile.mkdtemp(prefix=ASIDE_PREFIX, dir=folder))
    places = {kept / str(number): path for number, path in enumerate((*foreign, *ours))}
    try:
        with sole_writer(folder):
            for place, path in places.items():
                shutil.move(path, place)
        yield
    except BaseException:
        for place, path in reversed(places.items()):
            if os.path.lexists(place) and not os.path.lexists(path):
                shutil.move(place, path)
        shutil.rmtree(kept)
        raise
    if foreign:
        beside = _folder_beside(folder)
        for place, path in places.items():
            if path in foreign:
                target = beside / path.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.move(place, target)
        LOGGER.warning("%s: moved %d foreign files to %s", folder, len(foreign), beside)
    shutil.rmtree(kept)


def _folder_beside(folder: Path) -> Path:
    """A new name beside a dataset for what is foreign in it."""
    home = folder.resolve()
    names = (f"{home.name}-foreign{f'-{n}' if n > 1 else ''}" for n in itertools.count(1))
    return next(home.parent / name for name in names if not os.path.lexists(home.parent / name))


@contextmanager
def _as_it_was(folder: Path) -> Iterator[None]:
    """Put manifest and data card back if the block fails: they say how the dataset should be."""
    paths = [folder / name for name in (EPISODES, MANIFEST, DATA_CARD, CROISSANT)]
    before = {path: path.read_bytes() for path in paths if path.is_file()}
    waiting = folder / "episodes"
    there = set(waiting.iterdir()) if waiting.is_dir() else set()
    try:
        yield
    except BaseException:
        for made in set(waiting.iterdir()) - there if waiting.is_dir() else ():
            shutil.rmtree(made, ignore_errors=True)
        if not there and waiting.is_dir():
            waiting.rmdir()
        for path, data in before.items():
            if not path.is_file() or path.read_bytes() != data:
                write_whole(path, data)
        raise


def _maker(dataset: Dataset, jobs: int | None, quiet: bool) -> Callable[[], Manifest]:
    """What makes the dataset again in its folder."""
    fields: dict[str, Any] = dict(dataset.header.configuration)
    config: AnyConfig
    make: Callable[[], Manifest]
    try:
        if "what_if" in fields:
            what_if = WhatIf.model_validate_json(json.dumps(fields["what_if"]))
            config, make = what_if.episode, partial(make_what_if, what_if, dataset.path, quiet)
        else:
            config = config_in(fields)
            make = partial(generate, config, dataset.path, jobs, quiet, whole_or_not=True)
    except ValidationError:
        raise InputError(
            f"{dataset.path}: was not made by generate or what-if, expected a dataset that was; "
            "import it again"
        ) from None
    config.check()
    check_versions(str(dataset.path), fields, config.engine)
    return make


def verify_dataset(
    path: Path, mend: bool = False, jobs: int | None = None, quiet: bool = False
) -> list[Flaw]:
    """What ``graphrqi verify`` does.

    Args:
        path: folder of a dataset.
        mend: whether to repair.
        jobs: worker processes for a repair; None for one per processor.
        quiet: whether to show no progress.

    Returns:
        What is (still) wrong.
    """
    dataset = open_dataset(path)
    return repair(dataset, jobs, quiet) if mend else find_flaws(dataset)
