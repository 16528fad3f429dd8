"""Looks whether a dataset is what its manifest says, and makes again what is not."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import ValidationError

from behaviors.errors import InputError
from experiments.generate import GenerateConfig, generate
from sim.dataset import ENTRY, MANIFEST, Dataset, altered_files, made_with, open_dataset, road_path
from sim.lock import LOCK, sole_writer
from sim.schema import EPISODE_FILES, EpisodeEntry

State = Literal["missing", "altered", "foreign"]

_OURS: Final = frozenset({MANIFEST, LOCK, "README.md"})
"""Files of a dataset that no episode owns."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """One file that is not as it should be.

    Attributes:
        path: the file, relative to the dataset.
        state: missing, altered (another size or content), or foreign (not of this dataset).
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
    own = dataset.path / "episodes" / entry.id / ENTRY
    try:
        told = EpisodeEntry.model_validate_json(own.read_bytes()) if own.is_file() else None
    except ValidationError:
        told = None
    if told != entry:
        wrong.append(own)
    for path in wrong:
        state: State = "altered" if path.is_file() else "missing"
        road = path.parent.name == "roads"
        yield Flaw(path.relative_to(dataset.path), state, None if road else entry.id)


def _foreign(dataset: Dataset) -> Iterator[Path]:
    known = set(_OURS)
    for entry in dataset.manifest.episodes:
        known |= {f"episodes/{entry.id}/{name}" for name in (*EPISODE_FILES, ENTRY)}
    roads = [road_path(dataset.path, sha256) for sha256 in dataset.manifest.roads]
    known |= {path.relative_to(dataset.path).as_posix() for path in roads}
    for path in sorted(dataset.path.rglob("*")):
        relative = path.relative_to(dataset.path)
        if not path.is_dir() and relative.as_posix() not in known:
            yield relative


def repair(dataset: Dataset, jobs: int | None = None, quiet: bool = False) -> list[Flaw]:
    """Make again what is missing or altered, and remove what is foreign among the episodes.

    Foreign files elsewhere in the folder are left alone.

    Args:
        dataset: which; it must have been generated, with the packages that are installed now.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.

    Returns:
        What is still wrong afterwards.

    Raises:
        InputError: if the dataset cannot be made again here, or comes out differently.
    """
    config = _configuration(dataset)
    flaws = find_flaws(dataset)
    with sole_writer(dataset.path):
        for flaw in flaws:
            path = dataset.path / flaw.path
            if flaw.episode is not None:
                shutil.rmtree(dataset.path / "episodes" / flaw.episode, ignore_errors=True)
            if flaw.path.parts[0] in ("episodes", "roads"):
                path.unlink(missing_ok=True)
        for folder in sorted((dataset.path / "episodes").glob("*/"), reverse=True):
            if not any(folder.iterdir()):
                folder.rmdir()
    again = generate(config, dataset.path, jobs, quiet)
    if again != dataset.manifest:
        raise InputError(
            f"{dataset.path}: came out differently than its manifest said, expected the same; "
            "it was made on another platform"
        )
    return find_flaws(dataset)


def _configuration(dataset: Dataset) -> GenerateConfig:
    fields: dict[str, Any] = dict(dataset.manifest.configuration)
    versions = fields.pop("made_with", None)
    try:
        config = GenerateConfig.model_validate(fields)
    except ValidationError:
        raise InputError(
            f"{dataset.path}: was not made by generate, expected a generated dataset; "
            "import it again"
        ) from None
    here = made_with(config.engine)
    if versions != here:
        raise InputError(
            f"{dataset.path}: was made with {versions}, found {here}; install those versions"
        )
    return config


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
