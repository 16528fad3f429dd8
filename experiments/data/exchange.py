"""Imports recordings of other formats as datasets, and exports datasets to other formats."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from pydantic import JsonValue

from behaviors.errors import InputError
from experiments.console.notices import LOGGER, called
from experiments.console.progress import Progress
from experiments.data.data_card import write_data_card
from experiments.data.recorded_roads import RecordedRoads
from experiments.data.scene_check import DOUBTED, SCALED, admitted
from experiments.guard import guarded, guarded_call
from sim.files import Place, is_remote, new_folder, place_of, temporary_folder
from sim.formats import (
    FORMATS,
    formats_in,
    get_writer,
    left_out_files,
    new_index,
    read_formats,
)
from sim.formats.argoverse import NoWindowError
from sim.formats.common.doubts import doubt_of_times
from sim.formats.common.label_file import read_driver_labels
from sim.formats.recorded_tables import check_columns
from sim.store.dataset import is_dataset, open_dataset
from sim.store.schema import EpisodeMeta, Manifest, Split, split_of
from sim.store.writing import made_with, new_dataset

LEFT_OUT_NAMED: Final = 5
"""Most left-out files that are named (they fit one line)."""


def import_recordings(
    source: Path,
    out: Path,
    name: str | None = None,
    net: Path | None = None,
    split: Split | None = None,
    quiet: bool = False,
    types: Path | None = None,
    labels: Path | None = None,
    rate_hz: float | None = None,
    shift_m: tuple[float, float] | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    scenario: str | None = None,
) -> Manifest:
    """Make a dataset of recordings, their numbers kept to the last digit.

    Files that look like recordings and are not read are named on stderr and in the manifest.

    Args:
        source: a file, or a folder with files of one or several formats.
        out: folder of the dataset, new or empty, or a URL where nothing is.
        name: a key of ``FORMATS``, whose files alone are read; None to recognise each.
        net: the map of the recordings' place, checked against where vehicles move; None for what
            comes with each.
        split: which part of the data everything belongs to; None to split by index.
        quiet: whether to show no progress.
        types: a SUMO file with the vTypes of ``sumo-fcd`` recordings.
        labels: labels of some drivers, instead of those that come with the recordings.
        rate_hz: frames per second that the recordings really have; None for what they say. A
            recording whose times contradict its motion is then left out, or refused if it is alone.
        shift_m: how far maps are moved onto the positions, m; None not to move them.
        columns: what the columns of a table of one's own are, as `check_columns` takes them.
        units: of these columns.
        scenario: what the episodes' scenario is called; None for the format's name.

    Raises:
        InputError: if a file is broken or of no known format, ``net`` is of another place, times
            contradict the motion, or ``out`` holds anything else.
    """
    if columns is not None:
        check_columns(columns, units or {})
        if name not in (None, "table"):
            raise InputError(f"--format: found {name} beside --columns, expected table or none")
        name = "table"
    elif units:
        raise InputError("--units: found no --columns, expected those of a table of your own")
    roads = RecordedRoads(net, shift_m)
    given = None if labels is None else guarded_call(labels, read_driver_labels, labels)
    doubted: list[str] = []
    count = 0
    with _here(source) as source:
        names = [name] if name else formats_in(source)
        form = " or ".join(names)
        configuration = {"format": ", ".join(names), "source": source.name}
        if others := [file.name for file in left_out_files(source, names)]:
            more = len(others) - LEFT_OUT_NAMED
            said = ", ".join(others[:LEFT_OUT_NAMED]) + (f" and {more} more" if more > 0 else "")
            configuration["left_out"] = said
            LOGGER.warning(
                "%s: left out, because they are not in the format %s: %s", source, form, said
            )
        read = guarded(source, read_formats, source, names, types, rate_hz, columns, units)
        with (
            new_dataset(out, configuration) as dataset,
            Progress("importing recordings", 0, quiet) as shown,
        ):
            for key, recording in read:
                LOGGER.debug("%s: read %s as %s", source, recording.name, key)
                wrong = None if rate_hz is not None else doubt_of_times(recording.tracks)
                if wrong is not None and FORMATS[key].clock:
                    recording = replace(recording, notes=(*recording.notes, wrong))
                elif wrong is not None:
                    place = source / recording.file if source.is_dir() else source
                    able = "other --units, or " if key == "table" else ""
                    doubted.append(f"{place}: {wrong}, expected {able}import --rate HZ")
                    continue
                if given is not None:
                    found_labels = given.of(recording.tracks.names, recording.name, recording.file)
                    recording = recording.labelled(found_labels)
                unit = FORMATS[key].unit
                recording, doubt = admitted(recording, unit)
                if doubts := [*recording.doubts, *([doubt] if doubt else [])]:
                    LOGGER.warning("%s: %s", recording.name, "; ".join(doubts))
                road, found = roads.of(recording)
                options: dict[str, JsonValue] = {
                    "recording": recording.name, "file": recording.file,
                    "notes": [*recording.notes, *recording.doubts, *found],
                    **({} if unit == "m" else {SCALED: True}),
                    **({DOUBTED: doubt} if doubt else {}),
                }  # fmt: skip
                meta = EpisodeMeta(
                    scenario=scenario or key, engine=key, index=count,
                    split=split or split_of(count), options=options, made_with=made_with(key),
                )  # fmt: skip
                entry = dataset.write_recording(meta, recording.tracks, road, recording.styles)
                count += 1
                shown.advance(entry.agents, entry.agent_steps)
            if doubted and not count:
                raise InputError(doubted[0])
            for line in doubted:
                LOGGER.warning("%s: left out", line)
            roads.check()
            if given is not None:
                given.check()
    write_data_card(out)
    return open_dataset(out).manifest


@contextmanager
def as_dataset(source: Path, name: str | None = None, net: Path | None = None) -> Iterator[Path]:
    """A dataset as it is, or recordings as a temporary dataset that the block's end removes.

    Arguments are those of `import_recordings`; recordings are all in the test split.
    """
    if name is None and is_dataset(source):
        yield source
        return
    with _here(source) as source, temporary_folder("import") as scratch:
        if not source.exists():
            raise InputError(f"{source}: found nothing there, expected a dataset or a recording")
        folder = scratch / (source.resolve().name or "recordings")
        import_recordings(source, folder, name, net, split="test", quiet=True)
        with called(folder, source):
            yield folder


@contextmanager
def _here(source: Path) -> Iterator[Path]:
    """A path of this machine, or a copy, with the same name, of the file or folder at a URL."""
    if not is_remote(source):
        yield source
        return
    home, place = place_of(source.parent), place_of(source)
    with temporary_folder("fetched") as scratch:
        copy = scratch / source.name
        if home.size(source.name) is not None:
            copy.write_bytes(home.read(source.name))
        for name in () if copy.exists() else place.files():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            (copy / name).write_bytes(place.read(name))
        if not copy.exists():
            raise InputError(f"{place.url}: found nothing there")
        yield copy


@contextmanager
def _new_output(out: Path) -> Iterator[Path]:
    """A folder to fill, whose files appear in a new or empty folder, or at a URL, at the end."""
    if not is_remote(out):
        with new_folder(out) as folder:
            yield folder
        return
    target = place_of(out)
    if found := next(iter(target.files()), None):
        raise InputError(f"{target.url}: found {found} there, expected a new or empty folder")
    with temporary_folder("out") as folder:
        yield folder
        for name in Place(str(folder)).files():
            target.put(folder / name, name)


def export_dataset(dataset: Path, out: Path, name: str, quiet: bool = False) -> list[Path]:
    """Write every episode of a dataset in another format, and return the files.

    Episodes that have no window of the format's length are left out; a line on stderr says so.

    Args:
        dataset: folder of the dataset.
        out: a new or empty folder, or a URL where nothing is.
        name: a key of ``sim.formats.FORMATS`` that has a writer.
        quiet: whether to show no progress.

    Raises:
        InputError: if a step does not fit, no episode is long enough, or the folder holds anything.
    """
    writer, opened = get_writer(name), open_dataset(dataset)
    index = new_index(name)
    written: list[Path] = []
    left_out: list[NoWindowError] = []
    episodes = opened.manifest.episodes
    with _new_output(out) as folder, Progress("exporting episodes", len(episodes), quiet) as shown:
        for entry in episodes:
            tracks, road = opened.read(entry).tracks, opened.road(entry)
            try:
                files = writer(folder, entry.id, tracks, road)
            except NoWindowError as reason:
                left_out.append(reason)
            else:
                written += files
                if index is not None:
                    index.add(files, entry.id, tracks, road)
            shown.advance(entry.agents, entry.agent_steps)
        summary = f"{len(left_out)} of {len(episodes)} episodes left out"
        if not written:
            raise InputError(f"{dataset}: {summary}, first {left_out[0]}")
        if left_out:
            LOGGER.warning("%s: %s, first %s", dataset, summary, left_out[0])
        if index is not None:
            written += index.write(folder)
        return [out / path.relative_to(folder) for path in written]
