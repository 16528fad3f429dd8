"""Compares a dataset with its catalogue."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

from experiments.data.data_card import DATA_CARD
from sim.files import place_of
from sim.store.dataset import open_dataset
from sim.store.schema import EPISODES


class Flaw(NamedTuple):
    """One file, relative to the dataset, that is not as it should be, or not of the dataset."""

    path: Path
    state: Literal["missing", "altered", "foreign"]


def verify_dataset(path: Path) -> list[Flaw]:
    """Faults, in order of path, of every file's size and checksum beside a dataset's catalogue."""
    dataset = open_dataset(path)
    place, expected = place_of(dataset.path), dataset.header.files
    there = place.files()
    len(dataset.catalogue)  # which reads the rows
    known = {*expected, EPISODES, DATA_CARD}
    flaws = [Flaw(Path(name), "foreign") for name in there if name not in known]
    for name, file in expected.items():
        if name not in there:
            flaws.append(Flaw(Path(name), "missing"))
        elif there[name] != file.size or place.checksum(name) != file.sha256:
            flaws.append(Flaw(Path(name), "altered"))
    return sorted(flaws)
