"""Disturbances on hand-made tracks."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.data import disturbances
from experiments.data.disturbances import position_noise, renamed_tracks
from sim.frames import Tracks


def convoy(n: int = 4, seconds: float = 20.0) -> Tracks:
    """Cars 8 m apart at the same speed, each of another behaviour."""
    time_s = np.arange(round(seconds * 10)) / 10.0
    x = np.arange(n)[:, None] * 8.0 + 10.0 * time_s
    return Tracks.of_dense(
        ids=np.arange(n) * 2,
        names=tuple("abcdef"[:n]),
        kind=np.zeros(n, dtype=np.int8),
        length=np.full(n, 4.5),
        width=np.full(n, 1.8),
        time_s=time_s,
        xy=np.stack([x, np.zeros_like(x)], axis=2),
        heading=np.zeros_like(x),
        speed=np.full_like(x, 10.0),
        valid=np.ones_like(x, dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
        behavior=np.arange(n, dtype=np.int8),
    )


NAMES = ("position_noise", "correlated_noise", "frame_rate", "dropped_frames", "lost_detections",
         "lost_tracks", "renamed_tracks")  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_disturbances_are_repeatable_and_leave_their_argument(name):
    tracks = convoy()
    before = tracks.xy.copy()
    apply, level = getattr(disturbances, name), 2.5 if name == "frame_rate" else 0.3
    first, again = (apply(tracks, level, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.xy, again.xy)
    np.testing.assert_array_equal(tracks.xy, before)
    assert np.isnan(first.xy[~first.valid]).all()
    assert first.behavior.size == first.ids.size
    assert (np.diff(first.time_s) > 0).all()


def test_noise_has_the_deviation_asked_for():
    rng = np.random.default_rng(0)
    moved = position_noise(convoy(), 0.3, rng).xy - convoy().xy
    assert moved.std() == pytest.approx(0.3, rel=0.05)


def test_an_agent_that_is_found_again_is_a_piece_of_the_same():
    tracks = convoy(seconds=120.0)
    pieces = renamed_tracks(tracks, 2.0, np.random.default_rng(0))
    assert len(tracks.ids) < len(pieces.ids) < 40  # 16 losses are expected
    for letter in "abcd":
        rows = [i for i, name in enumerate(pieces.names) if name.startswith(letter)]
        assert pieces.valid[rows].sum(axis=0).max() == 1
        assert {int(pieces.behavior[i]) for i in rows} == {"abcd".index(letter)}
