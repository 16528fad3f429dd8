"""The catalogue ``episodes.parquet``: a row per episode, and what concerns the whole dataset."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import JsonValue

from behaviors.labels import BEHAVIORS
from sim.files import Place, place_of, whole_file
from sim.frames import KINDS
from sim.store.parquet import METADATA_KEY, parquet_options
from sim.store.schema import CATALOGUE, SCHEMA_VERSION, EpisodeEntry, FileEntry, Header

EPISODES: Final = "episodes.parquet"
"""Name of the catalogue; it is written last, so where it is the dataset is complete."""

WORDS: Final = [field.name for field in CATALOGUE if field.type == "string" and field.name != "id"]
"""Columns of which many rows have the same words."""

DRAWN: Final = (*BEHAVIORS, *(kind.value for kind in KINDS))
"""Columns that count drawn agents."""

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
            **{word: entry.drawn.get(word, 0) for word in DRAWN},
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
    options = {**parquet_options(CATALOGUE), "use_dictionary": WORDS}
    with (
        whole_file(place.path / EPISODES) as partial,
        pq.ParquetWriter(partial, CATALOGUE, **options) as writer,
    ):
        writer.write_table(table.combine_chunks(), row_group_size=_GROUP_ROWS)
        writer.add_key_value_metadata({METADATA_KEY: _json(header.model_dump())})
