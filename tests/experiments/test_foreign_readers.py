"""What is stored opens in the tools of others, without an error or a warning."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path

import pytest

from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from sim.store.dataset import open_dataset
from tests.experiments.shared import object_store


@pytest.fixture(autouse=True)
def _no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("read") / "data"
    config = GenerateConfig(
        scenarios=("straight_road", "four_way_intersection"), episodes=3, seed=6, duration_s=32.0
    )
    generate(config, folder, jobs=1, quiet=True)
    return folder


# --- datasets as they are -----------------------------------------------------------------------


HUB = """
import sys, warnings
warnings.simplefilter("error")
import datasets
folder, cache, rows = sys.argv[1], sys.argv[2], {}
for name in datasets.get_dataset_config_names(folder):
    found = datasets.load_dataset(folder, name, cache_dir=cache)
    rows[name] = {split: part.num_rows for split, part in found.items()}
default = datasets.load_dataset(folder, split="test", cache_dir=cache)
rows["default"] = default.column_names
print(rows)
"""


def test_the_hub_library_loads_a_folder(data: Path, tmp_path: Path) -> None:
    """Offline, and in a process of its own, where every warning is an error."""
    offline = {"HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    run = subprocess.run(
        [sys.executable, "-c", HUB, str(data), str(tmp_path / "cache")],
        env={**os.environ, **offline}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-3000:]
    found = ast.literal_eval(run.stdout.strip().splitlines()[-1])
    dataset = open_dataset(data)
    steps = Counter[str]()
    for entry in dataset.episodes():
        steps[entry.split] += entry.agent_steps
    assert found["steps"] == steps
    assert found["episodes"] == {"catalogue": len(dataset.episodes())}
    assert found["default"][:3] == ["episode", "agent", "step"]
    for table in ("agents", "frames", "signals", "events", "traits", "conflicts"):
        counts = {s: dataset.scan(table, split=s).count_rows() for s in steps}
        assert found.get(table, {}) == {split: n for split, n in counts.items() if n}


PAGE = Path(__file__).parents[2] / "docs" / "data.md"


def examples(heading: str) -> str:
    """The Python of one part of the page about data, after which warnings are errors."""
    parts = re.split(r"^(##+ .*)$", PAGE.read_text(), flags=re.MULTILINE)
    part = parts[parts.index(heading) + 1]
    blocks = re.findall(r"^```python\n(.*?)^```$", part, flags=re.MULTILINE | re.DOTALL)
    return "\n".join(["import warnings", 'warnings.simplefilter("error")', *blocks])


def shown(script: str, folder: Path) -> str:
    """What a script prints that runs in a folder, in a process of its own."""
    home = {"HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1", "HF_HOME": str(folder / "home")}
    run = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, **home}, cwd=folder,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (run.returncode, "warn" in run.stderr.lower()) == (0, False), run.stderr[-3000:]
    return run.stdout


def test_the_page_opens_a_folder_with_every_tool(data: Path, tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(data)
    script = examples("## Opening it with other tools")
    assert all(tool in script for tool in ("duckdb.sql", "pl.scan_parquet", "pd.read_parquet",
                                           "load_dataset"))  # fmt: skip
    steps = open_dataset(data).scan("steps", split="test").count_rows()
    told = shown(script, tmp_path)
    assert f"num_rows: {steps}" in told


def test_the_page_opens_an_object_store_with_every_tool(data: Path, tmp_path: Path) -> None:
    import s3fs

    dataset = open_dataset(data)
    with object_store("bucket"):
        s3fs.S3FileSystem(skip_instance_cache=True).put(f"{data}/", "bucket/data", recursive=True)
        told = shown(examples("### From an object store"), tmp_path)
    for split in ("train", "test"):
        assert str(dataset.scan("steps", split=split).count_rows()) in told
    for scenario in dataset.scenarios:
        speeds = dataset.scan("steps", split="train", scenario=scenario).to_table()["speed_mps"]
        assert str(max(speeds.to_pylist()))[:8] in told  # DuckDB shows eight digits
