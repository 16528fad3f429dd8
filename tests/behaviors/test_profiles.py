import numpy as np
import pytest

from behaviors.labels import BEHAVIORS, PROFILES, Behavior, Style
from behaviors.profiles import PROFILE_FIELDS, SOURCES, sample_profile


def test_every_number_of_every_profile_has_a_source():
    assert set(SOURCES) == set(PROFILE_FIELDS)
    assert all(len(text) > 20 for text in SOURCES.values())
    assert set(PROFILES) == set(BEHAVIORS)


@pytest.mark.parametrize("behavior", BEHAVIORS)
def test_spread_zero_gives_clones_and_the_profile_is_the_median(behavior):
    rng = np.random.default_rng(1)
    assert sample_profile(behavior.profile, rng, 0.0) == PROFILES[behavior]
    drawn = [sample_profile(behavior.profile, rng, 0.15).time_headway_s for _ in range(400)]
    assert np.median(drawn) == pytest.approx(PROFILES[behavior].time_headway_s, rel=0.03)
    assert np.std(np.log(drawn)) == pytest.approx(0.15, rel=0.12)


def test_spread_does_not_change_how_much_randomness_is_used():
    after = []
    for spread in (0.0, 0.5):
        rng = np.random.default_rng(3)
        sample_profile(Behavior.TIMID.profile, rng, spread)
        after.append(rng.random())
    assert after[0] == after[1]


def test_aggressive_drivers_keep_less_distance_than_conservative_ones():
    for name in ("time_headway_s", "min_gap_m", "yield_probability"):
        aggressive = [getattr(PROFILES[b], name) for b in BEHAVIORS if b.style == Style.AGGRESSIVE]
        careful = [getattr(PROFILES[b], name) for b in BEHAVIORS if b.style == Style.CONSERVATIVE]
        assert max(aggressive) < min(careful)
