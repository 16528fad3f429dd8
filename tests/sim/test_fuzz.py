"""A sample of ``tests/fuzz.py``: hostile files that graphrqi and independent readers agree on."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

SAMPLE = 100
FAILED_BEFORE = {"sumo-fcd": (46, 279)}
"""Numbers of inputs on which readers once differed."""


def _fuzz() -> ModuleType:
    path = Path(__file__).parents[1] / "fuzz.py"
    spec = importlib.util.spec_from_file_location("graphrqi_fuzz", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module


FUZZ = _fuzz()


@pytest.mark.parametrize("family", sorted(FUZZ.FILES))
def test_both_accept_or_both_refuse(family: str, tmp_path: Path) -> None:
    counts: Counter[str] = Counter()
    for number in (*FAILED_BEFORE.get(family, ()), *range(SAMPLE)):
        state, why = FUZZ.check(family, number, tmp_path)
        assert state not in ("disagree", "crash"), f"{family}:{number}: {why}"
        counts[state] += 1
    assert counts["read"] > SAMPLE // 10
    assert counts["refused"] > SAMPLE // 10


@pytest.mark.parametrize("family", sorted(FUZZ.TABLES))
def test_the_oracle_tells_rows_apart(family: str, tmp_path: Path) -> None:
    table = FUZZ.TABLES[family]
    whole = ",".join(table.columns) + "\n"
    for k in range(3):
        whole += ",".join(make(0, k) for make in table.columns.values()) + "\n"
    path = tmp_path / table.file
    path.write_text(whole)
    mine = FUZZ.ours(family, path)
    assert FUZZ.differ(mine, FUZZ.read_table(table, whole.encode())) is None
    moved = {key: (x + 1.0, y) for key, (x, y) in mine.items()}
    assert FUZZ.differ(moved, mine) is not None
    assert FUZZ.differ(mine, dict(list(mine.items())[1:])) is not None
