"""Recordings come in as datasets, and datasets go out as recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.data.exchange import export_dataset, import_recordings
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from sim.formats import FORMATS
from sim.store.dataset import open_dataset

ARGO = "frame,id,x,y\n" + "".join(
    f"{t},{i},{t * (1 + i)},{4 * i}\n" for t in range(60) for i in (0, 1)
)


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generated") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=1, seed=2, duration_s=30.0)
    generate(config, folder, jobs=1, quiet=True)
    return folder


@pytest.mark.parametrize("name", [n for n, entry in FORMATS.items() if entry.writer])
def test_datasets_go_out(generated: Path, tmp_path: Path, name: str) -> None:
    written = export_dataset(generated, tmp_path / "out", name, quiet=True)
    assert written
    assert all(path.exists() for path in written)


def test_out_and_in_again(generated: Path, tmp_path: Path) -> None:
    export_dataset(generated, tmp_path / "out", "sumo-fcd", quiet=True)
    import_recordings(tmp_path / "out", tmp_path / "back", quiet=True)
    before, after = open_dataset(generated), open_dataset(tmp_path / "back")
    one = before.read(before.episodes()[0]).tracks
    two = after.read(after.episodes()[0]).tracks
    assert one.names == two.names
    np.testing.assert_allclose(one.xy[:, -two.time_s.size :], two.xy, atol=1e-9)
    assert one.behavior is not None
    assert two.behavior is not None
    np.testing.assert_array_equal(one.behavior, two.behavior)


def test_a_net_gives_the_road(generated: Path, tmp_path: Path) -> None:
    (net,) = (generated / "roads").iterdir()
    path = tmp_path / "argo1_tracks.csv"
    path.write_text(ARGO)
    import_recordings(path, tmp_path / "with", "argo", net=net, quiet=True)
    import_recordings(path, tmp_path / "without", "argo", quiet=True)
    for name, has_road in (("with", True), ("without", False)):
        dataset = open_dataset(tmp_path / name)
        assert (dataset.road(dataset.episodes()[0]) is not None) is has_road


def test_import_names_what_is_no_scene(tmp_path, caplog):
    """Six cars, each with another on top of it, are read and doubted."""
    lines = ["track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for car in range(12):
        for step in range(30):
            x = 15.0 * (car % 6) + step + 0.3 * (car > 5)
            lines.append(f"{car},{step},{100 * step},car,{x},0,10,0,0,4.5,1.8")
    file = tmp_path / "vehicle_tracks_000.csv"
    file.write_text("\n".join(lines) + "\n")
    manifest = import_recordings(file, tmp_path / "data", quiet=True)
    (entry,) = manifest.episodes
    assert "superimposed" in entry.options["notes"][-1]
    assert caplog.messages[0].startswith("vehicle_tracks_000: no scene that can be believed")
    assert "superimposed" in (tmp_path / "data" / "README.md").read_text()
