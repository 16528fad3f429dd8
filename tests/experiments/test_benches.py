"""Every bench runs at its quick size and gives tidy rows."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest

from experiments.benches.registry import BENCHES, NEED_RECORDINGS
from experiments.cli.commands import bench, main
from experiments.study import run_study


@pytest.mark.parametrize("name", BENCHES)
def test_rows_are_tidy(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in NEED_RECORDINGS and not os.environ.get("GRAPHRQI_DATA"):
        pytest.skip("GRAPHRQI_DATA is not set: no recordings to measure on")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["bench", name, "--quick", "--json", "rows.json"])
    assert ended.value.code == 0
    rows = json.loads(Path("rows.json").read_text())
    assert rows
    for row in rows:
        assert {"metric", "value", "low", "high", "n"} <= row.keys()
        if row["value"] is None:
            assert row["n"] == 0  # nobody had an occasion
        else:
            assert math.isfinite(row["value"])


def test_every_bench_has_its_command() -> None:
    commands = {command.name for command in bench.registered_commands}
    assert commands == set(BENCHES)


def test_a_study_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def measured(name: str, quick: bool) -> list[dict[str, str | float | None]]:
        asked.append(name)
        return [{"metric": "m", "value": 1.0, "low": None, "high": None, "n": 1}]

    monkeypatch.setattr("experiments.study.run_bench", measured)
    monkeypatch.delenv("GRAPHRQI_DATA", raising=False)
    (tmp_path / "generate.json").write_text("[]")
    files = run_study(tmp_path)
    assert sorted(f.stem for f in files) == sorted(set(BENCHES) - NEED_RECORDINGS)
    assert sorted(asked) == sorted(set(BENCHES) - NEED_RECORDINGS - {"generate"})
    assert all(f.is_file() for f in files)
