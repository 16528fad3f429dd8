"""Compares a dataset with its catalogue."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from experiments.data.data_card import DATA_CARD
from sim.files import place_of
from sim.store.catalogue import EPISODES
from sim.store.dataset import open_dataset

State = Literal["missing", "altered", "foreign"]

_UNLISTED: Final = frozenset({EPISODES, DATA_CARD})
"""Files of a dataset that its catalogue does not list."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """One file that is not as it should be.

    Attributes:
        path: the file, relative to the dataset.
        state: missing, altered (another size or content), or foreign (not of this dataset).
    """

    path: Path
    state: State


def verify_dataset(path: Path) -> list[Flaw]:
    """Compare every file of a dataset with the size and the checksum in its catalogue.

    Args:
        path: folder or URL of the dataset.

    Returns:
        Faults in order of path; empty if there are none.

    Raises:
        InputError: if the catalogue's rows are broken.
    """
    dataset = open_dataset(path)
    place, header = place_of(dataset.path), dataset.header
    there = place.files()
    expected = {path: (file.size, file.sha256) for path, file in header.files.items()}
    len(dataset.catalogue)  # which reads the rows
    flaws = [Flaw(Path(name), "foreign") for name in there if name not in {*expected, *_UNLISTED}]
    for name, (size, sha256) in expected.items():
        if name not in there:
            flaws.append(Flaw(Path(name), "missing"))
        elif there[name] != size or place.checksum(name) != sha256:
            flaws.append(Flaw(Path(name), "altered"))
    return sorted(flaws, key=lambda flaw: flaw.path)
