"""What is exported and stored opens in the readers of others, without an error or a warning.

MetaDrive itself is not on the package index, so the logic of its ``read_dataset_summary`` and
``ScenarioDescription.sanity_check`` is written here from its published source (metadrive/scenario,
Apache 2.0). Only these tests read pickles, and only those just written.
"""

from __future__ import annotations

import pickle
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.data.configuration import GenerateConfig
from experiments.data.exchange import export_dataset
from experiments.data.generate import generate
from sim.store.dataset import open_dataset


@pytest.fixture(autouse=True)
def _no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("read") / "data"
    config = GenerateConfig(
        scenarios=("straight_road", "four_way_intersection"), episodes=2, seed=6, duration_s=32.0
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
    assert len(names) == len(dataset.episodes()) == 4
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
