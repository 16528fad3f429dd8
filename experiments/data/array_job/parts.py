"""An array job without a scheduler: commands that make a part each, and one that merges them.

Every part writes what it makes where the others write: a folder that all see, or a URL. Parts may
run in any order, at the same time, on any machines, and again. Blocks of episodes that a part makes
as a whole become shards at once; of others the episodes wait until `merge`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from behaviors.errors import InputError
from experiments.data.data_card import edited_cards, write_data_card
from experiments.data.generate import (
    PLAN,
    Generation,
    check_same,
    clear_partial,
    complete,
    listed_files,
    stoppable,
)
from experiments.data.parallel import checked_jobs
from experiments.data.shards.plan import (
    AnyConfig,
    Part,
    check_versions,
    config_in,
    configuration_of,
    key_of,
    planned_count,
    shares,
)
from experiments.data.shards.staging import staged
from sim.store.catalogue import ENTRY, altered_files, canonical, unlisted_episodes, validated_in
from sim.store.lock import one_of_several_writers, sole_writer
from sim.store.places import Folder, Place, Store, place_of
from sim.store.schema import EpisodeEntry, Manifest
from sim.store.sealing import Sealer, manifest_of, whole_shards

MISSING_NAMED: Final = 12
"""Most parts with missing episodes that an error names (they fit a line or two)."""


class Plan(BaseModel):
    """What all parts of a dataset have in common.

    Attributes:
        parts: how many there are.
        configuration: what the dataset is generated from, and the packages' versions.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    parts: Annotated[int, Field(ge=1)]
    configuration: dict[str, JsonValue]


def config_of(what: str, configuration: dict[str, JsonValue]) -> AnyConfig:
    """The configuration that a dataset says it was made from.

    Args:
        what: name of the dataset, for messages.
        configuration: with the packages' versions.

    Raises:
        InputError: if it was not generated, or with other versions than those installed.
    """
    try:
        config = config_in(configuration)
    except ValidationError:
        raise InputError(f"{what}: was not made by generate, expected a dataset that was") from None
    check_versions(what, configuration, config.engine)
    return config


def generate_part(
    config: AnyConfig, out: Path, part: Part, jobs: int | None = None, quiet: bool = False
) -> int:
    """Make one part of a dataset, or what is missing of it; `merge` completes the dataset.

    Args:
        config: what the whole dataset is made from, the same for all parts.
        out: where: a folder that all parts see, or a URL.
        part: which part.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.

    Returns:
        How many episodes the part has.

    Raises:
        InputError: if an option is wrong, the place holds something else or the same part is being
            made, or an episode could not be made (all others are made first).
        OSError: if something cannot be written.
        Interrupted: if the user stopped it.
    """
    jobs = checked_jobs(jobs)
    config.check()
    todo = list(shares(config, part))
    wanted = sum(len(share.tasks) for share in todo)
    name = f"part-{part.number}-of-{part.of}"
    with (
        staged(out, name) as folder,
        one_of_several_writers(folder, name),
        stoppable(folder, planned_count(config), out),
    ):
        place = place_of(out)
        _agree(place, folder, config, part)
        run = Generation(config, out, folder, jobs, None, quiet)
        blocks = {share.block for share in todo}
        there = whole_shards(place, listed_files(place), blocks)
        run.waiting = {
            key_of(entry, run.worlds): entry
            for entry in _waiting(place)
            if isinstance(place, Store)
        }
        run.run(todo, wanted, there)
        _send_waiting(folder, place)
    if run.failed:
        raise run.failure(wanted)
    return wanted


def _agree(place: Place, folder: Path, config: AnyConfig, part: Part) -> None:
    """Refuse to be a part of something else."""
    plan = Plan(parts=part.of, configuration=configuration_of(config))
    try:
        there = validated_in(Plan, place, PLAN)
    except FileNotFoundError:
        check_same(place, folder, config)
        place.write(PLAN, canonical(plan.model_dump()))
        return
    if there.parts != part.of:
        raise InputError(f"part: found {part}, expected one of {there.parts} parts, as the others")
    if there != plan:
        raise InputError(
            f"{place.url}: holds parts of another configuration; choose another folder"
        )


def _waiting(place: Place) -> Iterator[EpisodeEntry]:
    """The episodes that wait in a place, whole."""
    if isinstance(place, Folder):
        for entry in unlisted_episodes(place.path):
            if not altered_files(place.path, entry):
                yield entry
        return
    names = set(place.files("episodes"))
    for name in sorted(names):
        if name.endswith(f"/{ENTRY}"):
            entry = validated_in(EpisodeEntry, place, name)
            if all(f"episodes/{entry.id}/{file}" in names for file in entry.files):
                yield entry


def _send_waiting(folder: Path, place: Place) -> None:
    """Move finished episodes and roads from this machine to an object store."""
    if isinstance(place, Folder):
        return
    here = Folder(folder)
    for name in [*here.files("roads"), *here.files("episodes")]:
        if not name.endswith(ENTRY):
            place.write(name, here.read(name))
    for name in here.files("episodes"):
        if name.endswith(ENTRY):  # last: what has one is whole
            place.write(name, here.read(name))


def merge(out: Path, quiet: bool = False) -> Manifest:
    """Complete a dataset that was made in parts.

    Args:
        out: where the parts are, a folder or a URL.
        quiet: whether to show no progress.

    Returns:
        What its catalogue says.

    Raises:
        InputError: if there are no parts, a part is still being made, or an episode is missing;
            the message names the parts that have to be run again.
        OSError: if something cannot be written.
    """
    place = place_of(out)
    try:
        plan = validated_in(Plan, place, PLAN)
    except FileNotFoundError:
        raise InputError(
            f"{place.url}: found no {PLAN}, expected parts that generate --part made and that are "
            "not merged yet"
        ) from None
    config = config_of(place.url, plan.configuration)
    with staged(out) as folder, sole_writer(folder):
        clear_partial(folder)
        edited = edited_cards(out)
        run = Generation(config, out, folder, 1, None, quiet)
        shards = whole_shards(place, listed_files(place), hashed=False)
        known = run.known(shards)
        for entry in _waiting(place):
            known.setdefault(key_of(entry, run.worlds), entry)
        _check_complete(place, config, plan.parts, known, run.worlds)
        sealer = Sealer(place, folder, place)
        sealed = []
        for share in shares(config, None):
            entries = [known[key_of(task, run.worlds)] for task in share.tasks]
            sealed += sealer.seal(entries, shards)
        complete(run, sealed, sealer)
        write_data_card(out, edited)
    return manifest_of(place)


def _check_complete(
    place: Place,
    config: AnyConfig,
    parts: int,
    known: dict[tuple[str, int], EpisodeEntry],
    worlds: bool,
) -> None:
    """Refuse to merge while something is missing, and name the parts that it belongs to."""
    missing: dict[int, int] = {}
    for number in range(1, parts + 1):
        for share in shares(config, Part(number, parts)):
            lacks = sum(key_of(task, worlds) not in known for task in share.tasks)
            if lacks:
                missing[number] = missing.get(number, 0) + lacks
    if not missing:
        return
    named = [f"{number}/{parts}" for number in list(missing)[:MISSING_NAMED]]
    more = f" and {len(missing) - MISSING_NAMED} more" if len(missing) > MISSING_NAMED else ""
    raise InputError(
        f"{place.url}: found {sum(missing.values())} of {planned_count(config)} episodes missing, "
        f"expected all: run {'part' if len(missing) == 1 else 'parts'} {', '.join(named)}{more} "
        "again"
    )
