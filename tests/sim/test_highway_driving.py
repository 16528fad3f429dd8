"""How drivers of the highway engine accelerate and change lanes: values worked out by hand."""

import dataclasses
import math

import numpy as np
import pytest

from behaviors.labels import PROFILES, Behavior
from sim.frames import AgentKind
from sim.highway import driving
from sim.highway.driving import Beside, change_incentive, profile_fields
from sim.highway.state import blank_vehicles

PROFILE = dataclasses.replace(
    PROFILES[Behavior.CAREFUL],
    time_headway_s=1.5,
    min_gap_m=2.0,
    max_accel_mps2=1.0,
    comfort_decel_mps2=4.0,
    politeness=0.5,
    lane_change_gain=1.0,  # a threshold of 0.2 m/s2
    lane_change_assertiveness=1.0,  # imposes at most 2 m/s2 and changes into gaps of 2 m
    lane_change_patience_s=0.0,
)
LIMIT = 20.0 / PROFILE.speed_factor  # so that all want 20 m/s
NOBODY = (math.inf, 0.0)


def row(**changes):
    """The row of a driver."""
    profile = dataclasses.replace(PROFILE, **changes)
    made = blank_vehicles(1)[0]
    for name, value in profile_fields(profile, AgentKind.CAR).items():
        made[name] = value
    made.length, made.speed = 4.0, 10.0
    return made


DRIVER = row()


def test_idm_accelerates_by_its_equation():
    assert driving.idm(DRIVER, 10.0, 20.0, math.inf, 0.0) == 0.9375  # 1 - (1 / 2)^4
    # wants 2 + 10 * 1.5 + 10 * 4 / (2 sqrt(1 * 4)) = 27 m and has 54 m
    assert driving.idm(DRIVER, 10.0, 20.0, 54.0, 6.0) == pytest.approx(0.9375 - 0.25)


def test_krauss_reaches_its_safe_speed_in_one_step():
    # b T = 6: safe is sqrt(36 + 8 * 8) - 6 = 4 m/s at a room of 8 m; a step is 0.1 s
    assert driving.krauss(DRIVER, 5.0, 20.0, 8.0, 0.0) == pytest.approx((4.0 - 5.0) / 0.1)
    assert driving.krauss(DRIVER, 3.0, 20.0, 8.0, 0.0) == 1.0  # its largest acceleration
    assert driving.krauss(DRIVER, 3.0, 3.05, math.inf, 0.0) == pytest.approx(0.5)


def incentive(leader=NOBODY, new_leader=NOBODY, follower=NOBODY, new_follower=NOBODY, **changes):
    """Of a driver at 10 m/s that wants 20 m/s, given gaps and speeds of the others."""
    here, there = Beside(1, *leader, 2, *follower), Beside(3, *new_leader, 4, *new_follower)
    return change_incentive(row(**changes), LIMIT, here, there, DRIVER, DRIVER)


def test_a_free_lane_is_worth_the_leader_s_interaction():
    # behind a leader at 34 m and its own speed: (17 / 34)^2 = 0.25, less the threshold of 0.2
    assert incentive(leader=(34.0, 10.0)) == pytest.approx(0.05)
    assert incentive(leader=(68.0, 10.0)) == pytest.approx(0.0625 - 0.2)
    assert incentive() == pytest.approx(-0.2)


def test_politeness_weighs_what_the_new_follower_loses():
    # it wants 17 m of 17 m and loses 1 m/s2 of its free acceleration: 0.25 - 0.5 * 1 - 0.2
    behind = (17.0, 10.0)
    assert incentive(leader=(34.0, 10.0), new_follower=behind) == pytest.approx(-0.45)
    egoist = incentive(leader=(34.0, 10.0), new_follower=behind, politeness=0.0)
    assert egoist == pytest.approx(0.05)


def test_politeness_weighs_what_the_present_follower_gains():
    # it wants 17 m, has 17 m, and would have 17 + 4 + 34 m to the leader
    found = incentive(leader=(34.0, 10.0), follower=(17.0, 10.0))
    assert found == pytest.approx(0.25 + 0.5 * (1.0 - (17.0 / 55.0) ** 2) - 0.2)


def test_unsafe_changes_are_refused_whatever_they_bring():
    leader = (5.0, 0.0)
    # a follower at 10 m of the 17 m that it wants brakes with 0.9375 - 2.89 = -1.95 m/s2
    assert np.isfinite(incentive(leader, new_follower=(10.0, 10.0)))
    # at 9.9 m with 0.9375 - 2.949 = -2.01 m/s2
    assert incentive(leader, new_follower=(9.9, 10.0)) == -np.inf
    assert incentive(leader, new_leader=(1.9, 20.0)) == -np.inf  # a gap below 2 m
    assert incentive(leader, lane_change_gain=0.0) == -np.inf  # a driver that never changes


def test_impatient_drivers_do_not_take_a_lane_that_soon_ends_behind_a_leader():
    # 60 m at a speed difference of 20 - 10 last for 6 s
    found = [
        incentive((34.0, 10.0), new_leader=(60.0, 10.0), lane_change_patience_s=patience)
        for patience in (5.0, 7.0)
    ]
    assert np.isfinite(found).tolist() == [True, False]
    # worth while all the same if the new leader is faster by 0.15 m/s2 times 7 s = 1.05 m/s
    faster = incentive((34.0, 8.9), new_leader=(60.0, 10.0), lane_change_patience_s=7.0)
    assert np.isfinite(faster)
