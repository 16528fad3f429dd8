"""Tables of many shards as one `pyarrow.dataset.Dataset`, in a folder or in an object store.

Arrow reads with threads of its own, also ahead of what was asked for. Files of an object store are
read by Python's code (fsspec), and a thread that calls it while the interpreter ends aborts the
process. So the end of the interpreter waits for calls in progress and refuses later ones.
"""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import pyarrow as pa
import pyarrow.compute as pc

from behaviors.errors import InputError
from sim.store.places import Place, Store, full_name
from sim.store.schema import TABLES, FileName, shard_schema
from sim.store.shards import shard_file

T = TypeVar("T")

QUIET_S: Final = 0.2
"""Arrow's threads are done when none has called for so long, s (a call that is refused takes
microseconds, and what follows it comes at once)."""


class _Calls:
    """Calls of Python's code by Arrow's threads: which are in progress, and when the last ended."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._now = 0
        self._last_s = 0.0
        self._ended = False

    def make(self, call: Callable[..., T], *given: Any) -> T:
        """Make a call.

        Raises:
            OSError: if the interpreter ends.
        """
        with self._changed:
            self._last_s = time.monotonic()
            if self._ended:
                raise OSError("found the interpreter at its end, expected it to run")
            self._now += 1
        try:
            return call(*given)
        finally:
            with self._changed:
                self._now -= 1
                self._last_s = time.monotonic()
                self._changed.notify_all()

    def end(self) -> None:
        """Refuse further calls, and wait until there are none."""
        with self._changed:
            self._ended = True
            while self._now or time.monotonic() - self._last_s < QUIET_S:
                self._changed.wait(QUIET_S)


_calls = _Calls()


def _forget() -> None:
    """A forked process has none of its parent's threads."""
    global _calls
    _calls = _Calls()


os.register_at_fork(after_in_child=_forget)
atexit.register(lambda: _calls.end())


class _File:
    """A file of an object store as Arrow's threads read it, into memory that is Arrow's own.

    Python's memory would be given back by the thread that is the last to need it.
    """

    def __init__(self, file: Any) -> None:
        self._file = file

    @property
    def closed(self) -> bool:
        """Whether it is closed."""
        return bool(self._file.closed)

    def close(self) -> None:
        """Close it."""
        self._file.close()

    def seek(self, to: int, whence: int = 0) -> int:
        """Go to a place, and tell which it is."""
        return cast(int, _calls.make(self._file.seek, to, whence))

    def tell(self) -> int:
        """The place."""
        return cast(int, _calls.make(self._file.tell))

    def read(self, size: int = -1) -> bytes:
        """So many bytes; all that follow if none are asked for."""
        return cast(bytes, _calls.make(self._file.read, size))

    def read_buffer(self, size: int = -1) -> pa.Buffer:
        """The same in Arrow's memory."""
        return _calls.make(self._copied, size)

    def _copied(self, size: int) -> pa.Buffer:
        data = self._file.read(size)
        found = pa.allocate_buffer(len(data))
        memoryview(found).cast("B")[:] = data
        return found


def _filesystem(place: Place) -> Any:
    """What `pyarrow.dataset` reads a place with; None for folders."""
    if not isinstance(place, Store):
        return None
    from pyarrow.fs import FSSpecHandler, PyFileSystem

    class Handler(FSSpecHandler):  # type: ignore[misc]
        """Gives Arrow's threads files that the end of the interpreter waits for."""

        def open_input_file(self, path: str) -> pa.PythonFile:
            """A file, opened for reading."""
            return _calls.make(lambda: pa.PythonFile(_File(self.fs.open(path, "rb")), mode="r"))

    return PyFileSystem(Handler(place.filesystem))


def scanned(place: Place, table: str, fitting: pa.Table, alone: Any | None) -> Any:
    """The shards of some rows of a catalogue as one `pyarrow.dataset.Dataset`.

    Args:
        place: the dataset.
        table: which table.
        fitting: rows of the catalogue.
        alone: ids of the only episodes wanted; None for all that the shards have.
    """
    from pyarrow import dataset as arrow_dataset

    if table not in TABLES:
        raise InputError(f"table: found {table!r}, expected one of {', '.join(TABLES)}")
    name = cast(FileName, f"{table}.parquet")
    where = fitting.select(["scenario", "split", "shard"]).group_by(
        ["scenario", "split", "shard"]
    ).aggregate([])  # fmt: skip
    files = sorted(
        shard_file(name, row["scenario"], row["split"], row["shard"]) for row in where.to_pylist()
    )
    exact = bool(pc.any(fitting.column("exact")).as_py())
    schema = shard_schema(name, exact)
    for column in ("scenario", "split"):
        schema = schema.append(pa.field(column, pa.string()))
    found = arrow_dataset.dataset(
        [full_name(place, file) for file in files],
        schema=schema,
        format="parquet",
        filesystem=_filesystem(place),
        partitioning=arrow_dataset.partitioning(
            pa.schema([("scenario", pa.string()), ("split", pa.string())]), flavor="hive"
        ),
        partition_base_dir=full_name(place, table),
    )
    # A column without rows has no type of its own when it becomes a set.
    ids = None if alone is None else pa.array(alone.to_pylist(), pa.string())
    return found if ids is None else found.filter(pc.field("episode").isin(ids))
