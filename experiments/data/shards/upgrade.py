"""Rewrites datasets of schema version 1, a folder per episode, as shards."""

from __future__ import annotations

from pathlib import Path

from behaviors.errors import InputError
from experiments.data.data_card import write_data_card
from experiments.data.shards.staging import check_empty, holds, staged
from sim.store.dataset import open_dataset
from sim.store.lock import new_folder, same_again
from sim.store.places import place_of
from sim.store.schema import SCHEMA_VERSION, Manifest
from sim.store.sealing import Sealer, manifest_of


def upgrade(old: Path, out: Path) -> Manifest:
    """Write an older dataset anew, in the present layout. Episodes keep their ids and content.

    Where ``out`` already holds the same it stays as it is, as `import_recordings` has it.

    Args:
        old: the dataset, a folder or a URL; it is only read.
        out: a folder or a URL: new, empty, or with the same dataset.

    Returns:
        What the catalogue of the new dataset says.

    Raises:
        InputError: if ``old`` is broken or of the present layout, or ``out`` holds anything
            else.
        OSError: if something cannot be written.
    """
    dataset = open_dataset(old)
    if dataset.header.schema_version == SCHEMA_VERSION:
        raise InputError(
            f"{place_of(old).url}: found schema version {SCHEMA_VERSION}, expected an older one: "
            "there is nothing to upgrade"
        )
    if holds(out, dataset.header.configuration):
        with same_again(out, "dataset") as folder:
            return upgrade(old, folder)
    target = place_of(out)
    check_empty(target)
    with staged(out) as folder, new_folder(folder):
        sealer = Sealer(target, folder, place_of(old))
        shards = sealer.seal(dataset.manifest.episodes)
        sealer.complete(dataset.header.configuration, shards)
        write_data_card(out)
    return manifest_of(target)
