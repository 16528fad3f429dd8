"""How a driver of the highway engine accelerates, changes lanes and steers, and its random draws.

The laws themselves are those of `behaviors.driver_models`. Drivers are rows of
`sim.highway.state.VEHICLE`; `profile_fields` says what a profile sets in them.

A draw is a hash of the driver's key, of what is drawn, and of its number: which junction path,
which crossing, or how many such draws the driver has made before. So draws depend on the driver and
the encounter alone, whatever happens in between.

References:
    Steele, Lea, Flood (2014), Fast splittable pseudorandom number generators, OOPSLA: the mixing
        function of SplitMix64.
    Polack et al. (2017), IEEE IV: the kinematic bicycle that highway-env steers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from behaviors import driver_models
from behaviors.profiles import Profile
from sim.compiled import in_place, shared
from sim.frames import AgentKind
from sim.highway.state import KINDS_DRAWN, VEHICLE, Records, blank_vehicles
from sim.scenario import KIND_LIMITS, AgentSpec, CarFollowing

_free_acceleration = shared(driver_models.idm_free_acceleration)
_desired_gap = shared(driver_models.idm_desired_gap)
_interaction = shared(driver_models.idm_interaction)
safe_speed = shared(driver_models.krauss_safe_speed)
_incentive = shared(driver_models.mobil_incentive)
_safe = shared(driver_models.mobil_safe)

KRAUSS_STEP_S: Final = 0.1
"""Krauss's speed is reached within this, s: the longest step of either engine."""

CHANGE_GAIN_MPS2, IMPOSED_BRAKING_MPS2, MOST_IMPOSED_MPS2 = 0.2, 2.0, 6.0
"""MOBIL's threshold of an average driver (highway-env's; Kesting et al. use half of it); the
braking that it imposes on a new follower at most (highway-env's); the most that any driver imposes
(hard braking without locking wheels)."""

LEAST_CHANGE_GAP_M, WORTH_MPS2 = 0.5, 0.15
"""The smallest gap that any driver changes into, m. A driver takes a lane whose leader it will soon
reach only if that leader is faster than the present one by this times the driver's patience."""

STOP_MARGIN_M, BRAKING_RESERVE = 1.0, 2.0
"""A driver comes to rest this far before a stop line or a crossing, m. It brakes harder than
comfortably only as far as the distance left demands, times this reserve (IDM alone brakes to a
standstill whenever someone cuts in)."""

RANGE_M, RANGE_S, RESERVE = 80.0, 4.0, 1.25
"""Drivers attend to junctions and crossings within the farthest of: this distance (some seconds at
an urban speed), this time, and their comfortable braking distance times this reserve."""

STANDING_MPS: Final = 0.2
"""A slower vehicle counts as standing, m/s."""

LATERAL_GAIN_PER_S, HEADING_GAIN_PER_S, MAX_STEERING_RAD = 1.0 / 0.6, 5.0, math.pi / 3
"""Lateral speed wanted per metre from the lane's centre, heading rate wanted per radian of error,
and the largest steering angle: highway-env's KP_LATERAL, KP_HEADING and MAX_STEERING_ANGLE."""

LATERAL_SPEED_MPS, GUIDED = 1.5, 0.5
"""Largest lateral speed: a lane change takes about 3 s (as in the SUMO engine). In a turn drivers
keep the point this share of half the length ahead of the middle on their way: the front swings out
about as far as the rear cuts in."""

CUT_IN_REAR_M, UNSEEN_S, CUT_IN_BRAKING_MPS2 = (2.0, 15.0), 1.0, 4.0
"""Least and largest bumper gap to the vehicle that a driver cuts in front of; how long after it
began to change others see a vehicle on its new lane (it is half a metre aside then); the most
braking that a cut-in may demand of either driver."""

TAKEN: Final = [f.name for f in dataclasses.fields(Profile) if f.name in (VEHICLE.names or ())]
"""Fields of a profile that a row has under the same names."""

(
    RUNS_RED, ROLLS, YIELDS, CUTS_IN, STOPS, STOP_LASTS, WRONG_WAY, DAWDLES, LAPSES, LAPSE_LASTS,
    ERRS, OVERLOOKS, OVERLOOKS_LIGHT,
) = range(KINDS_DRAWN)  # fmt: skip
"""What is drawn."""

RATES: Final = {
    CUTS_IN: "cut_in_rate_per_min", STOPS: "stop_rate_per_min", LAPSES: "lapse_rate_per_min",
    WRONG_WAY: "wrong_way_rate_per_min",
}  # fmt: skip
"""What happens by itself, and the field of a profile that says how often."""


class Beside(NamedTuple):
    """Vehicles ahead and behind on a lane: row or -1, bumper gap, m, speed along the lane, m/s."""

    front: int
    front_gap: float
    front_speed: float
    rear: int
    rear_gap: float
    rear_speed: float


def profile_fields(profile: Profile, kind: AgentKind, law: CarFollowing = "IDM") -> dict[str, Any]:
    """What a profile sets in a driver's row of `VEHICLE`; the kind of vehicle limits the driver."""
    limits, gain = KIND_LIMITS[kind], profile.lane_change_gain
    assertive = profile.lane_change_assertiveness
    return {
        **{name: getattr(profile, name) for name in TAKEN},
        "change_threshold": CHANGE_GAIN_MPS2 / gain if gain > 0 else math.inf,
        "imposed_braking": min(IMPOSED_BRAKING_MPS2 * assertive, MOST_IMPOSED_MPS2),
        "change_gap": max(profile.min_gap_m / max(assertive, 1e-9), LEAST_CHANGE_GAP_M),
        "emergency_decel": max(limits.emergency_decel_mps2, profile.comfort_decel_mps2),
        "top_speed": min(limits.max_speed_mps, limits.cruise_mps * profile.speed_factor),
        "krauss": law == "Krauss",
        "rate_per_min": [
            getattr(profile, RATES[kind]) if kind in RATES else 0.0 for kind in range(KINDS_DRAWN)
        ],
    }


STOCK_DRIVER: Final = Profile(
    speed_factor=1.0, time_headway_s=1.5, min_gap_m=2.0, max_accel_mps2=3.0,
    comfort_decel_mps2=5.0, politeness=0.0, lane_change_gain=1.0,
    lane_change_patience_s=0.0, lane_change_assertiveness=1.0, gap_acceptance_s=1.0,
    crossing_gap_s=10.0, yield_probability=1.0, red_run_probability=0.0,
    stop_roll_probability=0.0, yellow_run_s=0.0, insistence=0.0, startup_delay_s=0.0,
    cut_in_rate_per_min=0.0, stop_rate_per_min=0.0, wrong_way_rate_per_min=0.0,
)  # fmt: skip
"""What others assume of a vehicle without a profile: highway-env's own driver."""


def driver_rows(agents: Sequence[AgentSpec], seed: int, law: CarFollowing = "IDM") -> Records:
    """(n,) rows of `VEHICLE` of drivers that are on no road yet."""
    rows = blank_vehicles(len(agents))
    rows["profiled"] = True
    drivers = [
        {
            "agent": one.id, "kind": one.kind.code, "length": one.length_m, "width": one.width_m,
            "key": driver_key((seed, one.seed)), **profile_fields(one.profile, one.kind, law),
        }
        for one in agents
        if one.profile is not None
    ]  # fmt: skip
    for name in drivers[0] if drivers else ():
        rows[name] = [driver[name] for driver in drivers]
    _plan_first(rows)
    return rows


@in_place()
def _plan_first(rows: Records) -> None:
    for i in range(rows.size):
        for kind in range(KINDS_DRAWN):
            plan_next(rows[i], kind, 0.0)


@in_place()
def idm(me: Any, speed: float, desired: float, gap: float, leader_speed: float) -> float:
    """IDM's acceleration, m/s2, not bounded below; the bumper gap is infinite without a leader."""
    accel = me.max_accel_mps2
    free = _free_acceleration(speed, desired, accel)
    if gap == np.inf:
        return float(free)
    wanted = _desired_gap(
        speed, leader_speed, me.min_gap_m, me.time_headway_s, accel, me.comfort_decel_mps2
    )
    return float(free - accel * _interaction(gap, wanted))


@in_place()
def krauss(me: Any, speed: float, desired: float, room: float, leader_speed: float) -> float:
    """Krauss's acceleration before dawdling, m/s2; ``room`` is the gap beyond the least one, m."""
    goal = desired
    if room < np.inf:
        safe = safe_speed(room, leader_speed, me.time_headway_s, me.comfort_decel_mps2)
        goal = min(goal, safe)
    return float(min(me.max_accel_mps2, (goal - speed) / KRAUSS_STEP_S))


@in_place(inner=True)
def bounded(me: Any, wanted: float, gap: float, closing: float) -> float:
    """A deceleration bounded by the comfortable one or, if greater, by what the gap demands."""
    limit = me.comfort_decel_mps2
    if closing > 0.0:
        limit = max(limit, BRAKING_RESERVE * closing * closing / (2.0 * max(gap, 0.1)))
    return float(max(wanted, -min(limit, me.emergency_decel)))


@in_place(inner=True)
def follow(me: Any, speed: float, desired: float, gap: float, leader_speed: float) -> float:
    """The acceleration behind a leader by the driver's law, m/s2; arguments as for `idm`."""
    if me.krauss:
        raw = krauss(me, speed, desired, gap - me.min_gap_m, leader_speed)
    else:
        raw = idm(me, speed, desired, gap, leader_speed)
    return bounded(me, raw, gap, speed - leader_speed)


@in_place(inner=True)
def approach(me: Any, speed: float, gap: float) -> float:
    """The acceleration by the driver's law towards a line at which to stop, m/s2."""
    if me.krauss:
        raw = krauss(me, speed, np.inf, gap - STOP_MARGIN_M, 0.0)
    else:
        accel = me.max_accel_mps2
        braking = _desired_gap(speed, 0.0, 0.0, 0.0, accel, me.comfort_decel_mps2)
        wanted = STOP_MARGIN_M + speed * min(me.time_headway_s, 1.5) + braking
        raw = accel * (1.0 - _interaction(gap, wanted))
    return bounded(me, raw, gap - 0.5 * STOP_MARGIN_M, speed)


@in_place(inner=True)
def start_up(me: Any, accel: float) -> float:
    """The acceleration after a standing vehicle was held back for its driver's start-up delay."""
    if me.speed > STANDING_MPS or accel <= 0.0:
        me.go_at = np.inf
        return accel
    if me.go_at == np.inf:
        me.go_at = me.clock + me.startup_delay_s
    return accel if me.clock >= me.go_at else 0.0


@in_place()
def change_incentive(
    me: Any, limit: float, here: Beside, there: Beside, old: Any, new: Any
) -> float:
    """MOBIL's incentive for a lane change beyond the driver's threshold, m/s2.

    It is minus infinity if the change is not safe, or if the new leader will soon be reached. All
    accelerations are IDM's. ``old`` and ``new`` are the followers' rows, any if there is none.
    """
    speed, desired, least_gap = me.speed, desired_speed(me, limit), me.change_gap
    never = me.change_threshold == np.inf
    if never or there.front_gap < least_gap or there.rear_gap < least_gap:
        return -np.inf
    if there.front_gap < np.inf and there.front_speed < desired:
        lasts = there.front_gap / (desired - there.front_speed)
        least = here.front_speed + WORTH_MPS2 * me.lane_change_patience_s
        better = here.front_gap < np.inf and there.front_speed > least
        if lasts < me.lane_change_patience_s and not better:
            return -np.inf
    after = idm(me, speed, desired, there.front_gap, there.front_speed)
    if not _safe(after, me.imposed_braking):
        return -np.inf
    own_gain = after - idm(me, speed, desired, here.front_gap, here.front_speed)
    new_gain = old_gain = 0.0
    if there.rear_gap < np.inf:
        imposed, free = _behind(new, me, limit, there)
        if not _safe(imposed, me.imposed_braking):
            return -np.inf
        new_gain = imposed - free
    if here.rear_gap < np.inf:
        behind, free = _behind(old, me, limit, here)
        old_gain = free - behind
    incentive = _incentive(own_gain, new_gain, old_gain, me.politeness)
    return float(incentive - me.change_threshold)


@in_place(inner=True)
def _behind(rear: Any, me: Any, limit: float, there: Beside) -> tuple[float, float]:
    """IDM's accelerations of a lane's follower, m/s2: behind a driver, and without it there."""
    wanted, gap = on_free_road(rear, limit), there.rear_gap + me.length + there.front_gap
    behind = idm(rear, there.rear_speed, wanted, there.rear_gap, me.speed)
    return behind, idm(rear, there.rear_speed, wanted, gap, there.front_speed)


@in_place(inner=True)
def may_cut_in(me: Any, there: Beside) -> bool:
    """Whether there is a vehicle to cut in front of on another lane, and enough room to do so."""
    least, most = CUT_IN_REAR_M
    if not least <= there.rear_gap <= most or there.front_gap < max(2.0 * me.change_gap, least):
        return False
    behind, ahead = max(there.rear_speed - me.speed, 0.0), max(me.speed - there.front_speed, 0.0)
    ahead = ahead if there.front_gap < np.inf else 0.0
    left, left_ahead = there.rear_gap - UNSEEN_S * behind, there.front_gap - UNSEEN_S * ahead
    if left < 0.0 or behind * behind > 2.0 * CUT_IN_BRAKING_MPS2 * left:
        return False
    return left_ahead > 0.0 and ahead * ahead <= 2.0 * CUT_IN_BRAKING_MPS2 * left_ahead


@in_place(inner=True)
def steering_angle(me: Any, lateral: float, lane_heading: float, curvature: float) -> float:
    """The steering angle that keeps to a lane, rad: highway-env's cascade from place to angle.

    Differs from it: in a bend the body's middle moves at a slip angle to the body, which is
    corrected for; without that, vehicles cut tight turns by most of a metre.
    """
    nonzero, half = max(me.speed, 1e-2), me.length / 2.0
    aside = min(max(-LATERAL_GAIN_PER_S * lateral, -LATERAL_SPEED_MPS), LATERAL_SPEED_MPS)
    turn = math.asin(min(max(aside / nonzero, -1.0), 1.0))
    slip = math.asin(min(max(half * curvature, -0.9), 0.9))
    wanted = lane_heading - slip + min(max(turn, -math.pi / 4), math.pi / 4)
    off = (wanted - me.heading + math.pi) % (2.0 * math.pi) - math.pi
    bend = curvature + HEADING_GAIN_PER_S * off / nonzero
    angle = math.atan(2.0 * math.tan(math.asin(min(max(half * bend, -1.0), 1.0))))
    return min(max(angle, -MAX_STEERING_RAD), MAX_STEERING_RAD)


@in_place(inner=True)
def turning_angle(me: Any, guided: float, lateral: float, lane_heading: float) -> float:
    """The steering angle that keeps a point, ``guided`` half lengths ahead, on its way, rad."""
    aside = min(max(-LATERAL_GAIN_PER_S * lateral, -LATERAL_SPEED_MPS), LATERAL_SPEED_MPS)
    turn = math.atan2(aside, max(me.speed, LATERAL_SPEED_MPS))
    course = (lane_heading + turn - me.heading + math.pi) % (2.0 * math.pi) - math.pi
    course = min(max(course, -MAX_STEERING_RAD), MAX_STEERING_RAD)
    angle = math.atan(2.0 / (1.0 + guided) * math.tan(course))
    return min(max(angle, -MAX_STEERING_RAD), MAX_STEERING_RAD)


@in_place(inner=True)
def on_free_road(me: Any, limit: float) -> float:
    """The speed that a driver wants where only the limit and the vehicle bound it, m/s."""
    return float(min(me.speed_factor * limit, me.top_speed))


@in_place(inner=True)
def desired_speed(me: Any, limit: float) -> float:
    """The speed wanted on a free road, below the cap of the rules, m/s."""
    return float(min(on_free_road(me, limit), me.speed_cap))


@in_place(inner=True)
def attention_m(me: Any) -> float:
    """How far ahead a driver attends to junctions and crossings, m."""
    braking = RESERVE * me.speed * me.speed / (2.0 * me.comfort_decel_mps2)
    return float(max(RANGE_M, RANGE_S * me.speed, braking))


@in_place(inner=True)
def can_stop(speed: float, distance: float, decel: float) -> bool:
    """Whether braking with ``decel``, m/s2, ends within a distance, m."""
    return speed * speed <= 2.0 * decel * max(distance, 0.05)


def driver_key(seed: int | tuple[int, ...]) -> np.uint64:
    """What all draws of one driver begin with, from its seed."""
    return np.uint64(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


@in_place(inner=True)
def _mixed(state: np.uint64, number: int) -> np.uint64:
    z = state + np.uint64(0x9E3779B97F4A7C15) * np.uint64(number + 1)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(z ^ (z >> np.uint64(31)))


@in_place()
def chance(key: np.uint64, kind: int, number: int) -> float:
    """A number drawn uniformly from 0 to 1, by a driver's key, what is drawn, and its number."""
    return float(_mixed(_mixed(key, kind), number) >> np.uint64(11)) * 2.0**-53


@in_place()
def draw(me: Any, kind: int) -> float:
    """A driver's next draw of a kind, from 0 to 1."""
    me.drawn[kind] += 1
    return chance(me.key, kind, me.drawn[kind] - 1)


@in_place(inner=True)
def plan_next(me: Any, kind: int, after_s: float) -> None:
    """Draw when something that a driver does by itself happens next, after a time, s.

    Such events are a Poisson process; where the rate is 0, nothing happens.
    """
    rate, me.due[kind] = me.rate_per_min[kind], np.inf
    if rate > 0.0:
        me.due[kind] = after_s - 60.0 / rate * math.log1p(-draw(me, kind))
