"""How a driver of the highway engine accelerates, changes lanes and steers.

The laws themselves are those of `behaviors.driver_models`. A driver's parameters are one row, made
by `driver_parameters` and laid out by the indices below.

References:
    Polack et al. (2017), IEEE IV: the kinematic bicycle that highway-env steers.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from behaviors.profiles import Profile
from sim.compiled import in_place, shared
from sim.frames import AgentKind
from sim.scenario import IMPERFECTION, KIND_LIMITS, CarFollowing

FloatArray = NDArray[np.float64]

SPEED_FACTOR: Final = 0
TIME_HEADWAY: Final = 1
MIN_GAP: Final = 2
MAX_ACCEL: Final = 3
COMFORT_DECEL: Final = 4
POLITENESS: Final = 5
CHANGE_THRESHOLD: Final = 6
PATIENCE: Final = 7
IMPOSED_BRAKING: Final = 8
CHANGE_GAP: Final = 9
EMERGENCY_DECEL: Final = 10
STARTUP_DELAY: Final = 11
TOP_SPEED: Final = 12
FOLLOWS_KRAUSS: Final = 13

PARAMETERS: Final = 14
"""How many numbers a row has."""

_free_acceleration = shared(driver_models.idm_free_acceleration)
_desired_gap = shared(driver_models.idm_desired_gap)
_interaction = shared(driver_models.idm_interaction)
_safe_speed = shared(driver_models.krauss_safe_speed)
_incentive = shared(driver_models.mobil_incentive)
_safe = shared(driver_models.mobil_safe)

KRAUSS_STEP_S: Final = 0.1
"""Krauss's speed is reached within this, s: the longest step of either engine."""

CHANGE_GAIN_MPS2: Final = 0.2
"""MOBIL's threshold of an average driver, m/s2 (highway-env's; Kesting et al. use 0.1)."""

IMPOSED_BRAKING_MPS2: Final = 2.0
"""Braking that an average driver imposes on a new follower at most, m/s2 (highway-env's)."""

MOST_IMPOSED_MPS2: Final = 6.0
"""The most braking that any driver imposes, m/s2 (hard braking without locking wheels)."""

LEAST_CHANGE_GAP_M: Final = 0.5
"""The smallest gap that any driver changes into, m."""

WORTH_MPS2: Final = 0.15
"""A driver takes a lane whose leader it will soon reach only if that leader is faster than the
present one by this times the driver's patience."""

STOP_MARGIN_M: Final = 1.0
"""A driver comes to rest this far before a stop line or a crossing, m."""

BRAKING_RESERVE: Final = 2.0
"""A driver brakes harder than comfortably only as far as the distance left demands, times this (IDM
alone brakes to a standstill whenever someone cuts in)."""

RANGE_M: Final = 80.0
"""Drivers attend to junctions and crossings within this distance (6 s at 14 m/s)."""

RANGE_S: Final = 4.0
"""They do so at least this long before they come there, s (from 20 m/s on, farther away)."""

RESERVE: Final = 1.25
"""They do so at least within their comfortable braking distance times this."""

STANDING_MPS: Final = 0.2
"""A slower vehicle counts as standing, m/s."""

LATERAL_GAIN_PER_S: Final = 1.0 / 0.6
"""Lateral speed wanted per metre from the lane's centre (highway-env's KP_LATERAL)."""

LATERAL_SPEED_MPS: Final = 1.5
"""Largest lateral speed, m/s: a lane change takes about 3 s (as in the SUMO engine)."""

HEADING_GAIN_PER_S: Final = 5.0
"""Heading rate wanted per radian of error (highway-env's KP_HEADING)."""

MAX_STEERING_RAD: Final = math.pi / 3
"""highway-env's MAX_STEERING_ANGLE."""

CUT_IN_REAR_M: Final = (2.0, 15.0)
"""Least and largest bumper gap to the vehicle that a driver cuts in front of, m."""

UNSEEN_S: Final = 1.0
"""Others see a vehicle on its new lane this long after it began to change, s: it is then 0.6 m
aside."""

CUT_IN_BRAKING_MPS2: Final = 4.0
"""The most braking that a cut-in may demand of either driver, m/s2."""


class Leader(NamedTuple):
    """The vehicle ahead on a lane.

    Attributes:
        gap: bumper to bumper, m; infinite if there is none.
        speed: along the lane, m/s.
    """

    gap: float
    speed: float


class Follower(NamedTuple):
    """The vehicle behind on a lane.

    Attributes:
        driver: its driver's parameters.
        speed: along the lane, m/s.
        desired: the speed that it wants, m/s.
        gap: bumper to bumper to the vehicle that may change lanes, m; infinite if there is none.
        front_gap: to the vehicle ahead of that one on the follower's lane, m.
    """

    driver: FloatArray
    speed: float
    desired: float
    gap: float
    front_gap: float


def driver_parameters(profile: Profile, kind: AgentKind, law: CarFollowing = "IDM") -> FloatArray:
    """One driver's parameters as the row that the functions of this module read.

    Args:
        profile: the driver's behaviour.
        kind: of vehicle, whose physics limit the driver.
        law: the car-following law that the driver uses.

    Returns:
        (14,) read-only.
    """
    limits = KIND_LIMITS[kind]
    gain = profile.lane_change_gain
    assertive = profile.lane_change_assertiveness
    row = np.array(
        [
            profile.speed_factor,
            profile.time_headway_s,
            profile.min_gap_m,
            profile.max_accel_mps2,
            profile.comfort_decel_mps2,
            profile.politeness,
            CHANGE_GAIN_MPS2 / gain if gain > 0 else math.inf,
            profile.lane_change_patience_s,
            min(IMPOSED_BRAKING_MPS2 * assertive, MOST_IMPOSED_MPS2),
            max(profile.min_gap_m / max(assertive, 1e-9), LEAST_CHANGE_GAP_M),
            max(limits.emergency_decel_mps2, profile.comfort_decel_mps2),
            profile.startup_delay_s,
            min(limits.max_speed_mps, limits.cruise_mps * profile.speed_factor),
            law == "Krauss",
        ]
    )
    row.flags.writeable = False
    return row


DEFAULT_PARAMETERS: Final = driver_parameters(
    Profile(
        speed_factor=1.0, time_headway_s=1.5, min_gap_m=2.0, max_accel_mps2=3.0,
        comfort_decel_mps2=5.0, politeness=0.0, lane_change_gain=1.0,
        lane_change_patience_s=0.0, lane_change_assertiveness=1.0, gap_acceptance_s=1.0,
        crossing_gap_s=10.0, yield_probability=1.0, red_run_probability=0.0,
        stop_roll_probability=0.0, yellow_run_s=0.0, insistence=0.0, startup_delay_s=0.0,
        cut_in_rate_per_min=0.0, stop_rate_per_min=0.0, wrong_way_rate_per_min=0.0,
    ),
    AgentKind.CAR,
)  # fmt: skip
"""The driver parameters that others assume of a vehicle without a profile: highway-env's own."""


@in_place()
def idm(driver: FloatArray, speed: float, desired: float, gap: float, leader_speed: float) -> float:
    """IDM's acceleration, m/s2, bumper to bumper, not bounded below.

    Args:
        driver: the driver's parameters.
        speed: own speed, m/s.
        desired: speed wanted on a free road, m/s.
        gap: bumper to bumper, m; infinite without leader.
        leader_speed: along the own lane, m/s.
    """
    accel = driver[MAX_ACCEL]
    free = _free_acceleration(speed, desired, accel)
    if gap == np.inf:
        return float(free)
    wanted = _desired_gap(
        speed, leader_speed, driver[MIN_GAP], driver[TIME_HEADWAY], accel, driver[COMFORT_DECEL]
    )
    return float(free - accel * _interaction(gap, wanted))


@in_place()
def krauss(
    driver: FloatArray, speed: float, desired: float, room: float, leader_speed: float
) -> float:
    """Krauss's acceleration, m/s2, not bounded below and before dawdling.

    Args:
        driver: the driver's parameters.
        speed: own speed, m/s.
        desired: speed wanted on a free road, m/s.
        room: bumper gap beyond the one at a standstill, m; infinite without a leader.
        leader_speed: along the own lane, m/s.
    """
    goal = desired
    if room < np.inf:
        safe = _safe_speed(room, leader_speed, driver[TIME_HEADWAY], driver[COMFORT_DECEL])
        goal = min(goal, safe)
    return float(min(driver[MAX_ACCEL], (goal - speed) / KRAUSS_STEP_S))


@in_place()
def dawdling(driver: FloatArray, speed: float, chance: float) -> float:
    """The acceleration that a driver with Krauss's law loses at random, m/s2 (as in SUMO).

    Args:
        driver: the driver's parameters.
        speed: m/s; dawdling never makes it negative.
        chance: drawn uniformly from 0 to 1.
    """
    return float(IMPERFECTION * chance * min(driver[MAX_ACCEL], speed / KRAUSS_STEP_S))


@in_place()
def bounded(driver: FloatArray, wanted: float, gap: float, closing: float) -> float:
    """Bound a deceleration by the comfortable one or, if greater, by what the gap demands.

    Args:
        driver: the driver's parameters.
        wanted: acceleration by the driver's law, m/s2.
        gap: distance left, m.
        closing: own speed minus that of what is ahead, m/s.
    """
    limit = driver[COMFORT_DECEL]
    if closing > 0.0:
        limit = max(limit, BRAKING_RESERVE * closing * closing / (2.0 * max(gap, 0.1)))
    return float(max(wanted, -min(limit, driver[EMERGENCY_DECEL])))


@in_place()
def follow(
    driver: FloatArray, speed: float, desired: float, gap: float, leader_speed: float
) -> float:
    """The acceleration behind a leader by the driver's law, m/s2; arguments as for `idm`."""
    if driver[FOLLOWS_KRAUSS]:
        raw = krauss(driver, speed, desired, gap - driver[MIN_GAP], leader_speed)
    else:
        raw = idm(driver, speed, desired, gap, leader_speed)
    return bounded(driver, raw, gap, speed - leader_speed)


@in_place()
def approach(driver: FloatArray, speed: float, gap: float) -> float:
    """The acceleration towards a line at which to stop, m/s2.

    The driver's law behind a standing obstacle, with `STOP_MARGIN_M` as the gap at a standstill.

    Args:
        driver: the driver's parameters.
        speed: m/s.
        gap: front bumper to the line, m.
    """
    if driver[FOLLOWS_KRAUSS]:
        raw = krauss(driver, speed, np.inf, gap - STOP_MARGIN_M, 0.0)
    else:
        accel = driver[MAX_ACCEL]
        braking = _desired_gap(speed, 0.0, 0.0, 0.0, accel, driver[COMFORT_DECEL])  # its last term
        wanted = STOP_MARGIN_M + speed * min(driver[TIME_HEADWAY], 1.5) + braking
        raw = accel * (1.0 - _interaction(gap, wanted))
    return bounded(driver, raw, gap - 0.5 * STOP_MARGIN_M, speed)


@in_place()
def start_up(
    driver: FloatArray, speed: float, accel: float, clock: float, go_at: float
) -> tuple[float, float]:
    """Hold a standing vehicle back for its driver's start-up delay.

    Args:
        driver: the driver's parameters.
        speed: m/s.
        accel: acceleration wanted, m/s2.
        clock: the time now, s.
        go_at: when it may start, s; infinite while it has no reason to.

    Returns:
        The acceleration, and the new ``go_at``.
    """
    if speed > STANDING_MPS:
        return accel, np.inf
    if accel <= 0.0:
        return accel, np.inf
    if go_at == np.inf:
        go_at = clock + driver[STARTUP_DELAY]
    return (accel if clock >= go_at else 0.0), go_at


@in_place()
def change_incentive(
    driver: FloatArray,
    speed: float,
    desired: float,
    leader: Leader,
    new_leader: Leader,
    follower: Follower,
    new_follower: Follower,
) -> float:
    """MOBIL's incentive for a lane change beyond the driver's threshold, m/s2.

    All accelerations in it are IDM's, whatever law the drivers follow by.

    Args:
        driver: the driver's parameters.
        speed: own speed, m/s.
        desired: speed wanted, m/s.
        leader: ahead on the present lane.
        new_leader: ahead on the other lane.
        follower: behind on the present lane.
        new_follower: behind on the other lane.

    Returns:
        Positive if the change is wanted and safe; minus infinity if it is not safe, or not worth
        while because the new leader will soon be reached.
    """
    threshold = driver[CHANGE_THRESHOLD]
    if threshold == np.inf:
        return -np.inf
    if new_leader.gap < driver[CHANGE_GAP] or new_follower.gap < driver[CHANGE_GAP]:
        return -np.inf
    if new_leader.gap < np.inf and new_leader.speed < desired:
        lasts = new_leader.gap / (desired - new_leader.speed)
        least = leader.speed + WORTH_MPS2 * driver[PATIENCE]
        better = leader.gap < np.inf and new_leader.speed > least
        if lasts < driver[PATIENCE] and not better:
            return -np.inf
    after = idm(driver, speed, desired, new_leader.gap, new_leader.speed)
    if not _safe(after, driver[IMPOSED_BRAKING]):
        return -np.inf
    own_gain = after - idm(driver, speed, desired, leader.gap, leader.speed)
    new_gain = old_gain = 0.0
    if new_follower.gap < np.inf:
        one = new_follower
        imposed = idm(one.driver, one.speed, one.desired, one.gap, speed)
        if not _safe(imposed, driver[IMPOSED_BRAKING]):
            return -np.inf
        before = idm(one.driver, one.speed, one.desired, one.front_gap, new_leader.speed)
        new_gain = imposed - before
    if follower.gap < np.inf:
        one = follower
        freed = idm(one.driver, one.speed, one.desired, one.front_gap, leader.speed)
        old_gain = freed - idm(one.driver, one.speed, one.desired, one.gap, speed)
    incentive = _incentive(own_gain, new_gain, old_gain, driver[POLITENESS])
    return float(incentive - threshold)


@in_place()
def may_cut_in(
    driver: FloatArray,
    speed: float,
    new_gap: float,
    new_speed: float,
    rear_gap: float,
    rear_speed: float,
) -> bool:
    """Whether there is a vehicle to cut in front of, and enough room to do so.

    Args:
        driver: the driver's parameters.
        speed: own speed, m/s.
        new_gap: to the leader on the other lane, m.
        new_speed: that leader's speed, m/s.
        rear_gap: from the follower on the other lane, m.
        rear_speed: that follower's speed, m/s.
    """
    if rear_gap < CUT_IN_REAR_M[0] or rear_gap > CUT_IN_REAR_M[1]:
        return False
    if new_gap < max(2.0 * driver[CHANGE_GAP], CUT_IN_REAR_M[0]):
        return False
    behind = max(rear_speed - speed, 0.0)
    ahead = max(speed - new_speed, 0.0) if new_gap < np.inf else 0.0
    left, left_ahead = rear_gap - UNSEEN_S * behind, new_gap - UNSEEN_S * ahead
    if left < 0.0 or behind * behind > 2.0 * CUT_IN_BRAKING_MPS2 * left:
        return False
    return left_ahead > 0.0 and ahead * ahead <= 2.0 * CUT_IN_BRAKING_MPS2 * left_ahead


@in_place()
def steer(
    lateral: float,
    lane_heading: float,
    curvature: float,
    heading: float,
    speed: float,
    length: float,
) -> float:
    """The steering angle that keeps to a lane, rad.

    highway-env's cascade: lateral position to heading, heading to heading rate, heading rate to
    angle. Differs from it: in a bend the body's middle moves at a slip angle to the body, which is
    corrected for; without that, vehicles cut tight turns by most of a metre.

    Args:
        lateral: distance to the right of the lane's centre, m.
        lane_heading: the lane's heading, rad.
        curvature: the lane's, rad/m, clockwise.
        heading: own heading, rad.
        speed: m/s.
        length: of the vehicle, m.
    """
    nonzero = speed if abs(speed) > 1e-2 else (1e-2 if speed >= 0.0 else -1e-2)
    half = length / 2.0
    aside = min(max(-LATERAL_GAIN_PER_S * lateral, -LATERAL_SPEED_MPS), LATERAL_SPEED_MPS)
    turn = math.asin(min(max(aside / nonzero, -1.0), 1.0))
    slip = math.asin(min(max(half * curvature, -0.9), 0.9))
    wanted = lane_heading - slip + min(max(turn, -math.pi / 4), math.pi / 4)
    off = (wanted - heading + math.pi) % (2.0 * math.pi) - math.pi
    bend = curvature + HEADING_GAIN_PER_S * off / nonzero
    angle = math.atan(2.0 * math.tan(math.asin(min(max(half * bend, -1.0), 1.0))))
    return min(max(angle, -MAX_STEERING_RAD), MAX_STEERING_RAD)


@in_place(inner=True)
def desired_speed(driver: FloatArray, limit: float, cap: float) -> float:
    """The speed wanted on a free road, m/s."""
    return float(min(min(driver[SPEED_FACTOR] * limit, driver[TOP_SPEED]), cap))


@in_place(inner=True)
def attention_m(driver: FloatArray, speed: float) -> float:
    """How far ahead a driver attends to junctions and crossings, m."""
    braking = RESERVE * speed * speed / (2.0 * driver[COMFORT_DECEL])
    return float(max(RANGE_M, RANGE_S * speed, braking))


@in_place(inner=True)
def can_stop(speed: float, distance: float, decel: float) -> bool:
    """Whether braking with ``decel``, m/s2, ends within a distance, m."""
    return speed * speed <= 2.0 * decel * max(distance, 0.05)
