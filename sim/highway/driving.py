"""The equations every driver drives by, compiled.

The same functions serve the vehicle objects, one at a time, and the loops over everybody on a
straight road (`decide`, `move`), so the two cannot drift apart. The loops are in this file and not
beside their caller because numba's cache looks at a function's own file only. A driver's numbers
are one row, laid out by the indices below (`driver_numbers` makes it from a `Profile`).

References:
    Treiber, Hennecke, Helbing (2000), Phys. Rev. E 62, 1805: IDM.
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08: his law.
    Kesting, Treiber, Helbing (2007), Transportation Research Record 1999, 86: MOBIL.
    Polack et al. (2017), IEEE IV: the kinematic bicycle; highway-env's steering cascade.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from behaviors.profiles import Profile
from sim.compiled import compiled, shared
from sim.frames import AgentKind
from sim.scenario import IMPERFECTION, KIND_LIMITS, CarFollowing

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

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
"""Nobody imposes more than this, m/s2 (our choice: hard braking without locking wheels)."""

LEAST_CHANGE_GAP_M: Final = 0.5
"""Nobody changes into a smaller gap than this, m (our choice)."""

WORTH_MPS2: Final = 0.15
"""A lane that soon comes up against a slower leader is taken all the same if that one is faster
than the present leader by this times the driver's patience (our choice)."""

STOP_MARGIN_M: Final = 1.0
"""How far before a stop line or a crossing one comes to rest, m (our choice)."""

BRAKING_RESERVE: Final = 2.0
"""Nobody brakes harder than comfortably unless the distance left demands it with this factor to
spare (our choice: IDM alone brakes to a standstill whenever someone cuts in)."""

STANDING_MPS: Final = 0.2
"""Below this a vehicle stands (our choice)."""

LATERAL_GAIN_PER_S: Final = 1.0 / 0.6
"""Lateral speed wanted per metre off the lane's centre (highway-env's KP_LATERAL)."""

LATERAL_SPEED_MPS: Final = 1.5
"""Largest lateral speed, m/s: a lane change takes about 3 s (our choice, as in SUMO's runs)."""

HEADING_GAIN_PER_S: Final = 5.0
"""Heading rate wanted per radian off (highway-env's KP_HEADING)."""

MAX_STEERING_RAD: Final = math.pi / 3
"""highway-env's MAX_STEERING_ANGLE."""

CUT_IN_REAR_M: Final = (2.0, 15.0)
"""Bumper gap to the one cut in front of, m: nearer is a collision, farther is no cut-in (our
choice)."""

UNSEEN_S: Final = 1.0
"""It takes this long until one who changes lanes is seen on the new one, s (0.6 m aside)."""

CUT_IN_BRAKING_MPS2: Final = 4.0
"""Braking that a cut-in may demand of either party at once, m/s2 (our choice)."""


def driver_numbers(profile: Profile, kind: AgentKind, law: CarFollowing = "IDM") -> FloatArray:
    """One driver's numbers as the row that the equations read.

    Args:
        profile: what the driver wants and dares.
        kind: what is driven; its physics limit the driver.
        law: the one by which it follows.

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


@compiled
def idm(driver: FloatArray, speed: float, desired: float, gap: float, leader_speed: float) -> float:
    """IDM's acceleration, m/s2, bumper to bumper, not bounded below.

    Args:
        driver: the driver's numbers.
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


@compiled
def krauss(
    driver: FloatArray, speed: float, desired: float, room: float, leader_speed: float
) -> float:
    """Krauss's acceleration, m/s2, not bounded below and before his dawdling.

    The speed from which one stops behind the leader, should both brake comfortably and oneself
    begin a headway later (Krauss 1998, eq. 3.2, as SUMO has it).

    Args:
        driver: the driver's numbers.
        speed: own speed, m/s.
        desired: speed wanted on a free road, m/s.
        room: bumper gap beyond the smallest one, m; infinite without leader.
        leader_speed: along the own lane, m/s.
    """
    goal = desired
    if room < np.inf:
        safe = _safe_speed(room, leader_speed, driver[TIME_HEADWAY], driver[COMFORT_DECEL])
        goal = min(goal, safe)
    return float(min(driver[MAX_ACCEL], (goal - speed) / KRAUSS_STEP_S))


def dawdling(driver: FloatArray, speed: float, chance: float) -> float:
    """By how much a driver who follows by Krauss's law falls short, m/s2 (as in SUMO).

    Args:
        driver: the driver's numbers.
        speed: m/s; nobody is slowed below standing.
        chance: drawn evenly from 0 to 1.
    """
    return IMPERFECTION * chance * min(float(driver[MAX_ACCEL]), speed / KRAUSS_STEP_S)


@compiled
def bounded(driver: FloatArray, wanted: float, gap: float, closing: float) -> float:
    """An acceleration no lower than comfort or, with a reserve, the distance left demands."""
    limit = driver[COMFORT_DECEL]
    if closing > 0.0:
        limit = max(limit, BRAKING_RESERVE * closing * closing / (2.0 * max(gap, 0.1)))
    return float(max(wanted, -min(limit, driver[EMERGENCY_DECEL])))


@compiled
def follow(
    driver: FloatArray, speed: float, desired: float, gap: float, leader_speed: float
) -> float:
    """The acceleration behind a leader by the driver's law, m/s2; arguments as of `idm`."""
    if driver[FOLLOWS_KRAUSS]:
        raw = krauss(driver, speed, desired, gap - driver[MIN_GAP], leader_speed)
    else:
        raw = idm(driver, speed, desired, gap, leader_speed)
    return bounded(driver, raw, gap, speed - leader_speed)


@compiled
def approach(driver: FloatArray, speed: float, gap: float) -> float:
    """The acceleration towards a line at which to stop, m/s2.

    The driver's law behind a standing obstacle whose minimal gap is `STOP_MARGIN_M` instead of the
    driver's.

    Args:
        driver: the driver's numbers.
        speed: m/s.
        gap: front bumper to the line, m.
    """
    if driver[FOLLOWS_KRAUSS]:
        raw = krauss(driver, speed, np.inf, gap - STOP_MARGIN_M, 0.0)
    else:
        accel = driver[MAX_ACCEL]
        braking = _desired_gap(speed, 0.0, 0.0, 0.0, accel, driver[COMFORT_DECEL])
        wanted = STOP_MARGIN_M + speed * min(driver[TIME_HEADWAY], 1.5) + braking
        raw = accel * (1.0 - _interaction(gap, wanted))
    return bounded(driver, raw, gap - 0.5 * STOP_MARGIN_M, speed)


@compiled
def start_up(
    driver: FloatArray, speed: float, accel: float, clock: float, go_at: float
) -> tuple[float, float]:
    """Hold a standing vehicle back for its driver's start-up delay.

    Args:
        driver: the driver's numbers.
        speed: m/s.
        accel: acceleration wanted, m/s2.
        clock: the time now, s.
        go_at: when it may go, s; infinite while there is no cause to.

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


@compiled
def change_incentive(
    driver: FloatArray,
    speed: float,
    desired: float,
    old_gap: float,
    old_speed: float,
    new_gap: float,
    new_speed: float,
    rear: FloatArray,
    rear_speed: float,
    rear_desired: float,
    rear_gap: float,
    rear_front_gap: float,
    old_rear: FloatArray,
    old_rear_speed: float,
    old_rear_desired: float,
    old_rear_gap: float,
    old_rear_front_gap: float,
) -> float:
    """MOBIL's advantage of a lane change beyond the driver's threshold, m/s2.

    Gaps are bumper to bumper and infinite where there is nobody.

    Args:
        driver: the driver's numbers.
        speed: own speed, m/s.
        desired: speed wanted, m/s.
        old_gap: to the leader on the present lane, m.
        old_speed: that leader's speed, m/s.
        new_gap: to the leader on the other lane, m.
        new_speed: that leader's speed, m/s.
        rear: the new follower's numbers.
        rear_speed: its speed, m/s.
        rear_desired: the speed it wants, m/s.
        rear_gap: from it to this vehicle, m.
        rear_front_gap: from it to the leader on the other lane, m.
        old_rear: the present follower's numbers.
        old_rear_speed: its speed, m/s.
        old_rear_desired: the speed it wants, m/s.
        old_rear_gap: from it to this vehicle, m.
        old_rear_front_gap: from it to the leader on the present lane, m.

    Returns:
        Positive if the change is wanted and safe; minus infinity if it is not safe.
    """
    threshold = driver[CHANGE_THRESHOLD]
    if threshold == np.inf:
        return -np.inf
    if new_gap < driver[CHANGE_GAP] or rear_gap < driver[CHANGE_GAP]:
        return -np.inf
    if new_gap < np.inf and new_speed < desired:
        lasts = new_gap / (desired - new_speed)
        better = old_gap < np.inf and new_speed > old_speed + WORTH_MPS2 * driver[PATIENCE]
        if lasts < driver[PATIENCE] and not better:
            return -np.inf
    after = idm(driver, speed, desired, new_gap, new_speed)
    if not _safe(after, driver[IMPOSED_BRAKING]):
        return -np.inf
    own_gain = after - idm(driver, speed, desired, old_gap, old_speed)
    rear_gain = old_rear_gain = 0.0
    if rear_gap < np.inf:
        imposed = idm(rear, rear_speed, rear_desired, rear_gap, speed)
        if not _safe(imposed, driver[IMPOSED_BRAKING]):
            return -np.inf
        rear_gain = imposed - idm(rear, rear_speed, rear_desired, rear_front_gap, new_speed)
    if old_rear_gap < np.inf:
        old_rear_gain = idm(
            old_rear, old_rear_speed, old_rear_desired, old_rear_front_gap, old_speed
        ) - idm(old_rear, old_rear_speed, old_rear_desired, old_rear_gap, speed)
    incentive = _incentive(own_gain, rear_gain, old_rear_gain, driver[POLITENESS])
    return float(incentive - threshold)


@compiled
def may_cut_in(
    driver: FloatArray,
    speed: float,
    new_gap: float,
    new_speed: float,
    rear_gap: float,
    rear_speed: float,
) -> bool:
    """Whether there is someone to cut in front of, and room for it; arguments as above."""
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


@compiled
def steer(
    lateral: float,
    lane_heading: float,
    curvature: float,
    heading: float,
    speed: float,
    length: float,
) -> float:
    """The steering angle that keeps to a lane, rad.

    highway-env's cascade (lateral place to heading, heading to heading rate, heading rate to
    angle). Differs from it: in a bend the body's middle moves at a slip angle to the body, which
    is allowed for; without that a tight turn is cut by most of a metre.

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


@compiled
def _search(
    i: int,
    lane: int,
    order: IntArray,
    count: IntArray,
    s: FloatArray,
    along: FloatArray,
    length: FloatArray,
    sight: float,
) -> tuple[int, float, float, int, float, float]:
    """Who is ahead of and behind a vehicle on a lane: row, bumper gap and speed of both."""
    here = s[i, lane]
    low, high = 0, count[lane]
    while low < high:
        middle = (low + high) // 2
        if s[order[lane, middle], lane] < here:
            low = middle + 1
        else:
            high = middle
    front, front_gap, front_speed = -1, np.inf, 0.0
    at = low
    while at < count[lane] and order[lane, at] == i:
        at += 1
    if at < count[lane]:
        j = order[lane, at]
        gap = -here + s[j, lane] - (length[i] + length[j]) / 2
        if gap < sight:
            front, front_gap, front_speed = j, gap, along[j, lane]
    rear, rear_gap, rear_speed = -1, np.inf, 0.0
    at = low - 1
    while at >= 0 and order[lane, at] == i:
        at -= 1
    if at >= 0:
        j = order[lane, at]
        rear, rear_gap = j, here - s[j, lane] - (length[i] + length[j]) / 2
        rear_speed = along[j, lane]
    return front, front_gap, front_speed, rear, rear_gap, rear_speed


@compiled
def _wanted_by(row: int, numbers: FloatArray, limit: float) -> float:
    if row < 0:
        return 0.0
    return float(min(numbers[row, SPEED_FACTOR] * limit, numbers[row, TOP_SPEED]))


@compiled
def decide(
    active: BoolArray,
    eligible: BoolArray,
    cutting_in: BoolArray,
    stopping: BoolArray,
    order: IntArray,
    count: IntArray,
    s: FloatArray,
    lateral: FloatArray,
    along: FloatArray,
    length: FloatArray,
    speed: FloatArray,
    heading: FloatArray,
    lane: IntArray,
    target: IntArray,
    numbers: FloatArray,
    default: FloatArray,
    stop_gap: FloatArray,
    speed_cap: FloatArray,
    clock: FloatArray,
    go_at: FloatArray,
    limit: FloatArray,
    lane_heading: float,
    sight: float,
    wanted: IntArray,
    steering: FloatArray,
    accel: FloatArray,
    cut_in: BoolArray,
) -> None:
    """Fill ``wanted``, ``steering``, ``accel``, ``go_at`` and ``cut_in`` of the active rows."""
    n, lanes = s.shape
    for i in range(n):
        if not active[i]:
            continue
        driver, mine, v = numbers[i], lane[i], speed[i]
        desired = min(driver[SPEED_FACTOR] * limit[mine], driver[TOP_SPEED], speed_cap[i])
        _, gap, ahead, rear, rear_gap, rear_speed = _search(
            i, mine, order, count, s, along, length, sight
        )
        choice = mine
        if target[i] != mine:
            choice = target[i]
            for j in range(n):
                if j == i or not active[j] or target[j] != target[i] or lane[j] == target[i]:
                    continue
                beyond = s[j, mine] - s[i, mine]
                room = beyond - (length[i] + length[j]) / 2
                if beyond > 0.0 and room < driver[CHANGE_GAP] + v * 0.5:
                    choice = mine
                    break
        elif eligible[i]:
            most = 0.0
            for side in (mine - 1, mine + 1):
                if side < 0 or side >= lanes:
                    continue
                _, new_gap, new_speed, new_rear, new_rear_gap, new_rear_speed = _search(
                    i, side, order, count, s, along, length, sight
                )
                if cutting_in[i] and may_cut_in(
                    driver, v, new_gap, new_speed, new_rear_gap, new_rear_speed
                ):
                    choice = side
                    cut_in[i] = True
                    break
                gain = change_incentive(
                    driver,
                    v,
                    desired,
                    gap,
                    ahead,
                    new_gap,
                    new_speed,
                    numbers[new_rear] if new_rear >= 0 else default,
                    new_rear_speed,
                    _wanted_by(new_rear, numbers, limit[mine]),
                    new_rear_gap,
                    new_rear_gap + length[i] + new_gap,
                    numbers[rear] if rear >= 0 else default,
                    rear_speed,
                    _wanted_by(rear, numbers, limit[mine]),
                    rear_gap,
                    rear_gap + length[i] + gap,
                )
                if gain > most:
                    choice, most = side, gain
        a = follow(driver, v, desired, gap, ahead)
        if choice != mine:
            _, new_gap, new_speed, _, _, _ = _search(
                i, choice, order, count, s, along, length, sight
            )
            a = min(a, follow(driver, v, desired, new_gap, new_speed))
        if stop_gap[i] < np.inf:
            a = min(a, approach(driver, v, stop_gap[i]))
        if stopping[i]:
            a = min(a, -driver[COMFORT_DECEL])
        a, go_at[i] = start_up(driver, v, a, clock[i], go_at[i])
        wanted[i], accel[i] = choice, a
        steering[i] = steer(lateral[i, choice], lane_heading, 0.0, heading[i], v, length[i])


@compiled
def move(
    mask: BoolArray,
    crashed: BoolArray,
    xy: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    steering: FloatArray,
    accel: FloatArray,
    most: float,
    dt: float,
) -> None:
    """highway-env's kinematic bicycle for ``dt`` seconds, in place."""
    for i in range(len(mask)):
        if not mask[i]:
            continue
        angle, a, v = steering[i], accel[i], speed[i]
        if crashed[i]:
            angle, a = 0.0, -v
        if v > most:
            a = min(a, most - v)
        slip = math.atan(0.5 * math.tan(angle))
        xy[i, 0] += v * math.cos(heading[i] + slip) * dt
        xy[i, 1] += v * math.sin(heading[i] + slip) * dt
        heading[i] += v * math.sin(slip) / (length[i] / 2.0) * dt
        speed[i] = max(v + a * dt, 0.0)
