"""Datasets: what is written comes back, whole or not at all; broken ones are refused by name."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behaviors import BEHAVIORS, InputError, sample_profile
from sim.arrow.budget import Layout, StoredColumn, check_budget
from sim.frames import AgentKind, Event, EventKind, Frame, Tracks
from sim.scenario import AgentSpec
from sim.store.atomic import remove_partial, whole_folder, write_whole
from sim.store.catalogue import altered_files, canonical, finished_episode
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import (
    AGENTS,
    EVENTS,
    HEADING_QUANTUM,
    MAX_CELLS,
    MAX_SHARD_STEPS,
    POSITION_QUANTUM,
    SIGNALS_TABLE,
    TABLES,
    TRAITS_TABLE,
    EpisodeMeta,
    Manifest,
    shard_schema,
    split_of,
)
from sim.store.sealing import write_manifest
from sim.store.writing import episode_id, write_episode, write_recording

META = EpisodeMeta(scenario="hand-made", engine="sumo", seed=4, options={"mix": {"timid": 1.0}})


def population() -> tuple[AgentSpec, ...]:
    """Six drivers, one of each behaviour; a pedestrian; and one who never enters."""
    rng = np.random.default_rng(0)
    drivers = [
        AgentSpec(
            id=i,
            kind=AgentKind.CAR,
            behavior=behavior,
            profile=sample_profile(behavior, rng),
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
    entry = write_episode(folder, META, frames(), population())
    write_manifest(folder, {"made": "by hand"}, [entry])
    return open_dataset(folder)


def old(folder: Path) -> Dataset:
    """The same as schema version 1 has it: a folder for the episode, and a manifest."""
    entry = write_episode(folder, META, frames(), population())
    manifest = Manifest(schema_version=1, configuration={}, roads={}, episodes=(entry,))
    content = manifest.model_dump(exclude={"files": True, "episodes": {"__all__": NEWER}})
    (folder / "manifest.json").write_bytes(canonical(content))
    return open_dataset(folder)


NEWER = {"shard", "row_group", "exact", "drawn"}
"""Fields of entries that schema version 1 did not have."""


def test_too_many_rows_end_a_simulation_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = np.cumsum([len(frame) for frame in frames()])
    taken = 0

    def watched() -> Iterator[Frame]:
        nonlocal taken
        for frame in frames():
            taken += 1
            yield frame

    monkeypatch.setattr("sim.store.encode.MAX_SHARD_STEPS", int(counts[19]))
    with pytest.raises(InputError, match=rf"steps\.parquet: found {counts[20]} rows, expected at"):
        write_episode(tmp_path, META, watched(), population())
    assert taken == 21
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    # rows of the time before do not count: the last 20 frames have as many as may be
    monkeypatch.setattr("sim.store.encode.MAX_SHARD_STEPS", int(counts[-1] - counts[19]))
    entry = write_episode(tmp_path, META, watched(), population(), since_s=2.0)
    assert entry.agent_steps == counts[-1] - counts[19]


def unpacking(rows: int, size: int, exact: bool) -> Layout:
    """What a shard's table of steps says of so many rows in so many bytes."""
    columns = tuple(
        StoredColumn(field.name, "DOUBLE", False, size=4 * rows, values=rows)
        for field in shard_schema("steps.parquet", exact)
    )
    return Layout(rows, columns, size)


@pytest.mark.parametrize("exact", [False, True])
def test_as_many_rows_may_be_written_as_are_read(exact: bool, tmp_path: Path) -> None:
    large = 5 * MAX_SHARD_STEPS  # bytes, 5 for each row
    check_budget(tmp_path, unpacking(MAX_SHARD_STEPS, large, exact), None, MAX_CELLS)
    with pytest.raises(InputError, match="found 50000001 rows"):
        check_budget(tmp_path, unpacking(MAX_SHARD_STEPS + 1, large, exact), None, MAX_CELLS)


@pytest.mark.parametrize("exact", [False, True])
def test_a_small_file_may_not_unpack_to_as_much_as_a_large_one(exact: bool, tmp_path: Path) -> None:
    rows = 2**30 // 64  # eight columns of eight bytes
    check_budget(tmp_path, unpacking(rows, 10**5, exact), None, MAX_CELLS)
    with pytest.raises(InputError, match=r"found columns of \d+ bytes in 100000, expected at most"):
        check_budget(tmp_path, unpacking(rows + 1, 10**5, exact), None, MAX_CELLS)


def test_rows_that_readers_would_not_trust_are_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.arrow.budget.MAX_TABLE_BYTES", 10**4)
    monkeypatch.setattr("sim.arrow.budget.MAX_GROWTH", 1)
    with pytest.raises(InputError, match=r"rows in \d+ bytes, of which readers take at most"):
        write_episode(tmp_path, META, frames(), population())
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


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


@pytest.mark.parametrize("heading", [np.pi, np.nextafter(-np.pi, 0.0)])
def test_rounded_headings_stay_in_range(tmp_path: Path, heading: float) -> None:
    one = np.ones(1)
    frame = Frame(0.1, [0], [[0, 0]], [heading], one, one, one, [0])  # type: ignore[arg-type]
    entry = write_episode(tmp_path, META, [frame], population()[:1])
    write_manifest(tmp_path, {}, [entry])
    back = open_dataset(tmp_path).read(entry).tracks.heading[0, 0]
    assert -np.pi < back <= np.pi
    assert np.cos(back - heading) > 1 - 1e-6


def test_recordings_come_back_to_the_last_digit(tmp_path: Path) -> None:
    source = Tracks.from_frames(frames(), names={i: f"track-{i}" for i in range(7)})
    entry = write_recording(tmp_path, META, source)
    write_manifest(tmp_path, {}, [entry])
    tracks = open_dataset(tmp_path).read(entry).tracks
    for name in ("ids", "kind", "length", "width", "time_s", "valid", "signals", "xy", "heading"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(source, name), err_msg=name)
    assert tracks.names == source.names
    assert tracks.behavior is None


def test_an_episode_without_agents_is_an_episode(tmp_path: Path) -> None:
    none = np.empty(0)
    empty = Frame(0.1, [], np.empty((0, 2)), none, none, none, none, [])  # type: ignore[arg-type]
    entry = write_episode(tmp_path, META, [empty], ())
    write_manifest(tmp_path, {}, [entry])
    assert open_dataset(tmp_path).read(entry).tracks.xy.shape == (0, 1, 2)


def test_same_content_same_bytes(tmp_path: Path) -> None:
    small(tmp_path / "a")
    small(tmp_path / "b")
    first = {p.relative_to(tmp_path / "a"): p for p in (tmp_path / "a").rglob("*") if p.is_file()}
    second = {p.relative_to(tmp_path / "b"): p for p in (tmp_path / "b").rglob("*") if p.is_file()}
    assert len(first) == 7
    assert first.keys() == second.keys()
    assert all(first[name].read_bytes() == second[name].read_bytes() for name in first)


def test_the_id_depends_on_everything_that_made_the_episode() -> None:
    agents = population()
    other = EpisodeMeta(**{**META.model_dump(), "seed": 5})
    assert episode_id(META, agents) == episode_id(META, agents[::-1])
    assert len({episode_id(META, agents), episode_id(other, agents), episode_id(META, ())}) == 3


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


def test_tables_open_in_polars(tmp_path: Path) -> None:
    import polars as pl

    dataset = small(tmp_path)
    steps = pl.scan_parquet(tmp_path / "steps", hive_partitioning=True).collect()
    assert steps.height == dataset.episodes()[0].agent_steps
    assert steps["episode"].n_unique() == 1
    assert steps["scenario"].unique().to_list() == ["hand-made"]


def test_tables_open_in_duckdb(tmp_path: Path) -> None:
    import duckdb

    small(tmp_path)
    query = (
        f"SELECT behavior, avg(speed_mps) FROM '{tmp_path}/steps/*/*/*.parquet' "
        f"JOIN '{tmp_path}/agents/*/*/*.parquet' USING (episode, agent) GROUP BY behavior"
    )
    speeds = dict(duckdb.sql(query).fetchall())
    assert set(speeds) == {*BEHAVIORS, None}
    assert all(0 < speed < 20 for speed in speeds.values())


def test_splits() -> None:
    splits = [split_of(i) for i in range(100)]
    assert {s: splits.count(s) for s in ("train", "validation", "test")} == {
        "train": 60,
        "validation": 20,
        "test": 20,
    }
    assert {split_of(i) for i in range(3)} == {"train", "validation", "test"}


# --- whole or not at all ------------------------------------------------------------------------


def test_nothing_is_left_of_an_episode_that_fails(tmp_path: Path) -> None:
    closed = []

    def failing() -> Iterator[Frame]:
        try:
            yield from list(frames())[:5]
            raise InputError("engine: broke down")
        finally:
            closed.append(True)

    with pytest.raises(InputError, match="broke down"):
        write_episode(tmp_path, META, failing(), population())
    assert list(tmp_path.rglob("*.parquet")) == []
    assert closed == [True]


def test_nothing_is_left_when_writing_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.write_bytes

    def full_disk(self: Path, data: bytes) -> int:
        if self.name == "events.parquet":
            raise OSError(28, "No space left on device", str(self))
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_episode(tmp_path, META, frames(), population())
    assert list((tmp_path / "episodes").iterdir()) == []


def test_a_failing_write_leaves_the_older_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    write_whole(path, b"old")

    def refuse(source: object, target: object) -> None:
        raise OSError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="Permission"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_whole_folder_replaces_and_leftovers_are_removed(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    for content in ("one", "two"):
        with whole_folder(target) as partial:
            (partial / "file").write_text(content)
    assert (target / "file").read_text() == "two"
    (tmp_path / ".partial-x-1").mkdir()
    (tmp_path / ".partial-y-2").write_text("half")
    assert remove_partial(tmp_path) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: {"ids": f.ids + 50}, "found agent 50"),
        (lambda f: {"xy": np.full((len(f), 2), np.nan)}, "found nan"),
        (lambda f: {"speed": np.full(len(f), np.inf)}, "found inf"),
        (lambda f: {"time_s": 0.1}, "expected later"),
    ],
    ids=["stranger", "nan", "infinite", "time"],
)
def test_frames_that_cannot_be(
    tmp_path: Path, change: Callable[[Frame], dict[str, object]], message: str
) -> None:
    bad = [dataclasses.replace(f, **change(f)) for f in list(frames())[1:5]]  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        write_episode(tmp_path, META, bad, population())


# --- hostile datasets ---------------------------------------------------------------------------


def edit_manifest(folder: Path, edit: Callable[[dict[str, object]], None]) -> None:
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda m: m.update(schema_version=99), "found schema_version 99, expected 1; a newer"),
        (lambda m: m.update(schema_version=0), "found schema_version 0"),
        (lambda m: m.update(schema_version="x"), "schema_version"),
        (lambda m: m.update(extra=1), "extra"),
        (lambda m: m.pop("episodes"), "episodes"),
        (lambda m: m["episodes"][0].update(colour="red"), r"episodes\.0\.colour"),
        (lambda m: m["episodes"][0].update(id="../../../etc"), r"episodes\.0\.id"),
        (lambda m: m["episodes"][0]["files"].update({"../x": {}}), r"episodes\.0\.files"),
        (lambda m: m["episodes"][0].update(road="../x"), r"episodes\.0\.road"),
        (lambda m: m["episodes"][0].update(agent_steps=-1), r"episodes\.0\.agent_steps"),
        (lambda m: m["episodes"][0].update(split="all"), r"episodes\.0\.split"),
    ],
)
def test_manifests_that_cannot_be(
    tmp_path: Path, edit: Callable[[dict[str, object]], None], message: str
) -> None:
    old(tmp_path)
    edit_manifest(tmp_path, edit)
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(tmp_path)
    assert "manifest.json" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b"null"])
def test_manifests_that_are_not_json(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(InputError, match=r"manifest\.json"):
        open_dataset(tmp_path)


def test_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run the same generate again"):
        open_dataset(tmp_path)
    with pytest.raises(InputError, match="found nothing there"):
        open_dataset(tmp_path / "nowhere")


def forge(dataset: Dataset, name: str, data: bytes, **entry: object) -> Dataset:
    """Replace a file and give the manifest its checksum, as an attacker would."""
    identity = dataset.episodes()[0].id
    (dataset.path / "episodes" / identity / name).write_bytes(data)

    def edit(manifest: dict[str, object]) -> None:
        first = manifest["episodes"][0]  # type: ignore[index]
        first["files"][name] = {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)}
        first.update(entry)

    edit_manifest(dataset.path, edit)
    return open_dataset(dataset.path)


def parquet(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return sink.getvalue().to_pybytes()


@pytest.mark.parametrize("name", TABLES)
def test_altered_truncated_and_missing_files(tmp_path: Path, name: str) -> None:
    dataset = old(tmp_path)
    (entry,) = dataset.episodes()
    path = tmp_path / "episodes" / entry.id / f"{name}.parquet"
    data = path.read_bytes()
    assert finished_episode(tmp_path, entry.id) == entry
    for content in (data[:-1], data[:-1] + bytes([data[-1] ^ 1]), b""):
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}\.parquet: found"):
            dataset.read(entry)
        assert altered_files(tmp_path, entry) == [path]
        assert finished_episode(tmp_path, entry.id) is None
    path.unlink()
    with pytest.raises(InputError, match=rf"{name}\.parquet: found no file"):
        dataset.read(entry)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("content", [b"", b"PAR1", b"\0" * 5000, b"PAR1" * 500])
def test_files_that_are_no_tables(tmp_path: Path, name: str, content: bytes) -> None:
    dataset = forge(old(tmp_path), f"{name}.parquet", content)
    with pytest.raises(InputError, match=rf"{name}\.parquet: found no readable"):
        dataset.read(dataset.episodes()[0])


def column(table: pa.Table, name: str, values: list[object]) -> pa.Table:
    index = table.schema.get_field_index(name)
    field = table.schema.field(index).with_nullable(True)
    return table.set_column(index, field, pa.array(values, type=field.type))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("steps", lambda t: t.take(list(range(t.num_rows))[::-1]), "out of order"),
        ("steps", lambda t: pa.concat_tables([t, t]), "rows, expected at most"),
        ("steps", lambda t: t.slice(0, 3).take([0, 0, 1]), "out of order"),
        ("steps", lambda t: t.drop_columns(["x_m"]), "found no column x_m"),
        ("steps", lambda t: column(t, "x_m", [float("nan")] * len(t)), "not finite"),
        ("steps", lambda t: column(t, "speed_mps", [float("inf")] * len(t)), "not finite"),
        ("steps", lambda t: column(t, "y_m", [None] * len(t)), "empty y_m"),
        ("steps", lambda t: column(t, "step", [10**6] * len(t)), "outside of 0"),
        ("steps", lambda t: column(t, "agent", [10**12] * len(t)), "does not have"),
        ("agents", lambda t: column(t, "behavior", ["evil"] * len(t)), "'evil', expected one of"),
        ("agents", lambda t: column(t, "kind", ["tank"] * len(t)), "'tank', expected one of"),
        ("agents", lambda t: column(t, "agent", [1] * len(t)), "out of order"),
        ("agents", lambda t: column(t, "length_m", [None] * len(t)), "empty length_m"),
        ("agents", lambda t: column(t, "min_gap_m", [-1.0] * len(t)), "min_gap_m"),
        ("agents", lambda t: column(t, "min_gap_m", [None] * len(t)), "no min_gap_m"),
        ("frames", lambda t: column(t, "time_s", [1.0] * len(t)), "each after"),
        ("frames", lambda t: t.slice(1), "expected 40 times"),
        ("signals", lambda t: column(t, "state", ["blue"] * len(t)), "'blue', expected one of"),
        ("signals", lambda t: column(t, "group", [-1] * len(t)), "signal group outside"),
        ("signals", lambda t: t.slice(2), "every signal group at step 0"),
        ("events", lambda t: column(t, "kind", ["party"] * len(t)), "'party', expected one of"),
        ("events", lambda t: column(t, "kind", [None] * len(t)), "empty kind"),
    ],
)
def test_tables_that_cannot_be(
    tmp_path: Path, name: str, change: Callable[[pa.Table], pa.Table], message: str
) -> None:
    dataset = old(tmp_path)
    home = tmp_path / "episodes" / dataset.episodes()[0].id
    changed = change(pq.read_table(home / f"{name}.parquet"))
    dataset = forge(dataset, f"{name}.parquet", parquet(changed))
    with pytest.raises(InputError, match=message) as caught:
        dataset.read(dataset.episodes()[0])
    assert f"{name}.parquet" in str(caught.value)


def test_rows_are_read_where_dense_arrays_would_not_fit(tmp_path: Path) -> None:
    dataset = old(tmp_path)
    home = tmp_path / "episodes" / dataset.episodes()[0].id
    agents = pq.read_table(home / "agents.parquet")
    many = pa.concat_tables([agents.slice(0, 1)] * 5000)
    many = column(many, "agent", list(range(5000)))
    times = pa.table({"time_s": np.arange(100_000.0)})
    forge(dataset, "agents.parquet", parquet(many.cast(agents.schema)))
    dataset = forge(dataset, "frames.parquet", parquet(times), frames=100_000)
    (entry, *_) = dataset.episodes()
    tracks = dataset.read(entry).tracks
    assert (tracks.as_rows().speed.size, tracks.time_s.size) == (entry.agent_steps, 100_000)


ROW = {
    "agents": {"agent": 0, "name": "a", "kind": "car", "length_m": 4.0, "width_m": 2.0}
    | {"depart_s": 0.0, "route": ["west"], "walking_speed_mps": 0.0, "seed": 0, "jaywalks": False},
    "signals": {"step": 0, "time_s": 0.1, "group": 0, "state": "red"},
    "events": {"time_s": 0.1, "kind": "contact", "agent": 0, "rule": ""},
    "traits": {"agent": 0, "trait": "weaving", "begin_s": 0.0, "end_s": 1.0, "value": 1.0},
}
"""A row of each table that becomes Python objects."""


def rows(table: str, count: int, **values: object) -> pa.Table:
    """One row of a table many times over."""
    schema = {"agents": AGENTS, "signals": SIGNALS_TABLE, "events": EVENTS, "traits": TRAITS_TABLE}
    one = pa.Table.from_pylist([ROW[table] | values], schema=schema[table])
    return one.take(pa.array(np.zeros(count, dtype=np.int64)))


@pytest.mark.parametrize("name", ROW)
def test_small_files_of_many_rows_are_refused(tmp_path: Path, name: str) -> None:
    data = parquet(rows(name, 10**6 + 1))
    assert len(data) < 200_000
    dataset = forge(old(tmp_path), f"{name}.parquet", data)
    with pytest.raises(InputError, match=rf"{name}\.parquet: found 1000001 rows, expected at most"):
        dataset.read(dataset.episodes()[0])


def test_a_route_of_many_edges_is_refused(tmp_path: Path) -> None:
    data = parquet(rows("agents", 1, route=["west"] * (10**6 + 1)))
    dataset = forge(old(tmp_path), "agents.parquet", data)
    with pytest.raises(InputError, match=r"agents\.parquet: found 1000001 rows"):
        dataset.read(dataset.episodes()[0])


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("agents", "name", "a" * 500_000),
        ("agents", "route", ["a" * 500_000]),
        ("events", "rule", "a" * 500_000),
    ],
)
def test_long_texts_in_every_row_are_refused(
    tmp_path: Path, name: str, field: str, value: object
) -> None:
    table = rows(name, 600, **{field: value})
    dataset = forge(old(tmp_path), f"{name}.parquet", parquet(table))
    with pytest.raises(InputError, match=rf"{name}\.parquet: found texts of up to 300000000 bytes"):
        dataset.read(dataset.episodes()[0])


def test_rows_that_no_agent_and_step_can_have_are_refused(tmp_path: Path) -> None:
    """However many rows the manifest announces."""
    dataset = old(tmp_path)
    steps = pq.read_table(tmp_path / "episodes" / dataset.episodes()[0].id / "steps.parquet")
    many = parquet(steps.take(pa.array(np.zeros(1000, dtype=np.int64))))
    dataset = forge(dataset, "steps.parquet", many, agent_steps=1000)
    with pytest.raises(InputError, match="found 1000 rows, expected at most 320"):
        dataset.read(dataset.episodes()[0])


def test_what_could_not_be_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.store.encode.MAX_OBJECTS", 7)
    with pytest.raises(InputError, match=r"agents\.parquet: found 8 rows, expected at most 7"):
        write_episode(tmp_path, META, frames(), population())
    assert not (tmp_path / "episodes").exists()


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return old(tmp_path_factory.mktemp("valid"))


@pytest.mark.parametrize("name", TABLES)
@settings(max_examples=100, deadline=None, database=None)
@given(data=st.data())
def test_altered_tables_are_read_or_refused(
    valid: Dataset, tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    source = valid.path / "episodes" / valid.episodes()[0].id / f"{name}.parquet"
    content = bytearray(source.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        length = data.draw(st.integers(0, 4))
        content[at : at + length] = data.draw(st.binary(max_size=4))
    folder = tmp_path_factory.mktemp("altered") / "data"
    shutil.copytree(valid.path, folder)
    dataset = forge(open_dataset(folder), f"{name}.parquet", bytes(content))
    message = f"{name}.parquet: read"
    try:
        dataset.read(dataset.episodes()[0])
    except InputError as error:
        message = str(error)
    shutil.rmtree(folder)
    assert ".parquet" in message
    assert "\n" not in message


def test_datasets_and_episodes_show_themselves(tmp_path: Path) -> None:
    dataset = small(tmp_path)
    shown = repr(dataset)
    assert len(shown) < 400
    assert "1 episode (1 train) of 1 scenario, 7 agents, 252 agent-steps" in shown
    assert "MB" in shown
    episode = dataset.read(dataset.episodes()[0])
    shown = repr(episode)
    assert len(shown) < 400
    assert "hand-made 0 by sumo, seed 4, train; 8 agents drawn, 0 shown traits" in shown
    again = dataset.manifest.model_copy(update={"episodes": dataset.episodes() * 25})
    many = Dataset(tmp_path, again)
    table = many._repr_html_()
    assert table.count("<tr>") == 12  # the header, ten episodes, how many more
    assert "and 15 more" in table


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
    steps = episode.to_pandas()
    assert len(steps) == 252
    np.testing.assert_array_equal(steps["x"], episode.tracks.xy[..., 0][episode.tracks.valid])


def test_without_pandas_tables_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = small(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pandas: found none"):
        dataset.to_pandas()
    with pytest.raises(InputError, match="pandas: found none"):
        dataset.read(dataset.episodes()[0]).to_pandas()
