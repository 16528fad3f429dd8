"""The catalogue ``episodes.parquet``: a row per episode, and what concerns the whole dataset."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import JsonValue, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.files import Place, place_of, whole_file
from sim.frames import KINDS
from sim.invalid_fields import first_wrong_field
from sim.store.parquet import METADATA_KEY, check_columns, metadata_of, opened, parquet_options
from sim.store.schema import CATALOGUE, SCHEMA_VERSION, EpisodeEntry, FileEntry, Header

EPISODES: Final = "episodes.parquet"
"""Name of the catalogue; it is written last, so where it is the dataset is complete."""

_WORDS: Final = [field.name for field in CATALOGUE if field.type == "string" and field.name != "id"]
_DRAWN: Final = (*BEHAVIORS, *(kind.value for kind in KINDS))
_GROUP_ROWS: Final = 2**17
"""Rows of a row group of the catalogue (a few MB)."""


def is_dataset(path: str | Path) -> bool:
    """Whether a folder or URL is that of a complete dataset."""
    return place_of(path).size(EPISODES) is not None


def words_of(option: JsonValue) -> str | None:
    """How the catalogue says an option of an episode: a word as it is, anything else as JSON.

    Examples:
        >>> words_of("dense"), words_of({"timid": 0.5, "careful": 0.5}), words_of(None)
        ('dense', '{"careful": 0.5, "timid": 0.5}', None)
    """
    return option if option is None or isinstance(option, str) else _json(option)


def _json(value: object) -> str:
    """One line of JSON; equal values give equal lines."""
    return json.dumps(value, sort_keys=True, allow_nan=False)


def catalogue_table(entries: Iterable[EpisodeEntry]) -> pa.Table:
    """Entries as rows of a catalogue, with the columns ``CATALOGUE``, in their order."""
    rows = [
        {
            **{name: getattr(entry, name, None) for name in CATALOGUE.names},
            **{word: entry.drawn.get(word, 0) for word in _DRAWN},
            "flow": words_of(entry.options.get("flow")),
            "mix": words_of(entry.options.get("mix")),
            "options": _json(entry.options),
            "made_with": _json(entry.made_with),
        }
        for entry in entries
    ]
    return pa.Table.from_pylist(rows, schema=CATALOGUE)


def write_catalogue(
    place: Place,
    configuration: Mapping[str, JsonValue],
    rows: Sequence[pa.Table],
    files: Mapping[str, FileEntry],
) -> None:
    """Write the catalogue of a dataset, which completes it.

    Args:
        place: the dataset.
        configuration: what it is made from.
        rows: tables of the columns ``CATALOGUE``, in any order.
        files: size and checksum of its other files, by name.

    Raises:
        OSError: if it cannot be written; an older one is then still there.
    """
    table = pa.concat_tables([CATALOGUE.empty_table(), *rows])
    table = table.sort_by([(name, "ascending") for name in ("scenario", "engine", "index", "id")])
    header = Header(
        schema_version=SCHEMA_VERSION,
        configuration=dict(configuration),
        files=dict(sorted(files.items())),
    )
    options = {**parquet_options(CATALOGUE), "use_dictionary": _WORDS}
    with (
        whole_file(place.path / EPISODES) as partial,
        pq.ParquetWriter(partial, CATALOGUE, **options) as writer,
    ):
        writer.write_table(table.combine_chunks(), row_group_size=_GROUP_ROWS)
        writer.add_key_value_metadata({METADATA_KEY: _json(header.model_dump())})


def read_header(place: Place) -> tuple[Header, int]:
    """Header of a dataset, and its number of episodes.

    Raises:
        InputError: if the catalogue is missing, broken or of another version.
    """
    path = place.path / EPISODES
    if place.size(EPISODES) is None:
        if not place.remote and not place.path.is_dir():
            what = "a file" if place.path.exists() else "nothing there"
            raise InputError(f"{place.url}: found {what}, expected a dataset (import makes one)")
        raise InputError(
            f"{path}: found no file; if the dataset is unfinished, run the same generate again"
        )
    with opened(place, EPISODES) as parquet:
        return metadata_of(path, parquet.metadata, Header), parquet.metadata.num_rows


def read_catalogue(place: Place) -> pa.Table:
    """All rows of a catalogue, with the columns ``CATALOGUE``; repeated words are in memory once.

    Raises:
        InputError: if the file is broken or has other columns.
    """
    with opened(place, EPISODES, read_dictionary=_WORDS) as parquet:
        found = parquet.metadata.schema.to_arrow_schema()  # of which no column is a dictionary
        check_columns(place.path / EPISODES, found, CATALOGUE)
        return parquet.read(use_threads=False).unify_dictionaries().combine_chunks()


def entries_of(table: pa.Table, path: Path) -> tuple[EpisodeEntry, ...]:
    """Rows of a catalogue as entries, whose JSON is parsed once where it is the same.

    Args:
        table: some of the rows.
        path: of the catalogue, for messages.

    Raises:
        InputError: if a row is not as it should be.
    """
    names = [name for name in EpisodeEntry.model_fields if name in CATALOGUE.names]
    parsed = cache(json.loads)
    found: list[EpisodeEntry] = []
    try:
        for row in table.to_pylist():
            fields = {name: row[name] for name in names}
            fields |= {name: parsed(row[name]) for name in ("options", "made_with")}
            fields["drawn"] = {str(word): row[word] for word in _DRAWN if row[word]}
            found.append(EpisodeEntry(**fields))
    except ValidationError as error:
        raise InputError(f"{path}: row {len(found)}: {first_wrong_field(error)}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: row {len(found)}: found options that are not JSON") from None
    return tuple(found)
