"""The catalogue ``episodes.parquet``: a row per episode, and what concerns the whole dataset.

A catalogue is opened by its last bytes alone; its rows are read when they are asked for, and become
`EpisodeEntry` objects only where an episode is. So a million episodes open in less than a second.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cached_property, reduce
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Style
from sim.arrow.budget import check_budget
from sim.arrow.parquet import Footer, opened, opened_group, read_footer, read_packed
from sim.frames import KINDS
from sim.invalid_fields import first_wrong_field
from sim.store.encode import parquet_options
from sim.store.places import Folder, Place, whole_file_at
from sim.store.schema import (
    CATALOGUE,
    SCHEMA_VERSION,
    EpisodeEntry,
    FileEntry,
    Header,
    Manifest,
    Split,
)

M = TypeVar("M", bound=BaseModel)

EPISODES: Final = "episodes.parquet"
"""Name of the catalogue; it is written last, so where it is the dataset is whole."""

METADATA_KEY: Final = b"graphrqi"
"""Under which key a Parquet file says in JSON what belongs to the file as a whole."""

MAX_EPISODES: Final = 10**8
"""Most rows of a catalogue that are read."""

_WORDS: Final = tuple(
    field.name for field in CATALOGUE if field.type == pa.string() and field.name != "id"
)
_DRAWN: Final = (*BEHAVIORS, *(kind.value for kind in KINDS))
_GROUP_ROWS: Final = 2**17
"""Rows of a row group of the catalogue (a few MB)."""


def catalogue_table(entries: Iterable[EpisodeEntry]) -> pa.Table:
    """Entries as the rows of a catalogue, in their order.

    Args:
        entries: of shards.

    Returns:
        A table of the columns ``CATALOGUE``.
    """
    columns: dict[str, list[Any]] = {name: [] for name in CATALOGUE.names}
    plain = ("id", "scenario", "engine", "split", "index", "seed", "recording", "frames", "agents",
             "agent_steps", "road", "row_group")  # fmt: skip
    for entry in entries:
        for name in plain:
            columns[name].append(getattr(entry, name))
        for name in _DRAWN:
            columns[name].append(entry.drawn.get(name, 0))
        columns["flow"].append(words_of(entry.options.get("flow")))
        columns["mix"].append(words_of(entry.options.get("mix")))
        columns["exact"].append(bool(entry.exact))
        columns["shard"].append(entry.shard or "")
        columns["options"].append(as_json(entry.options))
        columns["made_with"].append(as_json(entry.made_with))
    return pa.Table.from_pydict(columns, schema=CATALOGUE)


def words_of(option: JsonValue) -> str | None:
    """How the catalogue says an option of an episode: a word as it is, anything else as JSON.

    Examples:
        >>> words_of("dense"), words_of({"timid": 0.5, "careful": 0.5}), words_of(None)
        ('dense', '{"careful": 0.5, "timid": 0.5}', None)
    """
    if option is None or isinstance(option, str):
        return option
    return as_json(option)


def as_json(value: object) -> str:
    """One line of JSON; equal values give equal lines."""
    return json.dumps(value, sort_keys=True, allow_nan=False)


def write_catalogue(place: Place, header: Header, tables: Iterable[pa.Table]) -> None:
    """Write the catalogue of a dataset, which completes it.

    Args:
        place: the dataset.
        header: what concerns all of it.
        tables: its rows, sorted, in pieces; a row group's worth of them is in memory at a time.

    Raises:
        OSError: if it cannot be written; an older one is then still there, whole.
    """
    options = parquet_options(CATALOGUE)
    options["use_dictionary"] = list(_WORDS)
    waiting, written = CATALOGUE.empty_table(), 0
    if isinstance(place, Folder):
        place.path.mkdir(parents=True, exist_ok=True)
    with (
        whole_file_at(place.path / EPISODES) as partial,
        pq.ParquetWriter(partial, CATALOGUE, write_page_checksum=True, **options) as writer,
    ):
        for table in tables:
            waiting = pa.concat_tables([waiting, table])
            while len(waiting) >= _GROUP_ROWS:
                writer.write_table(waiting.slice(0, _GROUP_ROWS).combine_chunks())
                waiting = waiting.slice(_GROUP_ROWS)
                written += 1
        if len(waiting) or not written:
            writer.write_table(waiting.combine_chunks())
        writer.add_key_value_metadata({METADATA_KEY.decode(): as_json(header.model_dump())})


def metadata_of(path: Path, footer: Footer, model: type[M]) -> M:
    """What a Parquet file of ours says of itself as a whole.

    Args:
        path: of the file, for messages.
        footer: of the file.
        model: what it is expected to be.

    Raises:
        InputError: if it says nothing, or something else.
    """
    said = footer.metadata.get(METADATA_KEY)
    if said is None:
        raise InputError(f"{path}: found no metadata of graphrqi, expected a file of a dataset")
    try:
        return model.model_validate_json(said)
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


class Catalogue:
    """What a dataset holds; its rows are read when they are asked for.

    Attributes:
        header: what concerns the dataset as a whole.
    """

    def __init__(self, place: Place, footer: Footer) -> None:
        """Open a catalogue.

        Raises:
            InputError: if it is broken or of another version.
        """
        self._place = place
        self._path = place.path / EPISODES
        said = metadata_of(self._path, footer, Versioned)
        check_version(self._path, said.schema_version, SCHEMA_VERSION)
        self.header = metadata_of(self._path, footer, Header)
        self.count = footer.rows
        self._footer = footer

    @cached_property
    def table(self) -> pa.Table:
        """All rows, with the columns ``CATALOGUE``; repeated words are in memory once.

        Raises:
            InputError: if the file is broken or has other columns.
        """
        try:
            data = self._place.read(EPISODES)
        except FileNotFoundError:
            raise InputError(f"{self._path}: found no file any more") from None
        with opened(self._path, data) as (layout, source):
            if layout.rows > MAX_EPISODES:
                raise InputError(
                    f"{self._path}: found {layout.rows} rows, expected at most {MAX_EPISODES}"
                )
            found = pq.read_schema(source).remove_metadata()
            if not found.equals(CATALOGUE):
                other = next((f.name for f in CATALOGUE if f not in list(found)), found.names[-1])
                raise InputError(
                    f"{self._path}: found other columns, expected those of version "
                    f"{SCHEMA_VERSION} ({other})"
                )
            check_budget(self._path, layout, None, MAX_EPISODES)
            # one dictionary for all row groups
            packed = read_packed(source, list(_WORDS), None)
            return packed.unify_dictionaries().combine_chunks()

    @cached_property
    def totals(self) -> pa.Table:
        """Sums over the episodes of each scenario and split; one row group is read at a time.

        Returns:
            The columns ``scenario``, ``split``, ``episodes``, and sums of ``agents``,
            ``agent_steps`` and of every behaviour and kind that was drawn.

        Raises:
            InputError: if the file is broken.
        """
        summed = ["agents", "agent_steps", *map(str, _DRAWN)]
        found = []
        for number in range(len(self._footer.groups)):
            with opened_group(
                self._footer, number, lambda begin, end: self._place.read(EPISODES, begin, end)
            ) as (layout, parquet):
                names = ["scenario", "split", *summed]
                check_budget(self._path, layout, names, MAX_EPISODES)
                found.append(totals_of(parquet.read_row_group(number, names, use_threads=False)))
        whole = pa.concat_tables(found) if found else totals_of(CATALOGUE.empty_table())
        return _summed(whole, ["episodes", *summed])

    def entries(self, table: pa.Table | None = None) -> tuple[EpisodeEntry, ...]:
        """Rows as entries.

        Args:
            table: some of the rows; None for all.

        Raises:
            InputError: if a row is not as it should be.
        """
        rows = self.table if table is None else table
        return _entries(self._path, rows)

    @cached_property
    def manifest(self) -> Manifest:
        """Everything, as objects."""
        return Manifest(**dict(self.header), episodes=self.entries())


def totals_of(rows: pa.Table) -> pa.Table:
    """As `Catalogue.totals`, of some rows of a catalogue."""
    summed = ["agents", "agent_steps", *map(str, _DRAWN)]
    ones = pa.array(np.ones(len(rows), dtype=np.int64))
    table = rows.select(["scenario", "split", *summed]).append_column("episodes", ones)
    words = [table.column(name).cast(pa.string()) for name in ("scenario", "split")]
    table = table.set_column(0, "scenario", words[0]).set_column(1, "split", words[1])
    return _summed(table, ["episodes", *summed])


def _summed(table: pa.Table, names: list[str]) -> pa.Table:
    keys = ["scenario", "split"]
    sums = table.group_by(keys, use_threads=False).aggregate([(name, "sum") for name in names])
    return sums.select([*keys, *(f"{name}_sum" for name in names)]).rename_columns([*keys, *names])


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
        InputError: if a filter is no behaviour, no split, or no mix.
    """
    if split is not None and split not in get_args(Split):
        raise InputError(f"split: found {split!r}, expected one of {', '.join(get_args(Split))}")
    if behavior is not None and behavior not in BEHAVIORS:
        raise InputError(f"behavior: found {behavior!r}, expected one of {', '.join(BEHAVIORS)}")
    wanted = {
        "split": split,
        "scenario": scenario,
        "mix": None if mix is None else _mix_words(mix),
        "flow": flow if flow is None or isinstance(flow, str) else words_of(float(flow)),
    }
    fits = [pc.equal(table.column(n), value) for n, value in wanted.items() if value is not None]
    if behavior is not None:
        fits.append(pc.greater(table.column(str(behavior)), 0))
    return table.filter(reduce(pc.and_, fits)) if fits else table


class Versioned(BaseModel):
    """The one field that every version has."""

    model_config = ConfigDict(extra="ignore")
    schema_version: int


def check_version(path: Path, version: int, expected: int) -> None:
    """Refuse the description of a dataset that another version of this package wrote.

    Raises:
        InputError: naming both versions.
    """
    if version != expected:
        raise InputError(
            f"{path}: found schema_version {version}, expected {expected}"
            + ("; a newer graphrqi reads it" if version > expected else "")
        )


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


def _entries(path: Path, table: pa.Table) -> tuple[EpisodeEntry, ...]:
    plain = [
        name
        for name in CATALOGUE.names
        if name not in (*_DRAWN, "recording", "flow", "mix", "options", "made_with")
    ]
    columns = {name: table.column(name).to_pylist() for name in plain}
    drawn = np.stack([table.column(name).to_numpy() for name in _DRAWN]) if len(table) else None
    parsed: dict[str, Any] = {}

    def said(text: str) -> Any:
        if text not in parsed:
            parsed[text] = json.loads(text)
        return parsed[text]

    found = []
    options, made_with = (table.column(name).to_pylist() for name in ("options", "made_with"))
    try:
        for i in range(len(table)):
            assert drawn is not None
            some = np.flatnonzero(drawn[:, i])
            found.append(
                EpisodeEntry(
                    **{name: values[i] for name, values in columns.items()},
                    options=said(options[i]),
                    made_with=said(made_with[i]),
                    drawn={_DRAWN[k]: int(drawn[k, i]) for k in some},
                )
            )
    except ValidationError as error:
        raise InputError(f"{path}: row {len(found)}: {first_wrong_field(error)}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: row {len(found)}: found options that are no JSON") from None
    return tuple(found)


def open_catalogue(place: Place) -> Catalogue | None:
    """The catalogue of a dataset.

    Args:
        place: the dataset.

    Returns:
        The catalogue; None where there is no ``episodes.parquet``.

    Raises:
        InputError: if it is broken or of another version.
    """
    size = place.size(EPISODES)
    if size is None:
        return None
    path = place.path / EPISODES
    footer = read_footer(path, size, lambda begin, end: place.read(EPISODES, begin, end))
    return Catalogue(place, footer)


def sorted_entries(entries: Iterable[EpisodeEntry]) -> list[EpisodeEntry]:
    """Entries in the order of catalogues."""
    return sorted(entries, key=lambda e: (e.scenario, e.engine, e.index, e.id))


def header_of(
    configuration: Mapping[str, JsonValue],
    roads: Mapping[str, int],
    files: Mapping[str, FileEntry],
) -> Header:
    """The header of a dataset of the present version."""
    return Header(
        schema_version=SCHEMA_VERSION,
        configuration=dict(configuration),
        roads=dict(sorted(roads.items())),
        files=dict(sorted(files.items())),
    )
