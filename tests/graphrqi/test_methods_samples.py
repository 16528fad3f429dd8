"""Windows of observation cut out of recordings."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.features.observer import Observer
from graphrqi.samples import collect
from sim.frames import Tracks


def drivers(n: int = 6, seconds: float = 21.0) -> Tracks:
    time_s = np.arange(round(seconds * 10)) / 10.0
    x = np.arange(n)[:, None] * 20.0 + 8.0 * time_s
    return Tracks.of_dense(
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
    samples = collect(drivers(), Observer(), 0, lengths, every_s=every_s)
    found, counts = np.unique(samples.seconds.round(6), return_counts=True)
    assert found.tolist() == list(lengths)
    ends = np.unique(samples.time_s[samples.seconds == 1.0])
    np.testing.assert_allclose(np.diff(ends), every_s)
    assert (counts[:-1] >= counts[1:]).all()


def at_times(time_s: np.ndarray, n: int = 3) -> Tracks:
    """Drivers at constant speed, seen at these times."""
    x = np.arange(n)[:, None] * 20.0 + 8.0 * time_s
    return drivers(n).with_dense(
        time_s=time_s,
        xy=np.stack([x, np.zeros_like(x)], axis=2),
        heading=np.zeros_like(x),
        speed=np.full_like(x, 8.0),
        valid=np.ones_like(x, dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
    )


@pytest.mark.parametrize("step_s", [0.04, 0.1, 0.3, 0.4, 0.5, 0.7])
def test_windows_are_found_at_any_frame_step(step_s):
    """One ends near every second, and lasts as long as asked for to half a frame step."""
    samples = collect(at_times(step_s * np.arange(round(24.0 / step_s))), Observer(), 0, (10.0,))
    ends = np.unique(samples.time_s)
    assert ends.size >= 11
    near_s = max(0.25, 0.5 * step_s) + 1e-6
    assert (abs(ends - ends.round()) <= near_s).all()
    assert (abs(samples.seconds - 10.0) <= 0.5 * step_s + 1e-6).all()
    assert (samples.window_s == 10.0).all()


def test_no_window_spans_a_hole_in_the_recording():
    """Nobody is known to have been there meanwhile, so nothing is said of that time."""
    time_s = np.concatenate([np.arange(0.0, 12.0, 0.3), np.arange(40.0, 52.0, 0.3)])
    samples = collect(at_times(time_s), Observer(), 0, (5.0,))
    begin_s = samples.time_s - samples.seconds
    assert ((samples.time_s < 12.0) | (begin_s >= 39.9)).all()
    assert (samples.time_s > 40.0).any()
