"""Compares a dataset with its manifest, and makes again the episodes that differ."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import ValidationError

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from experiments.data.configuration import GenerateConfig
from experiments.data.data_card import DATA_CARD
from experiments.data.generate import AnyConfig, generate
from experiments.data.what_if import WhatIf, make_what_if
from experiments.data.worlds.episode import WorldsConfig
from sim.store.atomic import write_whole
from sim.store.catalogue import ENTRY, MANIFEST, altered_files, road_path
from sim.store.dataset import Dataset, open_dataset
from sim.store.lock import LOCK, sole_writer
from sim.store.schema import EPISODE_FILES, EpisodeEntry, Manifest
from sim.store.writing import made_with

State = Literal["missing", "altered", "foreign"]

_OURS: Final = frozenset({MANIFEST, LOCK, DATA_CARD})
"""Files of a dataset that no episode owns."""

_FOLDERS: Final = ("episodes", "roads")
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
        episode: the episode that it belongs to; None for roads and foreign files.
    """

    path: Path
    state: State
    episode: str | None


def find_flaws(dataset: Dataset) -> list[Flaw]:
    """Compare every file of a dataset with the manifest.

    Args:
        dataset: which.

    Returns:
        What is wrong, in order of path; empty if nothing is.
    """
    flaws = [flaw for entry in dataset.manifest.episodes for flaw in _flaws_of(dataset, entry)]
    flaws += [Flaw(path, "foreign", None) for path in _foreign(dataset)]
    return sorted(set(flaws), key=lambda f: f.path)


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
    known = {*_OURS, *_FOLDERS}
    for entry in dataset.manifest.episodes:
        known |= {f"episodes/{entry.id}/{name}" for name in (*EPISODE_FILES, ENTRY)}
    roads = [road_path(dataset.path, sha256) for sha256 in dataset.manifest.roads]
    known |= {path.relative_to(dataset.path).as_posix() for path in roads}
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
    flaws = find_flaws(dataset)
    for sha256 in dataset.manifest.roads:
        road = road_path(dataset.path, sha256)
        if road.is_dir():
            raise InputError(f"{road}: found a folder, expected a file; move it away")
    foreign = [
        dataset.path / flaw.path
        for flaw in flaws
        if flaw.state == "foreign" and flaw.path.parts[0] in _FOLDERS
    ]
    ours = [path for path in _obstacles(dataset) if path not in foreign]
    with _as_it_was(dataset.path), _aside(dataset.path, foreign, ours):
        again = make()
        if again != dataset.manifest:
            raise InputError(
                f"{dataset.path}: came out differently than its manifest said, expected the same; "
                "it was made on another platform"
            )
    with sole_writer(dataset.path):
        for folder in sorted((dataset.path / "episodes").rglob("*/"), reverse=True):
            if not any(folder.iterdir()):
                folder.rmdir()
    return find_flaws(dataset)


def _obstacles(dataset: Dataset) -> Iterator[Path]:
    """Paths that would stop generation, or be mistaken for an episode of this dataset."""
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
    paths = [folder / MANIFEST, folder / DATA_CARD]
    before = {path: path.read_bytes() for path in paths if path.is_file()}
    try:
        yield
    except BaseException:
        for path, data in before.items():
            if not path.is_file() or path.read_bytes() != data:
                write_whole(path, data)
        raise


def _maker(dataset: Dataset, jobs: int | None, quiet: bool) -> Callable[[], Manifest]:
    """What makes the dataset again in its folder."""
    fields: dict[str, Any] = dict(dataset.manifest.configuration)
    versions = fields.pop("made_with", None)
    config: AnyConfig
    make: Callable[[], Manifest]
    try:
        if "what_if" in fields:
            what_if = WhatIf.model_validate_json(json.dumps(fields["what_if"]))
            config, make = what_if.episode, partial(make_what_if, what_if, dataset.path, quiet)
        else:
            model: type[WorldsConfig | GenerateConfig] = (
                WorldsConfig if "worlds" in fields else GenerateConfig
            )
            config = model.model_validate(fields)
            make = partial(generate, config, dataset.path, jobs, quiet)
    except ValidationError:
        raise InputError(
            f"{dataset.path}: was not made by generate or what-if, expected a dataset that was; "
            "import it again"
        ) from None
    config.check()
    here = made_with(config.engine)
    if versions != here:
        raise InputError(
            f"{dataset.path}: was made with {versions}, found {here}; install those versions"
        )
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
