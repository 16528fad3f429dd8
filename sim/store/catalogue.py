"""The catalogue ``episodes.parquet``: a row per episode, and what concerns the whole dataset."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, reduce
from pathlib import Path
from typing import Final, get_args

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import JsonValue, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Style
from sim.files import Place, place_of, whole_file
from sim.frames import KINDS
from sim.invalid_fields import first_wrong_field
from sim.store.schema import (
    CATALOGUE,
    SCHEMA_VERSION,
    EpisodeEntry,
    FileEntry,
    Header,
    Split,
)
from sim.store.shards import METADATA_KEY, check_columns, metadata_of, opened, parquet_options

EPISODES: Final = "episodes.parquet"
"""Name of the catalogue; it is written last, so where it is the dataset is complete."""

_WORDS: Final = tuple(
    field.name for field in CATALOGUE if field.type == pa.string() and field.name != "id"
)
_DRAWN: Final = (*BEHAVIORS, *(kind.value for kind in KINDS))
_SUMMED: Final = ["agents", "agent_steps", *map(str, _DRAWN)]
_GROUP_ROWS: Final = 2**17
"""Rows of a row group of the catalogue (a few MB)."""


def as_json(value: object) -> str:
    """One line of JSON; equal values give equal lines."""
    return json.dumps(value, sort_keys=True, allow_nan=False)


def words_of(option: JsonValue) -> str | None:
    """How the catalogue says an option of an episode: a word as it is, anything else as JSON.

    Examples:
        >>> words_of("dense"), words_of({"timid": 0.5, "careful": 0.5}), words_of(None)
        ('dense', '{"careful": 0.5, "timid": 0.5}', None)
    """
    if option is None or isinstance(option, str):
        return option
    return as_json(option)


def catalogue_table(entries: Iterable[EpisodeEntry]) -> pa.Table:
    """Entries as the rows of a catalogue, in their order.

    Args:
        entries: of shards.

    Returns:
        A table of the columns ``CATALOGUE``.
    """
    rows = [
        {
            **{name: getattr(entry, name, None) for name in CATALOGUE.names},
            **{word: entry.drawn.get(word, 0) for word in _DRAWN},
            "flow": words_of(entry.options.get("flow")),
            "mix": words_of(entry.options.get("mix")),
            "options": as_json(entry.options),
            "made_with": as_json(entry.made_with),
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
    options = {**parquet_options(CATALOGUE), "use_dictionary": list(_WORDS)}
    with (
        whole_file(place.path / EPISODES) as partial,
        pq.ParquetWriter(partial, CATALOGUE, write_page_checksum=True, **options) as writer,
    ):
        writer.write_table(table.combine_chunks(), row_group_size=_GROUP_ROWS)
        writer.add_key_value_metadata({METADATA_KEY.decode(): as_json(header.model_dump())})


def read_header(place: Place) -> tuple[Header, int]:
    """Header of a dataset, and its number of episodes.

    Args:
        place: the dataset.

    Raises:
        InputError: if the catalogue is missing, broken or of another version.
    """
    path = place.path / EPISODES
    if place.size(EPISODES) is None:
        raise InputError(_why_none(place))
    with opened(place, EPISODES) as parquet:
        metadata = parquet.metadata
    try:
        said = json.loads((metadata.metadata or {}).get(METADATA_KEY, b"{}"))
    except (ValueError, RecursionError):
        said = {}  # `metadata_of` names what is wrong
    version = said.get("schema_version") if isinstance(said, dict) else None
    if isinstance(version, int) and version != SCHEMA_VERSION:
        newer = version > SCHEMA_VERSION
        raise InputError(
            f"{path}: found schema_version {version}, expected {SCHEMA_VERSION}; "
            + ("a newer graphrqi reads it" if newer else "make it again")
        )
    return metadata_of(path, metadata, Header), metadata.num_rows


def read_catalogue(place: Place) -> pa.Table:
    """All rows of a catalogue, with the columns ``CATALOGUE``; repeated words are in memory once.

    Args:
        place: the dataset.

    Raises:
        InputError: if the file is broken or has other columns.
    """
    with opened(place, EPISODES) as parquet:
        check_columns(place.path / EPISODES, parquet.schema_arrow, CATALOGUE)
        rows = parquet.read(use_threads=False)
    for name in _WORDS:
        words = rows.column(name).dictionary_encode()
        rows = rows.set_column(rows.schema.get_field_index(name), name, words)
    return rows.unify_dictionaries().combine_chunks()


def totals_of(table: pa.Table) -> pa.Table:
    """Sums over rows of a catalogue; see `sim.store.dataset.Dataset.totals`.

    Args:
        table: rows of a catalogue.
    """
    keys = ["scenario", "split"]
    plain = pa.schema([CATALOGUE.field(name) for name in (*keys, *_SUMMED)])
    sums = table.select(plain.names).cast(plain).group_by(keys, use_threads=False)
    summed = sums.aggregate([([], "count_all"), *((name, "sum") for name in _SUMMED)])
    return summed.rename_columns([*keys, "episodes", *_SUMMED])


def _why_none(place: Place) -> str:
    """The reason for a missing catalogue, in words."""
    if not place.filesystem.exists(place.full()):
        return f"{place.url}: found nothing there, expected a dataset"
    if not place.remote and not place.path.is_dir():
        return f"{place.url}: found a file, expected a dataset (import makes one of it)"
    if place.size("manifest.json") is not None:
        return f"{place.url}: found a dataset of an older version, expected one to be made again"
    return (
        f"{place.path / EPISODES}: found no file; if the dataset is unfinished, run the same "
        "generate again"
    )


def is_dataset(path: str | Path) -> bool:
    """Whether a folder or URL is that of a complete dataset."""
    return place_of(path).size(EPISODES) is not None


def rows_where(
    table: pa.Table,
    split: str | None = None,
    scenario: str | None = None,
    behavior: str | None = None,
    mix: str | Mapping[str, float] | None = None,
    flow: str | float | None = None,
) -> pa.Table:
    """The rows of a catalogue that fit; see `sim.store.dataset.Dataset.episodes`.

    Raises:
        InputError: if a filter is not a behaviour, a split, or a mix.
    """
    if split is not None and split not in get_args(Split):
        raise InputError(f"split: found {split!r}, expected one of {', '.join(get_args(Split))}")
    own: set[str] = set()
    if behavior is not None and behavior not in BEHAVIORS:
        for text in pc.unique(table.column("options")).to_pylist():
            own |= {*json.loads(text).get("behaviors", {})}
    if behavior is not None and behavior not in (*BEHAVIORS, *own):
        raise InputError(f"behavior: found {behavior!r}, expected one of {', '.join(BEHAVIORS)}")
    wanted = {
        "split": split,
        "scenario": scenario,
        "mix": None if mix is None else _mix_words(mix),
        "flow": flow if flow is None or isinstance(flow, str) else words_of(float(flow)),
    }
    fits = [pc.equal(table.column(n), value) for n, value in wanted.items() if value is not None]
    if behavior in own:  # drawn if the mix has it
        fits.append(pc.match_substring(table.column("mix"), f'"{behavior}": '))
    elif behavior is not None:
        fits.append(pc.greater(table.column(str(behavior)), 0))
    return table.filter(reduce(pc.and_, fits)) if fits else table


def _mix_words(mix: str | Mapping[str, float]) -> str:
    """A mix as the catalogue has it."""
    if isinstance(mix, str):
        if mix.startswith("{"):
            return mix
        try:
            mix = {
                name.strip(): float(share)
                for name, _, share in (part.partition("=") for part in mix.split(","))
            }
        except ValueError:
            raise InputError(f"mix: found {mix!r}, expected behavior=share,...") from None
    styles = {str(style): [b for b in BEHAVIORS if b.style is style] for style in Style}
    shares: dict[str, float] = {}
    for name, share in mix.items():
        members = styles.get(str(name), [str(name)])
        shares |= {str(member): float(share) / len(members) for member in members}
    return as_json(shares)


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
            texts = {name: parsed(row[name]) for name in ("options", "made_with")}
            drawn = {str(word): row[word] for word in _DRAWN if row[word]}
            found.append(EpisodeEntry(**{**{n: row[n] for n in names}, **texts, "drawn": drawn}))
    except ValidationError as error:
        raise InputError(f"{path}: row {len(found)}: {first_wrong_field(error)}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: row {len(found)}: found options that are not JSON") from None
    return tuple(found)
