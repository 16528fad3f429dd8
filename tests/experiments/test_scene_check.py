"""Recordings that are no scenes are found out, and none that is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from experiments.data.scene_check import check_scene
from sim.frames import Tracks

STEP_S = 0.1


def road(n: int = 24, seconds: float = 20.0, spacing_m: float = 11.0, first: int = 0) -> Tracks:
    """Cars on three lanes, each with its own smooth speed around 12 m/s."""
    time_s = STEP_S * np.arange(round(seconds / STEP_S))
    rng = np.random.default_rng(first)
    phase = rng.uniform(0.0, 6.0, n)[:, None]
    speed = 12.0 + 0.4 * np.sin(0.3 * time_s + phase)
    along = np.cumsum(speed, axis=1) * STEP_S + spacing_m * (np.arange(n) // 3)[:, None]
    across = np.broadcast_to(3.2 * (np.arange(n) % 3)[:, None], along.shape)
    return Tracks.of_dense(
        ids=first + np.arange(n),
        names=tuple(str(first + i) for i in range(n)),
        kind=np.zeros(n, dtype=np.int8),
        length=np.full(n, 4.5),
        width=np.full(n, 1.8),
        time_s=time_s,
        xy=np.stack([along, across], axis=2),
        heading=np.zeros_like(along),
        speed=speed,
        valid=np.ones_like(along, dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
    )


def together(*parts: Tracks) -> Tracks:
    """All actors of several recordings on one road."""

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])

    names = tuple(name for part in parts for name in part.names)
    fields = ("ids", "kind", "length", "width", "xy", "heading", "speed", "valid")
    return parts[0].with_dense(names=names, **{name: joined(name) for name in fields})


def standing() -> Tracks:
    """Cars that stand in a queue, bumper to bumper but 1 m."""
    parked = road(n=30, spacing_m=5.5)
    at = np.broadcast_to(parked.xy[:, :1], parked.xy.shape)
    return parked.with_dense(xy=at.copy(), speed=np.zeros_like(parked.speed))


def noisy(tracks: Tracks, deviation_m: float, memory_s: float, seed: int = 0) -> Tracks:
    error = np.random.default_rng(seed).normal(0.0, 1.0, tracks.xy.shape)
    kept = np.exp(-STEP_S / memory_s) if memory_s else 0.0
    for step in range(1, tracks.time_s.size):
        error[:, step] = kept * error[:, step - 1] + np.sqrt(1 - kept**2) * error[:, step]
    return tracks.with_dense(xy=tracks.xy + deviation_m * error)


@pytest.mark.parametrize("memory_s", [0.0, 0.5])
@pytest.mark.parametrize("deviation_m", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("make", [road, standing], ids=["driving", "queue"])
def test_noisy_traffic_is_a_scene(make, deviation_m, memory_s):
    assert not check_scene(noisy(make(), deviation_m, memory_s))


@pytest.mark.parametrize("every", [2, 4, 5])
def test_slow_frame_rates_and_lost_frames_make_no_doubt(every):
    tracks = noisy(road(seconds=40.0), 0.25, 0.0)
    chosen = np.arange(0, tracks.time_s.size, every)
    assert not check_scene(tracks.part(np.arange(24), chosen))
    kept = np.flatnonzero(np.random.default_rng(1).random(tracks.time_s.size) > 0.3)
    assert not check_scene(tracks.part(np.arange(24), kept))


def test_actors_on_top_of_each_other_are_superimposed():
    one = road()
    moved = road(first=100).with_dense(xy=one.xy + np.array([0.5, 0.45]))
    found = check_scene(together(one, moved))
    assert "(median distance to the next centre 0.7 m): actors are superimposed" in found[0]


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_frame_step_is_found_out(factor):
    tracks = road()
    found = check_scene(dataclasses.replace(tracks, time_s=factor * tracks.time_s))
    assert f"agents that go {1.0 / factor:.2f} times as far" in found[0]


def test_ids_that_name_one_after_another_jump():
    tracks = road()
    xy = tracks.xy.copy()
    for step in range(0, tracks.time_s.size, 20):  # six ids change their bodies every two seconds
        xy[:6, step:] = np.roll(xy[:6, step:], 1, axis=0)
        xy[0, step:, 0] += 60.0
    found = check_scene(tracks.with_dense(xy=xy))
    assert any("jump" in said for said in found)


def test_one_object_that_is_tracked_twice_is_no_reason_to_doubt():
    tracks = road()
    twin = tracks.part(np.array([0]), slice(None))
    twin = twin.with_dense(ids=np.array([500]), names=("500",), xy=twin.xy + 0.2)
    assert not check_scene(together(tracks, twin))
