"""Frames refuse lossy input by name; frames and tracks show themselves."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import Behavior
from sim.frames import Event, EventKind, Frame, Tracks

ONE = {
    "ids": [1], "xy": [[0, 0]], "heading": [0], "speed": [0], "length": [4], "width": [2],
    "kind": [0],
}  # fmt: skip


def test_numbers_of_other_types_are_taken() -> None:
    frame = Frame(0.0, **{**ONE, "ids": np.array([3.0]), "kind": np.zeros(1)})
    assert frame.ids.tolist() == [3]
    assert frame.kind.dtype == np.int8
    assert not frame.xy.flags.writeable


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("ids", [1.7], "float64 values, expected int64"),
        ("ids", [np.nan], "float64 values, expected int64"),
        ("kind", ["car"], "expected int8"),
        ("xy", [["a", "b"]], "expected float64"),
        ("xy", [[1j, 0]], "complex128 values, expected float64"),
        ("xy", [[0, 0], [1]], "expected an array"),
        ("speed", [1, 2], r"shape \(2,\), expected \(1,\)"),
        ("ids", [[1]], "shape"),
    ],
)
def test_what_loses_something_is_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=rf"Frame\.{name}: .*{message}"):
        Frame(0.0, **{**ONE, name: value})  # type: ignore[arg-type]


def crowd(n: int, time_s: float = 0.5) -> Frame:
    """Agents of all kinds in a row, each 1 m/s faster than the one before."""
    return Frame(
        time_s=time_s,
        ids=np.arange(n) * 1000,
        xy=np.stack([np.arange(n) * 10.0, np.zeros(n)], axis=1),
        heading=np.zeros(n),
        speed=np.arange(n) * 1.0,
        length=np.full(n, 4.0),
        width=np.full(n, 2.0),
        kind=np.arange(n) % 6,
        signals=np.zeros(3),
        events=(Event(EventKind.COLLISION, time_s, 0, 1000),),
    )


def test_a_frame_shows_its_time_and_counts() -> None:
    text = repr(crowd(7))
    assert text.startswith("Frame(0.5 s: 7 agents (2 car, 1 bus, 1 truck,")
    assert "mean speed 3.0 m/s, 3 signal groups, 1 event)" in text
    assert "0 agents" in repr(crowd(0))
    assert len(repr(crowd(200_000, 12345.678))) < 400


def test_tracks_show_their_agents_and_times() -> None:
    frames = [crowd(n, 0.1 * n) for n in range(1, 9)]
    tracks = Tracks.from_frames(frames, {0: Behavior.TIMID, 1000: None})
    text = repr(tracks)
    assert text.startswith("Tracks(8 agents (2 car, 2 bus, 1 truck")
    assert "8 frames from 0.1 to 0.8 s every 0.1 s, 36 rows, 1 labelled, 3 signal groups" in text
    assert "8 events" in text
    assert len(text) < 400
    assert "0 frames" in repr(Tracks.from_frames([]))
    table = tracks._repr_html_()
    assert table.count("<tr>") == 1 + 6
    # two cars: one from frame 1 on (8 rows at 0 m/s), one from frame 7 on (2 rows at 6 m/s)
    assert "<tr><td>car</td><td>2</td><td>10</td><td>1.2</td><td>1</td></tr>" in table
    assert "<table>" in Tracks.from_frames([])._repr_html_()


def test_tracks_become_a_pandas_table_with_a_row_per_agent_and_time() -> None:
    pytest.importorskip("pandas")
    tracks = Tracks.from_frames([crowd(1, 0.1), crowd(2, 0.2)], {0: Behavior.TIMID}, {0: "first"})
    table = tracks.to_pandas()
    assert table["id"].tolist() == [0, 0, 1000]
    assert table["name"].tolist() == ["first", "first", "1000"]
    assert table["kind"].tolist() == ["car", "car", "bus"]
    assert table["time_s"].tolist() == [0.1, 0.2, 0.2]
    assert table["x"].tolist() == [0.0, 0.0, 10.0]
    assert table["speed"].tolist() == [0.0, 0.0, 1.0]
    assert table["behavior"].tolist()[:2] == ["timid", "timid"]
    assert table["behavior"].isna().tolist() == [False, False, True]
    assert Tracks.from_frames([crowd(2)]).to_pandas()["behavior"].isna().all()


def test_a_missing_pandas_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"\Apandas: found none, .* pip install pandas\Z"):
        Tracks.from_frames([crowd(2)]).to_pandas()
