"""Forged Parquet files are refused in one line before Arrow reads them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from sim.arrow.budget import check_budget
from sim.arrow.parquet import look_through, opened, read_packed
from sim.arrow.thrift import ThriftError, read_struct


def content(table: pa.Table, **options: object) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, **options)
    return sink.getvalue().to_pybytes()


def small(rows: int = 40) -> pa.Table:
    return pa.table(
        {
            "agent": pa.array(np.arange(rows)),
            "name": pa.array(
                [None if i % 7 == 3 else f"car {i % 5}" for i in range(rows)], "string"
            ),
            "route": pa.array([["in", "out"][: i % 3] for i in range(rows)], pa.list_(pa.string())),
            "x_m": pa.array(np.linspace(0.0, 1.0, rows)),
        }
    )


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("compression", ["zstd", "none", "gzip"])
@pytest.mark.parametrize("rows", [0, 1, 40, 5000])
def test_the_layout_is_what_was_written(version: str, compression: str, rows: int) -> None:
    table = small(rows)
    data = content(
        table, data_page_version=version, compression=compression, row_group_size=1500,
        data_page_size=2000, write_page_index=True,
    )  # fmt: skip
    layout = look_through(Path("t.parquet"), data)
    assert layout.rows == rows
    assert [column.name.split(".")[0] for column in layout.columns] == table.column_names
    assert [column.repeated for column in layout.columns] == [False, False, True, False]
    assert layout.columns[0].values == rows
    assert layout.columns[3].size >= 8 * min(rows, 1)
    with opened(Path("t.parquet"), data) as (_, source):
        again = read_packed(source, ["name"], None)
    assert again.cast(table.schema).equals(table)


SCRIPT = """
import sys
from pathlib import Path
from behaviors.errors import InputError
from sim.arrow.budget import check_budget
from sim.arrow.parquet import opened, read_packed

data = Path(sys.argv[1]).read_bytes()
begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
read = refused = 0
for at in (*range(4, 60), *range(begin, len(data))):
    for change in (1, 2, 16, 0x80, 0xFF):
        forged = bytearray(data)
        forged[at] ^= change
        try:
            with opened(Path("forged.parquet"), bytes(forged)) as (layout, source):
                read_packed(source, check_budget(Path("x"), layout, None, 1000), None)
            read += 1
        except InputError as error:
            assert "\\n" not in str(error), error
            refused += 1
print(read, refused)
"""


def test_no_changed_byte_ends_the_process(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(content(small(6), compression="zstd", store_schema=False))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert min(map(int, done.stdout.split())) > 100


def test_forged_size_statistics_are_read_or_refused(tmp_path: Path) -> None:
    # Arrow ends the process when it is asked for this chunk: its histogram has a level too many
    data = bytearray(content(small(6).select(["name"]), compression="none", store_schema=False))
    levels = b"\x19\x26\x02\x0a"  # a list of two numbers: 1 without a name, 5 with one
    assert data.count(levels) == 1, "Arrow writes its size statistics in another way"
    forged = data.replace(levels, b"\x19\x36\x02\x0a\x00")
    size = int.from_bytes(forged[-8:-4], "little") + 1
    forged[-8:-4] = size.to_bytes(4, "little")
    native = "import sys, pyarrow.parquet as p; p.read_metadata(sys.argv[1]).row_group(0).column(0)"
    path = tmp_path / "t.parquet"
    path.write_bytes(forged)
    done = subprocess.run([sys.executable, "-c", native, path], capture_output=True, check=False)
    assert done.returncode < 0, "Arrow survives it: then this is no test any more"
    with (
        pytest.raises(InputError, match=r"t\.parquet: found no readable Parquet table"),
        opened(path) as (_, source),
    ):
        read_packed(source, ["name"], None)


@pytest.mark.parametrize("cut", [0, 3, 4, 11, 12, 200, -1, -4, -9])
def test_a_cut_file_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(content(small())[:cut])
    with pytest.raises(InputError, match=r"t\.parquet: found"), opened(path):
        pass


def test_what_unpacks_to_too_much_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim.arrow.budget.MAX_TEXT_BYTES", 10**7)
    text = pa.table({"name": pa.array(["a" * 10**5] * 300)})
    data = content(text, use_dictionary=False, compression="zstd")
    assert len(data) < 10**5
    path = Path("t.parquet")
    with pytest.raises(InputError, match=r"column name: found 300\d+ bytes, expected at most"):
        check_budget(path, look_through(path, data), None, 1000)
    with pytest.raises(InputError, match="found 300 rows, expected at most 299"):
        check_budget(path, look_through(path, data), ["name"], 299)


def test_texts_told_by_those_before_them_are_refused() -> None:
    table = pa.table({"name": pa.array(["abc" * 1000] * 10)})
    data = content(table, use_dictionary=False, column_encoding={"name": "DELTA_BYTE_ARRAY"})
    with pytest.raises(InputError, match="DELTA_BYTE_ARRAY"):
        look_through(Path("t.parquet"), data)


@pytest.mark.parametrize(
    "broken",
    [b"", b"\x15", b"\x15\x80\x80", b"\x18\x7f", b"\x19\xfc\xff\xff\x7f", b"\x1d\x00", b"\x1c" * 99,
     b"\x15" + b"\xff" * 12, b"\x15\x02\x05\x02\x04\x00", b"\x19" * 99],
)  # fmt: skip
def test_broken_structures_are_one_error(broken: bytes) -> None:
    with pytest.raises(ThriftError):
        read_struct(broken, 0, len(broken))


THREADS_SCRIPT = """
import os
import sys
from pathlib import Path
from sim.arrow.parquet import opened_group, read_footer

path = Path(sys.argv[1])
data = path.read_bytes()
read = lambda begin, end: data[begin:end]
footer = read_footer(path, len(data), read)
footer.arrow
before = len(os.listdir("/proc/self/task"))
for number in range(len(footer.groups)):
    with opened_group(footer, number, read) as (_, file):
        assert file.read_row_group(number, use_threads=False).num_rows
print(before, len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_row_groups_are_read_by_the_thread_that_asks(tmp_path: Path) -> None:
    """A thread of Arrow's that frees Python's memory while the interpreter ends aborts it."""
    path = tmp_path / "t.parquet"
    path.write_bytes(content(small(5000), row_group_size=1500))
    command = [sys.executable, "-c", THREADS_SCRIPT, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    before, after = done.stdout.split()
    assert before == after
