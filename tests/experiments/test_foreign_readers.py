"""What is exported and stored opens in the readers of others, without an error or a warning.

MetaDrive itself is not on the package index, so the logic of its ``read_dataset_summary`` and
``ScenarioDescription.sanity_check`` is written here from its published source (metadrive/scenario,
Apache 2.0). Only these tests read pickles, and only those just written.
"""

from __future__ import annotations

import ast
import os
import pickle
import re
import subprocess
import sys
import warnings
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars
import pyarrow.dataset
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import export_dataset
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


# --- MetaDrive ----------------------------------------------------------------------------------


def is_scenario_file(name: str) -> bool:
    stem = Path(name).name.removesuffix(".pkl")
    return name.endswith(".pkl") and (stem[:3] == "sd_" or stem.isdigit())


def read_dataset_summary(folder: Path) -> tuple[dict[str, Any], list[str], dict[str, str]]:
    """The summary, the names of the files, and where each of them is; checked as MetaDrive does."""
    summary = pickle.loads((folder / "dataset_summary.pkl").read_bytes())
    mapping = pickle.loads((folder / "dataset_mapping.pkl").read_bytes())
    for name in summary:
        assert name in mapping, "file name in mapping mismatches with summary"
        assert is_scenario_file(name)
        assert (folder / mapping[name] / name).exists()
    return summary, list(summary), mapping


ALLOWED = (int, float, str, np.ndarray, dict, list, tuple, type(None), set)
TYPES = ("VEHICLE", "PEDESTRIAN", "CYCLIST")


def check_types(found: Any) -> None:
    if isinstance(found, dict):
        assert all(isinstance(key, str) for key in found)
    inside = found.values() if isinstance(found, dict) else found
    for one in inside if isinstance(found, dict | list) else ():
        check_types(one)
    assert isinstance(found, ALLOWED), type(found)


def sanity_check(scenario: dict[str, Any]) -> None:
    """What MetaDrive's sanity_check asserts with check_self_type and valid_check."""
    assert type(scenario) is dict
    keys = {"tracks", "version", "id", "dynamic_map_states", "map_features", "length", "metadata"}
    assert keys <= set(scenario)
    check_types(scenario)
    length = scenario["length"]
    for name, agent in scenario["tracks"].items():
        assert {"type", "state", "metadata"} <= set(agent)
        assert agent["type"] in TYPES
        state = agent["state"]
        assert {"heading", "position"} <= set(state)
        for key, array in state.items():
            assert len(array) == length
            assert array.ndim in (1, 2)
            if key == "valid":
                assert array.sum() >= 1
            shown = array[..., :2] if key == "position" else array
            assert abs(shown[~state["valid"]].sum()) < 1e-2
        assert {"type", "object_id"} <= set(agent["metadata"])
        assert agent["metadata"]["object_id"] == name
    for feature in scenario["map_features"].values():
        if feature["type"].startswith("LANE_"):
            assert isinstance(feature["polyline"], np.ndarray | list | tuple)
    metadata = scenario["metadata"]
    assert {"metadrive_processed", "coordinate", "ts"} <= set(metadata)
    assert metadata["ts"].shape == (length,)
    assert metadata["sdc_id"] in scenario["tracks"]


def test_metadrive_reads_scenarionet_exports(data: Path, tmp_path: Path) -> None:
    written = export_dataset(data, tmp_path / "out", "scenarionet", quiet=True)
    summary, names, mapping = read_dataset_summary(tmp_path / "out")
    files = {"dataset_summary.pkl", "dataset_mapping.pkl", *names}
    assert {path.name for path in written} == files
    assert {p.name for p in (tmp_path / "out").iterdir()} == files | {".graphrqi-export"}
    dataset = open_dataset(data)
    assert len(names) == len(dataset.episodes()) == 6
    for name in names:
        scenario = pickle.loads((tmp_path / "out" / mapping[name] / name).read_bytes())
        sanity_check(scenario)
        assert set(summary[name]) == set(scenario["metadata"])
        assert isinstance(summary[name]["ts"], list)  # MetaDrive keeps no arrays there
        check_types(summary[name])
        (entry,) = (e for e in dataset.episodes() if e.id == scenario["id"])
        tracks = dataset.read(entry).tracks
        for row, agent in enumerate(tracks.names):
            found = summary[name]["object_summary"][agent]
            seen = tracks.xy[row, tracks.valid[row]]
            moved = sum(np.linalg.norm(b - a) for a, b in pairwise(seen))
            assert found["moving_distance"] == pytest.approx(moved, abs=0.01)
            assert found["valid_length"] == len(seen)
            assert found["continuous_valid_length"] <= len(seen)
        numbers = summary[name]["number_summary"]
        assert (
            numbers["num_objects"]
            == len(tracks.names)
            == sum(numbers["num_objects_each_type"].values())
        )


@pytest.mark.parametrize("form", ["scenarionet", "argoverse2", "argoverse1", "sumo-fcd"])
def test_two_datasets_are_not_mixed(data: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / "out"
    before = export_dataset(data, out, form, quiet=True)
    assert export_dataset(data, out, form, quiet=True) == before  # the same dataset again
    other = tmp_path / "other"
    config = GenerateConfig(scenarios=("straight_road",), episodes=1, seed=7, duration_s=15.0)
    generate(config, other, jobs=1, quiet=True)
    content = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="that does not come from this dataset"):
        export_dataset(other, out, form, quiet=True)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == content


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
    for table in ("agents", "frames", "signals", "events", "traits"):
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
    assert "torch.Size([32, " in told


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


def test_duckdb_polars_and_pyarrow_read_the_shards(data: Path) -> None:
    steps = sum(entry.agent_steps for entry in open_dataset(data).episodes())
    shards = f"{data}/steps/*/*/*.parquet"
    assert polars.scan_parquet(shards).select(polars.len()).collect().item() == steps
    counted = duckdb.sql(f"SELECT count(*) FROM '{shards}' WHERE split IS NOT NULL").fetchall()[0]
    assert counted == (steps,)
    scanned = pyarrow.dataset.dataset(data / "steps", partitioning="hive")
    assert scanned.count_rows() == steps
    assert {"scenario", "split"} <= set(scanned.schema.names)


def test_av2_reads_the_exported_scenarios(data: Path, tmp_path: Path) -> None:
    loader = pytest.importorskip(
        "av2.datasets.motion_forecasting.scenario_serialization",
        reason="av2 is not installed; it needs Python < 3.13",
    )
    from av2.map.map_api import ArgoverseStaticMap

    for folder in export_dataset(data, tmp_path / "out", "argoverse2", quiet=True):
        (file,) = folder.glob("scenario_*.parquet")
        scenario = loader.load_argoverse_scenario_parquet(file)
        assert len(scenario.timestamps_ns) == 110
        (archive,) = folder.glob("log_map_archive_*.json")
        assert ArgoverseStaticMap.from_json(archive).vector_lane_segments
