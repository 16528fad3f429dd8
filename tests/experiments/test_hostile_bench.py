"""A sample of ``graphrqi bench hostile`` and ``bench kills``: no input breaks a reader."""

from __future__ import annotations

import dataclasses
import os
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.benches.hostile import bench, trial, worker
from experiments.benches.hostile.calls import CALLS
from experiments.benches.hostile.grammars import TABLES, grow
from experiments.benches.hostile.oracles.grown import differ, read_table
from experiments.benches.hostile.oracles.recordings import rows_of
from experiments.benches.kills.bench import Settings as Kills
from experiments.benches.kills.bench import measure as measure_kills
from sim.formats import FORMATS, get_reader

SAMPLE = 40
FEW = {
    "model": 1, "dataset": 8, "sheet": 12, "labels": 12, "predictions": 12, "solver": 30,
    "stream": 4, "environment": 1, "net": 12, "net.gz": 12, "net-small": 20, "argoverse2-map": 20,
}  # fmt: skip


@pytest.mark.parametrize("family", trial.families())
def test_files_are_read_or_refused_in_one_line(family: str, tmp_path: Path) -> None:
    counts: Counter[str] = Counter()
    sample = FEW.get(family, SAMPLE)
    for number in (*bench.FAILED_BEFORE.get(family, ()), *range(sample)):
        state, why = trial.check(family, number, tmp_path / str(number))
        assert state not in trial.FAILURES, f"{family}:{number}: {why}"
        counts[state] += 1
    assert counts["refused"] + counts["stricter"] >= (family not in CALLS) * (sample // 10)
    assert list(tmp_path.iterdir()) == []


def test_every_format_that_is_read_has_a_family() -> None:
    read = {name for name, one in FORMATS.items() if one.reader is not None}
    assert read == {trial.sample_of(f).format for f in trial.families() if f not in CALLS} - {""}
    for name in read & {*TABLES}:
        assert f"{name}-grown" in trial.GROWN


@pytest.mark.parametrize(
    "family", [f for f in trial.families() if f not in CALLS and f not in trial.GROWN]
)
def test_the_oracles_agree_on_valid_files(family: str, tmp_path: Path) -> None:
    sample = trial.sample_of(family)
    for name, data in sample.files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    assert sample.differs(sample.read(tmp_path), sample.oracle(tmp_path)) is None


def test_an_input_is_the_same_wherever_it_is_made() -> None:
    assert trial.files_of("net", 7) == trial.files_of("net", 7)
    assert trial.files_of("net", 7) != trial.files_of("net", 8)
    assert grow("traf", 3) == grow("traf", 3)


@pytest.mark.parametrize("family", sorted(TABLES))
def test_the_oracle_tells_rows_apart(family: str, tmp_path: Path) -> None:
    table = TABLES[family]
    whole = ",".join(table.columns) + "\n"
    for k in range(3):
        whole += ",".join(make(0, k) for make in table.columns.values()) + "\n"
    path = tmp_path / table.file
    path.write_text(whole)
    mine = rows_of(family, get_reader(family)(path))
    assert differ(mine, read_table(table, whole.encode())) is None
    moved = {key: (x + 1.0, y) for key, (x, y) in mine.items()}
    assert differ(moved, mine) is not None
    assert differ(mine, dict(list(mine.items())[1:])) is not None


def test_what_ends_a_worker_is_told_and_the_rest_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def check(family: str, number: int, folder: Path) -> tuple[str, str]:
        if number == 1:
            os._exit(134)
        if number == 3:
            time.sleep(60)
        if number == 5:
            try:
                bytearray(3 * 10**9)
            except MemoryError:
                return "crash", "MemoryError"
        return "read", ""

    monkeypatch.setattr(worker, "check", check)
    held = np.ones(2**27)  # 1 GB that workers are forked with
    found = list(worker.try_all([("x", n) for n in range(7)], limit_gb=1.0, limit_s=0.4))
    del held
    assert [one.number for one in found] == list(range(7))
    assert [one.state for one in found] == [
        "read", "abort", "read", "slow", "read", "crash", "read"
    ]  # fmt: skip


def test_rows_count_every_input() -> None:
    (rows,) = bench.measure(bench.Settings(inputs=20, families=("traf", "study")))
    counts = {(row["family"], row["metric"]): row["value"] for row in rows}
    tried = {f: sum(counts[f, state] for state in trial.STATES) for f in ("traf", "study")}
    before = len(bench.FAILED_BEFORE["study"])
    assert tried == {"traf": 10 - before // 2, "study": 10 + before // 2}
    assert counts["traf", "peak_gb"] > 0
    with pytest.raises(InputError, match="--families: found 'trafd', expected some of"):
        list(bench.measure(bench.Settings(families=("trafd",))))
    with pytest.raises(InputError, match="--only: found 'traf', expected FAMILY:NUMBER"):
        list(bench.measure(bench.Settings(only="traf")))


def test_a_run_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    kept = str(tmp_path / "progress.json")
    settings = bench.Settings(inputs=6, families=("traf", "study"), progress=kept)
    list(bench.measure(settings))
    (rows,) = bench.measure(dataclasses.replace(settings, inputs=14))
    whole = bench.Settings(inputs=14, families=("traf", "study"))
    (wanted,) = bench.measure(whole)
    cost = ("slowest_s", "peak_gb")
    assert [r for r in rows if r["metric"] not in cost] == [
        r for r in wanted if r["metric"] not in cost
    ]
    with pytest.raises(InputError, match="found progress of"):
        list(bench.measure(dataclasses.replace(settings, seed=5)))


def test_numbers_that_only_python_reads_are_refused(tmp_path: Path) -> None:
    """Each was read as a number once: ``1_0``, digits of other scripts."""
    for family, old, new in (
        ("kitti", b" 9 -1.57", b" 0_9 -1.57"), ("lanelet2", b'v="20"', b'v="2_0"'),
        ("commonroad-map", b"<x>50</x>", b"<x>5_0</x>"), ("routes", b'"300"', b'"3_00"'),
        ("net-small", b'speed="13.89"', b'speed="1_3.89"'),
    ):  # fmt: skip
        sample = trial.sample_of(family)
        for name, data in sample.files.items():
            path = tmp_path / family / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data.replace(old, new))
        assert any(old in data for data in sample.files.values())
        with pytest.raises(InputError):
            sample.read(tmp_path / family)


def test_a_disturbed_command_loses_nothing() -> None:
    rows = [
        row
        for part in measure_kills(Kills(commands=("report",), kills=6, places=()))
        for row in part
    ]
    counts = {row["metric"]: row["value"] for row in rows}
    assert counts.pop("disturbed") <= 6
    assert set(counts.values()) == {0.0}


@pytest.mark.parametrize("digits", ["9", "0xf"])
@pytest.mark.parametrize("key", ["mix", "duration_s", "lanes", "spread", "flow"])
def test_numbers_of_very_many_digits_are_refused(tmp_path: Path, digits: str, key: str) -> None:
    for family in ("scenario", "study"):
        sample = trial.sample_of(family)
        ((name, data),) = sample.files.items()
        lines = [line for line in data.split(b"\n") if not line.startswith(key.encode())]
        lines = lines[: lines.index(b"[mix]")] if b"[mix]" in lines else lines
        (tmp_path / name).write_bytes(
            b"\n".join([*lines, f"{key} = {digits + 9000 * digits[-1]}".encode()])
        )
        with pytest.raises(InputError) as caught:
            sample.read(tmp_path)
        assert len(str(caught.value)) < 600
