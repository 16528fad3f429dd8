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
from experiments.data.remote import fetched, new_output
from experiments.data.scene_check import DOUBTED, SCALED, admitted
from experiments.guard import guarded, guarded_call
from sim.files import is_remote, temporary_folder, write_whole
from sim.formats import (
    FORMATS,
    formats_in,
    get_reader,
    get_writer,
    left_out_files,
    new_index,
    read_formats,
    recording_files,
)
from sim.formats.argoverse import NoWindowError
from sim.formats.common.doubts import doubt_of_times
from sim.formats.common.label_file import read_driver_labels
from sim.formats.own_table import check_columns
from sim.store.catalogue import is_dataset
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeMeta, Manifest, Split, split_of
from sim.store.writing import checksum, made_with, new_dataset

MARKER: Final = ".graphrqi-export"
"""File in a folder of exported files; it says which dataset they come from."""

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

    Args:
        source: a file, or a folder with files of one or several formats.
        out: folder of the dataset, new or empty, or a URL where nothing is.
        name: a key of ``sim.formats.FORMATS``, whose files alone are read; None to read every
            format that is recognised from the content. Files that look like recordings and are
            not read are named on stderr and in the manifest.
        net: the map that the recordings were made on, as `sim.road.files.read_road_file` takes
            it; None for what comes with each, if anything does. It is checked against where
            vehicles move (`sim.road.map_fit`).
        split: which part of the data everything belongs to; None to split by index.
        quiet: whether to show no progress.
        types: a SUMO file with the vTypes of ``sumo-fcd`` recordings.
        labels: a CSV file with labels of some drivers, as `sim.formats.common.label_file` reads
            it. They replace those that come with the recordings.
        rate_hz: frames per second that the recordings really have; None for what they say. A
            recording whose times contradict its motion is then left out, or refused if it is alone.
        shift_m: how far maps are moved onto the positions, m; None not to move them.
        columns: what the columns of a table of one's own are, as `sim.formats.own_table` has it.
        units: of these columns.
        scenario: what the episodes' scenario is called; None for the format's name.

    Returns:
        The manifest.

    Raises:
        InputError: if a file is broken or of no known format, ``net`` is of another place, times
            contradict the motion, or ``out`` holds anything else.
        OSError: if something cannot be written.
    """
    if is_remote(source):
        with fetched(source) as copy:
            return import_recordings(
                copy, out, name, net, split, quiet, types, labels, rate_hz, shift_m, columns,
                units, scenario,
            )  # fmt: skip
    if columns is not None:
        check_columns(columns, units or {})
        name = "table"
    names = [name] if name else formats_in(source)
    for key in names:
        get_reader(key)
    if types is not None and "sumo-fcd" not in names:
        raise InputError(f"types: found format {names[0]}, expected sumo-fcd: only it needs them")
    roads = RecordedRoads(net, shift_m)
    given = None if labels is None else guarded_call(labels, read_driver_labels, labels)
    configuration = {"format": ", ".join(names), "source": source.name}
    others = left_out_files(source, names)
    if others:
        configuration["left_out"] = ", ".join(file.name for file in others[:LEFT_OUT_NAMED])
        if len(others) > LEFT_OUT_NAMED:
            configuration["left_out"] += f" and {len(others) - LEFT_OUT_NAMED} more"
        LOGGER.warning(
            "%s: left out, because they are not in the format %s: %s",
            source,
            " or ".join(names),
            configuration["left_out"],
        )
    doubted: list[str] = []
    count = 0
    with (
        new_dataset(out, configuration) as dataset,
        Progress("importing recordings", 0, quiet) as shown,
    ):
        for key, recording in guarded(
            source, read_formats, source, names, types, rate_hz, columns, units
        ):
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
            said = [*recording.doubts, *([doubt] if doubt else [])]
            if said:
                LOGGER.warning("%s: %s", recording.name, "; ".join(said))
            road, found = roads.of(recording)
            options: dict[str, JsonValue] = {
                "recording": recording.name, "file": recording.file,
                "notes": [*recording.notes, *recording.doubts, *found],
            }  # fmt: skip
            if unit != "m":
                options[SCALED] = True
            if doubt:
                options[DOUBTED] = doubt
            meta = EpisodeMeta(
                scenario=scenario or key,
                engine=key,
                index=count,
                split=split or split_of(count),
                options=options,
                made_with=made_with(key),
            )
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

    Args:
        source: a dataset's folder, a file, or a folder of files.
        name: format of the recordings; None to recognise it from the content.
        net: as in `import_recordings`.

    Yields:
        Folder of a dataset; recordings are all in its test split.

    Raises:
        InputError: if a file is broken or of no known format.
    """
    if name is None and is_dataset(source):
        yield source
        return
    if is_remote(source):
        with fetched(source) as copy, as_dataset(copy, name, net) as folder:
            yield folder
        return
    if not source.exists():
        raise InputError(f"{source}: found nothing there, expected a dataset or a recording")
    with temporary_folder("import") as scratch:
        folder = scratch / (source.resolve().name or "recordings")
        import_recordings(source, folder, name, net, split="test", quiet=True)
        with called(folder, source):
            yield folder


def export_dataset(dataset: Path, out: Path, name: str, quiet: bool = False) -> list[Path]:
    """Write every episode of a dataset in another format.

    Episodes that have no window of the format's length are left out; a line on stderr says so.

    Args:
        dataset: folder of the dataset.
        out: where; created if need be. Files of the same names are replaced if they were exported
            from the same dataset.
        name: a key of ``sim.formats.FORMATS`` that has a writer.
        quiet: whether to show no progress.

    Returns:
        Summary of the export.

    Raises:
        InputError: if the dataset is broken, a step does not fit, no episode is long enough, or
            the folder holds other files of the format.
        OSError: if something cannot be written.
    """
    writer = get_writer(name)
    if is_remote(out):
        with new_output(out) as folder:
            made = export_dataset(dataset, folder, name, quiet)
            return [out / path.relative_to(folder) for path in made]
    opened = open_dataset(dataset)
    if is_dataset(out):
        raise InputError(f"{out}: found a dataset, expected another folder for the exported files")
    out.mkdir(parents=True, exist_ok=True)
    _claim(out, name, opened)
    index = new_index(name)
    written: list[Path] = []
    left_out: list[NoWindowError] = []
    episodes = opened.manifest.episodes
    with Progress("exporting episodes", len(episodes), quiet) as shown:
        for entry in episodes:
            tracks, road = opened.read(entry).tracks, opened.road(entry)
            try:
                files = writer(out, entry.id, tracks, road)
            except NoWindowError as reason:
                left_out.append(reason)
            else:
                written += files
                if index is not None:
                    index.add(files, entry.id, tracks, road)
            shown.advance(entry.agents, entry.agent_steps)
    if left_out:
        summary = f"{len(left_out)} of {len(episodes)} episodes left out, first {left_out[0]}"
        if not written:
            (out / MARKER).unlink(missing_ok=True)
            raise InputError(f"{dataset}: {summary}")
        LOGGER.warning("%s: %s", dataset, summary)
    return written if index is None else [*written, *index.write(out)]


def _claim(out: Path, name: str, dataset: Dataset) -> None:
    """Refuse a folder with files that were not exported from this dataset, or mark it as ours."""
    marker = out / MARKER
    episodes = "\n".join(entry.id for entry in dataset.manifest.episodes)
    identity = f"{checksum(episodes.encode())}\n"
    known = marker.is_file() and marker.stat().st_size <= len(identity)
    if known and marker.read_text(encoding="utf-8", errors="replace") == identity:
        return
    try:
        other = recording_files(out, name)[0]
    except InputError:  # there is none
        write_whole(marker, identity.encode())
        return
    raise InputError(
        f"{out}: found {other.relative_to(out)}, a {name} file that does not come from this "
        "dataset, expected a folder without such files: readers would mix both"
    )
