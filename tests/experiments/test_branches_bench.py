"""The bench of branches notices a branch that differs, and processes that are left behind."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from experiments.benches.branches import Settings, identical, measure
from sim.frames import Event, EventKind, Frame

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="branches need Linux")


def frame(x: float = 0.0) -> Frame:
    return Frame(
        time_s=1.0, ids=np.array([3]), xy=np.array([[x, 0.0]]), heading=np.zeros(1),
        speed=np.ones(1), length=np.full(1, 4.0), width=np.full(1, 2.0), kind=np.zeros(1),
        signals=np.array([1, 2]),
    )  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"xy": np.array([[np.nextafter(0.0, 1.0), 0.0]])},
        {"signals": np.array([1, 1])},
        {"events": (Event(EventKind.COLLISION, 1.0, 3, 4),)},
        {"time_s": 1.1},
    ],
    ids=["a place in its last bit", "a signal", "an event", "the time"],
)
def test_every_difference_counts(change: dict[str, object]) -> None:
    assert identical([frame()], [frame()])
    assert not identical([frame()], [dataclasses.replace(frame(), **change)])
    assert not identical([frame()], [frame(), frame()])


def test_signals_and_pedestrians_are_repeated_too() -> None:
    settings = Settings(
        scenarios=("four_way_intersection",), branches=10, at_s=28.0, seconds=4.0, seed=1
    )
    (rows,) = measure(settings)
    value = {row["metric"]: row["value"] for row in rows}
    assert value["identical"] == value["trunk_unharmed"] == 1.0
    assert value["dead_processes"] == 0
    assert value["pedestrians"] > 0  # type: ignore[operator]
    assert value["signal_changes"] > 0  # type: ignore[operator]
