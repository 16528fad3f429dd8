"""Smoothed motion: exact on parabolas, at any frame rate, with gaps; it measures the noise."""

import numpy as np
import pytest

from graphrqi.features.motion import Motion
from graphrqi.features.smooth_motion import SmoothMotion

IDS = np.array([3, 8])


def parabola(time_s: float) -> np.ndarray:
    """Two vehicles: one speeds up along x, one slows down along a diagonal."""
    east = 10.0 * time_s + 0.5 * 1.5 * time_s**2
    along = 20.0 * time_s - 0.5 * 1.0 * time_s**2
    return np.array([[east, 4.0], [0.6 * along, 0.8 * along]])


def followed(times: np.ndarray, noise_m: float = 0.0, seed: int = 0) -> tuple[SmoothMotion, Motion]:
    """What was watched, and the last motion that was measured."""
    rng = np.random.default_rng(seed)
    motion, found = SmoothMotion(), None
    for time_s in times:
        xy = parabola(time_s) + rng.normal(0.0, noise_m, (2, 2))
        found = motion.update(float(time_s), IDS, xy, np.ones(2, dtype=bool)) or found
    return motion, found


@pytest.mark.parametrize("step_s", [0.04, 0.1, 0.2, 0.3, 0.5])
def test_a_parabola_is_found_exactly_at_any_frame_rate(step_s):
    found = followed(np.arange(0.0, 6.0, step_s))[1]
    t = found.time_s
    assert found.ids.tolist() == IDS.tolist()
    assert np.allclose(found.xy, parabola(t), atol=1e-6)
    assert np.allclose(found.speed, [10.0 + 1.5 * t, 20.0 - t], atol=1e-6)
    assert np.allclose(found.acceleration, [1.5, -1.0], atol=1e-5)
    assert np.allclose(found.direction, [[1.0, 0.0], [0.6, 0.8]], atol=1e-6)


def test_missing_frames_are_bridged():
    times = np.arange(0.0, 6.0, 0.1)
    kept = times[np.random.default_rng(1).random(times.size) > 0.3]
    found = followed(kept)[1]
    assert np.allclose(found.acceleration, [1.5, -1.0], atol=1e-5)


@pytest.mark.parametrize("noise_m", [0.03, 0.1, 0.25])
def test_the_noise_is_measured_and_lengthens_the_stretch(noise_m):
    motion, found = followed(np.arange(0.0, 60.0, 0.1), noise_m)
    assert motion.noise_m == pytest.approx(noise_m, rel=0.25)
    exact = followed(np.arange(0.0, 60.0, 0.1))[1]
    assert found.time_s < exact.time_s


def test_noise_of_ten_centimetres_leaves_speed_and_acceleration():
    errors = []
    for seed in range(20):
        found = followed(np.arange(0.0, 8.0, 0.1), 0.1, seed)[1]
        t = found.time_s
        errors.append([found.speed[0] - 10.0 - 1.5 * t, found.acceleration[0] - 1.5])
    speed, acceleration = np.sqrt((np.array(errors) ** 2).mean(axis=0))
    # A difference over .4 s would be wrong by .35 m/s and, taken twice, by 1.2 m/s2.
    assert speed < 0.08
    assert acceleration < 0.35
