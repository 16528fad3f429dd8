"""Tracks hold what was seen: thousands of agents seen once each cost as many rows."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.data.exchange import export_dataset, import_recordings
from sim.formats import read_recordings
from sim.frames import KINDS, Tracks
from sim.store.dataset import open_dataset

ONCE = 8_000
"""Agents that are seen once each, at a time of their own: 6.4 * 10^7 agents times times."""


def sparse(n: int, t: int, seed: int = 0) -> Tracks:
    """Tracks made from arrays, about half of the cells empty, one agent never seen."""
    rng = np.random.default_rng(seed)
    valid = rng.random((n, t)) < 0.5
    valid[1] = False

    def some(*shape: int) -> np.ndarray:
        values = rng.normal(size=(n, t, *shape))
        values[~valid] = np.nan
        return values

    return Tracks.of_dense(
        ids=3 * np.arange(n), names=tuple(f"a{i}" for i in range(n)),
        kind=np.arange(n) % len(KINDS), length=np.full(n, 4.5), width=np.full(n, 1.8),
        time_s=0.1 * np.arange(t), xy=some(2), heading=some(), speed=np.abs(some()), valid=valid,
        signals=rng.integers(0, 3, (2, t)),
    )  # fmt: skip


def same(one: Tracks, two: Tracks) -> bool:
    names = ("ids", "kind", "length", "width", "time_s", "xy", "heading", "speed", "valid")
    return one.names == two.names and all(
        np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
        for name in (*names, "signals")
    )


def test_rows_and_arrays_are_the_same_tracks() -> None:
    dense = sparse(7, 11)
    rows = replace(dense)
    assert not {"xy", "heading", "speed", "valid"} & set(vars(rows)), "filled when asked for"
    assert same(dense, rows)
    assert not rows.xy.flags.writeable
    assert same(pickle.loads(pickle.dumps(rows)), dense)
    assert same(copy.deepcopy(rows), dense)


@pytest.mark.parametrize("columns", [slice(2, 9), slice(None), slice(1, 11, 3), [0, 4, 5, 10]])
def test_a_part_of_rows_is_the_part_of_the_arrays(columns: slice | list[int]) -> None:
    dense = sparse(7, 11)
    agents = np.array([0, 1, 4, 6])
    part = replace(dense).part(agents, columns if isinstance(columns, slice) else np.array(columns))
    for name in ("xy", "heading", "speed", "valid"):
        expected = getattr(dense, name)[agents][:, columns]
        assert np.array_equal(getattr(part, name), expected, equal_nan=True)
    assert part.time_s.tolist() == dense.time_s[columns].tolist()


def test_frames_and_windows_hold_who_is_present() -> None:
    dense = sparse(7, 11)
    rows = replace(dense)
    for step, frame in enumerate(rows.frames()):
        seen = np.flatnonzero(dense.valid[:, step])
        assert frame.ids.tolist() == dense.ids[seen].tolist()
        assert frame.xy.tolist() == dense.xy[seen, step].tolist()
    window = rows.window(6, 4)
    seen = np.flatnonzero(dense.valid[:, 5])
    assert window.ids.tolist() == dense.ids[seen].tolist()
    assert np.array_equal(window.xy, dense.xy[seen, 2:6], equal_nan=True)
    again = Tracks.from_frames(rows.frames())
    there = np.flatnonzero(dense.valid.any(axis=1))
    assert np.array_equal(again.xy, dense.xy[there], equal_nan=True)


def test_agents_seen_once_each_cost_what_was_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.frames.MAX_CELLS", 0)
    path = tmp_path / "a.csv"
    lines = [f"{1000 + k / 10:.1f},t{k},OTHERS,{k % 97}.5,{k % 89},PIT" for k in range(ONCE)]
    lines.append("1000.1,t0,OTHERS,1.5,0,PIT")  # files without an agent seen twice are refused
    path.write_text("\n".join(["TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME", *lines, ""]))
    import_recordings(path, tmp_path / "data", "argoverse1", quiet=True)
    dataset = open_dataset(tmp_path / "data")
    (entry,) = dataset.episodes()
    tracks = dataset.read(entry).tracks
    export_dataset(tmp_path / "data", tmp_path / "out", "sumo-fcd", quiet=True)
    assert (entry.agents, entry.frames, entry.agent_steps) == (ONCE, ONCE, ONCE + 1)
    (back,) = read_recordings(next((tmp_path / "out").rglob(f"{entry.id}.xml")), "sumo-fcd")
    assert back.tracks.row_speed.size == ONCE + 1
    np.testing.assert_allclose(back.tracks.row_xy, tracks.row_xy, atol=1e-9)
