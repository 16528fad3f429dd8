"""Shards: one episode is read out of many; damaged and forged ones are refused by name."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behaviors import InputError
from scenarios.demand import parse_mix
from sim.frames import Tracks
from sim.store import entries
from sim.store.dataset import Dataset, open_dataset
from sim.store.entries import rows_where
from sim.store.places import Folder
from sim.store.schema import TABLES, EpisodeEntry, EpisodeMeta, split_of
from sim.store.sealing import planned_shards, write_manifest
from sim.store.writing import write_recording

EPISODES = 6


def tracks(number: int) -> Tracks:
    """Two agents, told apart from those of other episodes by where they are."""
    steps = 5 + number
    xy = np.full((2, steps, 2), 100.0 * number)
    xy[..., 0] += np.arange(steps)
    return Tracks(
        ids=np.array([3, 8]), names=("a", "b"), kind=np.zeros(2, dtype=np.int8),
        length=np.full(2, 4.0), width=np.full(2, 2.0), time_s=0.1 * np.arange(steps), xy=xy,
        heading=np.zeros((2, steps)), speed=np.full((2, steps), 10.0),
        valid=np.ones((2, steps), dtype=bool), signals=np.zeros((1, steps), dtype=np.int8),
        behavior=np.array([0, 5], dtype=np.int8),
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shards") / "data"
    entries = [
        write_recording(
            folder,
            EpisodeMeta(
                scenario="a/b c", engine="ngsim", index=i, split=split_of(i),
                options={"flow": 300.0 if i % 2 else "dense"},
            ),
            tracks(i),
        )
        for i in range(EPISODES)
    ]  # fmt: skip
    write_manifest(folder, {}, entries)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data"


def shard(folder: Path, table: str, split: str = "train") -> Path:
    (path,) = (folder / table).glob(f"*/split={split}/*.parquet")
    return path


def test_every_episode_comes_back(made: Path) -> None:
    dataset = open_dataset(made)
    assert len(dataset) == EPISODES
    assert dataset.scenarios == ("a/b c",)
    for number, episode in enumerate(dataset):
        np.testing.assert_array_equal(episode.tracks.xy, tracks(number).xy)
        np.testing.assert_array_equal(episode.tracks.signals, tracks(number).signals)
        assert episode.tracks.names == ("a", "b")
    assert shard(made, "steps").parent.parent.name == "scenario=a%2Fb%20c"


def test_filters_choose_episodes(made: Path) -> None:
    dataset = open_dataset(made)
    assert [e.index for e in dataset.episodes(flow=300)] == [1, 3, 5]
    assert [e.index for e in dataset.episodes(flow="dense", split="test")] == [2]
    assert len(dataset.episodes(behavior="timid")) == EPISODES
    assert dataset.episodes(behavior="careful") == dataset.episodes(mix="timid=1") == ()
    assert set(dataset.scan(flow=300).to_table()["episode"].to_pylist()) == {
        e.id for e in dataset.episodes(flow=300)
    }
    assert dataset.scan("frames", split="train").count_rows() == sum(5 + i for i in (0, 3, 4, 5))
    for wrong, message in (
        ({"behavior": "angry"}, "found 'angry', expected one of impatient"),
        ({"mix": "timid"}, "expected behavior=share"),
        ({"split": "dev"}, "found 'dev', expected one of train, validation, test"),
    ):
        with pytest.raises(InputError, match=message):
            dataset.episodes(**wrong)
    with pytest.raises(InputError, match="expected one of steps, agents"):
        dataset.scan("step")
    for nothing in ({"mix": "timid=1"}, {"flow": "light"}, {"scenario": "a road", "flow": "dense"}):
        assert dataset.scan("steps", **nothing).to_table().num_rows == 0


SCAN = """
import itertools, sys, time
from pathlib import Path
import fsspec
from fsspec.implementations.memory import MemoryFile
from sim.store.dataset import open_dataset

folder, store = Path(sys.argv[1]), fsspec.filesystem("memory", use_listings_cache=False)
for file in folder.rglob("*.parquet"):
    store.pipe_file(f"/data/{file.relative_to(folder).as_posix()}", file.read_bytes())
read, number = MemoryFile.read, itertools.count()
MemoryFile.read = lambda file, *size: (time.sleep(0.1 * next(number)), read(file, *size))[1]
scan = open_dataset("memory://data").scan("steps")
if sys.argv[2] == "head":
    scan.head(1)
else:
    batches = scan.to_batches(batch_size=2)
    next(batches)
if sys.argv[2] == "left":
    del batches
print("done")
"""


@pytest.mark.parametrize("how", ["head", "kept", "left"])
def test_a_scan_of_an_object_store_need_not_be_read_to_its_end(made: Path, how: str) -> None:
    """Arrow's threads read ahead; one that calls Python while the interpreter ends aborts it."""
    pytest.importorskip("fsspec")
    done = subprocess.run(
        [sys.executable, "-c", SCAN, str(made), how], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


def test_a_mix_of_styles_is_found_as_it_was_asked_for(made: Path) -> None:
    asked = "aggressive=.25, timid=.75"
    kept = {str(behavior): share for behavior, share in parse_mix(asked).items()}
    table = open_dataset(made).catalogue
    column = pa.array([json.dumps(kept, sort_keys=True)] * len(table))
    table = table.set_column(table.schema.get_field_index("mix"), "mix", column)
    assert len(rows_where(table, mix=asked)) == EPISODES
    assert len(rows_where(table, mix={"timid": 0.75, "aggressive": 0.25})) == EPISODES
    assert len(rows_where(table, mix="aggressive=.75, timid=.25")) == 0


@pytest.mark.parametrize("table", TABLES)
def test_one_altered_byte_is_found_when_its_page_is_read(folder: Path, table: str) -> None:
    path = shard(folder, table)
    content = bytearray(path.read_bytes())
    begin = pq.read_metadata(path).row_group(0).column(0).data_page_offset
    said = []
    for at in range(begin + 4, begin + 60, 7):
        damaged = bytes([*content[:at], content[at] ^ 16, *content[at + 1 :]])
        path.write_bytes(damaged)
        dataset = open_dataset(folder)
        try:
            for entry in dataset.episodes(split="train"):
                dataset.read(entry)
        except InputError as error:
            said.append(str(error))
    assert said
    assert all(path.name in message and "\n" not in message for message in said)


@pytest.mark.parametrize("table", TABLES)
def test_lost_and_cut_shards_are_named(folder: Path, table: str) -> None:
    path = shard(folder, table)
    dataset = open_dataset(folder)
    (entry, *_) = dataset.episodes(split="train")
    content = path.read_bytes()
    for damaged in (content[:-1], content[: len(content) // 2], b"", b"PAR1" * 50):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"{path.name}: found no readable Parquet"):
            dataset.read(entry)
    path.unlink()
    with pytest.raises(InputError, match=rf"{path.name}: found no file, expected the shard"):
        dataset.read(entry)
    path.write_bytes(content)
    dataset.read(entry)


def test_another_episode_in_its_row_group_is_refused(folder: Path) -> None:
    dataset = open_dataset(folder)
    first, second, *_ = dataset.episodes(split="train")
    forged = second.model_copy(update={"row_group": first.row_group})
    with pytest.raises(InputError, match="found another episode, expected"):
        dataset.read(forged)
    with pytest.raises(InputError, match="row groups, expected"):
        dataset.read(first.model_copy(update={"row_group": 99}))


def test_rows_of_an_episode_that_lie_apart_are_refused(folder: Path) -> None:
    path = shard(folder, "agents")
    table = pq.read_table(path, partitioning=None)
    pq.write_table(table.take(pa.array([0, 2, 1, 3, 4, 5, 6, 7])), path)
    with pytest.raises(InputError, match="rows of an episode apart"):
        next(iter(open_dataset(folder)))


@settings(max_examples=60, deadline=None, database=None)
@given(data=st.data())
def test_altered_shards_and_catalogues_are_read_or_refused(
    made: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("altered") / "data"
    shutil.copytree(made, folder)
    names = ["episodes.parquet", *(str(shard(folder, t).relative_to(folder)) for t in TABLES)]
    path = folder / data.draw(st.sampled_from(names))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        length = data.draw(st.integers(0, 4))
        content[at : at + length] = data.draw(st.binary(max_size=4))
    path.write_bytes(bytes(content))
    message = ".parquet"
    try:
        dataset = open_dataset(folder)
        for entry in dataset.episodes(split="train"):
            dataset.read(entry)
    except InputError as error:
        message = str(error)
    shutil.rmtree(folder)
    assert ".parquet" in message
    assert "\n" not in message


def entry(index: int, steps: int = 10, exact: bool = False, engine: str = "sumo") -> EpisodeEntry:
    return EpisodeEntry(
        scenario="road", engine=engine, index=index, split=split_of(index), id=f"{index:016x}",
        frames=1, agents=1, agent_steps=steps, exact=exact,
    )  # fmt: skip


def test_shards_end_at_blocks_and_sizes() -> None:
    names = [part[0].shard for part in planned_shards(entry(i) for i in range(5003))]
    assert names == ["000002-004997", "005002-005002", "000000-004999", "005000-005000",
                     "000001-004996", "005001-005001"]  # fmt: skip
    large = [entry(i, steps=3 * 10**7) for i in (0, 3, 4)]
    assert [part[0].shard for part in planned_shards(large)] == [
        "000000-000000", "000003-000003", "000004-000004",
    ]  # fmt: skip
    mixed = [entry(0), entry(0, exact=True).model_copy(update={"id": "f" * 16})]
    assert [part[0].shard for part in planned_shards(mixed)] == ["000000-000000", "000000-000000-1"]


def test_a_dataset_without_a_catalogue_is_none(folder: Path) -> None:
    (folder / "episodes.parquet").unlink()
    with pytest.raises(InputError, match="run the same generate again"):
        open_dataset(folder)


def test_a_catalogue_of_many_row_groups_is_grouped(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(entries, "_GROUP_ROWS", 2)
    dataset = open_dataset(made)
    there = dataset.episodes()
    pieces = [there[:1], there[1:4], there[4:]]
    entries.write_catalogue(
        Folder(tmp_path), dataset.header, map(entries.catalogue_table, [[], *pieces])
    )
    again: Dataset = open_dataset(tmp_path)
    counts = again.catalogue.group_by("scenario").aggregate([("timid", "sum")]).to_pylist()
    assert counts == [{"scenario": "a/b c", "timid_sum": EPISODES}]
    assert again.manifest == dataset.manifest
    assert again.totals.equals(dataset.totals)
    assert again.totals.column("episodes").to_pylist() == [
        len(dataset.episodes(split=split)) for split in again.totals.column("split").to_pylist()
    ]
