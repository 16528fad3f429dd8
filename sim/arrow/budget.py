"""What a table holds by its file's own words, and how much of it may be read."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from behaviors.errors import InputError

MAX_TEXT_BYTES: Final = 2**28
"""Most bytes that the texts of one column may take (256 MiB)."""

MAX_TABLE_BYTES: Final = 2**30
"""Most bytes that the columns read may unpack to, of files of any size (1 GiB, half of the budget
of 2 GB that a small file has)."""

MAX_LARGE_TABLE_BYTES: Final = 2**32
"""Most bytes that the columns read may unpack to, however large the file is (4 GiB; an hour of
1,000 agents at 10 Hz takes 2.3)."""

MAX_GROWTH: Final = 64
"""How many times larger than its file the columns read may be, where they are larger than
``MAX_TABLE_BYTES`` (trajectories grow 14 to 25 times, forged files a thousand)."""


@dataclass(slots=True)
class StoredColumn:
    """One column as a file stores it.

    Attributes:
        name: with those of what it lies in, joined by dots.
        physical: how its values are stored, in Parquet's words.
        repeated: whether a row may have several values.
        values: how many there are.
        size: bytes that they take unpacked.
        pages: how many pages hold them.
        largest_page: bytes of the largest, unpacked.
    """

    name: str
    physical: str
    repeated: bool
    values: int = 0
    size: int = 0
    pages: int = 0
    largest_page: int = 0


@dataclass(frozen=True, slots=True)
class Layout:
    """What a file holds, by its own headers, which agree with each other.

    Attributes:
        rows: how many there are.
        columns: in the file's order.
        size: bytes that they take in the file.
    """

    rows: int
    columns: tuple[StoredColumn, ...]
    size: int


def check_budget(
    path: Path, layout: Layout, names: Collection[str] | None, max_values: int
) -> list[str]:  # fmt: skip
    """Refuse columns that have more values or bytes than there may be.

    Args:
        path: of the file, for messages.
        layout: what `look_through` found.
        names: the columns that are read; None for all.
        max_values: most values that one may have.

    Returns:
        Those of them that are texts.

    Raises:
        InputError: naming what is too much.
    """
    texts: list[str] = []
    total = 0
    for column in layout.columns:
        if names is not None and column.name.partition(".")[0] not in names:
            continue
        if column.values > max_values:
            raise InputError(f"{path}: found {column.values} rows, expected at most {max_values}")
        if column.physical == "BYTE_ARRAY":
            if column.size > MAX_TEXT_BYTES:
                raise InputError(
                    f"{path}: column {column.name}: found {column.size} bytes, expected at most "
                    f"{MAX_TEXT_BYTES}"
                )
            texts.append(column.name)
        total += max(column.size, 8 * column.values)
    if total > most_unpacked_bytes(layout.size):
        raise InputError(
            f"{path}: found columns of {total} bytes in {layout.size}, expected at most "
            f"{most_unpacked_bytes(layout.size)}"
        )
    return texts


def most_unpacked_bytes(size: int) -> int:
    """Most bytes that the columns of a file may unpack to.

    Args:
        size: of the file, bytes.

    Examples:
        >>> [most_unpacked_bytes(size) // 2**20 for size in (10**3, 2**25, 10**9)]
        [1024, 2048, 4096]
    """
    return min(max(MAX_TABLE_BYTES, MAX_GROWTH * size), MAX_LARGE_TABLE_BYTES)


def check_spelled_out(path: Path, column: pa.ChunkedArray, max_text_bytes: int) -> None:
    """Refuse texts that would not fit into memory once there is one for every row.

    Args:
        path: of the file, for messages.
        column: dictionaries of texts, or lists of them; others pass.
        max_text_bytes: most bytes that they may take.

    Raises:
        InputError: naming the bytes.
    """
    flat = pc.list_flatten(column) if pa.types.is_list(column.type) else column
    if not pa.types.is_dictionary(flat.type):
        return
    longest = [pc.max(pc.binary_length(part.dictionary)).as_py() for part in flat.chunks]
    size = len(flat) * max((n or 0 for n in longest), default=0)
    if size > max_text_bytes:
        raise InputError(
            f"{path}: found texts of up to {size} bytes in a column, expected at most "
            f"{max_text_bytes}"
        )


def check_number(path: Path, field: pa.Field) -> None:
    """Refuse a column of a file that Arrow reads as something else than numbers, such as times.

    Args:
        path: of the file, for the message.
        field: name and type of the column.

    Raises:
        InputError: naming both.
    """
    if not (pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
        raise InputError(f"{path}: column {field.name}: found {field.type}, expected numbers")
