"""A sample of ``graphrqi bench hostile`` and ``bench kills``: no input breaks a reader."""

from __future__ import annotations

import os
import time
from collections import Counter
from pathlib import Path

import pytest

from behaviors.errors import InputError
from experiments.benches.hostile import bench, trial, worker
from experiments.benches.hostile.calls import CALLS
from experiments.benches.hostile.grammars import TABLES, grow
from experiments.benches.hostile.oracles import differ, read_table
from experiments.benches.kills import Settings as Kills
from experiments.benches.kills import measure as measure_kills

SAMPLE = 60
FEW = {
    "model": 1, "dataset": 8, "sheet": 15, "labels": 15, "argoverse2-grown": 30, "solver": 30,
    "stream": 4, "environment": 1,
}  # fmt: skip


@pytest.mark.parametrize("family", trial.families())
def test_files_are_read_or_refused_in_one_line(family: str, tmp_path: Path) -> None:
    counts: Counter[str] = Counter()
    sample = FEW.get(family, SAMPLE)
    for number in (*bench.FAILED_BEFORE.get(family, ()), *range(sample)):
        state, why = trial.check(family, number, tmp_path / str(number))
        assert state not in bench.FAILURES, f"{family}:{number}: {why}"
        counts[state] += 1
    assert counts["refused"] + counts["stricter"] >= (family not in CALLS) * (sample // 10)
    assert list(tmp_path.iterdir()) == []


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
    mine = trial.rows_read(family, path)
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
    found = list(worker.try_all([("x", n) for n in range(7)], limit_gb=1.0, limit_s=1.0))
    assert [one.number for one in found] == list(range(7))
    assert [one.state for one in found] == [
        "read", "abort", "read", "slow", "read", "crash", "read"
    ]  # fmt: skip


def test_rows_count_every_input() -> None:
    (rows,) = bench.measure(bench.Settings(inputs=20, families=("traf", "study")))
    counts = {(row["family"], row["metric"]): row["value"] for row in rows}
    for family in ("traf", "study"):
        assert sum(counts[family, state] for state in bench.STATES) == 10
        assert counts[family, "worker_peak_gb"] > 0
    with pytest.raises(InputError, match="--families: found 'trafd', expected some of"):
        list(bench.measure(bench.Settings(families=("trafd",))))
    with pytest.raises(InputError, match="--only: found 'traf', expected FAMILY:NUMBER"):
        list(bench.measure(bench.Settings(only="traf")))


def test_a_disturbed_command_loses_nothing() -> None:
    rows = [row for part in measure_kills(Kills(commands=("report",), kills=6)) for row in part]
    counts = {row["metric"]: row["value"] for row in rows}
    assert counts.pop("disturbed") <= 6
    assert set(counts.values()) == {0.0}
