"""Datasets: what is written comes back, as a whole or not at all; broken ones are refused."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behaviors import BEHAVIORS, InputError, sample_profile
from behaviors.profiles import PERCEPTION_FIELDS
from scenarios import SCENARIOS
from sim.frames import AgentKind, Event, EventKind, Frame, Tracks
from sim.safety import conflicts
from sim.scenario import AgentSpec
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import (
    HEADING_QUANTUM,
    POSITION_QUANTUM,
    TABLES,
    EpisodeMeta,
    split_of,
)
from sim.store.writing import new_dataset

META = EpisodeMeta(scenario="hand-made", engine="sumo", seed=4, options={"mix": {"timid": 1.0}})


def population() -> tuple[AgentSpec, ...]:
    """Six drivers, one of each behaviour; a pedestrian; and one who never enters."""
    rng = np.random.default_rng(0)
    drivers = [
        AgentSpec(
            id=i,
            kind=AgentKind.CAR,
            behavior=behavior,
            profile=sample_profile(behavior.profile, rng),
            route=("west", "east"),
            depart_s=0.1 * i,
            length_m=4.0 + 0.1 * i,
            width_m=1.8,
            seed=100 + i,
        )
        for i, behavior in enumerate(BEHAVIORS)
    ]
    walker = AgentSpec(
        6, AgentKind.PEDESTRIAN, None, None, ("path",), 0.0, 0.25, 0.5, speed_mps=1.3, seed=9
    )
    absent = AgentSpec(7, AgentKind.BUS, BEHAVIORS[0], drivers[0].profile, (), 99.0, 12.0, 2.5)
    return (*drivers, walker, absent)


def frames(steps: int = 40) -> Iterator[Frame]:
    """Agents enter one after another and drive on; the first time step is empty."""
    agents = population()
    rng = np.random.default_rng(1)
    for step in range(steps):
        ids = np.arange(min(step, 7))
        yield Frame(
            time_s=0.1 * (step + 1),
            ids=ids,
            xy=np.column_stack([rng.uniform(-500, 500, ids.size), 3.2 * ids]),
            heading=rng.uniform(-np.pi, np.pi, ids.size),
            speed=rng.uniform(0, 20, ids.size),
            length=np.array([agents[i].length_m for i in ids]),
            width=np.array([agents[i].width_m for i in ids]),
            kind=np.array([agents[i].kind.code for i in ids], dtype=np.int8),
            signals=np.array([step // 10 % 3, 3], dtype=np.int8),
            events=(Event(EventKind.COLLISION, 0.1 * (step + 1), 0, 1, "follower"),)
            if step == 20
            else (),
        )


def small(folder: Path) -> Dataset:
    with new_dataset(folder, {"made": "by hand"}) as out:
        out.write_episode(META, frames(), population())
    return open_dataset(folder)


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    dataset = small(tmp_path)
    (entry,) = dataset.episodes()
    episode = dataset.read(entry)
    expected = Tracks.from_frames(frames(), {a.id: a.behavior for a in population()})
    tracks = episode.tracks
    assert episode.agents == population()
    assert (entry.frames, entry.agents, entry.agent_steps) == (40, 7, int(expected.valid.sum()))
    for name in ("ids", "kind", "length", "width", "time_s", "valid", "signals", "behavior"):
        found, wanted = getattr(tracks, name), getattr(expected, name)
        np.testing.assert_array_equal(found, wanted, err_msg=name)
        assert found.dtype == wanted.dtype
    assert tracks.names == expected.names
    assert tracks.events == expected.events
    for name, quantum in (
        ("xy", POSITION_QUANTUM),
        ("heading", HEADING_QUANTUM),
        ("speed", POSITION_QUANTUM),
    ):
        found, wanted = getattr(tracks, name), getattr(expected, name)
        np.testing.assert_allclose(found, wanted, atol=0.5 * quantum, rtol=0, err_msg=name)
        whole = found[np.isfinite(found)] / quantum
        np.testing.assert_array_equal(whole, np.rint(whole), err_msg=name)


def test_recordings_come_back_to_the_last_digit(tmp_path: Path) -> None:
    source = Tracks.from_frames(frames(), names={i: f"track-{i}" for i in range(7)})
    with new_dataset(tmp_path, {}) as out:
        entry = out.write_recording(META, source)
    tracks = open_dataset(tmp_path).read(entry).tracks
    for name in ("ids", "kind", "length", "width", "time_s", "valid", "signals", "xy", "heading"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(source, name), err_msg=name)
    assert tracks.names == source.names
    assert tracks.behavior is None


def test_steps_say_lane_leader_gap_and_acceleration(tmp_path: Path) -> None:
    """Two cars on a straight road, the second 30 m behind and braking; nobody knows a third's."""
    road = SCENARIOS["straight_road"]().road
    lane = next(lane for lane in road.lanes if not lane.walking and not lane.internal)
    (x0, y0), (x1, y1) = lane.centerline[[0, -1]]
    along = np.array([x1 - x0, y1 - y0]) / np.hypot(x1 - x0, y1 - y0)
    heading = float(np.arctan2(along[1], along[0]))
    agents = [dataclasses.replace(agent, length_m=4.0) for agent in population()[:2]]

    def driven() -> Iterator[Frame]:
        for step in range(5):
            s = np.array([80.0 + step, 50.0 + step])
            speed = np.array([10.0, 10.0 - 0.25 * step])
            yield Frame(
                time_s=0.1 * (step + 1), ids=[0, 1], xy=[x0, y0] + s[:, None] * along,
                heading=[heading] * 2, speed=speed, length=[4.0, 4.0], width=[2.0, 2.0],
                kind=[0, 0],
            )  # fmt: skip

    with new_dataset(tmp_path, {}) as out:
        out.write_episode(META, driven(), agents, road.source)
        later = META.model_copy(update={"index": 1, "split": "validation"})
        out.write_episode(later, driven(), agents)
    known, unknown = (
        open_dataset(tmp_path).scan("steps", split=split).to_table().to_pandas()
        for split in ("train", "validation")
    )
    second = known[known.agent == 1]
    assert set(known.lane) == {lane.id}
    np.testing.assert_allclose(second.lane_s_m, 50.0 + np.arange(5), atol=0.02)
    assert second.leader.tolist() == [0] * 5
    np.testing.assert_allclose(second.gap_m, 26.0, atol=0.02)
    assert second.acceleration_mps2.isna().tolist() == [True, False, False, False, False]
    np.testing.assert_allclose(second.acceleration_mps2[1:], -2.5, atol=0.01)
    assert known[known.agent == 0][["leader", "gap_m"]].isna().all(axis=None)
    assert unknown[["lane", "lane_s_m", "leader", "gap_m"]].isna().all(axis=None)


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_same_content_same_bytes(tmp_path: Path) -> None:
    small(tmp_path / "a")
    small(tmp_path / "b")
    assert len(content(tmp_path / "a")) == 8
    assert content(tmp_path / "a") == content(tmp_path / "b")


def test_the_id_depends_on_everything_that_made_the_episode(tmp_path: Path) -> None:
    def identity(name: str, seed: int = 4, agents: tuple[AgentSpec, ...] = ()) -> str:
        with new_dataset(tmp_path / name, {}) as out:
            meta = META.model_copy(update={"seed": seed})
            return out.write_episode(meta, frames(), agents or population()).id

    other = (*population()[:7], dataclasses.replace(population()[7], depart_s=98.0))
    assert identity("a") == identity("b", agents=population()[::-1])
    assert len({identity("c"), identity("d", seed=5), identity("e", agents=other)}) == 3


def test_tables_open_in_pandas(tmp_path: Path) -> None:
    import pandas as pd

    small(tmp_path)
    steps = pd.read_parquet(tmp_path / "steps")
    agents = pd.read_parquet(tmp_path / "agents")
    joined = steps.merge(agents[["episode", "agent", "behavior"]], on=["episode", "agent"])
    assert list(steps.columns[:4]) == ["episode", "agent", "step", "time_s"]
    assert set(joined.behavior.dropna()) == set(BEHAVIORS)
    assert set(steps.split) == {"train"}
    assert joined.time_s.max() == pytest.approx(4.0)


def test_splits() -> None:
    splits = [split_of(i) for i in range(100)]
    assert {s: splits.count(s) for s in ("train", "validation", "test")} == {
        "train": 60,
        "validation": 20,
        "test": 20,
    }
    assert {split_of(i) for i in range(3)} == {"train", "validation", "test"}


# --- as a whole or not at all -------------------------------------------------------------------


def test_nothing_is_left_of_a_dataset_that_fails(tmp_path: Path) -> None:
    closed = []

    def failing() -> Iterator[Frame]:
        try:
            yield from list(frames())[:5]
            raise InputError("engine: broke down")
        finally:
            closed.append(True)

    def write() -> None:
        with new_dataset(tmp_path / "new", {}) as out:
            out.write_episode(META, frames(), population())
            out.write_episode(META, failing(), population())

    with pytest.raises(InputError, match="broke down"):
        write()
    assert list(tmp_path.iterdir()) == []
    assert closed == [True]


# --- several episodes ---------------------------------------------------------------------------


def tracks(number: int) -> Tracks:
    """Two agents, told apart from those of other episodes by where they are."""
    steps = 5 + number
    xy = np.full((2, steps, 2), 100.0 * number)
    xy[..., 0] += np.arange(steps)
    return Tracks.of_dense(
        ids=np.array([3, 8]), names=("a", "b"), kind=np.zeros(2, dtype=np.int8),
        length=np.full(2, 4.0), width=np.full(2, 2.0), time_s=0.1 * np.arange(steps), xy=xy,
        heading=np.zeros((2, steps)), speed=np.full((2, steps), 10.0),
        valid=np.ones((2, steps), dtype=bool), signals=np.zeros((1, steps), dtype=np.int8),
        behavior=np.array([0, 5], dtype=np.int8),
    )  # fmt: skip


EPISODES = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shards") / "data"
    with new_dataset(folder, {}) as out:
        for i in range(EPISODES):
            meta = EpisodeMeta(
                scenario="a/b c", engine="ngsim", index=i, split=split_of(i),
                options={"flow": 300.0 if i % 2 else "dense"},
            )  # fmt: skip
            out.write_recording(meta, tracks(i))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data"


def shard(folder: Path, table: str) -> Path:
    return folder / table / "scenario=a%2Fb%20c" / "split=train" / "000000-000004.parquet"


def test_every_episode_comes_back(made: Path) -> None:
    dataset = open_dataset(made)
    assert len(dataset) == EPISODES
    assert dataset.scenarios == ("a/b c",)
    for number, episode in enumerate(dataset):
        np.testing.assert_array_equal(episode.tracks.xy, tracks(number).xy)
        np.testing.assert_array_equal(episode.tracks.signals, tracks(number).signals)
        assert episode.tracks.names == ("a", "b")
    assert pq.ParquetFile(shard(made, "steps")).num_row_groups == 3
    assert pq.ParquetFile(shard(made, "events")).num_row_groups == 0


def test_a_dataset_without_columns_of_perception_opens_with_zeros(tmp_path: Path) -> None:
    small(tmp_path / "data")
    (path,) = (tmp_path / "data" / "agents").rglob("*.parquet")
    rows = pq.read_table(path).drop_columns(list(PERCEPTION_FIELDS))
    pq.write_table(rows, path)
    dataset = open_dataset(tmp_path / "data")
    agents = dataset.read(next(iter(dataset.episodes()))).agents
    profiles = [one.profile for one in agents if one.profile is not None]
    assert profiles
    assert not any(getattr(one, name) for one in profiles for name in PERCEPTION_FIELDS)


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


# --- broken datasets ----------------------------------------------------------------------------


@pytest.mark.parametrize("table", ["steps", "agents", "frames", "signals"])
def test_lost_cut_and_altered_shards_are_named(folder: Path, table: str) -> None:
    path = shard(folder, table)
    dataset = open_dataset(folder)
    (entry, *_) = dataset.episodes(split="train")
    good = path.read_bytes()
    for damaged in (good[: len(good) // 2], b"", b"PAR1" * 50):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=path.name):
            dataset.read(entry)
    path.unlink()
    with pytest.raises(InputError, match=rf"{path.name}: found no file, expected the shard"):
        dataset.read(entry)
    begin, found = pq.read_metadata(made_by(path, good)).row_group(0).column(1), 0
    for at in range(begin.data_page_offset + 4, begin.data_page_offset + 60, 7):
        path.write_bytes(bytes([*good[:at], good[at] ^ 16, *good[at + 1 :]]))
        try:
            dataset.read(entry)
        except InputError as error:
            found += path.name in str(error)
    assert found


def made_by(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


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


def test_tables_for_pandas(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    dataset = small(tmp_path)
    (entry,) = dataset.episodes()
    table = dataset.to_pandas()
    assert len(table) == 1
    row = table.iloc[0]
    assert (row["id"], row["frames"], row["agent_steps"]) == (entry.id, 40, 252)
    assert pandas.isna(row["road"])
    episode = dataset.read(entry)
    steps = episode.tracks.to_pandas()
    assert len(steps) == 252
    np.testing.assert_array_equal(steps["x"], episode.tracks.xy[..., 0][episode.tracks.valid])


def test_conflicts_are_those_of_the_stored_tracks(tmp_path: Path) -> None:
    """The table of conflicts can be made again from what the dataset holds."""
    small(tmp_path / "a")
    dataset = open_dataset(tmp_path / "a")
    for entry in dataset.manifest.episodes:
        stored = dataset.conflicts(entry)
        again = conflicts(dataset.read(entry).tracks, dataset.road(entry))
        for field in dataclasses.fields(again):
            np.testing.assert_array_equal(getattr(stored, field.name), getattr(again, field.name))
