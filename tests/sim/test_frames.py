"""Frames refuse what loses something, and tracks become tables."""

from __future__ import annotations

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import Behavior
from sim.frames import Event, EventKind, Frame, Tracks

ONE = {
    "ids": [1], "xy": [[0, 0]], "heading": [0], "speed": [0], "length": [4], "width": [2],
    "kind": [0],
}  # fmt: skip


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
