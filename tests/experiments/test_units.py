"""Pixels become metres, and metres that are none are named."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.data.units import image_scale, in_metres
from sim.frames import Tracks


def street(metres: float = 0.05, horizon: float = np.inf, n: int = 30, seed: int = 0) -> Tracks:
    """Cars that drive at 6 m/s up and down a filmed street, in whole pixels.

    Args:
        metres: per pixel at the height 240.
        horizon: pixels above that height; infinite for a camera that looks straight down.
        n: how many.
        seed: of places.
    """
    rng = np.random.default_rng(seed)
    time_s = 0.04 * np.arange(250)
    way = 6.0 * time_s - 30.0 + rng.uniform(-8.0, 8.0, n)[:, None]
    way *= np.where(np.arange(n) % 2, -1.0, 1.0)[:, None]
    height = 240.0 + way / metres
    if np.isfinite(horizon):  # a tilted camera: way = 1.5 metres above / (1 - above / horizon)
        above = way / (1.5 * metres)
        height = 240.0 + above / (1.0 + above / horizon)
    here = metres / (1.0 - (height - 240.0) / horizon)
    across = 3.0 * rng.integers(-2, 3, n)[:, None] + 0.0 * way
    size = 2.2 / np.median(here, axis=1)
    xy = np.stack([np.rint(320.0 + across / here), np.rint(height)], axis=2)
    return Tracks.of_dense(
        ids=np.arange(n),
        names=tuple(map(str, range(n))),
        kind=np.zeros(n, dtype=np.int8),
        length=size,
        width=size,
        time_s=time_s,
        xy=xy,
        heading=np.zeros((n, 250)),
        speed=np.zeros((n, 250)),
        valid=np.ones((n, 250), dtype=bool),
        signals=np.empty((0, 250), dtype=np.int8),
    )


@pytest.mark.parametrize("metres", [0.02, 0.05, 0.3])
def test_the_scale_of_a_video_is_found(metres):
    scale = image_scale(street(metres))
    assert scale.metres == pytest.approx(metres, rel=0.2)
    assert abs(np.log(scale.metres / metres)) < 2.0 * scale.spread


@pytest.mark.parametrize("horizon", [2500.0, 1250.0])
def test_the_horizon_is_found_and_none_where_there_is_none(horizon):
    assert image_scale(street(0.05, horizon)).horizon == pytest.approx(horizon, rel=0.25)
    assert image_scale(street(0.05)).horizon == np.inf


@pytest.mark.parametrize("horizon", [np.inf, 2500.0, 1250.0])
def test_speeds_are_the_same_near_and_far(horizon):
    video = street(0.05, horizon)
    found = in_metres(video, image_scale(video))
    speed = found.speed[:, 30:-30].mean(axis=1)
    assert np.median(speed) == pytest.approx(6.0, rel=0.25)
    assert speed.std() < 0.12 * speed.mean()
    assert found.length.std() < 0.12 * found.length.mean()


def test_unseen_agents_and_gaps_stay_unknown():
    video = street()
    valid = video.valid.copy()
    valid[0], valid[1, 50:90] = False, False
    hidden = np.where(valid[..., None], video.xy, np.nan)
    found = in_metres(*(lambda t: (t, image_scale(t)))(
        video.with_dense(valid=valid, xy=hidden)
    ))  # fmt: skip
    assert np.isnan(found.xy[0]).all()
    assert np.isnan(found.speed[1, 50:90]).all()
    assert np.isfinite(found.xy[1:][valid[1:]]).all()
