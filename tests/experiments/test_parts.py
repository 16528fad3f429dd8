"""Datasets made in parts, merged, upgraded: the same bytes as made at once, and nothing missing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import experiments.data.generate
import experiments.data.shards.plan
import sim.store.sealing
import sim.store.shards
from behaviors import BEHAVIORS, InputError
from experiments.data.array_job.parts import generate_part, merge
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate
from experiments.data.shards.plan import Part, read_part, shares
from experiments.data.shards.upgrade import upgrade
from experiments.data.verify import verify_dataset
from experiments.data.worlds.episode import WorldsConfig
from sim.store.catalogue import canonical
from sim.store.dataset import Dataset, open_dataset
from sim.store.lock import sole_writer
from sim.store.schema import EPISODE_FIELDS
from tests.experiments.shared import content, in_this_process

CONFIG = GenerateConfig(
    scenarios=("straight_road", "two_way_road"), episodes=4, seed=5, duration_s=2.0
)


@pytest.fixture(autouse=True, scope="module")
def no_workers() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(experiments.data.generate, "make_in_processes", in_this_process)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (sim.store.sealing, sim.store.shards, experiments.data.shards.plan):
        monkeypatch.setattr(module, "BLOCK_EPISODES", 2)


def make_parts(folder: Path, numbers: list[int], of: int) -> None:
    for number in numbers:
        generate_part(CONFIG, folder, Part(number, of), jobs=1, quiet=True)


def test_parts_in_any_order_make_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    make_parts(tmp_path, [3, 1, 2, 1], 3)
    assert not (tmp_path / "episodes.parquet").exists()
    merge(tmp_path, quiet=True)
    assert content(tmp_path) == content(whole)
    with pytest.raises(InputError, match=r"found no plan\.json"):
        merge(tmp_path, quiet=True)
    generate(CONFIG, tmp_path, jobs=1, quiet=True)
    assert content(tmp_path) == content(whole)


@pytest.mark.usefixtures("small_blocks")
def test_blocks_of_parts_are_sealed_by_them(tmp_path: Path) -> None:
    generate(CONFIG, tmp_path / "once", jobs=1, quiet=True)
    once = content(tmp_path / "once")
    names = {path.name for path in (tmp_path / "once" / "agents").rglob("*.parquet")}
    assert names == {"000000-000000.parquet", "000001-000001.parquet", "000002-000002.parquet",
                     "000003-000003.parquet"}  # fmt: skip
    make_parts(tmp_path / "parts", [2], 2)
    assert len(list((tmp_path / "parts" / "agents").rglob("*.parquet"))) == 4
    assert not (tmp_path / "parts" / "episodes").exists()
    make_parts(tmp_path / "parts", [1], 2)
    merge(tmp_path / "parts", quiet=True)
    assert content(tmp_path / "parts") == once


def test_what_is_missing_is_named_by_its_part(tmp_path: Path) -> None:
    make_parts(tmp_path, [1, 3], 4)
    with pytest.raises(InputError, match=r"4 of 8 episodes missing.*run parts 2/4, 4/4 again"):
        merge(tmp_path, quiet=True)
    make_parts(tmp_path, [2, 4], 4)
    lost = next((tmp_path / "episodes").glob("*/steps.parquet"))
    lost.write_bytes(b"altered")
    with pytest.raises(InputError, match=r"1 of 8 episodes missing"):
        merge(tmp_path, quiet=True)
    make_parts(tmp_path, [1, 2, 3, 4], 4)
    assert len(merge(tmp_path, quiet=True).episodes) == 8


def test_parts_of_something_else_are_refused(tmp_path: Path) -> None:
    make_parts(tmp_path, [1], 4)
    other = CONFIG.model_copy(update={"seed": 6})
    with pytest.raises(InputError, match="parts of another configuration"):
        generate_part(other, tmp_path, Part(2, 4), jobs=1, quiet=True)
    with pytest.raises(InputError, match="found 2/3, expected one of 4 parts"):
        generate_part(CONFIG, tmp_path, Part(2, 3), jobs=1, quiet=True)
    with (
        sole_writer(tmp_path),
        pytest.raises(InputError, match="another run is writing"),
    ):
        make_parts(tmp_path, [2], 4)
    plan = json.loads((tmp_path / "plan.json").read_text())
    plan["configuration"]["made_with"]["numpy"] = "0.1"
    (tmp_path / "plan.json").write_bytes(canonical(plan))
    with pytest.raises(InputError, match="install those versions"):
        merge(tmp_path, quiet=True)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "-1/2", "1/0"])
def test_parts_that_cannot_be(text: str) -> None:
    with pytest.raises(InputError, match=r"expected K/N with K from 1 to N"):
        read_part(text)


@pytest.mark.parametrize("of", [1, 2, 3, 7, 20, 50])
@pytest.mark.parametrize("block", [2, 5, 1000])
@pytest.mark.parametrize("config", [CONFIG, WorldsConfig(worlds=11)])
def test_all_parts_together_are_everything_once(
    monkeypatch: pytest.MonkeyPatch, of: int, block: int, config: GenerateConfig | WorldsConfig
) -> None:
    monkeypatch.setattr(experiments.data.shards.plan, "BLOCK_EPISODES", block)
    everything = [task for share in shares(config, None) for task in share.tasks]
    parts = [shares(config, Part(number, of)) for number in range(1, of + 1)]
    made = [task for part in parts for share in part for task in share.tasks]
    assert made == everything


# --- older datasets -----------------------------------------------------------------------------


def as_version_1(whole: Path, folder: Path) -> None:
    """The same dataset in the layout of schema version 1."""
    entries = []
    generate_part(CONFIG, folder, Part(1, 2), jobs=1, quiet=True)
    generate_part(CONFIG, folder, Part(2, 2), jobs=1, quiet=True)
    (folder / "plan.json").unlink()
    for own in sorted((folder / "episodes").glob("*/episode.json")):
        entries.append(json.loads(own.read_text()))
        assert set(entries[-1]) == set(EPISODE_FIELDS)
    entries.sort(key=lambda e: (e["scenario"], e["engine"], e["index"], e["id"]))
    header = open_dataset(whole).header
    (folder / "manifest.json").write_bytes(
        canonical(
            {
                "schema_version": 1,
                "configuration": header.configuration,
                "roads": header.roads,
                "episodes": entries,
            }
        )
    )


def fitting(dataset: Dataset, behavior: str) -> set[str]:
    return {entry.id for entry in dataset.episodes(behavior=behavior)}


def test_older_datasets_are_read_upgraded_and_continued(whole: Path, tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    as_version_1(whole, old)
    dataset, present = open_dataset(old), open_dataset(whole)
    assert [e.id for e in dataset.episodes()] == [e.id for e in present.episodes()]
    assert verify_dataset(old) == []
    (first, *_) = dataset.episodes(split="train")
    drawn = [word for word in BEHAVIORS if first.id in fitting(dataset, word)]
    assert drawn
    assert drawn == [word for word in BEHAVIORS if first.id in fitting(present, word)]
    xy, same = dataset.read(first).tracks.xy, present.load_episode(first.id).tracks.xy
    np.testing.assert_array_equal(xy, same)
    with pytest.raises(InputError, match="graphrqi upgrade"):
        dataset.scan()
    before = content(old)
    upgrade(old, new)
    assert content(new) == content(whole)
    assert content(old) == before
    upgrade(old, new)  # as after a command that was stopped at its end
    assert content(new) == content(whole)
    (tmp_path / "edited").mkdir()
    shutil.copytree(new, tmp_path / "edited" / "new")
    (tmp_path / "edited" / "new" / "README.md").write_text("edited")
    with pytest.raises(InputError, match=r"found another dataset there \(README.md differs\)"):
        upgrade(old, tmp_path / "edited" / "new")
    with pytest.raises(InputError, match="nothing to upgrade"):
        upgrade(new, tmp_path / "newer")
    shutil.copytree(old, tmp_path / "again")
    generate(CONFIG, tmp_path / "again", jobs=1, quiet=True)
    assert content(tmp_path / "again") == content(whole)
    (old / "episodes" / first.id / "steps.parquet").unlink()
    assert verify_dataset(old, mend=True, jobs=1, quiet=True) == []
    assert content(old) == content(whole)


def test_a_dataset_grows_by_whole_shards(whole: Path, tmp_path: Path, small_blocks: None) -> None:
    more = CONFIG.model_copy(update={"episodes": 5})
    generate(CONFIG, tmp_path / "grown", jobs=1, quiet=True)
    kept = next((tmp_path / "grown" / "steps").rglob("000001-000001.parquet")).stat().st_ino
    generate(more, tmp_path / "grown", jobs=1, quiet=True)
    generate(more, tmp_path / "fresh", jobs=1, quiet=True)
    assert content(tmp_path / "grown") == content(tmp_path / "fresh")
    again = next((tmp_path / "grown" / "steps").rglob("000001-000001.parquet")).stat().st_ino
    assert again == kept
