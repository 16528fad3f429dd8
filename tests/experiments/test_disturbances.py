"""Disturbances on hand-made tracks."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.data.disturbances import (
    DISTURBANCES,
    cut_tracks,
    identity_switches,
    position_noise,
)
from sim.frames import Tracks


def convoy(n: int = 4, seconds: float = 20.0) -> Tracks:
    """Cars 8 m apart at the same speed, each of another behaviour."""
    time_s = np.arange(round(seconds * 10)) / 10.0
    x = np.arange(n)[:, None] * 8.0 + 10.0 * time_s
    return Tracks(
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


@pytest.mark.parametrize("name", sorted(DISTURBANCES))
def test_disturbances_are_repeatable_and_leave_their_argument(name):
    tracks = convoy()
    before = tracks.xy.copy()
    level = DISTURBANCES[name][1][-1]
    apply = DISTURBANCES[name][0]
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


def test_switched_identities_follow_another_agent():
    tracks = convoy(seconds=120.0)
    switched = identity_switches(tracks, 2.0, np.random.default_rng(1))
    jumps = np.abs(np.diff(switched.xy[..., 0], axis=1)) > 3.0
    assert 4 <= jumps.sum() <= 40  # 4 agents, 2 minutes, 2 per agent and minute: 16 expected
    np.testing.assert_allclose(np.sort(switched.xy[..., 0], axis=0), tracks.xy[..., 0])
    assert (
        identity_switches(tracks, 0.0, np.random.default_rng(1)).xy.tolist() == tracks.xy.tolist()
    )


def test_cut_tracks_are_pieces_of_the_whole():
    tracks = convoy()
    pieces = cut_tracks(tracks, 5.0, np.random.default_rng(0))
    assert pieces.valid.sum() == tracks.valid.sum()
    assert pieces.valid.sum(axis=1).max() <= 50
    for letter in "abcd":
        rows = [i for i, name in enumerate(pieces.names) if name.startswith(letter)]
        assert pieces.valid[rows].sum(axis=0).tolist() == [1] * 200
        assert {int(pieces.behavior[i]) for i in rows} == {"abcd".index(letter)}
