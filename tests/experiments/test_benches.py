"""Every bench follows the contract: it runs at its quick size and gives tidy rows."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from experiments.benches.contract import Bench, option
from experiments.benches.registry import BENCHES
from experiments.cli.bench import bench_command
from experiments.cli.commands import main
from experiments.report.sections import LAYOUTS
from experiments.rows import FIGURE, Row, read_rows, tidy_row
from experiments.scoring import evaluation


@pytest.mark.parametrize("name", BENCHES)
def test_rows_are_tidy(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = BENCHES[name]
    if bench.needs and not os.environ.get(bench.needs):
        pytest.skip(f"{bench.needs} is not set: no recordings to measure on")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["bench", name, "--quick", "--json", "rows.json"])
    assert ended.value.code == 0
    rows = read_rows(Path("rows.json"))
    assert rows
    for row in rows:
        assert row.keys() == {"bench", *bench.keys, *FIGURE}
        assert row["bench"] == name
        if row["value"] is None:
            assert row["n"] == 0  # nobody had an occasion
        else:
            assert isinstance(row["value"], int | float)
            assert math.isfinite(row["value"])


@pytest.mark.parametrize("name", BENCHES)
def test_every_bench_says_what_it_is(name: str) -> None:
    bench = BENCHES[name]
    assert bench.name == name
    assert bench.summary.endswith(".")
    assert type(bench.full) is type(bench.quick)
    assert bench.full != bench.quick


def test_the_layouts_are_of_benches() -> None:
    """A bench without a layout of its own is reported as other figures."""
    assert LAYOUTS.keys() <= {*BENCHES, evaluation.BENCH}


@dataclass(frozen=True)
class Settings:
    numbers: tuple[int, ...] = option((1, 2), "Which numbers.")
    who: tuple[str, ...] = option(("a",), "Whose.")
    often: int = option(3, "How often.")
    hidden: int = 7


def echo(settings: Settings) -> list[list[Row]]:
    return [
        [tidy_row({"who": who}, "sum", float(number * settings.often), None, None, settings.hidden)]
        for who in settings.who
        for number in settings.numbers
    ]


ECHO = Bench("echo", "Say what was asked for.", ("who",), Settings(), Settings(often=1), echo)


def rows_of(*arguments: str) -> list[tuple[object, object, object]]:
    out = Path("rows.json")
    bench_command(ECHO)([*arguments, "--json", str(out)], standalone_mode=False)
    return [(row["who"], row["value"], row["n"]) for row in json.loads(out.read_text())]


def test_settings_are_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert rows_of() == [("a", 3.0, 7), ("a", 6.0, 7)]
    assert rows_of("--quick") == [("a", 1.0, 7), ("a", 2.0, 7)]
    assert rows_of("--quick", "--numbers", "5") == [("a", 5.0, 7)]
    assert rows_of("--who", "b, c", "--numbers", "1", "--often", "2") == [
        ("b", 2.0, 7),
        ("c", 2.0, 7),
    ]
    names = {parameter.name for parameter in bench_command(ECHO).params}
    assert names == {"numbers", "who", "often", "quick", "json"}


def test_a_plot_without_a_format_is_refused_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("spectrum", "prediction", "classification"):
        with pytest.raises(SystemExit) as ended:
            main(["bench", name, "--plot", "rows.jpg"])
        assert ended.value.code == 2
        said = "--plot: found 'rows.jpg', expected a name that ends in .pdf, .png or .svg"
        assert said in capsys.readouterr().err


def test_rows_are_kept_after_every_part() -> None:
    counts: list[int] = []
    rows = ECHO.run(on_rows=lambda rows: counts.append(len(rows)))
    assert counts == [1, 2] == list(range(1, len(rows) + 1))
