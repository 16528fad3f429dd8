"""Driver models: values worked out by hand, and what the definitions say."""

import math

import pytest

from behaviors.driver_models import (
    braking_speed,
    gap_accepted,
    idm_desired_gap,
    idm_free_acceleration,
    idm_interaction,
    krauss_safe_speed,
    mobil_incentive,
    mobil_safe,
)


def idm(speed, desired_speed, gap, leader_speed, min_gap=2.0, headway=1.5, accel=1.0, decel=4.0):
    wanted = idm_desired_gap(speed, leader_speed, min_gap, headway, accel, decel)
    return idm_free_acceleration(speed, desired_speed, accel) - accel * idm_interaction(gap, wanted)


# IDM -----------------------------------------------------------------------------------------


def test_idm_on_a_free_road():
    assert idm(0.0, 20.0, math.inf, 0.0) == 1.0  # a (1 - 0)
    assert idm(10.0, 20.0, math.inf, 0.0) == 0.9375  # 1 - (1 / 2)^4 = 15 / 16
    assert idm(20.0, 20.0, math.inf, 0.0) == 0.0
    assert idm(40.0, 20.0, math.inf, 0.0) == -15.0  # 1 - 2^4


def test_idm_desired_gap():
    # 2 + 10 * 1.5 = 17; closing at 4 m/s adds 10 * 4 / (2 sqrt(1 * 4)) = 10
    assert idm_desired_gap(10.0, 10.0, 2.0, 1.5, 1.0, 4.0) == 17.0
    assert idm_desired_gap(10.0, 6.0, 2.0, 1.5, 1.0, 4.0) == 27.0
    # the leader pulls away at 10 m/s: 15 - 25 < 0, so that the gap at a standstill is left
    assert idm_desired_gap(10.0, 20.0, 2.0, 1.5, 1.0, 4.0) == 2.0


def test_idm_behind_a_leader():
    # wants 27 m and has 13.5 m: 15 / 16 - (27 / 13.5)^2
    assert idm(10.0, 20.0, 13.5, 6.0) == pytest.approx(0.9375 - 4.0)


@pytest.mark.parametrize("speed", [0.0, 5.0, 13.0, 19.0])
def test_idm_keeps_its_equilibrium_gap(speed):
    """Treiber et al. (2000), eq. 5: (s0 + v T) / sqrt(1 - (v / v0)^4) costs no acceleration."""
    gap = (2.0 + speed * 1.5) / math.sqrt(1.0 - (speed / 20.0) ** 4)
    assert idm(speed, 20.0, gap, speed) == pytest.approx(0.0, abs=1e-12)
    assert idm(speed, 20.0, 1.01 * gap, speed) > 0.0 > idm(speed, 20.0, 0.99 * gap, speed)


# Krauss --------------------------------------------------------------------------------------


def test_krauss_safe_speed():
    # 3 m in a reaction time of 1.5 s at 2 m/s, then 2^2 / (2 * 2) = 1 m
    assert krauss_safe_speed(4.0, 0.0, 1.5, 2.0) == 2.0
    assert (
        krauss_safe_speed(0.0, 7.0, 0.0, 2.0) == 7.0
    )  # who reacts at once follows bumper to bumper
    assert krauss_safe_speed(-3.0, 0.0, 1.5, 2.0) == 0.0


@pytest.mark.parametrize("gap", [0.5, 4.0, 40.0])
@pytest.mark.parametrize("leader_speed", [0.0, 3.0, 12.0])
def test_krauss_stops_where_its_leader_stops(gap, leader_speed):
    decel, reaction = 2.5, 1.2
    speed = krauss_safe_speed(gap, leader_speed, reaction, decel)
    own = speed * reaction + speed**2 / (2.0 * decel)
    assert own == pytest.approx(gap + leader_speed**2 / (2.0 * decel))


def test_braking_speed_is_undone_by_braking():
    assert braking_speed(8.0, 3.0, 1.0) == 5.0  # 25 - 2 * 8 = 9
    assert braking_speed(0.0, 3.0, 1.0) == 3.0


# MOBIL ---------------------------------------------------------------------------------------


def test_mobil_incentive():
    assert mobil_incentive(0.5, 0.0, 0.0, 1.0) == 0.5
    assert mobil_incentive(0.5, -2.0, 0.4, 0.0) == 0.5  # an egoist
    assert mobil_incentive(0.5, -2.0, 0.4, 0.5) == pytest.approx(-0.3)  # 0.5 + 0.5 * (-1.6)
    assert mobil_incentive(-0.2, 0.0, 1.0, 0.5) == pytest.approx(0.3)  # makes way for another


def test_mobil_safety():
    assert mobil_safe(0.5, 2.0)
    assert mobil_safe(-2.0, 2.0)
    assert not mobil_safe(-2.01, 2.0)


# Gap acceptance ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other_enters", "other_leaves", "accepted"),
    [
        (6.1, 7.0, True),  # leaves at 4, 2.1 s before the other comes
        (5.9, 7.0, False),  # only 1.9 s before
        (-1.0, 0.4, True),  # enters at 1, 0.6 s after the other has left
        (-1.0, 0.6, False),  # only 0.4 s after
        (-5.0, -4.0, True),
    ],
)
def test_gap_acceptance(other_enters, other_leaves, accepted):
    assert gap_accepted(1.0, 4.0, other_enters, other_leaves, 2.0, 0.5) is accepted


def test_longer_critical_gap_accepts_no_more():
    accepted = [gap_accepted(1.0, 4.0, 6.0, 7.0, critical, 0.5) for critical in (0.5, 1.5, 2.5)]
    assert accepted == [True, True, False]
