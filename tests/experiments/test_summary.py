"""The summary of a dataset: rates add up, groups share the road, files hold the rows."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from experiments.cli.commands import app
from experiments.data.exchange import export_dataset
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.summary import summary
from scenarios import get_scenario
from sim.store.dataset import Dataset, open_dataset


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two short episodes on the straight road."""
    folder = tmp_path_factory.mktemp("summary") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=2, flow="dense", duration_s=40.0)
    generate(config, folder, jobs=1, quiet=True)
    return open_dataset(folder)


def figures(rows):
    return {(row.get("behavior"), row["metric"]): row["value"] for row in rows}


def test_rates_are_counts_over_distance(made: Dataset) -> None:
    found = figures(summary(made))
    involved = sum(2 * (made.conflicts(entry).kind == 0).sum() for entry in made.manifest.episodes)
    assert involved > 0
    assert found[None, "conflicts_following_per_km"] * found[None, "km"] == pytest.approx(involved)
    assert found[None, "speed_mean_mps"] == pytest.approx(
        1000 * found[None, "km"] / (3600 * found[None, "hours"])
    )
    split = figures(summary(made, "behavior"))
    for metric in ("km", "drivers"):
        parts = [value for (group, name), value in split.items() if name == metric]
        assert sum(parts) == pytest.approx(found[None, metric])


def test_the_command_writes_the_same_rows_twice(made: Dataset, tmp_path: Path) -> None:
    files = tmp_path / "rows.json", tmp_path / "rows.csv"
    options = ["--by", "kind", "--json", str(files[0]), "--out", str(files[1])]
    answer = CliRunner().invoke(app, ["summary", str(made.path), *options])
    assert answer.exit_code == 0, answer.output
    rows = json.loads(files[0].read_text())
    with files[1].open() as text:
        assert [row["metric"] for row in csv.DictReader(text)] == [row["metric"] for row in rows]


def test_recordings_have_conflicts_too(made: Dataset, tmp_path: Path) -> None:
    export_dataset(Path(made.path), tmp_path / "fcd", "sumo-fcd", quiet=True)
    answer = CliRunner().invoke(app, ["summary", str(tmp_path / "fcd")])
    assert answer.exit_code == 0, answer.output
    assert "conflicts following per km" in answer.output


def test_a_recording_with_a_break_and_a_map_has_a_summary(made: Dataset, tmp_path: Path) -> None:
    export_dataset(Path(made.path), tmp_path / "fcd", "sumo-fcd", quiet=True)
    file = next(one for one in (tmp_path / "fcd").glob("*.xml") if ".types" not in one.name)
    seen = re.sub(r'(?s) *<timestep time="1[0-3]\.[^>]*>.*?</timestep>\n', "", file.read_text())
    file.write_text(seen)
    net = str(get_scenario("straight_road")().road.source)
    answer = CliRunner().invoke(app, ["summary", str(file), "--net", net])
    assert answer.exit_code == 0, answer.output
    assert "headway" in answer.output
