"""Windows of observation cut out of recordings."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.features.spectrum_observers import NullObserver
from graphrqi.samples import collect
from sim.frames import Tracks


def drivers(n: int = 6, seconds: float = 21.0) -> Tracks:
    time_s = np.arange(round(seconds * 10)) / 10.0
    x = np.arange(n)[:, None] * 20.0 + 8.0 * time_s
    return Tracks(
        ids=np.arange(n),
        names=tuple(map(str, range(n))),
        kind=np.zeros(n, dtype=np.int8),
        length=np.full(n, 4.5),
        width=np.full(n, 1.8),
        time_s=time_s,
        xy=np.stack([x, np.zeros_like(x)], axis=2),
        heading=np.zeros_like(x),
        speed=np.full_like(x, 8.0),
        valid=np.ones_like(x, dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
        behavior=np.arange(n, dtype=np.int8),
    )


@pytest.mark.parametrize("every_s", [1.0, 3.0, 0.5])
def test_every_length_asked_for_is_cut(every_s):
    """However seldom windows end, each length that fits into a life is there."""
    lengths = (1.0, 2.0, 5.0, 10.0)
    samples = collect(drivers(), NullObserver(), 0, lengths, every_s=every_s)
    found, counts = np.unique(samples.seconds.round(6), return_counts=True)
    assert found.tolist() == list(lengths)
    ends = np.unique(samples.time_s[samples.seconds == 1.0])
    np.testing.assert_allclose(np.diff(ends), every_s)
    assert (counts[:-1] >= counts[1:]).all()


def test_one_length_is_drawn_per_driver_and_moment():
    samples = collect(drivers(60), NullObserver(), 0, (1.0, 2.0, 5.0), 3.0, per_moment=1, seed=4)
    late = samples.where(samples.time_s > 5.5)
    moments = set(zip(late.agent.tolist(), late.time_s.tolist(), strict=True))
    assert len(moments) == len(late) == 60 * np.unique(late.time_s).size
    _, counts = np.unique(late.seconds.round(6), return_counts=True)
    assert counts.min() > 0.2 * len(late)
