"""What a family of inputs is: a valid input, what reads it, and what an independent reader says."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

EPISODE: Final = "0123456789abcdef"
"""The episode of tables that speak of one."""


@dataclass(frozen=True)
class Sample:
    """A family of inputs.

    Attributes:
        files: a valid input, by the files' paths in its folder.
        read: reads it, from its folder: everything that a command does with it before it works.
        oracle: reads the same files, from their folder, with other code; raises
            `experiments.benches.hostile.oracles.Refused` where they are no such files.
        differs: in words, what the oracle's answer (second) says against what was read (first);
            None where they agree.
        format: the registered format of recordings that it is, if it is one.
    """

    files: dict[str, bytes]
    read: Callable[[Path], Any]
    oracle: Callable[[Path], Any]
    differs: Callable[[Any, Any], str | None]
    format: str = ""


def csv_text(header: str, rows: Iterable[Iterable[object]], separator: str = ",") -> bytes:
    r"""A table as text.

    Examples:
        >>> csv_text("a,b", [[1, "x"]])
        b'a,b\n1,x\n'
    """
    lines = [separator.join(map(str, row)) for row in rows]
    return "\n".join([*([header] if header else []), *lines, ""]).encode()


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as a Parquet file."""
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def table_bytes(schema: pa.Schema, known: Sequence[dict[str, Any]]) -> bytes:
    """A table of a schema; what rows do not say is null in texts and 1/6 in numbers."""
    others = {field.name: 1 / 6 if pa.types.is_floating(field.type) else None for field in schema}
    return parquet_bytes(pa.Table.from_pylist([others | row for row in known], schema=schema))


def files_in(root: Path) -> dict[str, bytes]:
    """The files of a folder, by their paths in it; locks are left out."""
    files = (path for path in sorted(root.rglob("*")) if path.is_file() and path.name != ".lock")
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}
